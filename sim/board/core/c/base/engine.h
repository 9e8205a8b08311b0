/* The engine of the emulated board, from the inside: the types that its C files share.
 *
 * Time is kept in 1/65536 of a cycle of 216 MHz. Between callbacks it stands at the start of the running block; the
 * instruction at hand is `clock_now()`. Everything that decides what happens next is in `struct state`, plain values that
 * a snapshot copies; the rest is memory, the processor's registers, and what can be made again. */
#ifndef ENGINE_H
#define ENGINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <unicorn/unicorn.h>

#include "api.h"

enum {
	FRACTION = 16, /* bits of time below a cycle */
	IRQ_COUNT = 104,
	EXCEPTION_COUNT = 16 + IRQ_COUNT,
	ALARM_MAX = 128,
	WINDOW_MAX = 160,
	ANSWER_MAX = 16,
	BREAKPOINT_MAX = 64,
	WATCHPOINT_MAX = 32,
	DEPTH_MAX = EXCEPTION_COUNT,
	MPU_REGIONS = 8,
	MESSAGE_BYTES = 512,
};
#define NOWHERE UINT32_MAX /* an address that no instruction has */
#define XPSR_THUMB (1u << 24)

/* RM0431 2.2.2, table 1; BOOT_ADD0's default is the alias. */
#define ITCM_BASE 0x00000000u
#define ITCM_BYTES 0x4000u
#define ALIAS_BASE 0x00200000u
#define FLASH_BASE 0x08000000u
#define FLASH_BYTES 0x80000u
#define SYSTEM_BASE 0x1FF00000u
#define SYSTEM_BYTES 0x10000u
#define SYSTEM_ALIAS_BASE 0x00100000u /* BOOT_ADD1's default */
#define RAM_BASE 0x20000000u /* DTCM, SRAM1, SRAM2 without a gap */
#define RAM_BYTES 0x40000u
#define DTCM_BYTES 0x10000u
#define APB_BASE 0x40000000u
#define APB_BYTES 0x80000u
#define AHB2_BASE 0x50000000u
#define AHB2_BYTES 0x80000u
#define PPB_BASE 0xE0000000u
#define PPB_BYTES 0x100000u
#define NULL_PAGE_BYTES 0x100u

/* Where code may run, as one row of halfwords: ITCM, then flash. */
#define ITCM_HALFWORDS (ITCM_BYTES / 2u)
#define CODE_HALFWORDS (ITCM_HALFWORDS + FLASH_BYTES / 2u)

static inline bool inside(uint32_t address, uint32_t size, uint32_t base, uint32_t bytes)
{
	return address >= base && address - base < bytes && size <= bytes - (address - base);
}

enum exception {
	EXC_THREAD = 0,
	EXC_RESET = 1,
	EXC_NMI = 2,
	EXC_HARD = 3,
	EXC_MEM = 4,
	EXC_BUS = 5,
	EXC_USAGE = 6,
	EXC_SVC = 11,
	EXC_PENDSV = 14,
	EXC_SYSTICK = 15,
	EXC_IRQ0 = 16,
};

/* What the engine does at an instruction beside unicorn. */
enum special_kind {
	SPECIAL_ACCESS,  /* check alignment and the null page */
	SPECIAL_DIVIDE,
	SPECIAL_MASKS,   /* may make a pending exception deliverable */
	SPECIAL_WAIT,    /* WFI */
	SPECIAL_CONTROL, /* reads CONTROL */
};

struct special {
	uint16_t offset; /* from the block's start [bytes] */
	uint8_t kind;
	uint8_t base;    /* register */
	uint8_t index;   /* register, 15: none */
	uint8_t shift;
	uint8_t align;   /* [bytes], 1: none */
	uint8_t always;  /* misaligned is a fault whatever CCR says */
	int16_t immediate;
};

/* What a load or store accesses: `bytes` at base + (index << shift) + immediate. */
struct access {
	uint8_t base, index, shift; /* registers; index 15: none */
	bool store;
	uint16_t bytes;             /* 0: it is no load or store */
	int32_t immediate;
};

/* What was last of a store to memory and a barrier (DSB, DMB). Stores against the stack pointer do not count, they are the
 * compiler's; nor do stores to registers, which an instruction that has made one is taken to make always. */
enum order { ORDER_NONE, ORDER_STORE, ORDER_BARRIER };

