/* Lets the n-th call of a kind fail, in the process that preloads this library and arms it.
 *
 * Calls count where they concern a path below one folder (a root), so that caches and inputs are left alone;
 * allocations count from a size on. Kinds: see enum kind. Arm it with faults_arm, ask with faults_count.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum kind { NONE, OPEN, WRITE, RENAME, SYNC, REMOVE, MAKE, ALLOCATE };

static atomic_int armed = NONE;
static atomic_long counted, first;
static int error_number, for_ever;
static size_t least_bytes;
static char root[PATH_MAX];

void faults_arm(int kind, long n, int error, int all_from_there, size_t bytes, const char *below)
{
    armed = NONE;
    counted = 0;
    first = n;
    error_number = error;
    for_ever = all_from_there;
    least_bytes = bytes;
    strncpy(root, below, sizeof root - 1);
    armed = kind;
}

long faults_count(void) { return counted; }

static int fails(enum kind kind)
{
    if (armed != kind)
        return 0;
    long number = ++counted;
    if (number != first && !(for_ever && number > first))
        return 0;
    errno = error_number;
    return 1;
}

static int below_root(int folder, const char *path)
{
    char place[PATH_MAX * 2];
    if (!path || !*root)
        return 0;
    if (path[0] == '/')
        return strncmp(path, root, strlen(root)) == 0;
    if (folder == AT_FDCWD) {
        if (!getcwd(place, sizeof place))
            return 0;
    } else {
        char link[64];
        snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t length = readlink(link, place, sizeof place - 1);
        if (length < 0)
            return 0;
        place[length] = 0;
    }
    return strncmp(place, root, strlen(root)) == 0;
}

static int is_below(int descriptor) { return below_root(descriptor, "."); }

#define REAL(type, name, ...)                                      \
    static type (*real)(__VA_ARGS__);                              \
    if (!real)                                                     \
        real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

#define AT(kind, folder, path) (armed == (kind) && below_root(folder, path) && fails(kind))
#define ON(kind, descriptor) (armed == (kind) && is_below(descriptor) && fails(kind))

#define MODE_OF(flags, mode)                                        \
    mode_t mode = 0;                                               \
    if ((flags) & (O_CREAT | O_TMPFILE)) {                         \
        va_list rest;                                              \
        va_start(rest, flags);                                     \
        mode = va_arg(rest, mode_t);                               \
        va_end(rest);                                              \
    }

int open(const char *path, int flags, ...)
{
    MODE_OF(flags, mode)
    REAL(int, "open", const char *, int, mode_t);
    return AT(OPEN, AT_FDCWD, path) ? -1 : real(path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
    MODE_OF(flags, mode)
    REAL(int, "open64", const char *, int, mode_t);
    return AT(OPEN, AT_FDCWD, path) ? -1 : real(path, flags, mode);
}

int openat(int folder, const char *path, int flags, ...)
{
    MODE_OF(flags, mode)
    REAL(int, "openat", int, const char *, int, mode_t);
    return AT(OPEN, folder, path) ? -1 : real(folder, path, flags, mode);
}

FILE *fopen(const char *path, const char *mode)
{
    REAL(FILE *, "fopen", const char *, const char *);
    return AT(OPEN, AT_FDCWD, path) ? NULL : real(path, mode);
}

FILE *fopen64(const char *path, const char *mode)
{
    REAL(FILE *, "fopen64", const char *, const char *);
    return AT(OPEN, AT_FDCWD, path) ? NULL : real(path, mode);
}

ssize_t write(int descriptor, const void *data, size_t size)
{
    REAL(ssize_t, "write", int, const void *, size_t);
    return ON(WRITE, descriptor) ? -1 : real(descriptor, data, size);
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at)
{
    REAL(ssize_t, "pwrite", int, const void *, size_t, off_t);
    return ON(WRITE, descriptor) ? -1 : real(descriptor, data, size, at);
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at)
{
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    return ON(WRITE, descriptor) ? -1 : real(descriptor, data, size, at);
}

size_t fwrite(const void *data, size_t size, size_t count, FILE *file)
{
    REAL(size_t, "fwrite", const void *, size_t, size_t, FILE *);
    return ON(WRITE, fileno(file)) ? 0 : real(data, size, count, file);
}

int ftruncate(int descriptor, off_t size)
{
    REAL(int, "ftruncate", int, off_t);
    return ON(WRITE, descriptor) ? -1 : real(descriptor, size);
}

int ftruncate64(int descriptor, off64_t size)
{
    REAL(int, "ftruncate64", int, off64_t);
    return ON(WRITE, descriptor) ? -1 : real(descriptor, size);
}

/* what a stream has kept back is written out when it is closed: a full disk may show only then */
int fclose(FILE *file)
{
    REAL(int, "fclose", FILE *);
    int failed = armed == WRITE && fileno(file) >= 0 && (fcntl(fileno(file), F_GETFL) & O_ACCMODE) != O_RDONLY
                 && ON(WRITE, fileno(file));
    int result = real(file);
    if (!failed)
        return result;
    errno = error_number;
    return EOF;
}

