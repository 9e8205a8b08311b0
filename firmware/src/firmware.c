#include "firmware.h"

#include <string.h>

#include "common/fence.h"
#include "common/words.h"
#include "motors/dshot.h"
#include "safety/chirp_interlock.h"

#define REASON_IF(condition, name) ((condition) ? SAFETY_REASON(name) : 0u)
/* The thrust of the highest throttle stick that arms. */
#define THROTTLE_LOW ((float)(NF_THROTTLE_LOW_US - NF_CHANNEL_MIN_US) / (float)(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US))

/* Does the tilt allow arming? Not evaluated while the motors turn. */
static bool firmware_level(const struct firmware *fw)
{
	float up[3];

	if (safety_motors(&fw->safety) || fw->level_cosine == FIRMWARE_ANY_TILT)
		return true;
	attitude_up(&fw->attitude, up);
	return attitude_known(&fw->attitude) && up[2] >= fw->level_cosine;
}

/* Does the last good frame switch the mode ARM on, whatever the link's state? */
static bool firmware_switch_on(const struct firmware *fw)
{
	return (fw->receiver.on & MODE_BIT(ARM)) != 0;
}

/* Returns the reasons that forbid arming now. While the receiver is lost, its throttle counts as low. */
static uint32_t firmware_reasons(const struct firmware *fw)
{
	const bool lost = receiver_link(&fw->receiver) == RECEIVER_LOST;
	const bool throttle_high = fw->receiver.channels_us[NF_CHANNEL_THROTTLE] > NF_THROTTLE_LOW_US;

	return fw->edges.forbidden | control_reasons(&fw->control, fw->pid_wanted) |
	       REASON_IF(fw->health != NF_GYRO_HEALTH_GOOD, GYRO_BAD) | REASON_IF(fw->grace_left > 0, BOOT_GRACE) |
	       REASON_IF(!fw->gyro.calibrated, GYRO_NOT_CALIBRATED) | REASON_IF(lost, RECEIVER_LOST) |
	       REASON_IF(!lost && throttle_high, THROTTLE_HIGH) | REASON_IF(!firmware_level(fw), NOT_LEVEL) |
	       REASON_IF(motor_test_forbids(&fw->motor_test) || dshot_command_busy(&fw->dshot_command), MOTOR_TEST);
}

/* Returns the inputs of safety's state machine except those found by a control step. While the receiver is lost, the arm
 * switch counts as off. */
static uint32_t firmware_inputs(const struct firmware *fw)
{
	static const uint16_t health[] = {
		[NF_GYRO_HEALTH_GOOD] = 0,
		[NF_GYRO_HEALTH_INVALID] = SAFETY_GYRO_INVALID,
		[NF_GYRO_HEALTH_STUCK] = SAFETY_GYRO_STUCK,
		[NF_GYRO_HEALTH_SATURATED] = 0, /* flown, until it is railed */
		[NF_GYRO_HEALTH_SILENT] = SAFETY_GYRO_SILENT,
	};
	const enum receiver_link link = receiver_link(&fw->receiver);

	return health[fw->health] | (gyro_railed(&fw->gyro) ? SAFETY_GYRO_SATURATED : 0u) |
	       (link == RECEIVER_HOLD ? SAFETY_RECEIVER_HELD : 0u) |
	       (link != RECEIVER_LOST && firmware_switch_on(fw) ? SAFETY_SWITCH_ON : 0u);
}

/* Returns whether the pilot selects the PID. Switches of a lost receiver are ignored and the last choice stays,
 * except that a trial needs its switch to be held on a live link. */
static bool firmware_choose_pid(const struct firmware *fw)
{
	const enum receiver_link link = receiver_link(&fw->receiver);
	const uint32_t on = fw->receiver.on;

	if (fw->trial && (link != RECEIVER_GOOD || !(on & MODE_BIT(TRIAL))))
		return true;
	return link == RECEIVER_LOST ? fw->pid_wanted : (on & MODE_BIT(PID)) != 0;
}

/* Resets all state of the last flight. */
static void firmware_forget(struct firmware *fw)
{
	if (fw->rested)
		return;
	takeoff_reset(&fw->takeoff);
	turning_reset(&fw->turning);
	plausibility_reset(&fw->plausibility);
	crash_reset(&fw->crash);
	fw->rested = true;
}

