/* Starts a host on Windows: the start-up of the compiler's own C library takes long to build. */
#include <corecrt_startup.h>
#include <stdlib.h>

int main(int argc, char **argv);

/* main calls it for constructors, of which C has none. */
void __main(void) {
}

void start(void) {
    _configure_narrow_argv(_crt_argv_unexpanded_arguments);
    exit(main(*__p___argc(), *__p___argv()));
}
