#include "hal/host/reference.h"

#include <string.h>

#include "background.h"
#include "control/pid.h"
#include "hal/host/board.h"
#include "hal/host/changes.h"
#include "hal/host/convert.h"
#include "hal/host/log_pipe.h"
#include "runtime.h"

struct reference {
	struct firmware firmware;
	_Alignas(8) float weights[POLICY_WEIGHT_COUNT];
	struct task_stats stats[TASK_COUNT];
	struct background background;
	struct runtime runtime;
	struct host_board board;
	struct hal hal;              /* of the board */
	struct setting_change changes[NF_SETTING_COUNT];
	struct log_ring log;
	struct log_ring watched;     /* of reference_watch */
	struct log_pipe pipe;
	_Alignas(8) uint8_t flash_bytes[NF_FLASH_BYTES];
};
_Static_assert(_Alignof(struct reference) <= 8, "callers align to 8");

size_t reference_size(void)
{
	return sizeof(struct reference);
}

int reference_init(void *self, unsigned gyro_hz, const char *const settings[], size_t count)
{
	struct reference *r = self;
	const struct background_config config = {
		.board = {
			.hal = &r->hal,
			.alignment = HOST_GYRO_ALIGNMENT,
			.gyro_rate_hz = gyro_hz,
			.changes = r->changes,
			.change_count = count,
			.bank = HOST_BANK,
			.identity = host_identity,
			.cycles_hz = 1000000000u,
		},
		.firmware = &r->firmware,
		.weights = r->weights,
		.stats = r->stats,
		.pid = &pid_gains_built_in,
		.log = &r->log,
	};

	memset(r, 0, sizeof *r);
	if (gyro_hz == 0)
		return NF_ERR_GYRO_RATE;
	if (count > NF_SETTING_COUNT)
		return NF_ERR_SETTINGS;
	for (size_t i = 0; i < count; ++i)
		if (!change_parse(settings[i], &r->changes[i]))
			return NF_ERR_SETTINGS;
	memset(r->flash_bytes, 0xFF, sizeof r->flash_bytes);
	host_board_install(r->flash_bytes);
	host_board_init(&r->board, r->flash_bytes);
	log_pipe_init(&r->pipe);
	r->board.log = &r->pipe.device;
	r->hal = host_board_hal(&r->board);
	r->runtime = (struct runtime){
		.hal = &r->hal,
		.firmware = &r->firmware,
		.stats = r->stats,
		.background = &r->background,
		.log = &r->log,
	};
	const enum nf_err err = background_start(&r->background, &config);

	receiver_line_start(&r->board.line, r->background.settings.receiver_protocol);
	log_ring_init(&r->log, r->background.settings.blackbox_device != NF_BLACKBOX_DEVICE_NONE);
	return err;
}

void reference_receiver(void *self, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	struct reference *r = self;

	(void)receiver_line_put(&r->board.line, channels_us);
}

void reference_power(void *self, double volts, double amps, double control_us)
{
	struct reference *r = self;

	r->board.power = convert_power(volts, amps);
	r->board.control_us = control_us;
}

void reference_rotors(void *self, const uint16_t words[NF_MOTOR_COUNT_MAX])
{
	struct reference *r = self;

	memcpy(r->board.rotors, words, sizeof r->board.rotors);
}

/* From body axes to those of the simulator's wire. */
static void reference_turn(const double body[3], double frd[3])
{
	frd[0] = body[0];
	frd[1] = -body[1];
	frd[2] = -body[2];
}

bool reference_sample(void *self, const double rates[3], const double force[3], uint16_t dshot[])
{
	struct reference *r = self;
	double rates_frd[3], force_frd[3];

	reference_turn(rates, rates_frd);
	reference_turn(force, force_frd);
	const struct imu_sample sample = host_board_sample(rates_frd, force_frd);
	runtime_sample(&r->runtime, &sample);
	runtime_background(&r->runtime);
	const size_t size = r->board.motor_count * sizeof dshot[0];
	const bool changed = memcmp(dshot, r->board.dshot, size) != 0;
	memcpy(dshot, r->board.dshot, size);
	return changed;
}

size_t reference_blackbox(void *self, uint8_t *bytes, size_t capacity)
{
	struct reference *r = self;

	return log_pipe_drain(&r->pipe, bytes, capacity);
}

void reference_silent(void *self, uint16_t dshot[])
{
	struct reference *r = self;

	runtime_gyro_silent(&r->runtime);
	runtime_background(&r->runtime);
	memcpy(dshot, r->board.dshot, r->board.motor_count * sizeof dshot[0]);
}

void reference_trace(const void *self, struct reference_trace *out)
{
	const struct reference *r = self;
	const struct control_trace *trace = firmware_trace(&r->firmware);

	memset(out, 0, sizeof *out);
	out->step = trace->step;
	memcpy(out->setpoint, trace->setpoint, sizeof out->setpoint);
	memcpy(out->gyro, trace->gyro, sizeof out->gyro);
	out->throttle = trace->throttle;
	out->armed = trace->armed;
	out->motors = trace->motor_count;
	memcpy(out->dshot, trace->dshot, sizeof out->dshot);
}

void reference_answer(const void *self, struct reference_answer *out)
{
	const struct reference *r = self;
	const struct firmware_status *status = &r->firmware.status;

	memset(out, 0, sizeof *out);
	memcpy(out->observation, r->firmware.control.seen, sizeof r->firmware.control.seen);
	memcpy(out->action, r->firmware.control.action, sizeof r->firmware.control.action);
	out->arming_reasons = status->arming_reasons;
	out->state = status->state;
	out->stop_cause = status->stop_cause;
	out->fallback_cause = status->fallback_cause;
	out->pid_flies = status->pid_flies;
}

void reference_watch(void *self)
{
	struct reference *r = self;

	log_ring_init(&r->watched, true);
	r->runtime.log = &r->watched;
}

bool reference_record(void *self, struct log_record *record)
{
	struct reference *r = self;
	const struct log_record *next = log_ring_next(&r->watched);

	if (!next)
		return false;
	*record = *next;
	log_ring_take(&r->watched);
	return true;
}

size_t reference_state_size(void)
{
	return sizeof(struct firmware);
}

uint32_t reference_layout(void)
{
	return firmware_layout();
}

bool reference_state(const void *self, uint8_t *bytes)
{
	const struct reference *r = self;

	if (r->firmware.samples != r->firmware.window)
		return false;
	memcpy(bytes, &r->firmware, sizeof r->firmware);
	return true;
}

bool reference_restore(void *self, const uint8_t *bytes, size_t count, uint32_t layout)
{
	struct reference *r = self;

	return firmware_restore(&r->firmware, bytes, count, layout);
}

int reference_replay(void *self, const struct replay_step *step, uint16_t dshot[])
{
	struct reference *r = self;

	return replay_run(&r->firmware, step, dshot);
}

size_t reference_link(void *self, unsigned port, const uint8_t *in, size_t n, uint8_t *out, size_t cap)
{
	struct reference *r = self;

	return runtime_link(&r->runtime, port, in, n, out, cap);
}

void reference_link_reset(void *self, unsigned port)
{
	struct reference *r = self;

	runtime_link_reset(&r->runtime, port);
}

void reference_link_pause(void *self, unsigned port)
{
	struct reference *r = self;

	runtime_link_pause(&r->runtime, port);
}

void reference_link_lost(void *self, unsigned port)
{
	struct reference *r = self;

	runtime_link_lost(&r->runtime, port);
}

bool reference_link_busy(void *self, unsigned port)
{
	struct reference *r = self;

	return runtime_link_busy(&r->runtime, port);
}
