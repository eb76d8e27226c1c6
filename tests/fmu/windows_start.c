/* Start-up code of a host on Windows; that of the compiler's C library takes long to build. */
#include <corecrt_startup.h>
#include <stdlib.h>

int main(int argc, char **argv);

/* Called by main for constructors, which C lacks. */
void __main(void) {
}

void start(void) {
    _configure_narrow_argv(_crt_argv_unexpanded_arguments);
    exit(main(*__p___argc(), *__p___argv()));
}
