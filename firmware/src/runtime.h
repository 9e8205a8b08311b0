/* The whole firmware around a board: what main.c runs on a chip or as the host program, and what the library
 * (hal/host/reference.c) runs for its caller. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "background.h"
#include "blackbox/log_ring.h"
#include "firmware.h"
#include "housekeeping/scheduler.h"
#include "port/hal.h"
#include "port/imu.h"

/* References to the parts, which lie in the memory that the board requires. */
struct runtime {
	const struct hal *hal;
	struct firmware *firmware;
	struct task_stats *stats;      /* [TASK_COUNT], by enum nf_task */
	struct background *background;
	struct log_ring *log;
	uint32_t lost;                 /* gyro samples since the last control step, that were not taken */
	uint32_t fed_at;               /* gyro sample at which the watchdog was fed last */
};

/* The members of struct hal_handlers; `runtime` is a struct runtime. */
void runtime_sample(void *runtime, const struct imu_sample *sample);
void runtime_gyro_silent(void *runtime);
void runtime_background(void *runtime);
size_t runtime_link(void *runtime, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity);
void runtime_link_reset(void *runtime, unsigned port);
void runtime_link_pause(void *runtime, unsigned port);
void runtime_link_lost(void *runtime, unsigned port);
bool runtime_link_busy(void *runtime, unsigned port);
void runtime_name(void *runtime, char *text, size_t capacity);
