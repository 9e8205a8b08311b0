/* Which peripheral an access goes to, and the chip as unicorn sees it. */
#include "../base/machine.h"
#include "../code/code.h"
#include "system.h"

int windows_at(const struct engine *e, uint32_t address)
{
	if (inside(address, 1, APB_BASE, APB_BYTES))
		return e->apb[(address - APB_BASE) >> 10];
	if (inside(address, 1, AHB2_BASE, AHB2_BYTES))
		return e->ahb2[(address - AHB2_BASE) >> 10];
	return inside(address, 1, PPB_BASE, PPB_BYTES) ? e->ppb[(address - PPB_BASE) >> 10] : -1;
}

static struct answer *windows_answer(struct engine *e, uint32_t address, uint32_t size)
{
	if (size != 4u)
		return NULL;
	for (uint32_t i = 0; i < e->answer_count; ++i)
		if (e->answers[i].address == address)
			return e->answers[i].generation == e->answers_generation + 1u ? &e->answers[i] : NULL;
	return NULL;
}

uint32_t windows_read(struct engine *e, uint32_t address, uint32_t size)
{
	const int found = windows_at(e, address);

	if (found >= 0) {
		struct answer *const answer = e->windows[found].answers ? windows_answer(e, address, size) : NULL;
		const uint64_t began = clock_host_ns(e);

		++e->windows[found].reads;
		if (answer != NULL) {
			++answer->reads;
			return answer->value;
		}
		const uint32_t value = e->callbacks.read(e->callbacks.user, (uint32_t)found, address - e->windows[found].base, size);
		e->spent[SPENT_DEVICES] += clock_host_ns(e) - began;
		return value;
	}
	if (address >= PPB_BASE)
		return system_read(e, address, size);
	fail(e, "read of %u bytes at 0x%08X, where no modelled peripheral is", size, address);
	return 0;
}

void windows_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const int found = windows_at(e, address);

	if (found >= 0) {
		const uint64_t began = clock_host_ns(e);

		++e->windows[found].writes;
		if (e->windows[found].answers || inside(address, size, AHB2_BASE, AHB2_BYTES))
			engine_forget_answers(e);
		e->callbacks.write(e->callbacks.user, (uint32_t)found, address - e->windows[found].base, size, value);
		e->spent[SPENT_DEVICES] += clock_host_ns(e) - began;
	} else if (address >= PPB_BASE) {
		system_write(e, address, size, value);
	} else {
		fail(e, "write of 0x%X (%u bytes) to 0x%08X, where no modelled peripheral is", value, size, address);
	}
}

static uint64_t windows_read_region(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
	const struct region *const r = user;

	(void)uc;
	return windows_read(r->engine, r->base + (uint32_t)offset, size);
}

static void windows_write_region(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
	const struct region *const r = user;

	(void)uc;
	blocks_note_device_store(r->engine);
	windows_write(r->engine, r->base + (uint32_t)offset, size, (uint32_t)value);
}

static uc_err windows_map_region(struct engine *e, uint32_t number, uint32_t base, uint32_t bytes)
{
	struct region *const r = &e->regions[number];

	*r = (struct region){.engine = e, .base = base};
	return uc_mmio_map(e->uc, base, bytes, windows_read_region, r, windows_write_region, r);
}

/* Unicorn asks once for each page what may be done there. Its own answer lets code run from RAM, and a page that may hold
 * code takes every store by a slow way that looks for translated code. What is wrong (a store to flash, a fetch from RAM)
 * still comes to light where unicorn compares the access with the mapping. */
static bool windows_fill_tlb(uc_engine *uc, uint64_t address, uc_mem_type type, uc_tlb_entry *result, void *user)
{
	const bool fetch = type == UC_MEM_FETCH, code = address < RAM_BASE || fetch;

	(void)user;
	if (!fetch) /* it finds ITSTATE as the block before has left it, which is right */
		forget_conditions(uc);
	result->paddr = address;
	result->perms = UC_PROT_READ | UC_PROT_WRITE | (code ? UC_PROT_EXEC : 0);
	return true;
}

/* The chip's memory and the windows of its peripherals, as unicorn sees them. */
uc_err windows_map(struct engine *e)
{
	const uint32_t code = UC_PROT_READ | UC_PROT_EXEC, data = UC_PROT_READ | UC_PROT_WRITE;
	uc_engine *const uc = e->uc;
	uc_hook hook;
	uc_err error = uc_mem_map_ptr(uc, ITCM_BASE, ITCM_BYTES, UC_PROT_ALL, e->itcm);

	error = error ? error : uc_mem_map_ptr(uc, ALIAS_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, FLASH_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, SYSTEM_BASE, SYSTEM_BYTES, UC_PROT_READ, e->system);
	error = error ? error : uc_mem_map_ptr(uc, SYSTEM_ALIAS_BASE, SYSTEM_BYTES, UC_PROT_READ, e->system);
	error = error ? error : uc_mem_map_ptr(uc, RAM_BASE, RAM_BYTES, data, e->ram);
	error = error ? error : windows_map_region(e, 0, APB_BASE, APB_BYTES);
	error = error ? error : windows_map_region(e, 1, AHB2_BASE, AHB2_BYTES);
	error = error ? error : windows_map_region(e, 2, PPB_BASE, PPB_BYTES);
	error = error ? error : uc_ctl_tlb_mode(uc, UC_TLB_VIRTUAL);
	return error ? error : uc_hook_add(uc, &hook, UC_HOOK_TLB_FILL, (void *)windows_fill_tlb, NULL, 1, 0);
}
