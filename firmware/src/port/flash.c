#include "port/flash.h"

const struct flash_sector flash_sectors[NF_FLASH_SECTORS_COUNT] = NF_FLASH_SECTORS;

const uint8_t *flash_at(const struct flash *flash, uint32_t address)
{
	return flash->at(flash->context, address);
}

bool flash_erase(const struct flash *flash, unsigned sector)
{
	return flash->erase(flash->context, sector);
}

bool flash_program(const struct flash *flash, uint32_t address, const void *words, size_t bytes)
{
	return flash->program(flash->context, address, words, bytes);
}
