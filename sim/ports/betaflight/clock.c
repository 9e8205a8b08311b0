/* Simulated time for an unmodified Betaflight SITL, which is a separate program started with this library
 * in LD_PRELOAD. Betaflight paces itself by CLOCK_MONOTONIC and nanosleep(); here both belong to the
 * simulator, so that a flight takes as long as it takes and repeats exactly.
 *
 * The simulator holds the other end of a SOCK_SEQPACKET socket, whose descriptor is in NEUROFLIGHT_CONTROL:
 *
 *     struct report  program -> simulator   PARKED: the main thread has reached its limit and stands still
 *                                           BOUND: a server got port `value` instead of its own, `port`
 *                                           SENT: neither
 *                                           each followed by the servo packets that it has sent meanwhile
 *     struct permit  simulator -> program   run to limit_ns, but first take in the packets that follow: a
 *                                           state packet, a receiver packet, as it says; or, with `copies`, a
 *                                           message follows whose descriptor is a copy's end of such a socket
 *
 * Betaflight hears state and receiver packets in a thread each, its serial ports live in another. They share
 * data with the main thread unguarded. Here one thread works at a time, each from one select() to the next.
 *
 * The two threads for packets lend their stacks: the first select() leaves the stack to the main thread, and
 * waits on another one. With a packet, the main thread goes on there as if select() had returned, and comes
 * back at the next select(). So a packet is dealt with before time goes on, without waking a thread. They
 * take their stacks back when the program joins its threads. When the simulator goes away the program ends.
 *
 * A copy is a child of the program as it stands there, its main thread and its memory, and speaks to the
 * simulator over a socket of its own. It has no other thread: its serial ports are silent.
 *
 * Servers get free ports on loopback. Servo packets (to 9001) go to the simulator as above, motor packets
 * (to 9002), which say the same in thousandths, nowhere.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

enum {
	READING_NS = 100, /* what a look at the clock costs the main thread, so that its waiting loops end */
	/* Each turn of the main loop sleeps 50 us to spare the computer. A board does not, and the sleep would
	 * only make the gyro's task late: sleeps up to SPARING_NS cost TURN_NS. */
	SPARING_NS = 60000,
	TURN_NS = 12500,
	STATE_BYTES = 144,
	RECEIVER_BYTES = 40,
	STATE_PORT = 9003,
	RECEIVER_PORT = 9004,
	SERVO_PORT = 9001,
	MOTOR_PORT = 9002,
	SERVO_BYTES = 68,
	SERVO_PACKETS = 16, /* kept for one report */
	SPIN_NS = 100000, /* real, for which the next permit is looked for before the thread sleeps: a wake-up takes longer */
	KEEPER_BYTES = 65536, /* of the stack on which a thread waits that has lent its own */
};

enum { PARKED = 1, BOUND = 2, SENT = 3 };

struct report {
	uint32_t kind;
	uint32_t port;
	uint64_t value; /* [ns] of simulated time, or a port */
};

struct permit {
	uint64_t limit_ns;
	uint32_t states; /* packets that follow, at most one each */
	uint32_t receivers;
	uint32_t copies; /* 0 or 1; then nothing else is asked for */
	uint32_t reserved;
	uint8_t packets[STATE_BYTES + RECEIVER_BYTES];
};

/* Where packets of one kind arrive. */
struct server {
	const uint16_t port;
	const size_t size; /* of a packet */
	int fd;
	bool lent;             /* its thread's stack is the main thread's */
	const uint8_t *packet; /* to be read; NULL: none */
	ucontext_t thread;     /* in its select() */
	ucontext_t keeper;
	uint8_t keeper_stack[KEEPER_BYTES];
};

static struct server servers[] = {
	{.port = STATE_PORT, .size = STATE_BYTES, .fd = -1},
	{.port = RECEIVER_PORT, .size = RECEIVER_BYTES, .fd = -1},
};
enum { SERVERS = sizeof servers / sizeof servers[0] };

