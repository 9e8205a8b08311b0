#include "motors/dshot_command.h"

/* Motor controllers accept commands only after stop frames for some time. */
#define STOPS_BEFORE_MS 10u
#define STOPS_AFTER_MS 1u
/* A command that changes a setting must be sent 6 times in a row (9 times for the first controllers). */
#define REPEATS 10u

/* Beacons are sent once; the next command waits until they have sounded. Times: BLHeli_32's specification. */
static const struct row {
	uint8_t command;
	uint8_t repeats;
	uint16_t busy_ms;
} rows[] = {
	{ NF_DSHOT_COMMAND_BEACON_1, 1, 260 },
	{ NF_DSHOT_COMMAND_BEACON_2, 1, 260 },
	{ NF_DSHOT_COMMAND_BEACON_3, 1, 280 },
	{ NF_DSHOT_COMMAND_BEACON_4, 1, 280 },
	{ NF_DSHOT_COMMAND_BEACON_5, 1, 1020 },
	{ NF_DSHOT_COMMAND_DIRECTION_1, REPEATS, STOPS_AFTER_MS },
	{ NF_DSHOT_COMMAND_DIRECTION_2, REPEATS, STOPS_AFTER_MS },
	{ NF_DSHOT_COMMAND_SAVE, REPEATS, 35 },
	{ NF_DSHOT_COMMAND_EXTENDED_TELEMETRY, REPEATS, STOPS_AFTER_MS },
	{ NF_DSHOT_COMMAND_DIRECTION_NORMAL, REPEATS, STOPS_AFTER_MS },
	{ NF_DSHOT_COMMAND_DIRECTION_REVERSED, REPEATS, STOPS_AFTER_MS },
};

/* A request: the command, the outputs of its motors above it, and above them the command that follows it. */
#define ASKED_OUTPUTS 8
#define ASKED_NEXT 16
#define ASKED_STOP (1u << 31) /* so that it differs from nothing */

static const struct row *dshot_command_find(unsigned command)
{
	for (size_t i = 0; i < sizeof rows / sizeof rows[0]; ++i)
		if (rows[i].command == command)
			return &rows[i];
	return NULL;
}

void dshot_command_init(struct dshot_command *self, unsigned gyro_rate_hz, unsigned motor_count,
			const uint8_t outputs[])
{
	*self = (struct dshot_command){ .gyro_rate_hz = gyro_rate_hz,
					.motor_count = (uint8_t)motor_count,
					.outputs = outputs };
}

bool dshot_command_busy(const struct dshot_command *self)
{
	return self->left > 0 ||
	       self->asked != 0; /* in this order: the last sample of a sequence asks for what follows it */
}

enum nf_refusal dshot_command_ask(struct dshot_command *self, unsigned command, unsigned motor, bool stopped)
{
	const unsigned next = command >> 8;

	if (command == NF_DSHOT_COMMAND_STOP) {
		self->asked = ASKED_STOP;
		return NF_REFUSAL_NONE;
	}
	if (!dshot_command_find(command & 0xFFu) || (next != 0 && next != NF_DSHOT_COMMAND_SAVE))
		return NF_REFUSAL_PAYLOAD;
	if (motor >= self->motor_count && motor != NF_DSHOT_ALL_MOTORS)
		return NF_REFUSAL_INDEX;
	if (!stopped)
		return NF_REFUSAL_ARMED;
	if (dshot_command_busy(self))
		return NF_REFUSAL_ORDER;
	const uint32_t motors = motor == NF_DSHOT_ALL_MOTORS ? (1u << self->motor_count) - 1u :
							       1u << self->outputs[motor];
	self->asked = (command & 0xFFu) | motors << ASKED_OUTPUTS | next << ASKED_NEXT;
	return NF_REFUSAL_NONE;
}

/* The request is one store, so the interrupt never sees half of it. */
static void dshot_command_take(struct dshot_command *self)
{
	const uint32_t asked = self->asked;
	const struct row *row = dshot_command_find(asked & 0xFFu);

	self->asked = 0;
	self->left = 0;
	if (!row)
		return;
	self->command = row->command;
	self->wanted = (uint8_t)(asked >> ASKED_OUTPUTS);
	self->next = (uint8_t)(asked >> ASKED_NEXT);
	self->until = self->gyro_rate_hz * row->busy_ms / 1000u;
	self->from = self->until + row->repeats;
	self->left = self->from + self->gyro_rate_hz * STOPS_BEFORE_MS / 1000u;
}

/* One sample of a sequence, never in flight: that path does without it. */
static __attribute__((noinline)) bool dshot_command_send(struct dshot_command *self, uint16_t dshot[])
{
	if (self->asked != 0)
		dshot_command_take(self);
	if (self->left == 0)
		return false;
	if (self->left == 1 && self->next != 0)
		self->asked = self->next | (uint32_t)self->wanted << ASKED_OUTPUTS;
	--self->left;
	const bool telling = self->left >= self->until && self->left < self->from;
	for (unsigned i = 0; i < self->motor_count; ++i)
		dshot[i] = telling && (self->wanted >> i & 1u) ? self->command : NF_DSHOT_STOP;
	return telling;
}

void dshot_command_unsent(struct dshot_command *self)
{
	if (self->left > 0)
		++self->left;
}

bool dshot_command_step(struct dshot_command *self, bool stopped, uint16_t dshot[])
{
	if (!stopped) {
		self->asked = 0;
		self->left = 0;
	}
	return dshot_command_busy(self) && dshot_command_send(self, dshot);
}
