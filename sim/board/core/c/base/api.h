/* What Python calls of the engine (core/library.py), and what both sides share. Python reads this file as it stands:
 * plain declarations only; it skips the lines that begin with #. */
#ifndef ENGINE_API_H
#define ENGINE_API_H

#include <stdbool.h>
#include <stdint.h>

#define TIME_HZ UINT64_C(216000000) /* of every cycle below */
#define NEVER UINT64_MAX            /* in place of a cycle */

/* Why engine_run came back. */
enum outcome {
	RUN_REACHED = 0,   /* the time asked for */
	RUN_LIMIT = 1,     /* the number of instructions asked for */
	RUN_BREAKPOINT = 2,
	RUN_RESET = 3,     /* the image or a peripheral asks for a system reset */
	RUN_FAILED = 4,    /* engine_message says what */
	RUN_ASLEEP = 5,    /* WFI with nothing that could ever end it, and no time to run to */
	RUN_WATCHPOINT = 6, /* before the access that engine_watch_hit tells of; inside an IT block: behind the block */
};

/* What the engine calls; `user` comes back as it was given. They never unwind: a failure is reported by engine_fail. */
typedef uint32_t (*read_callback)(void *user, uint32_t window, uint32_t offset, uint32_t size);
typedef void (*write_callback)(void *user, uint32_t window, uint32_t offset, uint32_t size, uint32_t value);
typedef void (*alarm_callback)(void *user, uint32_t alarm);
typedef void (*flash_callback)(void *user, uint32_t address, uint32_t size, uint32_t value);
typedef void (*sleep_callback)(void *user);
typedef void (*rom_callback)(void *user);

struct callbacks {
	read_callback read;
	write_callback write;
	alarm_callback alarm;
	flash_callback flash; /* the program stores into flash */
	sleep_callback sleep; /* time is about to pass while the core sleeps; NULL: nobody is told */
	rom_callback rom;     /* the program has come to system memory: what it does there is the callback's */
	void *user;
};

/* What each exception has taken; exception 0 is the thread. Times in 1/65536 cycles. */
struct task {
	uint64_t activations;
	uint64_t instructions;
	uint64_t least, most; /* instructions of one activation, what interrupted it left out */
	uint64_t longest;     /* time from entry to return, what interrupted it included */
	uint64_t latest;      /* longest time from pending to entry */
	uint64_t latest_at;   /* when that was */
	uint32_t latest_pc;   /* what ran then */
};

/* Of the call tree. */
struct node {
	uint32_t function, parent, child, sibling;
	uint32_t return_to; /* address, UINT32_MAX: a handler or the thread */
	uint64_t instructions;
};

/* Memory that a debugger watches. */
struct watchpoint {
	uint32_t address, size;
	bool loads, stores; /* which of the core's accesses count */
};

struct watch_hit {
	uint32_t number;  /* of the watchpoint */
	uint32_t address; /* the first byte of it that is accessed */
};

struct core_counts {
	uint64_t instructions, accesses; /* those skipped under a condition included; to peripherals */
	uint64_t hash;                   /* of all jumps, exceptions and their times */
	uint32_t depth;                  /* active exceptions */
	bool sleeping;
};

struct engine;

/* cpi: cycles of the core for an instruction, 16 bits below the point. function_of: of each halfword of code, for the
 * call tree; the caller keeps it. NULL: no memory. */
struct engine *engine_new(uint64_t cpi, bool strict, bool profiling, const uint16_t *function_of);
/* Opens unicorn and maps the chip. 0, or unicorn's error. */
int engine_open(struct engine *e);
void engine_free(struct engine *e);
void engine_callbacks(struct engine *e, const struct callbacks *callbacks);
/* A system reset: registers as ARMv7-M B1.5.5 says, RAM as it is. The stack and the first instruction come from
 * `vectors`. Alarms and lines of peripherals are cancelled. */
void engine_reset(struct engine *e, uint32_t vectors);
/* The number of a new window; -1: taken, not aligned or no place of peripherals. */
int engine_attach(struct engine *e, uint32_t base, uint32_t size);
/* The number of an answer for the register at `address` in an attached window, not yet known; -1: there are too many, or
 * there is none. */
