#include "hal/stm32f7/core/fault.h"

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/kept.h"
#include "hal/stm32f7/core/motor_pins.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/stop.h"
#include "nf_contract.h"
#include "port/hal.h"

#define NOTE_MAGIC 0x544C4146u /* "FALT" */
/* A board that faults at each start would reset for ever: after so many faults in a row without hal_fault_clear it stops
 * and shows them by the LED. */
#define FAULTS_IN_A_ROW_MAX 3u
_Static_assert(NF_IMAGE_STARTS_MAX < FAULTS_IN_A_ROW_MAX, "a new image that faults gives way to the old one before");

enum { EXCEPTION_NMI = 2 }; /* SCB_ICSR VECTACTIVE: only the clock failure raises it */
enum { RESET_KEY = 0x05FA }; /* SCB_AIRCR VECTKEY */
#define FRAME_BYTES 32u /* what every exception stacks last: r0..r3, r12, lr, pc, psr */

/* Linker script. */
extern uint32_t dtcm_start[], stack_top[];

_Noreturn void fault_stop(const uint32_t *frame);

/* Kept across every reset; after a loss of power its checksum fails. */
static struct note {
	uint32_t magic;
	uint32_t in_a_row;
	struct fault_record record;
	uint32_t checksum;
} note __attribute__((section(".noinit")));

/* Set by fault_start. */
static uint32_t reset_flags; /* RCC_CSR as it was */
static uint32_t steps_before_reset;
static bool armed_before_reset;
static bool shows_card;

/* Rotates before each word, so that exchanged or equal words change the sum. */
static uint32_t fault_checksum(const struct note *n)
{
	const uint32_t *const words = (const uint32_t *)(const void *)n;
	uint32_t sum = NOTE_MAGIC;

	for (uint32_t i = 0; i < offsetof(struct note, checksum) / sizeof(uint32_t); ++i)
		sum = (sum << 5 | sum >> 27) ^ words[i];
	return sum;
}
_Static_assert(sizeof(struct fault_record) % sizeof(uint32_t) == 0, "the checksum takes words");

static bool fault_noted(void)
{
	return note.magic == NOTE_MAGIC && note.checksum == fault_checksum(&note);
}

static void fault_forget_flight(void)
{
	kept.steps = 0;
	kept.armed = 0;
}

/* The mark of a flight stays until its end is recorded, as a line that bounces resets the chip more than once. */
void fault_start(void)
{
	reset_flags = RCC_CSR;
	RCC_CSR |= RCC_CSR_RMVF;
	steps_before_reset = kept.steps;
	armed_before_reset = kept_armed();
	/* After a loss of power memory holds anything. */
	shows_card = kept.card == KEPT_SHOW_CARD &&
		     (reset_flags & (RCC_CSR_SFTRSTF | RCC_CSR_WDGRSTF | RCC_CSR_PORRSTF)) == RCC_CSR_SFTRSTF;
	kept.card = 0;
	if (!armed_before_reset)
		fault_forget_flight();
}

bool fault_shows_card(void)
{
	return shows_card;
}

void fault_note_steps(uint32_t steps, bool armed)
{
	kept.steps = steps;
	kept.armed = armed ? KEPT_ARMED + steps : 0u;
}

/* The cause of a reset that no software requested. BORRSTF without PORRSTF is the brown-out detector's, where the option
 * bytes have it on; as the chip is delivered it is off, and a dip sets both, as power-on does (RM0431, RCC_CSR; STM32F7
 * HAL: "POR/PDR or BOR reset"). Then memory tells a dip in flight: it still says that the motors were armed, which
 * an aircraft that was switched off would not. A pull at NRST leaves no flag of its own; the motors were armed then, and
 * nothing of this program resets an armed board without a note. */
static uint32_t fault_kind_of_reset(void)
{
	if ((reset_flags & RCC_CSR_WDGRSTF) != 0u)
		return FAULT_WATCHDOG;
	if ((reset_flags & (RCC_CSR_BORRSTF | RCC_CSR_PORRSTF)) == RCC_CSR_BORRSTF)
		return FAULT_BROWN_OUT;
	if (!armed_before_reset)
		return FAULT_NONE;
	return (reset_flags & RCC_CSR_PORRSTF) != 0u ? FAULT_BROWN_OUT : FAULT_RESET;
}

