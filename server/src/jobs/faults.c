/* Makes one write or fsync of a process fail, or ends the process before it: loaded with LD_PRELOAD by the tests of what jobs survive.
 *
 * FAULT_FOLDER: calls about files below it count. FAULT_FULL: file that makes the disk full as long as it is there. FAULT_AT: which of them, from 1; 0: none. FAULT_KIND: an errno, or "crash".
 * FAULT_COUNT: file that gets the number of calls when the process ends. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long calls;

static int is_below(const char *path) {
    const char *folder = getenv("FAULT_FOLDER");
    return folder && strncmp(path, folder, strlen(folder)) == 0;
}

/* Whether the call that begins is the one that fails; then errno is set. */
static int fails(void) {
    long call = atomic_fetch_add(&calls, 1) + 1;
    const char *at = getenv("FAULT_AT"), *kind = getenv("FAULT_KIND"), *full = getenv("FAULT_FULL");
    if (full && access(full, F_OK) == 0) {
        errno = ENOSPC;
        return 1;
    }
    if (!at || call != atol(at)) return 0;
    if (!kind || strcmp(kind, "crash") == 0) _exit(137);
    errno = atoi(kind);
    return 1;
}

static int fails_on(int file) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return is_below(path) && fails();
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t write(int file, const void *bytes, size_t length) {
    return fails_on(file) ? -1 : REAL(write)(file, bytes, length);
}
ssize_t pwrite(int file, const void *bytes, size_t length, off_t at) {
    return fails_on(file) ? -1 : REAL(pwrite)(file, bytes, length, at);
}
ssize_t pwrite64(int file, const void *bytes, size_t length, off64_t at) {
    return fails_on(file) ? -1 : REAL(pwrite64)(file, bytes, length, at);
}
int fsync(int file) { return fails_on(file) ? -1 : REAL(fsync)(file); }
int fdatasync(int file) { return fails_on(file) ? -1 : REAL(fdatasync)(file); }
int ftruncate(int file, off_t length) { return fails_on(file) ? -1 : REAL(ftruncate)(file, length); }
int ftruncate64(int file, off64_t length) { return fails_on(file) ? -1 : REAL(ftruncate64)(file, length); }
int rename(const char *from, const char *to) { return is_below(to) && fails() ? -1 : REAL(rename)(from, to); }

__attribute__((destructor)) static void report(void) {
    const char *path = getenv("FAULT_COUNT");
    FILE *file = path ? fopen(path, "w") : NULL;
    if (!file) return;
    fprintf(file, "%ld", atomic_load(&calls));
    fclose(file);
}
