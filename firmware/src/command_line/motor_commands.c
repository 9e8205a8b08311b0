/* motor: turns one motor for some seconds, under the interlock of the motor test. */
#include "command_line/command.h"
#include "common/nf_math.h"
#include "policy.h"

#define SECONDS_MAX 5u
#define LEAVE_S 60u /* after the last motor command, the leave to turn motors ends */
#define VALUE_MAX_US ((uint32_t)(NF_CHANNEL_MIN_US + (NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US) * NF_MOTOR_TEST_MAX))
#define FRESH_MS (NF_MOTOR_TEST_TIMEOUT_MS / 5u) /* how often a value is given again */

/* All others stand. */
static enum nf_refusal motor_give(const struct command_line *cl)
{
	uint16_t values_us[POLICY_ACTION_COUNT];

	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
		values_us[i] = i + 1 == cl->motor.turning ? cl->motor.value_us : NF_CHANNEL_MIN_US;
	return cl->services->motors(cl->services->context, values_us, POLICY_ACTION_COUNT);
}

const char *command_turn_motor(struct command_line *cl, const struct firmware_status *status)
{
	struct command_line_motor *motor = &cl->motor;
	const uint32_t now = command_samples(cl);

	if (!motor->turning) {
		motor->allowed = motor->allowed && now - motor->allowed_since < LEAVE_S * status->gyro_rate_hz;
		return NULL;
	}
	if (now - motor->since >= motor->samples) {
		command_stop_motor(cl);
		motor->allowed_since = now;
		return "stopped";
	}
	if (now - motor->given < status->gyro_rate_hz * FRESH_MS / 1000u)
		return NULL;
	motor->given = now;
	if (motor_give(cl) == NF_REFUSAL_NONE)
		return NULL;
	motor->turning = 0;
	motor->allowed = false;
	return "stopped: arming switch, receiver or time-out ended the motor test; 'motor test on' allows it again";
}

/* --- The command ------------------------------------------------------------------------------------------------ */
static void motor_fail(const struct task_line *t, const char *why)
{
	command_error(t);
	printer_line(t->out, "motor: %s", why);
}

/* What the ESC tells, where it is asked. */
static void motor_say_told(const struct task_line *t, unsigned motor)
{
	const struct rotors *r = t->services->rotors;
	const unsigned errors = rotors_errors(r, motor);

	if (!r->on)
		return;
	if (r->silent >> motor & 1u) {
		printer_say(t->out, ", its ESC is silent");
		return;
	}
	printer_say(t->out, ", ");
	printer_fixed(t->out, r->speed[motor] * (30.0f / NF_PI), 0);
	printer_say(t->out, " rpm, %u.%u %% errors", errors / 100u, errors / 10u % 10u);
	if (r->known[motor] >> NF_ESC_TEMPERATURE & 1u)
		printer_say(t->out, ", %u deg C", r->told[motor][NF_ESC_TEMPERATURE]);
	if (r->known[motor] >> NF_ESC_VOLTAGE & 1u) {
		printer_say(t->out, ", ");
		printer_fixed(t->out, 0.25f * (float)r->told[motor][NF_ESC_VOLTAGE], 2);
		printer_say(t->out, " V");
	}
	if (r->known[motor] >> NF_ESC_CURRENT & 1u)
		printer_say(t->out, ", %u A", r->told[motor][NF_ESC_CURRENT]);
}

static bool motor_list(const struct task_line *t)
{
	const char *const test = t->row > 0 ? "" : t->cl->motor.allowed ? ", test on" : ", test off";

	printer_say(t->out, "motor %u: DShot %u", t->row + 1, t->status->trace.dshot[t->row]);
	motor_say_told(t, t->row);
	printer_line(t->out, "%s", test);
	return t->row + 1 < POLICY_ACTION_COUNT;
}

/* Asks for the test, as MSP's MOTOR_TEST does, and closes it again: it is opened for each motor that turns. */
static void motor_test_on(const struct task_line *t)
{
	const struct services *s = t->services;

	if (t->cl->mode != COMMAND_LINE_TYPED) {
		motor_fail(t, "only a typed session turns motors, one that '#' opens");
		return;
	}
	if (s->motor_test(s->context, NULL, NF_MOTOR_TEST_MAGIC) != NF_REFUSAL_NONE) {
		motor_fail(t, "not disarmed and ready: 'status' tells");
		return;
	}
	(void)s->motor_test(s->context, NULL, 0);
	t->cl->motor.allowed = true;
	t->cl->motor.allowed_since = command_samples(t->cl);
	printer_line(t->out, "PROPELLERS OFF? 'motor N VALUE SECONDS' turns motor N; any byte stops it");
}

static void motor_test_off(const struct task_line *t)
{
	t->cl->motor.allowed = false;
	printer_line(t->out, "motor test off");
}

static bool motor_parse(const char *text, uint32_t *number, uint32_t *value_us, uint32_t *seconds)
{
	text = command_number(text, number);
	if (text)
		text = command_number(text, value_us);
	if (text)
		text = command_number(text, seconds);
	return text && *text == '\0' && *number >= 1 && *number <= POLICY_ACTION_COUNT &&
	       *value_us >= NF_CHANNEL_MIN_US && *value_us <= VALUE_MAX_US && *seconds >= 1 && *seconds <= SECONDS_MAX;
}

static void motor_expected(const struct task_line *t)
{
	command_got(t, "motor", t->arguments);
	printer_line(t->out, "'test on', 'test off' or N VALUE SECONDS: 1 to %u, 1000 to %u us, 1 to %u s",
		     (unsigned)POLICY_ACTION_COUNT, (unsigned)VALUE_MAX_US, SECONDS_MAX);
}

/* The test is opened anew: interrupt and background decide each time whether a motor may turn. */
static void motor_turn(const struct task_line *t, uint32_t number, uint32_t value_us, uint32_t seconds)
{
	struct command_line *cl = t->cl;
	const struct services *s = t->services;
	const uint32_t now = command_samples(cl);

	if (!cl->motor.allowed) {
		motor_fail(t, "no motor test is open; take the propellers off, then 'motor test on'");
		return;
	}
	if (s->motor_test(s->context, NULL, NF_MOTOR_TEST_MAGIC) != NF_REFUSAL_NONE) {
		cl->motor.allowed = false;
		motor_fail(t, "not disarmed and ready: 'status' tells");
		return;
	}
	cl->motor = (struct command_line_motor){
		.allowed = true,
		.allowed_since = now,
		.turning = (uint8_t)number,
		.value_us = (uint16_t)value_us,
		.since = now,
		.samples = seconds * t->status->gyro_rate_hz,
		.given = now,
	};
	if (motor_give(cl) == NF_REFUSAL_NONE)
		return;
	command_stop_motor(cl);
	motor_fail(t, "the motor test does not take that value");
}

bool command_motor(const struct task_line *t)
{
	uint32_t number, value_us, seconds;

	if (t->arguments[0] == '\0')
		return motor_list(t);
	if (command_is(t->arguments, "test on"))
		motor_test_on(t);
	else if (command_is(t->arguments, "test off"))
		motor_test_off(t);
	else if (motor_parse(t->arguments, &number, &value_us, &seconds))
		motor_turn(t, number, value_us, seconds);
	else
		motor_expected(t);
	return false;
}