bool hal_fault_take(struct fault_record *record)
{
	if (fault_noted()) {
		*record = note.record;
		return true;
	}
	const uint32_t kind = fault_kind_of_reset();
	if (kind == FAULT_NONE)
		return false;
	*record = (struct fault_record){ .kind = kind, .uptime_steps = steps_before_reset };
	if (kind == FAULT_BROWN_OUT) /* the reset level, which the option bytes select */
		record->line = VALUE(FLASH_OPTCR_BOR_LEV, FLASH_OPTCR);
	return true;
}

void hal_fault_clear(void)
{
	note.magic = 0;
	reset_flags = 0;
	armed_before_reset = false;
	fault_forget_flight();
}

static _Noreturn void fault_reset_chip(void)
{
	barrier();
	SCB_AIRCR = FIELD(SCB_AIRCR_VECTKEY, RESET_KEY) | SCB_AIRCR_SYSRESETREQ;
	barrier();
	for (;;)
		;
}

_Noreturn void fault_reset(enum nf_reboot kind)
{
	interrupts_disable();
	motor_pins_force_low();
	kept.request = kind == NF_REBOOT_ROM ? KEPT_ENTER_ROM : 0u;
	kept.card = kind == NF_REBOOT_CARD ? KEPT_SHOW_CARD : 0u;
	fault_reset_chip();
}

/* Keeps `record` and starts anew, or rests. */
static _Noreturn void fault_keep(struct fault_record *record)
{
	const uint32_t before = fault_noted() ? note.in_a_row : 0u;

	record->uptime_steps = kept.steps;
	note.magic = NOTE_MAGIC;
	note.in_a_row = before + 1u;
	note.record = *record;
	note.checksum = fault_checksum(&note);
	if (note.in_a_row >= FAULTS_IN_A_ROW_MAX)
		stop(LED_FAULT);
	fault_reset_chip();
}

_Noreturn void fault_assert_failed(const char *file, uint32_t line)
{
	interrupts_disable();
	motor_pins_force_low();
	struct fault_record record = { .kind = FAULT_ASSERT, .line = line };

	for (size_t i = 0; i + 1u < sizeof record.file && file[i] != '\0'; ++i)
		record.file[i] = file[i];
	fault_keep(&record);
}

static void fault_copy_frame(struct fault_record *record, const uint32_t *frame)
{
	for (uint32_t i = 0; i < 4u; ++i)
		record->r[i] = frame[i];
	record->r12 = frame[4];
	record->lr = frame[5];
	record->pc = frame[6];
	record->psr = frame[7];
}

/* `frame`: where the exception stacked its registers; after a stack overflow anything at all, but a whole word's place, as the
 * stack pointer has no other (ARMv7-M B1.4.1). */
_Noreturn void fault_stop(const uint32_t *frame)
{
	motor_pins_force_low();
	const uint32_t exception = VALUE(SCB_ICSR_VECTACTIVE, SCB_ICSR);
	const uint32_t at = (uint32_t)frame;
	struct fault_record record = {
		.kind = exception == EXCEPTION_NMI ? FAULT_CLOCK : FAULT_HARD,
		.cfsr = SCB_CFSR,
		.hfsr = SCB_HFSR,
		.mmfar = SCB_MMFAR,
		.bfar = SCB_BFAR,
		.sp = at,
		.line = exception,
	};

	if (at >= (uint32_t)dtcm_start && at <= (uint32_t)stack_top - FRAME_BYTES)
		fault_copy_frame(&record, frame);
	fault_keep(&record);
}

/* The stack may be what overflowed: outside its bounds, or with too little left, it begins anew. Inside them it
 * goes on below the frame, which it must not overwrite. */
__attribute__((naked)) void fault_handler(void)
{
	__asm volatile("cpsid i\n\t"
		       "mov r0, sp\n\t"
		       "ldr r1, =dtcm_start + 512\n\t" /* fault_stop takes less */
		       "ldr r2, =stack_top\n\t"
		       "cmp r0, r1\n\t"
		       "blo 1f\n\t"
		       "cmp r0, r2\n\t"
		       "bls 2f\n"
		       "1:\tmov sp, r2\n"
		       "2:\tb fault_stop\n\t"
		       ".ltorg");
}
