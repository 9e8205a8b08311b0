/* The boot part in sector 0: starts the image of one of the two banks, or the boot loader in the chip's ROM.
 *
 * Runs from reset on its own: no .data, no .bss, nothing from a bank but what it checks; at 16 MHz, interrupts never
 * enabled. */
#include <stdbool.h>
#include <stdint.h>

#include "hal/stm32f7/boot/boot_flash.h"
#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/kept.h"
#include "hal/stm32f7/core/led.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/watchdog.h"
#include "storage/image_bank.h"

#define CYCLES_PER_US 16u
#define PULL_UP_US 20u /* until a line that nobody drives has risen: 50 kOhm and 100 pF take 5 us each time constant */
#define BREAK_MS 50u /* far longer than a character at any speed, in which a talking line is low too */

/* Addresses of the chip's boot loader (AN2606: STM32F72x). */
#define ROM_ADDRESS 0x1FF00000u
#define ROM_END 0x1FF0EDC0u
#define RAM_END 0x20040000u

/* Linker script. */
extern uint32_t stack_top[];
extern uint32_t dtcm_start[], dtcm_end[];

void boot_reset(void);
void boot_fault(void);

extern void (*const boot_vectors[])(void);

/* The head of a program's vector table. */
struct head {
	uint32_t stack;
	uint32_t reset;
};

static const struct head *boot_head(uint32_t address)
{
	return (const struct head *)address;
}

/* --- Into another program --------------------------------------------------------------------------------- */
static _Noreturn void boot_enter(uint32_t address)
{
	const struct head *const head = boot_head(address);

	SCB_VTOR = address;
	__asm volatile("dsb\n\t"
		       "isb\n\t"
		       "msr msp, %0\n\t"
		       "bx %1" ::"r"(head->stack),
		       "r"(head->reset));
	__builtin_unreachable();
}

static void boot_light(void)
{
	if (!board_is_known(&board))
		return;
	gpio_start();
	led_start();
	led_light(true);
}

/* A fault before an image took over: the LED lit for ever. Motor pins are inputs since reset. */
void boot_fault(void)
{
	boot_light();
	for (;;)
		__asm volatile("wfi");
}

/* The chip's boot loader takes an image by USB DFU or UART. It finds the chip as after a reset, but for the lit LED; the
 * watchdog does not run, or it would reset the chip amid an erasure. */
static __attribute__((noinline)) _Noreturn void boot_enter_rom(void)
{
	const struct head *const head = boot_head(ROM_ADDRESS);

	boot_light();
	if (head->stack > (uint32_t)dtcm_start && head->stack <= RAM_END && head->reset > ROM_ADDRESS &&
	    head->reset < ROM_END && head->reset % 2u == 1u)
		boot_enter(ROM_ADDRESS);
	boot_fault();
	__builtin_unreachable();
}

/* --- A way into the ROM without a button -------------------------------------------------------------------- */
#define RESETS (RCC_CSR_SFTRSTF | RCC_CSR_WDGRSTF | RCC_CSR_PORRSTF)

/* The image clears the causes of resets when it starts: they are those of this reset, and of starts that never came so
 * far. */
static bool boot_reset_was(uint32_t cause)
{
	return (RCC_CSR & RESETS) == cause;
}

/* Returns the request that the image left before it reset the chip. */
static bool boot_is_asked(void)
{
	const bool asked = kept.request == KEPT_ENTER_ROM;

	kept.request = 0;
	return asked && boot_reset_was(RCC_CSR_SFTRSTF);
}

static void boot_timer_start(uint32_t microseconds)
{
	SYST_RVR = microseconds * CYCLES_PER_US - 1u;
	SYST_CVR = 0;
	SYST_CSR = SYST_CSR_CLKSOURCE | SYST_CSR_ENABLE;
}

static bool boot_timer_over(void)
{
	return (SYST_CSR & SYST_CSR_COUNTFLAG) != 0u;
}

static bool boot_line_low(void)
{
	return !gpio_read(pin_of(board.msp.rx), true);
}

