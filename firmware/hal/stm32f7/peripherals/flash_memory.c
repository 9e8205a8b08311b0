#include "hal/stm32f7/peripherals/flash_memory.h"

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/core/watchdog.h"
#include "hal/stm32f7/peripherals/flash_registers.h"
#include "nf_contract.h"
#include "port/flash.h"

/* Waits are counted in reads of the register, each after a pause of so many loop turns of at least a cycle: the cycle
 * counter may wrap before a sector is erased. The data sheet's times are 31 ms a kilobyte and 0.1 ms a word at most, 16
 * us a word as a rule. */
#define PAUSE_TURNS 128u
#define READS_A_SECOND (CLOCK_CORE_HZ / PAUSE_TURNS)
#define ERASE_READS_A_KILOBYTE (READS_A_SECOND / 25u)
#define WORD_READS (READS_A_SECOND / 250u)
#define READS_A_FEED 256u /* of the watchdog: not much more than a millisecond */

extern const char bank_start[]; /* linker script: of the bank that this image runs from */

/* May the sector that begins there be erased? */
static bool flash_memory_spare(uint32_t address)
{
	return address != NF_FLASH_BOOT_ADDRESS && address != (uint32_t)bank_start;
}

/* Does all of it lie in one sector, and not over code? */
static bool flash_memory_storable(uint32_t address, size_t bytes)
{
	const uint32_t state = (uint32_t)bank_start + NF_FLASH_BANK_A_SIZE - NF_IMAGE_TAIL_BYTES;

	for (size_t i = 0; i < NF_FLASH_SECTORS_COUNT; ++i)
		if (address >= flash_sectors[i].address && bytes <= flash_sectors[i].size &&
		    address - flash_sectors[i].address <= flash_sectors[i].size - bytes)
			return flash_memory_spare(flash_sectors[i].address) ||
			       (address >= state && flash_sectors[i].address != NF_FLASH_BOOT_ADDRESS);
	return false;
}

static void flash_memory_unlock(void)
{
	if ((FLASH_CR & FLASH_CR_LOCK) == 0u)
		return;
	FLASH_KEYR = FLASH_KEY_1;
	FLASH_KEYR = FLASH_KEY_2;
}

static void flash_memory_pause(void)
{
	for (uint32_t turns = PAUSE_TURNS; turns != 0u; --turns)
		__asm volatile("");
}

/* Waits for the operation under way, feeding the watchdog. */
static bool flash_memory_wait(uint32_t looks)
{
	for (uint32_t look = 0; (FLASH_SR & FLASH_SR_BSY) != 0u; ++look) {
		if (look == looks)
			return false;
		if (look % READS_A_FEED == 0u)
			watchdog_feed();
		flash_memory_pause();
	}
	return true;
}

static bool flash_memory_succeeded(uint32_t looks)
{
	return flash_memory_wait(looks) && (FLASH_SR & FLASH_ERRORS) == 0u;
}

/* The caches hold the old contents of flash. Other modified lines are written to memory first. */
static void flash_memory_invalidate_caches(void)
{
	FLASH_ACR &= ~FLASH_ACR_ARTEN;
	FLASH_ACR |= FLASH_ACR_ARTRST;
	FLASH_ACR &= ~FLASH_ACR_ARTRST;
	FLASH_ACR |= FLASH_ACR_ARTEN;
	core_clean_caches();
}

/* From here until `flash_memory_end` nothing may read flash, neither code nor vectors nor tables, and nothing
 * interrupts. */
static bool flash_memory_begin(void)
{
	interrupts_disable();
	flash_memory_unlock();
	const bool ready = flash_memory_wait(WORD_READS);
	FLASH_SR = FLASH_ERRORS | FLASH_SR_EOP; /* of earlier operations */
	return ready;
}

static void flash_memory_end(void)
{
	FLASH_CR = FLASH_CR_LOCK;
	interrupts_enable();
	flash_memory_invalidate_caches(); /* takes longer than the gyro waits, and no handler reads what was written */
}

/* `size`: of the sector [bytes]. In ITCM, as all that runs between `begin` and `end`. */
static __attribute__((noinline)) bool flash_memory_erase_sector(unsigned sector, uint32_t size)
{
	bool good = flash_memory_begin();

	if (good) {
		FLASH_CR = FIELD(FLASH_CR_PSIZE, FLASH_PARALLEL_32) | FLASH_CR_SER | FIELD(FLASH_CR_SNB, sector);
		FLASH_CR |= FLASH_CR_STRT;
		barrier();
		good = flash_memory_succeeded(size / 1024u * ERASE_READS_A_KILOBYTE);
	}
	flash_memory_end();
	return good;
}

static __attribute__((noinline)) bool flash_memory_program_words(uint32_t address, const uint32_t *words, size_t count)
{
	bool good = flash_memory_begin();

	FLASH_CR = FIELD(FLASH_CR_PSIZE, FLASH_PARALLEL_32) | FLASH_CR_PG;
	for (size_t i = 0; good && i < count; ++i) {
		REGISTER(address + sizeof(uint32_t) * i) = words[i];
		barrier(); /* one word at a time reaches flash */
		good = flash_memory_succeeded(WORD_READS);
	}
	flash_memory_end();
	return good;
}

bool flash_memory_erase(void *context, unsigned sector)
{
	if (sector >= NF_FLASH_SECTORS_COUNT || !flash_memory_spare(flash_sectors[sector].address))
		return false;
	const uint32_t address = flash_sectors[sector].address, size = flash_sectors[sector].size;

	if (!flash_memory_erase_sector(sector, size))
		return false;
	for (uint32_t offset = 0; offset < size; offset += sizeof(uint32_t))
		if (REGISTER(address + offset) != FLASH_ERASED)
			return false;
	return true;
}

bool flash_memory_program(void *context, uint32_t address, const void *words, size_t bytes)
{
	const uint32_t *const from = words;
	const size_t count = bytes / sizeof(uint32_t);

	if (address % sizeof(uint32_t) != 0u || bytes % sizeof(uint32_t) != 0u ||
	    (uint32_t)words % sizeof(uint32_t) != 0u || !flash_memory_storable(address, bytes))
		return false;
	if (!flash_memory_program_words(address, from, count))
		return false;
	for (size_t i = 0; i < count; ++i)
		if (REGISTER(address + sizeof(uint32_t) * i) != from[i])
			return false;
	return true;
}