int engine_new_answer(struct engine *e, uint32_t address);
/* What that register's word reads as, without a callback, until a store to a window with answers or to AHB2, or
 * `engine_forget_answers`. */
void engine_answer(struct engine *e, uint32_t answer, uint32_t value);
void engine_forget_answers(struct engine *e);
/* Reads that were answered so since the last call. */
uint64_t engine_answered(struct engine *e, uint32_t answer);
/* Its number; -1: there are too many. */
int engine_new_alarm(struct engine *e);
void engine_set_alarm(struct engine *e, uint32_t alarm, uint64_t cycle);
uint64_t engine_due(const struct engine *e, uint32_t alarm);
uint64_t engine_cycle(const struct engine *e);
void engine_irq(struct engine *e, uint32_t number, bool asserted);
void engine_nmi(struct engine *e);
/* A bus master's access: no check of alignment, no MPU. */
uint32_t engine_load(struct engine *e, uint32_t address, uint32_t size);
void engine_store(struct engine *e, uint32_t address, uint32_t size, uint32_t value);
/* NULL: no memory is there. */
uint8_t *engine_memory(struct engine *e, uint32_t address, uint32_t size);
/* Changes memory as a bus master of its own. Flash is changed from within a store to it, too. */
int engine_poke(struct engine *e, uint32_t address, const uint8_t *data, uint32_t size);
void engine_core_clock(struct engine *e, uint64_t hz);
void engine_flash_busy(struct engine *e, uint64_t until);
void engine_want_reset(struct engine *e);
/* A callback has failed; the message is Python's own. */
void engine_fail(struct engine *e);
const char *engine_message(const struct engine *e);
/* Where the program is: in a callback the instruction at hand, after a failure the one that failed. */
uint32_t engine_pc(const struct engine *e);
void engine_set_pc(struct engine *e, uint32_t pc);
uint32_t engine_register(struct engine *e, int name);
void engine_set_register(struct engine *e, int name, uint32_t value);
/* Plain values that decide what happens next: a snapshot copies them. */
void *engine_state(struct engine *e);
uint32_t engine_state_bytes(void);
/* After `engine_state` has been overwritten. */
void engine_restored(struct engine *e);
/* What the core has done so far. */
struct core_counts engine_counts(const struct engine *e);
/* Whether the data cache is on and holds what lies at `address`. */
bool engine_cached(const struct engine *e, uint32_t address);
/* Whether the program has stored to memory since its last barrier (DSB, DMB), in the handler or thread that runs; false
 * between two instructions. */
bool engine_stored(struct engine *e);
/* A request of `exception`, called `name`, that waits longer than `cycles` (of 216 MHz) is an error; 0: it may wait.
 * The caller keeps `name`. urgent: so is another interrupt that it may not interrupt. */
void engine_bound_entry(struct engine *e, uint32_t exception, uint64_t cycles, const char *name, bool urgent);
/* Begins, or ends, to measure where this machine's time goes. */
void engine_clock(struct engine *e, bool on);
const uint64_t *engine_spent(const struct engine *e);
const struct task *engine_task(const struct engine *e, uint32_t exception);
uint64_t *engine_enters(struct engine *e);
uint64_t *engine_leaves(struct engine *e);
int engine_set_breakpoints(struct engine *e, const uint32_t *addresses, uint32_t count);
/* More than WATCHPOINT_MAX: -1. While there is one, each instruction is looked at: the run is slower and the same. */
int engine_set_watchpoints(struct engine *e, const struct watchpoint *watchpoints, uint32_t count);
const struct watch_hit *engine_watch_hit(const struct engine *e);
/* Break- and watchpoints at the program counter are run over once; what interrupts the instruction there does not
 * count. */
void engine_skip_breakpoint(struct engine *e);
const struct node *engine_nodes(const struct engine *e, uint32_t *count);
/* Runs until `cycle` (of 216 MHz) or for at most `instructions`. Returns an enum outcome. */
int engine_run(struct engine *e, uint64_t cycle, uint64_t instructions);

#endif
