/* The Cortex-M7 around the program: barriers, interrupts, memory protection, caches. */
#pragma once

#include <stdint.h>

/* The whole budget of interrupt priorities (4 bits, 0 is the most urgent). Nothing else interrupts:
 * UARTs receive by circular DMA, motor frames and replies are sent by DMA and polled (but for the end of a frame that ESCs
 * answer); so is USB, without DMA.
 *
 *   priority             who                        how often      how long
 *   PRIORITY_FAULT       all faults, clock failure  never          to the reset, motors stopped
 *   PRIORITY_GYRO_EDGE   EXTI, data-ready           8 kHz          < 2 us: starts a read every n-th edge
 *   PRIORITY_MOTORS      a DMA stream, frame sent   gyro rate      < 1 us: listens to the answers; motor_telemetry alone,
 *                        or answers stored                         likewise: has them decoded
 *   PRIORITY_ANSWERS     PendSV                     gyro rate      < 20 us: decodes them; motor_telemetry alone
 *   PRIORITY_SAMPLE      a DMA stream, read done    gyro rate      the control path, < 1 gyro period
 *   PRIORITY_TICK        SysTick                    1 kHz          < 1 us: counts milliseconds; a silent gyro's step,
 *                                                                  stop frames until the program sends its own
 *   (thread)             background, MSP, sleep     the rest
 *
 * Samples, answers and the tick share a priority, so that none interrupts another: samples and the tick may step the core,
 * which reads the answers. Of those that wait, answers come first (ARMv7-M B1.5.4: the lowest exception). Erasing and
 * programming flash mask all of it but faults. */
enum priority {
	PRIORITY_FAULT = 0,
	PRIORITY_GYRO_EDGE = 1,
	PRIORITY_MOTORS = 2,
	PRIORITY_SAMPLE = 3,
	PRIORITY_TICK = PRIORITY_SAMPLE,
	PRIORITY_ANSWERS = PRIORITY_SAMPLE,
};

/* Normal memory (DMA buffers) and device registers are not ordered against each other without it. */
static inline void barrier(void)
{
	__asm volatile("dsb" ::: "memory");
}

/* Also throws away instructions fetched under the old settings. */
static inline void barrier_instructions(void)
{
	__asm volatile("dsb\n\tisb" ::: "memory");
}

static inline void interrupts_disable(void)
{
	__asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_enable(void)
{
	__asm volatile("cpsie i\n\tisb" ::: "memory");
}

/* Masks interrupts. Returns what interrupts_release takes to have them as they were. */
static inline uint32_t interrupts_hold(void)
{
	uint32_t held;

	__asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(held)::"memory");
	return held;
}

static inline void interrupts_release(uint32_t held)
{
	__asm volatile("msr primask, %0" ::"r"(held) : "memory");
}

/* Until the next interrupt has been served. The tick ends every sleep within a millisecond. */
static inline void wait_for_interrupt(void)
{
	__asm volatile("dsb\n\twfi" ::: "memory");
}

/* Faults by name instead of one hard fault; traps on division by zero and unaligned access; null page and
 * the empty external memory closed, SRAM2 not cached; both caches on. Interrupts off or not yet enabled. */
void core_start(void);

/* Writes back and invalidates the data cache, invalidates the instruction cache. Runs from ITCM, any context. */
void core_clean_caches(void);

/* Sets the priority, then enables interrupt `irq` (IRQ_...). */
void interrupt_enable(uint32_t irq, enum priority priority);
