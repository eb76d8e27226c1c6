/* Misbehaviour of a hostile FMU in a call, selected by the environment: DEED is "<call> <deed>". Precedes
 * all other code of an FMU; `hostile.py` puts the calls of `misbehave` into its functions.
 */
#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Neither in C99 nor in its headers. */
int chdir(const char *path);
int close(int file);
int fork(void);
int getpid(void);
int mkdir(const char *path, unsigned mode);
int mkfifo(const char *path, unsigned mode);
int setsid(void);
unsigned sleep(unsigned seconds);
long write(int file, const void *bytes, size_t size);
int pthread_create(unsigned long *thread, const void *how, void *(*run)(void *), void *with);

int kill(int process, int number);
int getppid(void);
int open(const char *path, int how, ...);
int socket(int domain, int type, int protocol);
int symlink(const char *from, const char *to);
int unlink(const char *path);
int rename(const char *from, const char *to);
int chmod(const char *path, unsigned mode);
int truncate(const char *path, long size);
int execve(const char *path, char *const arguments[], char *const environment[]);
int ptrace(int request, int process, void *address, void *data);
int fcntl(int file, int command, ...);

enum { FILES = 256, PIECE = 1 << 26, SIGNALS = 64, MANY = 30, DONE = 99 };

static void *crash(void *with) {
    *(volatile int *)8 = 1;
    return with;
}

static void flee(void) {
    /* An orphaned grandchild outside the session. */
    if (fork() == 0) {
        setsid();
        if (fork() == 0) {
            FILE *file = fopen(getenv("PID_FILE"), "w");
            fprintf(file, "%d", getpid());
            fclose(file);
            sleep(1000);
        }
        exit(0);
    }
    sleep(1);
}

long syscall(long number, ...);

/* Call the system as a line of ATTACKS says, "number argument ..": p is an empty buffer, t the path TARGET. */
static long call_system(const char *line) {
    static char buffer[4096];
    long a[7] = {0};
    int count = 0;
    memset(buffer, 0, sizeof buffer);
    for (const char *word = line; *word && *word != '\n' && count < 7; count++) {
        char *end = NULL;
        a[count] = *word == 'p' ? (long)buffer : *word == 't' ? (long)getenv("TARGET") : strtol(word, &end, 0);
        word = end ? end : word + 1;
        word += *word == ' ';
    }
    return syscall(a[0], a[1], a[2], a[3], a[4], a[5], a[6]);
}

/* Write the result of each attack to standard error, or its error number. */
static int attack(const char *lines) {
    int number = 1;
    for (const char *line = lines; *line; number++) {
        errno = 0;
        const long result = call_system(line);
        if (getenv("REPORT")) {
            fprintf(stderr, "%d\n", result < 0 ? errno : 0);
        } else if (result >= 0 || errno != 1) {
            return number;
        }
        line = strchr(line, '\n') + 1;
    }
    return 0;
}

/* Try what a sandbox must refuse; return its result. */
static int attempt(const char *what) {
    const char *target = getenv("TARGET");
    unsigned long thread;
    char *const nothing[] = {NULL};
    if (strcmp(what, "read") == 0) {
        return open(target, 0);
    } else if (strcmp(what, "write") == 0) {
        return open(target, 2);
    } else if (strcmp(what, "create") == 0) {
        return open(target, 0102, 0600);
    } else if (strcmp(what, "truncate") == 0) {
        return truncate(target, 0);
    } else if (strcmp(what, "remove") == 0) {
        return unlink(target);
    } else if (strcmp(what, "move") == 0) {
        return rename(target, "mine");
    } else if (strcmp(what, "read by a link") == 0) {
        return symlink(target, "link") < 0 ? -1 : open("link", 0);
    } else if (strcmp(what, "permit") == 0) {
        return chmod(target, 0777);
    } else if (strcmp(what, "socket 1") == 0 || strcmp(what, "socket 2") == 0) {
        return socket(what[7] - '0', 1, 0);
    } else if (strcmp(what, "execute") == 0) {
        return execve("/bin/true", nothing, nothing);
    } else if (strcmp(what, "fork") == 0) {
        return fork();
    } else if (strcmp(what, "signal") == 0) {
        return kill(getppid(), 9);
    } else if (strcmp(what, "signal all") == 0) {
        return kill(-1, 9);
    } else if (strcmp(what, "signal by a file") == 0) {
        return fcntl(1, 8, getppid());
    } else if (strcmp(what, "trace") == 0) {
        return ptrace(16, getppid(), NULL, NULL);
    } else if (strcmp(what, "thread") == 0) {
        return -pthread_create(&thread, NULL, crash, NULL);
    }
    return 0;
}