/* Is the MSP line held low? One look tells where it is not. */
static bool boot_hears_break(void)
{
	const struct pin rx = pin_of(board.msp.rx);
	const uint32_t clocks = RCC_AHB1ENR;

	gpio_start();
	gpio_input(rx, GPIO_PULL_UP);
	boot_timer_start(PULL_UP_US);
	while (!boot_timer_over())
		;
	bool low = boot_line_low();
	if (low) {
		boot_timer_start(BREAK_MS * 1000u);
		while (low && !boot_timer_over())
			low = boot_line_low();
	}
	SYST_CSR = 0;
	gpio_input(rx, GPIO_FLOATING);
	RCC_AHB1ENR = clocks;
	return low;
}

/* --- Which bank --------------------------------------------------------------------------------------------- */
/* An image's own description of the board lies behind its header. */
static bool boot_is_described(unsigned bank)
{
	const uint32_t address = image_bank_places[bank].address + NF_IMAGE_HEADER_OFFSET + NF_IMAGE_HEADER_BYTES;

	return board_is_known((const struct board *)address);
}

/* Whatever the checksum says, the core is not sent to where no image can be. */
static bool boot_is_image(unsigned bank)
{
	const struct nf_image_header header = image_bank_header(&boot_flash, bank);
	const uint32_t address = image_bank_places[bank].address;
	const struct head *const head = boot_head(address);

	return board_is_known(&board) && boot_is_described(bank) && image_bank_fits(&header, bank, board.name) &&
	       head->stack > (uint32_t)dtcm_start && head->stack <= (uint32_t)dtcm_end && head->stack % 8u == 0u &&
	       head->reset > address && head->reset < address + NF_FLASH_BANK_A_SIZE && head->reset % 2u == 1u;
}

/* Returns whether there is a confirmed image. It answers MSP, by which it can be asked for the ROM. */
static bool boot_has_proven(void)
{
	for (unsigned bank = 0; bank < IMAGE_BANK_COUNT; ++bank)
		if (boot_is_image(bank) && image_bank_marks(&boot_flash, bank).confirmed)
			return true;
	return false;
}

/* Only where the board has just got its power: after a reset in flight no line may keep the image from its motors. A
 * dip of the supply in flight looks like power-on (fault.c), but memory then tells that the motors were armed. And only
 * where no image has run well yet: a line is low as well where what is plugged in has no power, or is starting. */
static bool boot_is_broken_into(void)
{
	return boot_reset_was(RCC_CSR_PORRSTF) && !kept_armed() && !boot_has_proven() && board_is_known(&board) &&
	       boot_hears_break();
}

/* The header has been looked at. */
static bool boot_is_whole(unsigned bank)
{
	const struct nf_image_header header = image_bank_header(&boot_flash, bank);

	return image_bank_whole_behind(&boot_flash, bank, &header, NULL, 0);
}

/* An image on probation is checked, and its start counted; where that cannot be, another goes before it. One that has
 * run well is not checked here: that takes 50 ms, and after a reset in flight motors wait for their stop frames. It
 * checks itself (storage/image_probation.h). */
static unsigned boot_choose(void)
{
	struct image_bank_marks marks[IMAGE_BANK_COUNT];
	bool good[IMAGE_BANK_COUNT];
	unsigned last = IMAGE_BANK_NONE;

	for (unsigned bank = 0; bank < IMAGE_BANK_COUNT; ++bank) {
		marks[bank] = image_bank_marks(&boot_flash, bank);
		good[bank] = boot_is_image(bank);
	}
	for (;;) {
		const unsigned bank = image_bank_choose(marks, good);
		if (bank == IMAGE_BANK_NONE)
			return last;
		if (marks[bank].confirmed)
			return bank;
		good[bank] = boot_is_whole(bank);
		if (good[bank] && image_bank_count_start(&boot_flash, bank))
			return bank;
		if (good[bank])
			last = bank;
		good[bank] = false;
	}
}

void boot_reset(void)
{
	if (boot_is_asked() || boot_is_broken_into())
		boot_enter_rom();
	const unsigned bank = boot_choose();

	if (bank < IMAGE_BANK_COUNT) {
		/* An image that hangs before its own watchdog runs is started again, and at last gives way to the other one. */
		watchdog_start_as_reset();
		boot_enter(image_bank_places[bank].address);
	}
	boot_enter_rom();
}

/* Reset, NMI and the faults are all that can happen before VTOR moves to the bank. */
__attribute__((section(".boot_vectors"), used)) void (*const boot_vectors[])(void) = {
	(void (*)(void))stack_top, boot_reset, boot_fault, boot_fault, boot_fault, boot_fault, boot_fault,
};