/* A run of instructions that unicorn translated as one. */
struct block {
	uint32_t start;          /* address */
	uint32_t size;           /* bytes */
	uint16_t count;
	uint16_t special_count;
	uint16_t float_offset;   /* of the first floating-point instruction, UINT16_MAX: none */
	uint16_t opening;        /* instructions at its start that an IT before it covers */
	uint16_t open;           /* instructions after its end that its last IT covers */
	bool calls;              /* ends in BL or BLX */
	uint8_t counts;          /* it is nothing but SUBS of one from this register and BNE to itself, plus 1; 0: it is not */
	uint8_t order;           /* enum order */
	uint32_t device_stores;  /* of the engine, when `order` was found */
	uint32_t code;           /* row in `enters` that it begins at */
	uint64_t times;          /* executed to its end, and not yet in `enters` */
	uint16_t *offsets;       /* of each instruction; bit 0: inside an IT, where nothing stops */
	struct special *specials;
	struct block *next;      /* what ran after it last; NULL: not known */
	struct block *other;     /* from the same address, but of another length or under an IT */
};

struct activation {
	uint32_t exception;
	uint32_t node, called; /* of the call tree, at entry */
	uint64_t entered;     /* instructions executed when it began */
	uint64_t preempted;   /* instructions of what interrupted it */
	uint64_t time;        /* at entry */
	bool stored;          /* to memory, and no barrier since then; but for what is left of a block: */
	uint32_t part, part_bytes; /* address and size of what was executed of it; 0 bytes: nothing is left to look at */
};

/* One bit for each exception. */
struct flags {
	uint64_t words[2];
};

static inline bool get(const struct flags *flags, uint32_t i)
{
	return flags->words[i >> 6] >> (i & 63u) & 1u;
}

static inline void put(struct flags *flags, uint32_t i, bool value)
{
	const uint64_t bit = UINT64_C(1) << (i & 63u);

	flags->words[i >> 6] = value ? flags->words[i >> 6] | bit : flags->words[i >> 6] & ~bit;
}

struct state {
	uint64_t time;
	uint64_t tick;               /* time of one instruction at the core clock of now */
	uint64_t cpi;                /* core cycles of an instruction, FRACTION bits below the point */
	uint64_t core_hz;
	uint64_t core_time;          /* when core_hz was set */
	uint64_t core_cycles;        /* core cycles counted until then */
	uint64_t instructions;
	uint64_t hash;
	uint64_t due[ALARM_MAX];     /* cycle */
	uint64_t flash_busy;         /* cycle until which fetches from flash wait */
	uint64_t flash_rested;       /* cycle at which it was busy last */
	uint64_t stalled;            /* time at which a fetch waited for it last */
	uint32_t last_end;           /* where the last block ended */
	uint32_t pc;                 /* valid between blocks */
	uint32_t depth;              /* of `active` */
	uint32_t repeats;            /* a handler's runs in a row, its request up at the end of each */
	struct activation active[DEPTH_MAX + 1]; /* [0] is the thread */
	struct task tasks[EXCEPTION_COUNT];
	uint64_t pended_at[EXCEPTION_COUNT];
	uint32_t pended_pc[EXCEPTION_COUNT];    /* what ran then */
	uint8_t pended_in[EXCEPTION_COUNT];     /* exception whose handler that was, EXC_THREAD: none */
	struct flags pending, is_active, enabled, line;
	uint8_t priority[EXCEPTION_COUNT];
	uint32_t node;               /* of the call tree, where the program is */
	uint32_t called;             /* the address behind a call that was the last instruction; NOWHERE: none */
	bool sleeping, itcm_closed;
	bool in_rom; /* system memory is what the program counter points to, and the callback knows */
	/* System control space. */
	uint32_t vtor, aircr, scr, ccr, cpacr, cfsr, hfsr, dfsr, mmfar, bfar, csselr, shcsr;
	uint32_t fpccr, fpcar, actlr, itcmcr, dtcmcr, ahbpcr, cacr;
	uint32_t mpu_ctrl, mpu_rnr, mpu_rbar[MPU_REGIONS], mpu_rasr[MPU_REGIONS];
	uint32_t demcr, dwt_ctrl, dwt_zero, dwt_held;
	bool dwt_unlocked;
	uint32_t syst_csr, syst_rvr, syst_held;
	uint64_t syst_zero;          /* core cycle at which the counter reaches 0; NEVER: it stands */
};

/* A window of addresses with peripherals behind it. */
struct window {
	uint32_t base, size;
	uint64_t reads, writes;
	bool answers; /* some of its registers have an answer */
};

/* What a register reads as until something happens there: a program that polls asks its peripheral once. */
struct answer {
	uint32_t address, value;
	uint64_t generation; /* it holds while `answers_generation` is one less */
	uint64_t reads;      /* answered by it */
};

/* Where unicorn hands accesses on: what it says of an address counts from `base`. */
struct region {
	struct engine *engine;
	uint32_t base;
};

