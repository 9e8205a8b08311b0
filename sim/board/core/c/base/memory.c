/* Registers of the core, memory behind addresses, and how an error is told. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "machine.h"

const int general[16] = {
	UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3, UC_ARM_REG_R4, UC_ARM_REG_R5,
	UC_ARM_REG_R6, UC_ARM_REG_R7, UC_ARM_REG_R8, UC_ARM_REG_R9, UC_ARM_REG_R10, UC_ARM_REG_R11,
	UC_ARM_REG_R12, UC_ARM_REG_SP, UC_ARM_REG_LR, UC_ARM_REG_PC,
};

uint32_t reg(struct engine *e, int name)
{
	uint32_t value = 0;

	uc_reg_read(e->uc, name, &value);
	return value;
}

void set_reg(struct engine *e, int name, uint32_t value)
{
	uc_reg_write(e->uc, name, &value);
}

/* To be called by whatever unicorn calls back for an access to data and goes on behind. Before such a callback it sets
 * ITSTATE to that of the instruction at hand, as if a fault had to be told. A block that runs keeps its conditions to
 * itself and counts on ITSTATE being zero: left as it is, the conditions of an access inside an IT block would fall on the
 * first instructions of the block that runs next, and be tied to every later way there from here. */
void forget_conditions(uc_engine *uc)
{
	const uint32_t none = XPSR_THUMB;

	uc_reg_write(uc, UC_ARM_REG_EPSR, &none);
}

uint8_t *host(struct engine *e, uint32_t address, uint32_t size)
{
	if (inside(address, size, RAM_BASE, RAM_BYTES))
		return e->ram + (address - RAM_BASE);
	if (inside(address, size, FLASH_BASE, FLASH_BYTES))
		return e->flash + (address - FLASH_BASE);
	if (inside(address, size, ALIAS_BASE, FLASH_BYTES))
		return e->flash + (address - ALIAS_BASE);
	if (inside(address, size, ITCM_BASE, ITCM_BYTES))
		return e->itcm + address;
	if (inside(address, size, SYSTEM_BASE, SYSTEM_BYTES))
		return e->system + (address - SYSTEM_BASE);
	if (inside(address, size, SYSTEM_ALIAS_BASE, SYSTEM_BYTES))
		return e->system + (address - SYSTEM_ALIAS_BASE);
	return NULL;
}

uint32_t row_of(uint32_t address)
{
	if (address < ITCM_BYTES)
		return address / 2u;
	if (inside(address, 2, FLASH_BASE, FLASH_BYTES))
		return ITCM_HALFWORDS + (address - FLASH_BASE) / 2u;
	if (inside(address, 2, ALIAS_BASE, FLASH_BYTES))
		return ITCM_HALFWORDS + (address - ALIAS_BASE) / 2u;
	return NOWHERE;
}

/* The first failure stands: what follows it may be its consequence. */
void fail(struct engine *e, const char *format, ...)
{
	va_list arguments;

	clock_attend(e);
	if (e->failed)
		return;
	e->failed = true;
	e->last_pc = e->block != NULL ? e->at : e->s.pc;
	va_start(arguments, format);
	vsnprintf(e->message, sizeof e->message, format, arguments);
	va_end(arguments);
}
