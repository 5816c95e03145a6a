/* The wall clock of a process is ahead by what a shared file says, from the moment on that this changes.
 *
 * For LD_PRELOAD. CLOCKS_FILE has one number of nanoseconds (int64) for each place; this process reads that of
 * CLOCKS_PLACE, and a bridge, which inherits its server's environment, that of BRIDGE_PLACE. Waits with a deadline by
 * the wall clock (condition variables, mutexes and semaphores of Fast DDS's shared memory) end by the clock as it is
 * set then, as they do where a whole machine's clock is set.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { PLACES = 8, BRIDGE_PLACE = 1, S = 1000000000, SLICE_NS = 5000000 };
/* Of a wait: so soon a clock that is set is noticed. */

static volatile int64_t *offset_ns;

__attribute__((constructor)) static void open_offsets(void) {
    const char *path = getenv("CLOCKS_FILE"), *place = getenv("CLOCKS_PLACE");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0)
        return;
    void *mapped = mmap(NULL, PLACES * sizeof(int64_t), PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (mapped == MAP_FAILED)
        return;
    char command[65536];
    int of_self = open("/proc/self/cmdline", O_RDONLY | O_CLOEXEC);
    ssize_t size = of_self < 0 ? 0 : read(of_self, command, sizeof command);
    if (of_self >= 0)
        close(of_self);
    int is_bridge = size > 0 && memmem(command, (size_t)size, "ros2_mcp_bridge", 15) != NULL;
    offset_ns = (int64_t *)mapped + (is_bridge ? BRIDGE_PLACE : place ? atoi(place) : 0);
}

static int by_wall(clockid_t clock) { return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE; }

int clock_gettime(clockid_t clock, struct timespec *now) {
    int result = (int)syscall(SYS_clock_gettime, clock, now);
    if (result == 0 && offset_ns && by_wall(clock)) {
        int64_t ns = (int64_t)now->tv_sec * S + now->tv_nsec + *offset_ns;
        now->tv_sec = ns / S, now->tv_nsec = ns % S;
    }
    return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    (void)zone;
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec, now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    return now ? (*now = exact.tv_sec) : exact.tv_sec;
}

/* The end of the next slice by the steady clock; 0 where the deadline by the wall clock is over. */
static int next_slice(const struct timespec *deadline, struct timespec *slice) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (now.tv_sec > deadline->tv_sec || (now.tv_sec == deadline->tv_sec && now.tv_nsec >= deadline->tv_nsec))
        return 0;
    int64_t left = ((int64_t)deadline->tv_sec - now.tv_sec) * S + deadline->tv_nsec - now.tv_nsec;
    clock_gettime(CLOCK_MONOTONIC, slice);
    int64_t ends = (int64_t)slice->tv_sec * S + slice->tv_nsec + (left < SLICE_NS ? left : SLICE_NS);
    slice->tv_sec = ends / S, slice->tv_nsec = ends % S;
    return 1;
}

int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock,
                           const struct timespec *deadline) {
    static int (*wait)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
    if (!wait)
        *(void **)&wait = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
    if (!by_wall(clock))
        return wait(condition, mutex, clock, deadline);
    struct timespec slice;
    int result = ETIMEDOUT;
    while (result == ETIMEDOUT && next_slice(deadline, &slice))
        result = wait(condition, mutex, CLOCK_MONOTONIC, &slice);
    return result;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *deadline) {
    int is_steady = condition->__data.__wrefs & 2; /* as glibc keeps pthread_condattr_setclock(CLOCK_MONOTONIC) */
    return pthread_cond_clockwait(condition, mutex, is_steady ? CLOCK_MONOTONIC : CLOCK_REALTIME, deadline);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *deadline) {
    static int (*lock)(pthread_mutex_t *, clockid_t, const struct timespec *);
    if (!lock)
        *(void **)&lock = dlsym(RTLD_NEXT, "pthread_mutex_clocklock");
    struct timespec slice;
    int result = pthread_mutex_trylock(mutex);
    result = result == EBUSY ? ETIMEDOUT : result;
    while (result == ETIMEDOUT && next_slice(deadline, &slice))
        result = lock(mutex, CLOCK_MONOTONIC, &slice);
    return result;
}

int sem_timedwait(sem_t *semaphore, const struct timespec *deadline) {
    static int (*wait)(sem_t *, clockid_t, const struct timespec *);
    if (!wait)
        *(void **)&wait = dlsym(RTLD_NEXT, "sem_clockwait");
    struct timespec slice;
    if (sem_trywait(semaphore) == 0)
        return 0;
    errno = ETIMEDOUT;
    while (errno == ETIMEDOUT && next_slice(deadline, &slice)) {
        if (wait(semaphore, CLOCK_MONOTONIC, &slice) == 0)
            return 0;
    }
    return -1;
}