/* Updates safety with all conditions that hold now, and the inputs `found`. */
static void firmware_update_safety(struct firmware *fw, uint32_t found)
{
	fw->pid_wanted = firmware_choose_pid(fw);
	const struct safety_conditions conditions = {
		.reasons = firmware_reasons(fw),
		.inputs = firmware_inputs(fw) | found,
	};
	if (safety_update(&fw->safety, conditions)) {
		fw->gyro.rests = false;
		control_reset(&fw->control);
		firmware_forget(fw); /* where frames disarm and arm within one control step, nothing has rested */
	}
}

void firmware_report(struct firmware *fw)
{
	struct firmware_status *status = &fw->status;
	const struct control *control = &fw->control;

	receiver_channels(&fw->receiver, status->channels_us);
	status->arming_reasons = safety_reasons(&fw->safety, firmware_reasons(fw));
	status->modes = (uint8_t)receiver_modes(&fw->receiver);
	status->receiver_good = receiver_link(&fw->receiver) == RECEIVER_GOOD;
	status->receiver_quality = (uint8_t)receiver_quality(&fw->receiver);
	status->state = (uint8_t)fw->safety.state;
	status->stop_cause = (uint8_t)fw->safety.stop_cause;
	status->fallback_cause = (uint8_t)control->fallback;
	status->refused_cause = (uint8_t)control->refused;
	status->gyro_health = (uint8_t)fw->health;
	status->policy_good = control->good[CONTROLLER_POLICY];
	status->pid_built_in = control->good[CONTROLLER_PID];
	status->pid_flies = control->flying == CONTROLLER_PID;
	status->idle = control->mixers[control->flying].idle;
	if (fw->gyro.last.temperature != 0)
		status->temperature_deg_c = gyro_temperature_c(&fw->gyro, fw->gyro_chip);
	status->attitude_known = attitude_known(&fw->attitude);
	status->airborne = fw->takeoff.airborne;
}

bool firmware_control_due(const struct firmware *fw)
{
	return fw->until_control == 0;
}

static struct motor_test_view firmware_test_view(const struct firmware *fw)
{
	return (struct motor_test_view){
		.stopped = fw->safety.state == NF_FLIGHT_DISARMED,
		.switch_on = firmware_switch_on(fw),
		.link = receiver_link(&fw->receiver),
	};
}

/* Evaluates a frame. Each one is evaluated, so that no "off" is lost behind an "on" of the same step. */
static void firmware_take_frame(struct firmware *fw)
{
	const bool good = fw->receiver.age == 0;
	const struct motor_test_view seen = firmware_test_view(fw);

	motor_test_update(&fw->motor_test, &seen);
	firmware_update_safety(fw, good && !firmware_switch_on(fw) ? SAFETY_OFF_HEARD : 0u);
}

/* Takes rare inputs from the background and returns them packed as edge flags. */
static __attribute__((noinline)) uint32_t firmware_take_handed(struct firmware *fw)
{
	const uint32_t flags = (fw->posted ? (uint32_t)LOG_EDGE_POSTED : 0u) |
			       (fw->acknowledged ? (uint32_t)LOG_EDGE_ACKNOWLEDGED : 0u) |
			       (fw->calibrate ? (uint32_t)LOG_EDGE_CALIBRATE : 0u) |
			       (fw->weights == WEIGHTS_BAD ? (uint32_t)LOG_EDGE_WEIGHTS_BAD : 0u) |
			       (fw->weights == WEIGHTS_RENEWED ? (uint32_t)LOG_EDGE_WEIGHTS_GOOD : 0u);

	fw->acknowledged = false;
	fw->calibrate = false;
	if (flags & LOG_EDGE_WEIGHTS_GOOD) {
		fw->weights = WEIGHTS_KNOWN;
		control_policy_good(&fw->control, true);
	}
	return flags;
}

/* Takes the background's inputs once at the begin of each control step. */
static __attribute__((noinline)) void firmware_take_edges(struct firmware *fw)
{
	struct firmware_edges *edges = &fw->edges;

	fw->begun = true;
	edges->forbidden = fw->forbidden;
	edges->voltage_gain = fw->voltage_gain;
	edges->flags = fw->silences;
	fw->silences = 0;
	fw->control.pid.compensation = edges->voltage_gain;
	if (fw->handed != 0)
		edges->flags |= firmware_take_handed(fw);
}