static void misbehave(const char *call) {
    const char *deed = getenv("DEED");
    const size_t length = strlen(call);
    if (!deed || strncmp(deed, call, length) != 0 || deed[length] != ' ') {
        return;
    }
    deed += length + 1;
    if (strcmp(deed, "attack") == 0) {
        exit(attack(getenv("ATTACKS")));
    } else if (strcmp(deed, "exit") == 0) {
        exit(0);
    } else if (strcmp(deed, "loop") == 0) {
        signal(SIGINT, SIG_IGN);
        signal(SIGTERM, SIG_IGN);
        for (volatile unsigned i = 0;; i++) {
        }
    } else if (strncmp(deed, "try ", 4) == 0) {
        const int result = attempt(deed + 4);
        exit(result < 0 ? errno : DONE);
    } else if (strcmp(deed, "segfault") == 0) {
        crash(NULL);
    } else if (strcmp(deed, "abort") == 0) {
        abort();
    } else if (strcmp(deed, "crash beside") == 0) {
        unsigned long thread;
        pthread_create(&thread, NULL, crash, NULL);
        sleep(1000);
    } else if (strcmp(deed, "sleep") == 0) {
        sleep(1000);
    } else if (strcmp(deed, "doze") == 0) {
        sleep(1);
    } else if (strcmp(deed, "deafen") == 0) {
        for (int file = 0; file < 3; file++) {
            close(file);
        }
        for (int number = 1; number <= SIGNALS; number++) {
            signal(number, SIG_IGN);
        }
    } else if (strcmp(deed, "multiply") == 0) {
        for (int i = 0; i < MANY; i++) {
            if (fork() == 0) {
                setsid();
                signal(SIGTERM, SIG_IGN);
                sleep(1000);
            }
        }
    } else if (strcmp(deed, "litter") == 0) {
        FILE *file = fopen("litter", "w");
        fputs("mine", file);
        fclose(file);
    } else if (strcmp(deed, "chdir") == 0) {
        if (chdir("/") != 0) {
            abort();
        }
    } else if (strcmp(deed, "memory") == 0) {
        for (char *volatile piece; (piece = malloc(PIECE)) != NULL;) {
            *piece = 1;
        }
        abort();
    } else if (strcmp(deed, "file") == 0) {
        FILE *file = fopen("large", "w");
        fseek(file, 2147483647L, SEEK_SET);
        fputc(1, file);
        exit(fflush(file) == 0 ? 0 : 9);
    } else if (strcmp(deed, "hang up") == 0) {
        for (int file = 3; file < FILES; file++) {
            close(file);
        }
        sleep(1000);
    } else if (strcmp(deed, "talk") == 0) {
        const unsigned char nonsense[] = {0, 0, 0, 12, 9, 0, 0, 0, 200, 0, 0, 0, '[', '[', '[', 0};
        for (int file = 3; file < FILES; file++) {
            write(file, nonsense, sizeof nonsense);
        }
    } else if (strcmp(deed, "half a word") == 0) {
        for (int file = 3; file < FILES; file++) {
            write(file, "\0\0\0", 3);
        }
        sleep(1000);
    } else if (strcmp(deed, "dribble") == 0) {
        for (unsigned i = 0;; i++) {
            /* The length of an answer, then that answer byte by byte. */
            for (int file = 3; file < FILES; file++) {
                write(file, i == 0 ? "\0\0\1\0" : "\0", i == 0 ? 4 : 1);
            }
            sleep(1);
        }
    } else if (strcmp(deed, "flee") == 0) {
        flee();
        exit(0);
    } else if (strcmp(deed, "pull away") == 0) {
        /* A file that the other end might open after this process has ended; reading it never ends. */
        if (remove("shared") != 0 || (mkfifo("shared", 0600) != 0 && symlink("/dev/zero", "shared") != 0)) {
            abort();
        }
        exit(0);
    } else if (strcmp(deed, "fork") == 0) {
        fork(); /* both continue */
    } else if (strcmp(deed, "dig") == 0) {
        for (int i = 0; i < 1200; i++) {
            if (mkdir("d", 0700) != 0 || chdir("d") != 0) {
                abort();
            }
        }
    } else if (strcmp(deed, "flood") == 0) {
        for (int i = 0; i < 1000000; i++) {
            puts("I write and write and write.");
        }
    }
}

__attribute__((constructor)) static void loaded(void) {
    misbehave("load");
}
