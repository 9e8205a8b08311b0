/* Registers of the core, memory behind addresses, and which peripheral an access goes to. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "engine.h"

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

	look_again(e);
	if (e->failed)
		return;
	e->failed = true;
	e->last_pc = e->block != NULL ? e->at : e->s.pc;
	va_start(arguments, format);
	vsnprintf(e->message, sizeof e->message, format, arguments);
	va_end(arguments);
}

static int window_at(const struct engine *e, uint32_t address)
{
	if (inside(address, 1, APB_BASE, APB_BYTES))
		return e->apb[(address - APB_BASE) >> 10];
	if (inside(address, 1, AHB2_BASE, AHB2_BYTES))
		return e->ahb2[(address - AHB2_BASE) >> 10];
	return inside(address, 1, PPB_BASE, PPB_BYTES) ? e->ppb[(address - PPB_BASE) >> 10] : -1;
}

uint32_t device_read(struct engine *e, uint32_t address, uint32_t size)
{
	const int found = window_at(e, address);

	if (found >= 0) {
		const uint64_t began = clock_ns(e);

		++e->windows[found].reads;
		const uint32_t value = e->callbacks.read(e->callbacks.user, (uint32_t)found, address - e->windows[found].base, size);
		e->spent[SPENT_DEVICES] += clock_ns(e) - began;
		return value;
	}
	if (address >= PPB_BASE)
		return system_read(e, address, size);
	fail(e, "read of %u bytes at 0x%08X, where no modelled peripheral is", size, address);
	return 0;
}

void device_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const int found = window_at(e, address);

	if (found >= 0) {
		const uint64_t began = clock_ns(e);

		++e->windows[found].writes;
		e->callbacks.write(e->callbacks.user, (uint32_t)found, address - e->windows[found].base, size, value);
		e->spent[SPENT_DEVICES] += clock_ns(e) - began;
	} else if (address >= PPB_BASE) {
		system_write(e, address, size, value);
	} else {
		fail(e, "write of 0x%X (%u bytes) to 0x%08X, where no modelled peripheral is", value, size, address);
	}
}

static uint64_t read_region(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
	const struct region *const r = user;

	(void)uc;
	return device_read(r->engine, r->base + (uint32_t)offset, size);
}

static void write_region(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
	const struct region *const r = user;

	(void)uc;
	device_write(r->engine, r->base + (uint32_t)offset, size, (uint32_t)value);
}

static uc_err map_region(struct engine *e, uint32_t number, uint32_t base, uint32_t bytes)
{
	struct region *const r = &e->regions[number];

	*r = (struct region){.engine = e, .base = base};
	return uc_mmio_map(e->uc, base, bytes, read_region, r, write_region, r);
}

/* The chip's memory and the windows of its peripherals, as unicorn sees them. */
uc_err memory_map(struct engine *e)
{
	const uint32_t code = UC_PROT_READ | UC_PROT_EXEC, data = UC_PROT_READ | UC_PROT_WRITE;
	uc_engine *const uc = e->uc;
	uc_err error = uc_mem_map_ptr(uc, ITCM_BASE, ITCM_BYTES, UC_PROT_ALL, e->itcm);

	error = error ? error : uc_mem_map_ptr(uc, ALIAS_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, FLASH_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, SYSTEM_BASE, SYSTEM_BYTES, UC_PROT_READ, e->system);
	error = error ? error : uc_mem_map_ptr(uc, RAM_BASE, RAM_BYTES, data, e->ram);
	error = error ? error : map_region(e, 0, APB_BASE, APB_BYTES);
	error = error ? error : map_region(e, 1, AHB2_BASE, AHB2_BYTES);
	return error ? error : map_region(e, 2, PPB_BASE, PPB_BYTES);
}