/* The last frame is evaluated by the control step that follows, together with its other conditions: a step with a frame
 * should take no longer than the others. */
void firmware_receive(struct firmware *fw, const uint8_t *bytes, size_t count)
{
	if (!fw->begun)
		firmware_take_edges(fw);
	while (receiver_push(&fw->receiver, &bytes, &count)) {
		fw->heard = count == 0 && !receiver_waits(&fw->receiver);
		if (!fw->heard)
			firmware_take_frame(fw);
	}
}

void firmware_rotors(struct firmware *fw, const uint16_t words[NF_MOTOR_COUNT_MAX])
{
	rotors_step(&fw->rotors, words, fw->outputs);
}

/* Takes the channels that the background has posted. */
static void firmware_receive_posted(struct firmware *fw)
{
	if (!(fw->edges.flags & LOG_EDGE_POSTED))
		return;
	fence();
	fw->heard |= receiver_msp(&fw->receiver, fw->posted_us);
	fence();
	fw->posted = false;
}

/* Setpoint and throttle from the sticks, or from the failsafe while it brings the aircraft down. */
static void firmware_command(struct firmware *fw)
{
	struct control_trace *trace = &fw->status.trace;
	uint16_t channels_us[NF_CHANNEL_COUNT];

	receiver_channels(&fw->receiver, channels_us);
	rates_setpoint(&fw->rates, channels_us, trace->setpoint);
	trace->throttle = rates_throttle(channels_us);
	if (!safety_descending(&fw->safety))
		return;
	for (int i = 0; i < 3; ++i)
		trace->setpoint[i] = 0.0f;
	trace->throttle = fw->failsafe_throttle;
}

/* Are the outputs that were flown plausible? If not, the PID takes over. Returns the conditions for safety where that has
 * been done and does not help, or no PID is built in. */
static uint32_t firmware_doubt(struct firmware *fw, const struct plausibility_input *input)
{
	const bool watched = fw->control.flying == CONTROLLER_POLICY || fw->control.latched;

	if (!fw->doubts || !watched)
		return 0; /* off, or the pilot chose the PID */
	const enum nf_fallback_cause cause = plausibility_step(&fw->plausibility, input);
	if (cause == NF_FALLBACK_NONE)
		return 0;
	plausibility_reset(&fw->plausibility);
	if (control_distrust(&fw->control, cause)) {
		crash_relieve(&fw->crash);
		return 0;
	}
	/* The PID is believed to ask for the right thing: unwinding its integral looks like the wrong way for a while. */
	if (cause == NF_FALLBACK_OSCILLATION || (cause == NF_FALLBACK_WRONG_WAY && fw->control.latched))
		return 0;
	return crash_watches(&fw->crash) ? SAFETY_CRASH : 0u;
}

/* Gyro and setpoint to motor outputs. Returns 0, or the conditions for safety for which `output` must not be flown. */
static uint32_t firmware_fly(struct firmware *fw, float output[POLICY_ACTION_COUNT])
{
	static const uint32_t verdicts[] = {
		[CRASH_NONE] = 0,
		[CRASH_HAPPENED] = SAFETY_CRASH,
		[CRASH_RUNAWAY] = SAFETY_RUNAWAY,
	};
	const struct control_trace *trace = &fw->status.trace;

	if (!fw->takeoff.airborne)
		takeoff_step(&fw->takeoff, trace->gyro, trace->throttle);
	const bool airborne = fw->takeoff.airborne;
	const struct control_input input = {
		.setpoint = trace->setpoint,
		.rate = trace->gyro,
		.throttle = trace->throttle,
		.rotor_speed = fw->rotors.speed,
		.rotors_silent = fw->rotors.silent,
		.pid_wanted = fw->pid_wanted,
		.standing = !airborne,
		/* Light aircraft fly long before that is a take-off, and what turns one then must see what its motors do. */
		.held = !airborne && fw->takeoff.raised == 0,
	};

	if (!control_step(&fw->control, &input, output))
		return SAFETY_NO_CONTROLLER;
	if (airborne && fw->rotors.on)
		weak_motor_step(&fw->weak_motor, fw->rotors.speed, fw->rotors.silent, output);
	turning_step(&fw->turning, trace->gyro);
	const struct crash_input crash = {
		.setpoint = trace->setpoint,
		.rate = trace->gyro,
		.turning = &fw->turning,
		.spread = control_spread(&fw->control),
		.airborne = airborne,
		.thrust = airborne && trace->throttle > THROTTLE_LOW,
	};
	float demand[3];
	const struct plausibility_input outputs = {
		.setpoint = trace->setpoint,
		.rate = trace->gyro,
		.demand = control_demand(&fw->control, demand) ? demand : NULL,
		.turning = &fw->turning,
		.room = fw->chirp.room,
		.moved = fw->control.moved,
		.standing = !airborne,
		.thrust = crash.thrust,
	};

	const uint32_t found = verdicts[crash_step(&fw->crash, &crash)];
	return firmware_doubt(fw, &outputs) | found;
}