static struct {
	int control;
	_Atomic uint64_t now_ns;
	struct permit permit; /* the last one; of the main thread */
	bool alone;           /* on one processor, where the simulator runs only while this thread sleeps */
	bool spins;           /* the last permit came within SPIN_NS */
	bool guest;           /* the main thread is on a stack that was lent to it */
	ucontext_t home;      /* of the main thread meanwhile */
	size_t servo_count;   /* guarded by `busy`, as all that Betaflight does */
	uint8_t servo[SERVO_PACKETS][SERVO_BYTES];
	pthread_mutex_t lock; /* of what follows, up to the functions, and of `lent` */
	pthread_cond_t changed;
	pthread_cond_t end;  /* `ending` is set */
	bool busy;   /* a thread works */
	bool ending; /* threads are joined */
	int (*clock_gettime)(clockid_t, struct timespec *);
	int (*nanosleep)(const struct timespec *, struct timespec *);
	int (*bind)(int, const struct sockaddr *, socklen_t);
	int (*select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
	ssize_t (*recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
	ssize_t (*sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
	int (*pthread_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
	int (*pthread_join)(pthread_t, void **);
} s = {.control = -1, .busy = true, .lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER,
     .end = PTHREAD_COND_INITIALIZER};

static _Thread_local bool main_thread;

/* Whether the caller is Betaflight's main loop. */
static bool main_loop(void)
{
	return main_thread && !s.guest;
}

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
	cpu_set_t processors;
	s.alone = sched_getaffinity(0, sizeof processors, &processors) == 0 && CPU_COUNT(&processors) == 1;
	main_thread = true;
}

static void report(uint32_t kind, uint32_t port, uint64_t value)
{
	struct report head = {kind, port, value};
	const struct iovec parts[] = {{&head, sizeof head}, {s.servo, s.servo_count * SERVO_BYTES}};
	const struct msghdr message = {.msg_iov = (struct iovec *)parts, .msg_iovlen = 2};
	if (sendmsg(s.control, &message, MSG_NOSIGNAL) < 0) {
		_exit(1);
	}
	s.servo_count = 0;
}

/* Let another thread work. */
static void rest(void)
{
	pthread_mutex_lock(&s.lock);
	s.busy = false;
	pthread_cond_broadcast(&s.changed);
	pthread_mutex_unlock(&s.lock);
}

/* Work, once no other thread does and the stack of `server`, if any, is lent. */
static void work(const struct server *server)
{
	pthread_mutex_lock(&s.lock);
	while (s.busy || (server != NULL && !server->lent)) {
		pthread_cond_wait(&s.changed, &s.lock);
	}
	s.busy = true;
	pthread_mutex_unlock(&s.lock);
}

/* Deal with a packet, of the main thread: its select() returns, and the next one comes back here. */
static void deliver(struct server *server, const uint8_t *packet)
{
	rest();
	work(server);
	server->packet = packet;
	s.guest = true;
	swapcontext(&s.home, &server->thread);
	s.guest = false;
}

/* Of a thread that has lent its stack: wait here, on another one, until it takes it back. */
static void keep(int index)
{
	struct server *server = &servers[index];
	pthread_mutex_lock(&s.lock);
	server->lent = true;
	s.busy = false;
	pthread_cond_broadcast(&s.changed);
	while (!s.ending) {
		pthread_cond_wait(&s.end, &s.lock);
	}
	while (s.busy) {
		pthread_cond_wait(&s.changed, &s.lock);
	}
	server->lent = false;
	s.busy = true;
	pthread_mutex_unlock(&s.lock);
	setcontext(&server->thread);
}

/* A select() of the thread of `server`: 1 with a packet, 0 without. */
static int await_packet(struct server *server)
{
	if (s.guest) {
		swapcontext(&server->thread, &s.home);
	} else {
		getcontext(&server->keeper);
		server->keeper.uc_stack.ss_sp = server->keeper_stack;
		server->keeper.uc_stack.ss_size = sizeof server->keeper_stack;
		makecontext(&server->keeper, (void (*)(void))keep, 1, (int)(server - servers));
		swapcontext(&server->thread, &server->keeper);
	}
	return server->packet != NULL;
}

static struct server *server_of(int fd)
{
	for (int i = 0; i < SERVERS; ++i) {
		if (fd >= 0 && servers[i].fd == fd) {
			return &servers[i];
		}
	}
	return NULL;
}

/* Of the computer's clock. */
static uint64_t real_ns(void)
{
	struct timespec now;
	s.clock_gettime(CLOCK_MONOTONIC, &now);
	return (uint64_t)now.tv_sec * 1000000000U + (uint64_t)now.tv_nsec;
}

/* The next permit. The processor is kept, and lent to others, only while permits come within SPIN_NS. */
static ssize_t await_permit(void)
{
	const uint64_t began = real_ns();
	ssize_t got = -1;
	while (s.spins && got < 0 && real_ns() - began < SPIN_NS) {
		got = recv(s.control, &s.permit, sizeof s.permit, MSG_DONTWAIT);
		if (got < 0 && errno != EAGAIN) {
			return got;
		}
		if (got < 0) {
			sched_yield();
		}
	}
	if (got < 0) {
		got = recv(s.control, &s.permit, sizeof s.permit, 0);
	}
	s.spins = !s.alone && real_ns() - began < SPIN_NS;
	return got;
}

/* The descriptor of a copy's socket, in a message of its own. */
static int receive_socket(void)
{
	union {
		char bytes[CMSG_SPACE(sizeof(int))];
		struct cmsghdr aligned;
	} room;
	char byte;
	struct iovec part = {&byte, sizeof byte};
	struct msghdr message = {
		.msg_iov = &part, .msg_iovlen = 1, .msg_control = room.bytes, .msg_controllen = sizeof room.bytes};
	const ssize_t got = recvmsg(s.control, &message, 0);
	const struct cmsghdr *head = got == sizeof byte ? CMSG_FIRSTHDR(&message) : NULL;
	int fd = -1;
	if (head == NULL || head->cmsg_type != SCM_RIGHTS || head->cmsg_len != CMSG_LEN(sizeof fd)) {
		_exit(1);
	}
	memcpy(&fd, CMSG_DATA(head), sizeof fd);
	return fd;
}

/* Make a copy of the program, of the main thread while no other works: it goes on from here as the program
 * does. The simulator sees one that could not be made by the end of its socket. */
static void copy(void)
{
	const int control = receive_socket();
	signal(SIGCHLD, SIG_IGN); /* nobody waits for copies */
	pthread_mutex_lock(&s.lock);
	const pid_t child = fork();
	pthread_mutex_unlock(&s.lock);
	if (child != 0) {
		close(control);
		return;
	}
	close(s.control);
	s.control = control;
	s.spins = false;
	s.alone = true; /* there are many, and one that spins takes the others' processor */
	s.lock = (pthread_mutex_t)PTHREAD_MUTEX_INITIALIZER;
	s.changed = s.end = (pthread_cond_t)PTHREAD_COND_INITIALIZER; /* those that wait are not here */
}

/* Stand still until the simulator permits more and its packets are dealt with. */
static void park(void)
{
	rest();
	report(PARKED, 0, s.now_ns);
	ssize_t got = await_permit();
	while (got == offsetof(struct permit, packets) && s.permit.copies > 0) {
		work(NULL);
		copy();
		rest();
		report(PARKED, 0, s.now_ns);
		got = await_permit();
	}
	const size_t states = s.permit.states * STATE_BYTES, receivers = s.permit.receivers * RECEIVER_BYTES;
	if (got < 0 || (size_t)got != offsetof(struct permit, packets) + states + receivers) {
		_exit(1);
	}
	work(NULL);
	if (receivers > 0) {
		deliver(&servers[1], s.permit.packets + states);
	}
	if (states > 0) {
		deliver(&servers[0], s.permit.packets);
	}
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
	if (main_loop()) {
		pass(READING_NS);
	}
	const uint64_t now_ns = s.now_ns;
	time->tv_sec = (time_t)(now_ns / 1000000000U);
	time->tv_nsec = (long)(now_ns % 1000000000U);
	return 0;
}

int nanosleep(const struct timespec *time, struct timespec *left)
{
	if (!main_loop()) {
		return s.nanosleep(time, left);
	}
	const uint64_t ns = (uint64_t)time->tv_sec * 1000000000U + (uint64_t)time->tv_nsec;
	pass(ns > SPARING_NS ? ns : TURN_NS);
	return 0;
}

/* A thread waits for the world in here, and nowhere else. */
int select(int count, fd_set *readable, fd_set *writable, fd_set *failed, struct timeval *timeout)
{
	struct server *server = server_of(count - 1);
	if (server != NULL && !s.ending) {
		return await_packet(server);
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
	struct server *server = server_of(fd);
	if (server == NULL || server->packet == NULL) {
		return s.recvfrom(fd, data, size, flags, from, length);
	}
	size = size < server->size ? size : server->size;
	memcpy(data, server->packet, size);
	server->packet = NULL;
	return (ssize_t)size;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
	struct sockaddr_in address;
	if (to == NULL || to->sa_family != AF_INET || length < sizeof address) {
		return s.sendto(fd, data, size, flags, to, length);
	}
	memcpy(&address, to, sizeof address);
	const uint16_t port = ntohs(address.sin_port);
	if (port == MOTOR_PORT) {
		return (ssize_t)size;
	}
	if (port != SERVO_PORT || size != SERVO_BYTES) {
		return s.sendto(fd, data, size, flags, to, length);
	}
	if (s.servo_count == SERVO_PACKETS) {
		report(SENT, 0, 0);
	}
	memcpy(s.servo[s.servo_count++], data, size);
	return (ssize_t)size;
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
	for (int i = 0; i < SERVERS; ++i) {
		if (servers[i].port == ntohs(four->sin_port)) {
			servers[i].fd = fd;
		}
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
	pthread_mutex_lock(&s.lock);
	s.ending = true;
	pthread_cond_broadcast(&s.end);
	pthread_mutex_unlock(&s.lock);
	rest();
	const int error = s.pthread_join(thread, value);
	work(NULL);
	return error;
}
