/* The whole firmware around a board: what main.c runs on a chip or as the host program, and what the library
 * (hal/host/reference.c) runs for its caller. */
#ifndef NF_PROGRAM_H
#define NF_PROGRAM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "background.h"
#include "blackbox/log_ring.h"
#include "common/imu.h"
#include "firmware.h"
#include "hal/hal.h"
#include "housekeeping/scheduler.h"

/* What it is made of lies where the board wants it. */
struct program {
	const struct hal *hal;
	struct firmware *firmware;
	struct task_stats *stats;      /* [TASK_COUNT], by enum nf_task */
	struct background *background;
	struct log_ring *log;
	uint32_t lost;                 /* gyro samples since the last control step, that were not taken */
	uint32_t fed_at;               /* gyro sample at which the watchdog was fed last */
};

/* The members of struct hal_handlers; `program` is a struct program. */
void program_sample(void *program, const struct imu_sample *sample);
void program_gyro_silent(void *program);
void program_background(void *program);
size_t program_link(void *program, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity);
void program_link_reset(void *program, unsigned port);
void program_link_pause(void *program, unsigned port);
void program_link_lost(void *program, unsigned port);
bool program_link_busy(void *program, unsigned port);

#endif
