/*
 * A disk that loses power: what was synced, and nothing else.
 *
 * Preloaded into a process (LD_PRELOAD), this library writes a journal of every fsync and fdatasync
 * below one directory: for a file its whole content at that moment, for a directory the list of its
 * entries. A reader of the journal can put together what a disk holds that lost power between any
 * two of them and kept only what it had promised (tests/power_cut/disk.rs).
 *
 * POWER_CUT_ROOT is the directory, which is durable itself, and POWER_CUT_JOURNAL the directory of
 * the journal. An entry of the journal is a file `NNNNNN-f-INODE` with the content of a file, or
 * `NNNNNN-d-INODE` with a line `TYPE INODE NAME` for each entry of a directory.
 *
 * Every inode that was seen is kept open to the end. Its number is then not given to another file,
 * and SQLite's POSIX locks, which the closing of any descriptor of the file would release, stay.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#define MOST_INODES 4096

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *journal;
static char root[PATH_MAX];
static unsigned long events;
static struct { dev_t dev; ino_t ino; int fd; } held[MOST_INODES];
static int held_count;

static void fail(const char *what) {
    perror(what);
    _exit(99);
}

/* A descriptor of the inode that stays open; -1 if it is gone. */
static int hold(const char *path, const struct stat *at) {
    for (int i = 0; i < held_count; i++)
        if (held[i].ino == at->st_ino && held[i].dev == at->st_dev) return held[i].fd;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return -1;
    if (held_count == MOST_INODES) fail("power cut: too many inodes");
    held[held_count].dev = at->st_dev;
    held[held_count].ino = at->st_ino;
    held[held_count++].fd = fd;
    return fd;
}

static FILE *begin(char *staging) {
    snprintf(staging, PATH_MAX, "%s/staging", journal);
    FILE *out = fopen(staging, "we");
    if (!out) fail("power cut: journal");
    return out;
}

static void publish(FILE *out, const char *staging, char kind, ino_t ino) {
    char name[PATH_MAX];
    if (fclose(out)) fail("power cut: journal");
    snprintf(name, sizeof name, "%s/%06lu-%c-%llu", journal, events++, kind, (unsigned long long)ino);
    if (rename(staging, name)) fail("power cut: journal");
}

static void note_file(const char *path, const struct stat *at) {
    char staging[PATH_MAX], buffer[1 << 16];
    int fd = hold(path, at);
    if (fd < 0) fail("power cut: open");
    FILE *out = begin(staging);
    off_t place = 0;
    ssize_t got;
    while ((got = pread(fd, buffer, sizeof buffer, place)) > 0) {
        if (fwrite(buffer, 1, got, out) != (size_t)got) fail("power cut: journal");
        place += got;
    }
    if (got < 0) fail("power cut: read");
    publish(out, staging, 'f', at->st_ino);
}

static void note_directory(const char *path, const struct stat *at) {
    char staging[PATH_MAX], inside[PATH_MAX];
    hold(path, at);
    DIR *dir = opendir(path);
    if (!dir) fail("power cut: directory");
    FILE *out = begin(staging);
    struct dirent *entry;
    while ((entry = readdir(dir))) {
        if (!strcmp(entry->d_name, ".") || !strcmp(entry->d_name, "..")) continue;
        struct stat found;
        if (snprintf(inside, sizeof inside, "%s/%s", path, entry->d_name) >= PATH_MAX) continue;
        /* Gone in the meantime: as if it had gone before. */
        if (lstat(inside, &found)) continue;
        char type = S_ISDIR(found.st_mode) ? 'd' : S_ISREG(found.st_mode) ? 'f' : '?';
        if (type == '?' || hold(inside, &found) < 0) continue;
        fprintf(out, "%c %llu %s\n", type, (unsigned long long)found.st_ino, entry->d_name);
    }
    closedir(dir);
    publish(out, staging, 'd', at->st_ino);
}

/* Everything that is there at the start is durable. */
static void note_all(const char *path) {
    struct stat at;
    char inside[PATH_MAX];
    if (lstat(path, &at)) return;
    if (S_ISREG(at.st_mode)) note_file(path, &at);
    if (!S_ISDIR(at.st_mode)) return;
    note_directory(path, &at);
    DIR *dir = opendir(path);
    if (!dir) fail("power cut: directory");
    struct dirent *entry;
    while ((entry = readdir(dir))) {
        if (!strcmp(entry->d_name, ".") || !strcmp(entry->d_name, "..")) continue;
        if (snprintf(inside, sizeof inside, "%s/%s", path, entry->d_name) >= PATH_MAX) continue;
        note_all(inside);
    }
    closedir(dir);
}

__attribute__((constructor)) static void start(void) {
    const char *named = getenv("POWER_CUT_ROOT");
    journal = getenv("POWER_CUT_JOURNAL");
    if (!named || !journal || !realpath(named, root)) fail("power cut: POWER_CUT_ROOT");
    note_all(root);
}

static void note(int fd) {
    struct stat at;
    char link[64], path[PATH_MAX];
    size_t length = strlen(root);
    if (!root[0] || fstat(fd, &at) || at.st_nlink == 0) return;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t got = readlink(link, path, sizeof path - 1);
    if (got < 0) return;
    path[got] = 0;
    if (strncmp(path, root, length) || (path[length] != '/' && path[length])) return;
    pthread_mutex_lock(&lock);
    if (S_ISDIR(at.st_mode)) note_directory(path, &at);
    if (S_ISREG(at.st_mode)) note_file(link, &at);
    pthread_mutex_unlock(&lock);
}

int fsync(int fd) {
    int done = (int)syscall(SYS_fsync, fd);
    if (!done) note(fd);
    return done;
}

int fdatasync(int fd) {
    int done = (int)syscall(SYS_fdatasync, fd);
    if (!done) note(fd);
    return done;
}