/* CFSR, what of it more than one file tells (B3.2.15). */
#define FAULT_INSTRUCTION_ACCESS 1u
#define FAULT_DATA_ACCESS (1u << 1)
#define FAULT_BUS_INSTRUCTION (1u << 8)
#define FAULT_BUS_PRECISE (1u << 9)
#define FAULT_UNDEFINED (1u << 16)
#define FAULT_STATE (1u << 17)
#define FAULT_NO_COPROCESSOR (1u << 19)
#define FAULT_UNALIGNED (1u << 24)
#define FAULT_DIVIDE (1u << 25)

struct fault {
	enum exception exception; /* EXC_THREAD: none */
	uint32_t cfsr, hfsr;
	uint32_t address;
	bool has_address;
	bool jumped; /* the branch before is to blame */
	char text[MESSAGE_BYTES];
};

/* Where the time of this machine goes [ns], when asked for. */
enum { SPENT_CODE, SPENT_DEVICES, SPENT_COUNT }; /* unicorn with its hooks; accesses to peripherals and their alarms */

struct engine {
	struct state s;
	uc_engine *uc;
	uint8_t *itcm, *flash, *system, *ram;

	/* The block that runs; NULL between blocks. */
	struct block *block;
	uint32_t start;              /* its address */
	uint32_t at;                 /* the instruction at hand */
	uint32_t next_special;
	uint32_t stop_at;            /* first address in it at which hooks_consider runs */
	uint32_t event_stop;         /* first address in it not to be executed */
	bool attention;              /* something changed that may be due before event_stop */
	bool stopped;                /* by us, before `at` */
	bool waiting;                /* WFI is being executed */
	uint32_t control_in;         /* register that CONTROL was read into by the instruction before, plus 1 */
	uint32_t interrupt;          /* of unicorn's numbers, UINT32_MAX: none */
	uint64_t until, limit;       /* time, instructions */
	uint64_t next_due;           /* time of the earliest alarm or SysTick */

	uint64_t entry_bound[EXCEPTION_COUNT]; /* time that a request may wait; 0: any */
	const char *bound_name[EXCEPTION_COUNT]; /* what such a request is called */
	bool urgent[EXCEPTION_COUNT];          /* and whether it must be able to interrupt all others */
	bool strict;                 /* a fault is an error of the image, not an exception to take */
	bool failed, reset_wanted;
	char message[MESSAGE_BYTES];
	struct fault fault;
	uint32_t fault_type, fault_at, fault_size, fault_value; /* as unicorn told */
	uint32_t last_pc;            /* where it stood when it failed */

	struct block **blocks;       /* CODE_HALFWORDS, by where they begin */
	uint32_t block_rows;         /* of them, the first ones, that may hold any */
	uint64_t *enters, *leaves;   /* CODE_HALFWORDS + 1: counts by differences */
	bool *to_device;             /* CODE_HALFWORDS: whether a store there went to a register */
	uint32_t device_stores;      /* such instructions so far */

	struct region regions[3];    /* of peripherals: APB and AHB1, AHB2, the core's own */
	struct window windows[WINDOW_MAX];
	uint32_t window_count, alarm_count;
	struct answer answers[ANSWER_MAX];
	uint32_t answer_count;
	uint64_t answers_generation;
	int16_t apb[APB_BYTES >> 10], ahb2[AHB2_BYTES >> 10], ppb[PPB_BYTES >> 10];
	struct callbacks callbacks;

	uint32_t flash_patch;        /* a store to flash: offset whose bytes are set right after it */
	uint8_t flash_bytes[8];
	bool flash_stored, code_changed;

	uint32_t breakpoints[BREAKPOINT_MAX], breakpoint_count;
	struct watchpoint watchpoints[WATCHPOINT_MAX];
	struct watch_hit watch_hit;
	uint32_t watch_count;
	uint32_t skip;               /* address of the breakpoint or watched access to run over once */
	uint32_t skip_depth;         /* `skip` ends once an instruction was executed at this exception depth or below */
	bool at_breakpoint, at_watchpoint;
	bool watch_passed;           /* a watched access was executed, inside an IT block */

	/* The call tree, when asked for. */
	bool profiling;
	const uint16_t *function_of; /* CODE_HALFWORDS */
	bool clocked;
	uint64_t spent[SPENT_COUNT];
	struct node *nodes;
	uint32_t node_count, node_capacity;
};

/* The trace's hash takes in `value`. */
static inline void engine_mix(struct state *s, uint64_t value)
{
	uint64_t hash = (s->hash ^ value) * UINT64_C(0x9E3779B97F4A7C15);

	s->hash = hash ^ hash >> 29;
}

#endif
