/* A board for main.c that a watchdog has reset. Its argument: "good", "flash refuses", or "settings refused", where a
 * change of this start contradicts itself. Prints whether the fault stands in flash and whether its record was cleared. */
#include <stdio.h>
#include <string.h>

#include "hal/host/board.h"
#include "port/hal.h"
#include "storage/settings.h"

static struct host_board board;
static struct hal hal;
static _Alignas(8) uint8_t bytes[NF_FLASH_BYTES];
static struct setting_change wrong;
static bool cleared;

static bool refuse(void *context, uint32_t address, const void *words, size_t count)
{
	(void)context, (void)address, (void)words, (void)count;
	return false;
}

int hal_init(int argc, char **argv, struct hal_info *info)
{
	const char *how = argc > 1 ? argv[1] : "";

	memset(bytes, 0xFF, sizeof bytes);
	host_board_init(&board, bytes);
	hal = host_board_hal(&board);
	if (strcmp(how, "flash refuses") == 0)
		hal.flash.program = refuse;
	wrong.index = NF_SETTING_COUNT;
	*info = (struct hal_info){
		.hal = &hal,
		.alignment = HOST_GYRO_ALIGNMENT,
		.gyro_rate_hz = 1000,
		.changes = &wrong,
		.change_count = strcmp(how, "settings refused") == 0,
		.identity = host_identity,
		.cycles_hz = 1000000000u,
	};
	return HAL_RUN;
}

static int tell(void)
{
	const uint8_t *log = bytes + (NF_FLASH_FAULT_RECORD_ADDRESS - NF_FLASH_BASE);
	uint32_t kind;

	memcpy(&kind, log + 8, sizeof kind); /* behind magic and boot */
	printf("%s %s\n", kind == FAULT_WATCHDOG ? "logged" : "unlogged", cleared ? "cleared" : "kept");
	return 0;
}

int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings)
{
	(void)handlers, (void)settings;
	return tell();
}

int hal_refuse(enum nf_err why)
{
	(void)why;
	return tell();
}

bool hal_fault_take(struct fault_record *record)
{
	*record = (struct fault_record){ .kind = FAULT_WATCHDOG };
	return true;
}

void hal_fault_clear(void)
{
	cleared = true;
}
