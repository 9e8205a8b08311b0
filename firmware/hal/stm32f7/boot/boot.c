/* The boot part in sector 0: starts the image of one of the two banks.
 *
 * Runs from reset on its own: no .data, no .bss, nothing from a bank but what it checks. */
#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"
#include "storage/image_bank.h"

/* Linker script. */
extern uint32_t stack_top[];
extern uint32_t dtcm_start[], dtcm_end[];

void boot_reset(void);
void boot_fault(void);

extern void (*const boot_vectors[])(void);

struct bank_head {
	uint32_t stack;
	uint32_t reset;
};

static const uint8_t *boot_flash_at(void *context, uint32_t address)
{
	(void)context;
	return (const uint8_t *)address;
}

static const struct flash boot_flash = { .at = boot_flash_at };

/* Whatever the checksum says, the core is not sent to where no image can be. */
static bool boot_is_head(const struct bank_head *head, uint32_t bank_address)
{
	return head->stack > (uint32_t)dtcm_start && head->stack <= (uint32_t)dtcm_end && head->stack % 8u == 0u &&
	       head->reset > bank_address && head->reset < bank_address + NF_FLASH_BANK_A_SIZE &&
	       head->reset % 2u == 1u;
}

/* No image, or a fault before it took over: LED0 lit for ever. Motor pins are inputs since reset. */
void boot_fault(void)
{
	RCC_AHB1ENR |= BOARD_PORT_CLOCKS;
	(void)RCC_AHB1ENR;
	gpio_output(BOARD_LED0, false);
	for (;;)
		__asm volatile("wfi");
}

/* The checksum of an image that has run well is not looked at again: it takes 0.1 s at the speed that the chip starts with,
 * and after a reset in flight motors wait for their stop frames. The image itself checks it. */
static unsigned boot_choose(void)
{
	static const char board[NF_IMAGE_BOARD_BYTES] = BOARD_TARGET;
	struct image_bank_marks marks[IMAGE_BANK_COUNT];
	bool good[IMAGE_BANK_COUNT];

	for (unsigned bank = 0; bank < IMAGE_BANK_COUNT; ++bank) {
		const struct nf_image_header header = image_bank_header(&boot_flash, bank);
		marks[bank] = image_bank_marks(&boot_flash, bank);
		good[bank] = image_bank_fits(&header, bank, board);
	}
	for (;;) {
		const unsigned bank = image_bank_choose(marks, good);
		if (bank == IMAGE_BANK_NONE || marks[bank].confirmed || image_bank_whole(&boot_flash, bank, board))
			return bank;
		good[bank] = false;
	}
}

void boot_reset(void)
{
	const unsigned bank = boot_choose();

	if (bank == IMAGE_BANK_NONE)
		boot_fault();
	const uint32_t address = image_bank_places[bank].address;
	const struct bank_head *const head = (const struct bank_head *)address;
	if (!boot_is_head(head, address))
		boot_fault();
	SCB_VTOR = address;
	__asm volatile("dsb\n\t"
		       "isb\n\t"
		       "msr msp, %0\n\t"
		       "bx %1" ::"r"(head->stack),
		       "r"(head->reset));
	__builtin_unreachable();
}

/* Reset, NMI and the faults are all that can happen before VTOR moves to the bank. */
__attribute__((section(".boot_vectors"), used)) void (*const boot_vectors[])(void) = {
	(void (*)(void))stack_top, boot_reset, boot_fault, boot_fault, boot_fault, boot_fault, boot_fault,
};
