/* Preloaded into a process: lets the n-th call that touches a watched folder fail, or kills the
   process there. Calls are counted, and recorded if a file for the record is given. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

#define PATH_SIZE 8192

static pid_t armed_process = 0;
static long calls_left = -1; /* until the fault */
static int fault_code = 0;   /* 0 kills */
static int record = -1;
static char watched[PATH_SIZE];

/* Arms this process, not its children. `point` is the number of the call from 0, -1 for none. */
void arm_fault(const char *folder, long point, int code, int record_handle)
{
    strncpy(watched, folder, sizeof(watched) - 1);
    calls_left = point;
    fault_code = code;
    record = record_handle;
    armed_process = getpid();
}

static const char *name_of_handle(int handle, char *buffer)
{
    char link[64];
    snprintf(link, sizeof(link), "/proc/self/fd/%d", handle);
    const ssize_t length = readlink(link, buffer, PATH_SIZE - 1);
    buffer[length > 0 ? length : 0] = '\0';
    return buffer;
}

/* Returns whether the call has to fail; `path` may be NULL for a call on an open file. */
static int fails(const char *call, int folder, const char *path)
{
    char place[PATH_SIZE] = "";
    char text[3 * PATH_SIZE];
    if (armed_process == 0 || armed_process != getpid())
        return 0;
    if (path != NULL && path[0] == '/')
        strncpy(place, path, sizeof(place) - 1);
    else if (folder == AT_FDCWD)
        syscall(SYS_getcwd, place, sizeof(place));
    else
        name_of_handle(folder, place);
    if (strncmp(place, watched, strlen(watched)) != 0)
        return 0;
    if (record >= 0) {
        const int relative = path != NULL && path[0] != '/';
        const int length = snprintf(text, sizeof(text), "%s %s%s%s\n", call, place,
                                    relative ? "/" : "", relative ? path : "");
        syscall(SYS_write, record, text, (size_t)length);
    }
    if (calls_left < 0 || calls_left-- != 0)
        return 0;
    if (fault_code == 0)
        kill(getpid(), SIGKILL);
    errno = fault_code;
    return 1;
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define OPEN(name)                                                                                 \
    int name(const char *path, int flags, ...)                                                     \
    {                                                                                              \
        va_list rest;                                                                              \
        va_start(rest, flags);                                                                     \
        const mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0;            \
        va_end(rest);                                                                              \
        return fails("open", AT_FDCWD, path) ? -1 : NEXT(name)(path, flags, mode);                 \
    }
OPEN(open)
OPEN(open64)

#define OPEN_IN(name)                                                                              \
    int name(int folder, const char *path, int flags, ...)                                         \
    {                                                                                              \
        va_list rest;                                                                              \
        va_start(rest, flags);                                                                     \
        const mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0;            \
        va_end(rest);                                                                              \
        return fails("open", folder, path) ? -1 : NEXT(name)(folder, path, flags, mode);           \
    }
OPEN_IN(openat)
OPEN_IN(openat64)

ssize_t write(int handle, const void *data, size_t size)
{
    return fails("write", handle, NULL) ? -1 : NEXT(write)(handle, data, size);
}

int fsync(int handle)
{
    return fails("fsync", handle, NULL) ? -1 : NEXT(fsync)(handle);
}

int mkdir(const char *path, mode_t mode)
{
    return fails("mkdir", AT_FDCWD, path) ? -1 : NEXT(mkdir)(path, mode);
}

int mkdirat(int folder, const char *path, mode_t mode)
{
    return fails("mkdir", folder, path) ? -1 : NEXT(mkdirat)(folder, path, mode);
}

int unlink(const char *path)
{
    return fails("unlink", AT_FDCWD, path) ? -1 : NEXT(unlink)(path);
}

int unlinkat(int folder, const char *path, int flags)
{
    return fails("unlink", folder, path) ? -1 : NEXT(unlinkat)(folder, path, flags);
}

int rmdir(const char *path)
{
    return fails("unlink", AT_FDCWD, path) ? -1 : NEXT(rmdir)(path);
}

int rename(const char *path, const char *new_path)
{
    return fails("rename", AT_FDCWD, path) ? -1 : NEXT(rename)(path, new_path);
}

int renameat(int folder, const char *path, int new_folder, const char *new_path)
{
    return fails("rename", folder, path) ? -1 : NEXT(renameat)(folder, path, new_folder, new_path);
}

int renameat2(int folder, const char *path, int new_folder, const char *new_path, unsigned flags)
{
    return fails("rename", folder, path)
               ? -1
               : NEXT(renameat2)(folder, path, new_folder, new_path, flags);
}

int linkat(int folder, const char *path, int new_folder, const char *new_path, int flags)
{
    return fails("link", folder, path)
               ? -1
               : NEXT(linkat)(folder, path, new_folder, new_path, flags);
}