void firmware_rehearse_init(struct firmware *fw, bool pid)
{
	float output[POLICY_ACTION_COUNT];

	fw->pid_wanted = pid;
	fw->status.trace.throttle = 0.5f;
	(void)firmware_fly(fw, output);
}

/* The motors' values of a control step whose outputs are `output`. */
static void firmware_drive(struct firmware *fw, const float output[POLICY_ACTION_COUNT])
{
	struct control_trace *trace = &fw->status.trace;
	const struct mixer *mixer = &fw->control.mixers[fw->control.flying];
	const struct motor_test_view seen = firmware_test_view(fw);
	const bool stand = !trace->armed || mixer_stops(mixer, trace->throttle);

	if (motor_test_step(&fw->motor_test, &seen, trace->dshot))
		return;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		trace->dshot[i] = stand ? NF_DSHOT_STOP : dshot_value(output[i]);
}

static void firmware_publish(struct firmware *fw)
{
	firmware_report(fw);
	fence();
	++fw->published;
}

/* While the motors stand. The first step of a flight should take no longer than the others, so that what it needs is done
 * before. */
static __attribute__((noinline)) void firmware_rest(struct firmware *fw)
{
	if (fw->edges.flags & LOG_EDGE_ACKNOWLEDGED)
		control_acknowledge(&fw->control);
	if (fw->edges.flags & LOG_EDGE_CALIBRATE) {
		fw->gyro.calibrated = false; /* the old bias stays until there is a new one */
		fw->gyro.rests = false; /* its window begins now */
	}
	gyro_rest(&fw->gyro, !motor_test_forbids(&fw->motor_test) && !dshot_command_busy(&fw->dshot_command));
	control_rest(&fw->control);
	firmware_forget(fw);
}

/* Marks the policy as bad. If it flies, the PID takes over with this control step. If no PID is built in, the policy flies on
 * under the plausibility check, because one wrong weight is safer than no controller. */
static void firmware_lose_weights(struct firmware *fw)
{
	if (safety_motors(&fw->safety))
		(void)control_distrust(&fw->control, NF_FALLBACK_WEIGHTS);
	control_policy_good(&fw->control, false);
}

static void firmware_control_step(struct firmware *fw, const float rate[3])
{
	struct control_trace *trace = &fw->status.trace;
	float output[POLICY_ACTION_COUNT] = { 0 };
	float acceleration[3];

	if (!fw->begun)
		firmware_take_edges(fw);
	fw->begun = false;
	words_copy(trace->gyro, rate, sizeof trace->gyro);
	gyro_acceleration(&fw->gyro, acceleration);
	attitude_step(&fw->attitude, rate, acceleration);
	for (int i = 0; i < 3; ++i)
		fw->status.accel_g[i] = acceleration[i] * (1.0f / NF_GRAVITY);
	safety_tick(&fw->safety);
	firmware_receive_posted(fw);
	if (fw->heard)
		firmware_take_frame(fw);
	else
		firmware_update_safety(fw, 0);
	fw->heard = false;
	firmware_command(fw);
	if ((fw->receiver.on & MODE_BIT(CHIRP)) || fw->chirp.sweep.state != CHIRP_IDLE)
		chirp_interlock_step(&fw->chirp, &fw->control, &fw->receiver, &fw->safety, trace->setpoint);
	if (fw->edges.flags & LOG_EDGE_WEIGHTS_BAD)
		firmware_lose_weights(fw);
	if (safety_motors(&fw->safety)) {
		if (fw->rested)
			weak_motor_reset(&fw->weak_motor); /* told until the next flight */
		fw->rested = false;
		const uint32_t found = firmware_fly(fw, output);
		if (found)
			firmware_update_safety(fw, found);
	} else {
		firmware_rest(fw);
	}
	trace->armed = safety_motors(&fw->safety);
	firmware_drive(fw, output);
	trace->step = fw->control_steps++;
	firmware_publish(fw);
}

