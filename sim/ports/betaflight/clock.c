/* Simulated time for an unmodified Betaflight SITL, which is a separate program started with this library
 * in LD_PRELOAD. Betaflight paces itself by CLOCK_MONOTONIC and nanosleep(); here both belong to the
 * simulator, so that a flight takes as long as it takes and repeats exactly.
 *
 * The simulator holds the other end of a SOCK_SEQPACKET socket, whose descriptor is in NEUROFLIGHT_CONTROL:
 *
 *     struct report  program -> simulator   PARKED: the main thread has reached its limit and stands still
 *                                           BOUND: a server got port `value` instead of its own, `port`
 *     struct permit  simulator -> program   run to limit_ns, but first take in so many packets
 *
 * Packets reach the program over UDP in threads of its own, its serial ports live in another. They share
 * data with the main thread unguarded. Here one thread works at a time: the main thread until it is parked,
 * each other from one select() to the next. `states` and `receivers` count all packets that were sent so
 * far; the main thread goes on when the last of them is dealt with, so that nothing depends on how the
 * system schedules threads. When the simulator goes away the program ends.
 *
 * Servers get free ports on loopback. Servo packets (to 9001) go to NEUROFLIGHT_MOTOR_PORT, motor packets
 * (to 9002), which say the same in thousandths, nowhere.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum {
	READING_NS = 100, /* what a look at the clock costs the main thread, so that its waiting loops end */
	/* Each turn of the main loop sleeps 50 us to spare the computer. A board does not, and the sleep would
	 * only make the gyro's task late: sleeps up to SPARING_NS cost TURN_NS. */
	SPARING_NS = 60000,
	TURN_NS = 5000,
	STATE_BYTES = 144,
	RECEIVER_BYTES = 40,
	SERVO_PORT = 9001,
	MOTOR_PORT = 9002,
};

enum { PARKED = 1, BOUND = 2 };

struct report {
	uint32_t kind;
	uint32_t port;
	uint64_t value; /* [ns] of simulated time, or a port */
};

struct permit {
	uint64_t limit_ns;
	uint32_t states;
	uint32_t receivers;
};

