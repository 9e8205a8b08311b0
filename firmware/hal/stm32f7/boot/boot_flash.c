#include "hal/stm32f7/boot/boot_flash.h"

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/peripherals/flash_registers.h"

/* In reads of a register, at least two cycles each of 16 MHz: a word takes 0.1 ms at most. */
#define WORD_READS 16000u

static const uint8_t *boot_flash_at(void *context, uint32_t address)
{
	return (const uint8_t *)address;
}

static bool boot_flash_wait(void)
{
	for (uint32_t look = 0; look < WORD_READS; ++look)
		if ((FLASH_SR & FLASH_SR_BSY) == 0u)
			return true;
	return false;
}

static bool boot_flash_program(void *context, uint32_t address, const void *words, size_t bytes)
{
	const uint32_t *const from = words;
	bool good = boot_flash_wait();

	if ((FLASH_CR & FLASH_CR_LOCK) != 0u) {
		FLASH_KEYR = FLASH_KEY_1;
		FLASH_KEYR = FLASH_KEY_2;
	}
	FLASH_SR = FLASH_ERRORS | FLASH_SR_EOP; /* of earlier operations */
	FLASH_CR = FIELD(FLASH_CR_PSIZE, FLASH_PARALLEL_32) | FLASH_CR_PG;
	for (size_t i = 0; good && i < bytes / sizeof(uint32_t); ++i) {
		REGISTER(address + sizeof(uint32_t) * i) = from[i];
		barrier(); /* one word at a time reaches flash */
		good = boot_flash_wait() && (FLASH_SR & FLASH_ERRORS) == 0u &&
		       REGISTER(address + sizeof(uint32_t) * i) == from[i];
	}
	FLASH_CR = FLASH_CR_LOCK;
	return good;
}

const struct flash boot_flash = { .at = boot_flash_at, .program = boot_flash_program };