/* Counts one gyro sample in all timers. */
static void firmware_tick(struct firmware *fw)
{
	++fw->samples;
	if (fw->grace_left > 0)
		--fw->grace_left;
	receiver_tick(&fw->receiver);
}

/* A lost sample in which a control step was due, or has been overdue. */
static void firmware_fall_behind(struct firmware *fw)
{
	if (++fw->overdue < fw->control_divider)
		return;
	fw->overdue = 0; /* that step is lost too: the next one is due */
	++fw->control_steps;
	safety_tick(&fw->safety);
}

void firmware_lost(struct firmware *fw, uint32_t count)
{
	for (; count > 0; --count) {
		if (fw->until_control == 0)
			firmware_fall_behind(fw);
		else
			--fw->until_control;
		firmware_tick(fw);
	}
}

/* The motors' values to their outputs, where they are not wired in their own order. */
static __attribute__((noinline)) void firmware_rewire(const struct firmware *fw, uint16_t dshot[POLICY_ACTION_COUNT])
{
	for (size_t i = 0; i < POLICY_ACTION_COUNT; ++i)
		dshot[fw->outputs[i]] = fw->status.trace.dshot[i];
}

bool firmware_sample(struct firmware *fw, const struct imu_sample *sample, uint16_t dshot[POLICY_ACTION_COUNT])
{
	float rate[3];

	fw->health = gyro_step(&fw->gyro, sample, rate);
	rpm_filter_step(&fw->rpm, &fw->rotors, rate);
	filters_step(&fw->filters, rate);
	gyro_mean_take(&fw->mean, rate);
	if (firmware_control_due(fw)) {
		gyro_mean_read(&fw->mean, rate);
		firmware_control_step(fw, rate);
	}
	for (size_t i = 0; i < POLICY_ACTION_COUNT; ++i)
		dshot[i] = fw->status.trace.dshot[i];
	if (fw->rewired)
		firmware_rewire(fw, dshot);
	if (fw->until_control == 0) {
		fw->until_control = fw->control_divider - fw->overdue;
		fw->overdue = 0;
		fw->window = fw->samples + 1u;
	}
	--fw->until_control;
	firmware_tick(fw);
	return dshot_command_step(&fw->dshot_command, !fw->status.trace.armed, dshot);
}

void firmware_gyro_silent(struct firmware *fw, uint16_t dshot[POLICY_ACTION_COUNT])
{
	struct control_trace *trace = &fw->status.trace;

	for (uint32_t i = 0; i < fw->gyro_rate_hz * NF_GYRO_BAD_MS / 1000u; ++i)
		firmware_tick(fw);
	fw->health = NF_GYRO_HEALTH_SILENT;
	fw->edges.forbidden = fw->forbidden; /* nothing arms in silence; it is told */
	fw->silences = (fw->silences | LOG_EDGE_SILENT) + LOG_EDGE_SILENCE;
	motor_test_end(&fw->motor_test);
	firmware_update_safety(fw, 0);
	trace->armed = safety_motors(&fw->safety);
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		trace->dshot[i] = NF_DSHOT_STOP;
	firmware_publish(fw);
	memcpy(dshot, trace->dshot, POLICY_ACTION_COUNT * sizeof dshot[0]);
}

void firmware_deadline(struct firmware *fw, bool missed)
{
	if (safety_motors(&fw->safety))
		control_deadline(&fw->control, missed);
}

const struct control_trace *firmware_trace(const struct firmware *fw)
{
	return &fw->status.trace;
}