static struct {
	int control;
	uint16_t motor_port;
	_Atomic uint64_t now_ns;
	struct permit permit; /* the last one; of the main thread */
	pthread_mutex_t lock; /* of what follows, up to the functions */
	pthread_cond_t changed;
	bool busy;       /* a thread works */
	uint32_t states; /* packets dealt with */
	uint32_t receivers;
	int (*clock_gettime)(clockid_t, struct timespec *);
	int (*nanosleep)(const struct timespec *, struct timespec *);
	int (*bind)(int, const struct sockaddr *, socklen_t);
	int (*select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
	ssize_t (*recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
	ssize_t (*sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
	int (*pthread_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
	int (*pthread_join)(pthread_t, void **);
} s = {.control = -1, .busy = true, .lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};

static _Thread_local bool main_thread;
static _Thread_local uint32_t *taken; /* the count of the packet that it deals with */

static long number(const char *name)
{
	const char *text = getenv(name);
	return text == NULL ? -1 : strtol(text, NULL, 10);
}

__attribute__((constructor)) static void start(void)
{
	*(void **)&s.clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
	*(void **)&s.nanosleep = dlsym(RTLD_NEXT, "nanosleep");
	*(void **)&s.bind = dlsym(RTLD_NEXT, "bind");
	*(void **)&s.select = dlsym(RTLD_NEXT, "select");
	*(void **)&s.recvfrom = dlsym(RTLD_NEXT, "recvfrom");
	*(void **)&s.sendto = dlsym(RTLD_NEXT, "sendto");
	*(void **)&s.pthread_create = dlsym(RTLD_NEXT, "pthread_create");
	*(void **)&s.pthread_join = dlsym(RTLD_NEXT, "pthread_join");
	s.control = (int)number("NEUROFLIGHT_CONTROL");
	s.motor_port = (uint16_t)number("NEUROFLIGHT_MOTOR_PORT");
	main_thread = true;
}

static void report(uint32_t kind, uint32_t port, uint64_t value)
{
	const struct report message = {kind, port, value};
	if (send(s.control, &message, sizeof message, MSG_NOSIGNAL) != sizeof message) {
		_exit(1);
	}
}

/* Let another thread work. */
static void rest(void)
{
	pthread_mutex_lock(&s.lock);
	s.busy = false;
	pthread_cond_broadcast(&s.changed);
	pthread_mutex_unlock(&s.lock);
}

/* Work, once no other thread does and all packets of `permit`, if any, are dealt with. */
static void work(const struct permit *permit)
{
	pthread_mutex_lock(&s.lock);
	while (s.busy ||
	       (permit != NULL && (s.states != permit->states || s.receivers != permit->receivers))) {
		pthread_cond_wait(&s.changed, &s.lock);
	}
	s.busy = true;
	pthread_mutex_unlock(&s.lock);
}

/* Stand still until the simulator permits more and its packets are dealt with. */
static void park(void)
{
	rest();
	report(PARKED, 0, s.permit.limit_ns);
	if (recv(s.control, &s.permit, sizeof s.permit, 0) != sizeof s.permit) {
		_exit(1);
	}
	work(&s.permit);
}

/* The main thread's time goes on by `ns`. */
static void pass(uint64_t ns)
{
	const uint64_t end = s.now_ns + ns;
	while (end >= s.permit.limit_ns) {
		s.now_ns = s.permit.limit_ns;
		park();
	}
	s.now_ns = end;
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
	if (clock != CLOCK_MONOTONIC) {
		return s.clock_gettime(clock, time);
	}
	if (main_thread) {
		pass(READING_NS);
	}
	const uint64_t now_ns = s.now_ns;
	time->tv_sec = (time_t)(now_ns / 1000000000U);
	time->tv_nsec = (long)(now_ns % 1000000000U);
	return 0;
}

int nanosleep(const struct timespec *time, struct timespec *left)
{
	if (!main_thread) {
		return s.nanosleep(time, left);
	}
	const uint64_t ns = (uint64_t)time->tv_sec * 1000000000U + (uint64_t)time->tv_nsec;
	pass(ns > SPARING_NS ? ns : TURN_NS);
	return 0;
}

/* A thread waits for the world in here, and nowhere else; the packet before is dealt with. */
int select(int count, fd_set *readable, fd_set *writable, fd_set *failed, struct timeval *timeout)
{
	if (taken != NULL) {
		++*taken; /* guarded by `busy`, which is ours */
		taken = NULL;
	}
	rest();
	const int ready = s.select(count, readable, writable, failed, timeout);
	const int error = errno;
	work(NULL);
	errno = error;
	return ready;
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
	const ssize_t got = s.recvfrom(fd, data, size, flags, from, length);
	if (got == STATE_BYTES) {
		taken = &s.states;
	} else if (got == RECEIVER_BYTES) {
		taken = &s.receivers;
	}
	return got;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
	struct sockaddr_in address;
	if (to == NULL || to->sa_family != AF_INET || length < sizeof address) {
		return s.sendto(fd, data, size, flags, to, length);
	}
	memcpy(&address, to, sizeof address);
	if (ntohs(address.sin_port) == MOTOR_PORT) {
		return (ssize_t)size;
	}
	if (ntohs(address.sin_port) == SERVO_PORT) {
		address.sin_port = htons(s.motor_port);
	}
	return s.sendto(fd, data, size, flags, (const struct sockaddr *)&address, sizeof address);
}

int bind(int fd, const struct sockaddr *wanted, socklen_t length)
{
	const struct sockaddr_in *four = (const struct sockaddr_in *)wanted;
	struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	socklen_t size = sizeof address;
	if (wanted->sa_family != AF_INET) {
		return s.bind(fd, wanted, length);
	}
	if (s.bind(fd, (const struct sockaddr *)&address, size) != 0 ||
	    getsockname(fd, (struct sockaddr *)&address, &size) != 0) {
		return -1;
	}
	report(BOUND, ntohs(four->sin_port), ntohs(address.sin_port));
	return 0;
}

struct beginning {
	void *(*routine)(void *);
	void *argument;
};

static void *begin(void *data)
{
	const struct beginning beginning = *(struct beginning *)data;
	free(data);
	work(NULL);
	void *value = beginning.routine(beginning.argument);
	rest();
	return value;
}

int pthread_create(pthread_t *thread, const pthread_attr_t *how, void *(*routine)(void *), void *argument)
{
	struct beginning *beginning = malloc(sizeof *beginning);
	if (beginning == NULL) {
		return EAGAIN;
	}
	*beginning = (struct beginning){routine, argument};
	return s.pthread_create(thread, how, begin, beginning);
}

int pthread_join(pthread_t thread, void **value)
{
	rest();
	const int error = s.pthread_join(thread, value);
	work(NULL);
	return error;
}