int rename(const char *from, const char *to)
{
    REAL(int, "rename", const char *, const char *);
    return AT(RENAME, AT_FDCWD, to) ? -1 : real(from, to);
}

int renameat(int from_folder, const char *from, int to_folder, const char *to)
{
    REAL(int, "renameat", int, const char *, int, const char *);
    return AT(RENAME, to_folder, to) ? -1 : real(from_folder, from, to_folder, to);
}

int link(const char *from, const char *to)
{
    REAL(int, "link", const char *, const char *);
    return AT(RENAME, AT_FDCWD, to) ? -1 : real(from, to);
}

int linkat(int from_folder, const char *from, int to_folder, const char *to, int flags)
{
    REAL(int, "linkat", int, const char *, int, const char *, int);
    return AT(RENAME, to_folder, to) ? -1 : real(from_folder, from, to_folder, to, flags);
}

int fsync(int descriptor)
{
    REAL(int, "fsync", int);
    return ON(SYNC, descriptor) ? -1 : real(descriptor);
}

int fdatasync(int descriptor)
{
    REAL(int, "fdatasync", int);
    return ON(SYNC, descriptor) ? -1 : real(descriptor);
}

int unlink(const char *path)
{
    REAL(int, "unlink", const char *);
    return AT(REMOVE, AT_FDCWD, path) ? -1 : real(path);
}

int unlinkat(int folder, const char *path, int flags)
{
    REAL(int, "unlinkat", int, const char *, int);
    return AT(REMOVE, folder, path) ? -1 : real(folder, path, flags);
}

int rmdir(const char *path)
{
    REAL(int, "rmdir", const char *);
    return AT(REMOVE, AT_FDCWD, path) ? -1 : real(path);
}

int mkdir(const char *path, mode_t mode)
{
    REAL(int, "mkdir", const char *, mode_t);
    return AT(MAKE, AT_FDCWD, path) ? -1 : real(path, mode);
}

int chmod(const char *path, mode_t mode)
{
    REAL(int, "chmod", const char *, mode_t);
    return AT(MAKE, AT_FDCWD, path) ? -1 : real(path, mode);
}

/* allocations: glibc's own are under other names too, which saves the looking up, itself an allocation */
extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);

#define LACKS(bytes) (armed == ALLOCATE && (bytes) >= least_bytes && fails(ALLOCATE))

void *malloc(size_t size) { return LACKS(size) ? NULL : __libc_malloc(size); }

void *calloc(size_t count, size_t size) { return LACKS(count * size) ? NULL : __libc_calloc(count, size); }

void *realloc(void *old, size_t size) { return LACKS(size) ? NULL : __libc_realloc(old, size); }

void *memalign(size_t to, size_t size) { return LACKS(size) ? NULL : __libc_memalign(to, size); }

void *aligned_alloc(size_t to, size_t size) { return LACKS(size) ? NULL : __libc_memalign(to, size); }

int posix_memalign(void **found, size_t to, size_t size)
{
    if (LACKS(size))
        return error_number;
    *found = __libc_memalign(to, size);
    return *found ? 0 : ENOMEM;
}
