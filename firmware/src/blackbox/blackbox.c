#include "blackbox/blackbox.h"

#include <string.h>

#include "common/limit.h"
#include "storage/mode_range.h"
#include "storage/settings.h"

#define SLICE_PIECES 4u  /* frames or lines of a slice: four control steps at the lowest gyro rate */
#define AFTER_MS 200u    /* the log goes on for so long after disarming */
#define SILENT_MS 250u   /* without a control step, motors stopped: the gyro is gone, and the log ends */
#define AFTER_STEPS (AFTER_MS * POLICY_CONTROL_RATE_HZ / 1000u)
_Static_assert(2u * LOG_SNAPSHOT_STEPS <= LOG_RING_RECORDS, "the ring holds them while the header is written");

enum phase {
	WAITING,  /* for a reason to log */
	HEADER,
	FRAMES,
	FAREWELL, /* the last bytes are passed on */
	ENDING,   /* the device ends the log */
};

/* Why motors stopped, in the ecosystem's numbers; 0: for a reason that it has no number for. */
static const uint8_t reasons[] = {
	[NF_STOP_NONE] = 0, [NF_STOP_SWITCH] = 4, [NF_STOP_RECEIVER] = 1, [NF_STOP_CRASH] = 5, [NF_STOP_RUNAWAY] = 6,
};

/* Where each axis of the chip points, as the firmware turns it. */
static void blackbox_init_mount(struct log_mount *mount, const struct gyro *gyro)
{
	struct gyro turned = *gyro;

	for (unsigned axis = 0; axis < 3; ++axis) {
		float body[3];
		for (unsigned i = 0; i < 3; ++i)
			turned.last.accel[i] = i == axis ? LOG_COUNTS_G : 0;
		gyro_acceleration(&turned, body);
		for (unsigned i = 0; i < 3; ++i)
			mount->turn[i][axis] = body[i] / NF_GRAVITY;
	}
	mount->bias = gyro->bias;
}

void blackbox_init(struct blackbox *b, const struct blackbox_config *config)
{
	const struct nf_settings *s = config->about.settings;

	*b = (struct blackbox){ .config = *config, .pieces = SLICE_PIECES };
	for (unsigned slot = 0; slot < NF_MODE_SLOT_COUNT; ++slot) {
		const struct mode_range range = mode_range_unpack(settings_whole(s, SETTING_AT_mode1 + slot));
		b->switched |= range.mode == NF_MODE_BLACKBOX && range.low < range.high;
	}
	blackbox_init_mount(&b->mount, config->gyro);
	for (unsigned motor = 0; motor < POLICY_ACTION_COUNT; ++motor)
		b->mount.outputs[motor] = (uint8_t)(settings_whole(s, SETTING_AT_motor1_output + motor) - 1u);
	log_frames_init(&b->frames, s->blackbox_disabled_mask, s->gyro_rate_hz / POLICY_CONTROL_RATE_HZ,
			s->motor_telemetry != 0);
}

void blackbox_status(const struct blackbox *b, struct blackbox_status *status)
{
	*status = (struct blackbox_status){
		.chosen = (uint8_t)b->config.about.settings->blackbox_device,
		.logging = blackbox_logs(b),
		.lossy = b->dropped > 0,
		.frames = b->written,
		.dropped = b->dropped,
		.bytes = b->bytes,
	};
	if (b->config.device)
		b->config.device->status(b->config.device->context, &status->device);
}

bool blackbox_logs(const struct blackbox *b)
{
	return b->phase != WAITING;
}

/* --- Before a log ------------------------------------------------------------------------------------------------ */
/* Is a log to be written while the motors and modes are so? */
static bool blackbox_wanted(const struct blackbox *b, bool armed, uint32_t modes)
{
	if (b->config.about.settings->blackbox_mode == NF_BLACKBOX_MODE_ALWAYS)
		return true;
	return armed && (!b->switched || (modes & MODE_BIT(BLACKBOX)) != 0);
}

/* Drops the records of steps before that one. */
static void blackbox_forget(struct blackbox *b, uint32_t step)
{
	for (const struct log_record *r; (r = log_ring_next(b->config.ring)) && (int32_t)(r->trace.step - step) < 0;)
		log_ring_take(b->config.ring);
}

static bool blackbox_has_state(const struct blackbox *b)
{
	return b->config.snapshot && b->config.snapshot->taken;
}

static void blackbox_lose_state(struct blackbox *b)
{
	if (b->config.snapshot)
		b->config.snapshot->taken = false;
}

/* Takes the firmware's state anew where it is old, and drops the records that it holds already. */
static void blackbox_renew(struct blackbox *b)
{
	struct log_snapshot *snapshot = b->config.snapshot;

	if (snapshot)
		log_snapshot_renew(snapshot);
	blackbox_forget(b, blackbox_has_state(b) ? snapshot->step : b->view.step);
}

static void blackbox_begin(struct blackbox *b)
{
	const struct log_device *device = b->config.device;
	const enum log_answer answer = device->begin(device->context);
	const struct log_record *r = log_ring_next(b->config.ring);

	if (answer != LOG_DONE || !r) {
		if (answer != LOG_LATER)
			blackbox_lose_state(b);
		return;
	}
	b->config.about.first_step = r->trace.step;
	b->config.about.volts_cv = (int32_t)(limit(b->view.volts, 0.0f, 600.0f) * 100.0f);
	if (b->config.snapshot && r->trace.step != b->config.snapshot->step)
		blackbox_lose_state(b);
	b->header = (struct log_header){ 0 };
	b->sample = r->sample;
	b->next = r->trace.step;
	b->first = true;
	b->gap = true;
	b->armed = false;
	b->slow.flags = log_flags(r);
	b->disarmed = 0;
	b->written = b->dropped = b->bytes = 0;
	b->phase = HEADER;
}

static void blackbox_wait(struct blackbox *b)
{
	struct log_device_status status;

	b->config.device->status(b->config.device->context, &status);
	if (status.state != NF_LOG_STATE_READY) {
		blackbox_lose_state(b);
		blackbox_forget(b, b->view.step + 1u);
		return;
	}
	/* Without a state it waits for one, some steps at most. */
	const bool ready = (!b->config.snapshot || blackbox_has_state(b)) && log_ring_next(b->config.ring);
	if (ready && blackbox_wanted(b, b->view.armed, b->view.modes))
		blackbox_begin(b);
	else
		blackbox_renew(b);
}

/* --- A log ------------------------------------------------------------------------------------------------------- */
static void blackbox_event(struct blackbox *b, enum nf_log_event event, uint32_t one, uint32_t two)
{
	const unsigned counts[] = { [NF_LOG_EVENT_SYNC_BEEP] = 1,
				    [NF_LOG_EVENT_LOGGING_RESUME] = 2,
				    [NF_LOG_EVENT_DISARM] = 1,
				    [NF_LOG_EVENT_FLIGHT_MODE] = 2 };
	const uint32_t values[] = { one, two };

	b->out_count += (uint32_t)log_frames_event(b->out + b->out_count, event, values,
						   event < sizeof counts / sizeof counts[0] ? counts[event] : 0);
}

/* Writes an event when a mode of the ecosystem changed. Its programs would show our own flags as modes, so these are
 * written in slow frames only. */
static void blackbox_tell_modes(struct blackbox *b, uint32_t flags)
{
	const uint32_t boxes = flags & LOG_BOXES, last = b->slow.flags & LOG_BOXES;

	if (boxes != last)
		blackbox_event(b, NF_LOG_EVENT_FLIGHT_MODE, boxes, last);
}

static void blackbox_tell_stop(struct blackbox *b, unsigned cause)
{
	blackbox_event(b, NF_LOG_EVENT_DISARM, cause < sizeof reasons ? reasons[cause] : 0u, 0);
}

/* Writes an event frame for each change since the last frame. */
static void blackbox_tell(struct blackbox *b, const struct log_step *step)
{
	const struct log_record *r = step->record;
	const bool armed = r->trace.armed != 0;

	if (armed && !b->armed)
		blackbox_event(b, NF_LOG_EVENT_SYNC_BEEP, step->time_us, 0);
	blackbox_tell_modes(b, log_flags(r));
	if (!armed && b->armed)
		blackbox_tell_stop(b, r->stop_cause);
	b->armed = armed;
}

static void blackbox_tell_slow(struct blackbox *b, const struct log_step *step)
{
	struct log_slow slow;

	log_slow_load(&slow, step, &b->frames, b->dropped);
	if (!b->first && !log_slow_tells(&slow, &b->slow))
		return;
	b->out_count += (uint32_t)log_frames_slow(&slow, b->out + b->out_count);
	b->slow = slow;
}

/* Writes events, slow frame and main frame of a step. The first main frame comes first, because some decoders find
 * the end of the header by it. */
static void blackbox_frame(struct blackbox *b, const struct log_step *step)
{
	const bool intra = b->gap || step->iteration >= b->intra_at;

	if (b->first)
		b->out_count += (uint32_t)log_frames_intra(&b->frames, step, b->out + b->out_count);
	else if (b->gap)
		blackbox_event(b, NF_LOG_EVENT_LOGGING_RESUME, step->iteration, step->time_us);
	blackbox_tell(b, step);
	blackbox_tell_slow(b, step);
	if (!b->first && intra)
		b->out_count += (uint32_t)log_frames_intra(&b->frames, step, b->out + b->out_count);
	else if (!intra)
		b->out_count += (uint32_t)log_frames_inter(&b->frames, step, b->out + b->out_count);
	if (intra)
		b->intra_at = step->iteration - step->iteration % LOG_INTRA_INTERVAL + LOG_INTRA_INTERVAL;
	b->first = false;
	b->gap = false;
	++b->written;
}

/* Takes a record; returns whether there was one. */
static bool blackbox_record(struct blackbox *b)
{
	const struct log_about *about = &b->config.about;
	const struct log_record *r = log_ring_next(b->config.ring);

	if (!r)
		return false;
	const struct log_step step = {
		.record = r,
		.iteration = r->trace.step - about->first_step,
		/* Every gyro rate has periods of whole microseconds. */
		.time_us = r->sample * (1000000u / about->settings->gyro_rate_hz),
		.volts_cv = (int32_t)(limit(b->view.volts, 0.0f, 600.0f) * 100.0f + 0.5f),
		.amps_ca = (int32_t)(limit(b->view.amps, -300.0f, 300.0f) * 100.0f),
		.mount = &b->mount,
	};
	const bool armed = r->trace.armed != 0;

	b->gap |= r->trace.step != b->next;
	b->dropped += r->trace.step - b->next;
	b->sample = r->sample;
	b->next = r->trace.step + 1u;
	b->disarmed = armed ? 0 : b->armed || b->disarmed > 0 ? b->disarmed + 1 : 0;
	/* Frames go on for a while after disarming, and before arming they lead up to it. */
	if (b->switched && armed && !blackbox_wanted(b, armed, r->modes))
		b->gap = true;
	else if (step.iteration % about->settings->blackbox_divider == 0)
		blackbox_frame(b, &step);
	log_ring_take(b->config.ring);
	return true;
}

/* Did control steps end because the gyro says nothing any more? */
static bool blackbox_silent(const struct blackbox *b)
{
	const uint32_t since = b->view.samples - b->sample;

	return !b->view.armed && since > b->config.about.settings->gyro_rate_hz * SILENT_MS / 1000u;
}

/* Writes the end of a flight whose last control step was recorded before its motors stopped. */
static void blackbox_tell_silence(struct blackbox *b)
{
	struct log_slow *slow = &b->slow;
	const uint32_t flags = log_flags_stopped(slow->flags, b->view.state, b->view.stop_cause);

	blackbox_tell_modes(b, flags);
	slow->flags = flags;
	slow->edges = slow->receiver_count = 0; /* these belong to the step that they came in */
	memset(slow->receiver, 0, sizeof slow->receiver);
	b->out_count += (uint32_t)log_frames_slow(slow, b->out + b->out_count);
	if (b->armed)
		blackbox_tell_stop(b, b->view.stop_cause);
}

/* Is the log over, with the record that was taken last? */
static bool blackbox_over(const struct blackbox *b)
{
	return b->disarmed >= AFTER_STEPS && !blackbox_wanted(b, false, 0);
}

/* Fills `out`; returns whether there was something to fill it with. */
static bool blackbox_fill(struct blackbox *b)
{
	switch ((enum phase)b->phase) {
	case HEADER: {
		b->out_count = (uint32_t)log_header_next(&b->header, &b->config.about, &b->frames, (char *)b->out);
		if (b->out_count == 0)
			b->phase = FRAMES;
		return true;
	}
	case FRAMES:
		if (!blackbox_over(b)) {
			if (blackbox_record(b))
				return true;
			if (!blackbox_silent(b))
				return false;
			blackbox_tell_silence(b);
		}
		blackbox_event(b, NF_LOG_EVENT_LOG_END, 0, 0);
		b->phase = FAREWELL;
		return true;
	case FAREWELL:
		b->phase = ENDING;
		return false;
	default:
		return false;
	}
}

/* Passes on what is left in `out`; returns whether nothing is. */
static bool blackbox_pass(struct blackbox *b)
{
	const struct log_device *device = b->config.device;
	const size_t taken = device->write(device->context, b->out + b->out_at, b->out_count - b->out_at);

	b->out_at += (uint32_t)taken;
	b->bytes += (uint32_t)taken;
	if (b->out_at < b->out_count)
		return false;
	b->out_at = b->out_count = 0;
	return true;
}

static void blackbox_end(struct blackbox *b)
{
	const struct log_device *device = b->config.device;

	blackbox_forget(b, b->view.step + 1u);
	if (device->end(device->context) == LOG_LATER)
		return;
	b->phase = WAITING;
	blackbox_lose_state(b);
}

static void blackbox_go_on(struct blackbox *b)
{
	struct log_device_status status;

	b->config.device->status(b->config.device->context, &status);
	if (status.state != NF_LOG_STATE_LOGGING) { /* it failed, or is gone */
		b->out_at = b->out_count = 0;
		b->phase = ENDING;
		return;
	}
	for (unsigned piece = 0; piece < b->pieces && blackbox_pass(b); ++piece)
		if (!blackbox_fill(b))
			break;
	(void)blackbox_pass(b);
}

void blackbox_step(struct blackbox *b, const struct blackbox_view *view)
{
	const struct log_device *device = b->config.device;

	if (!device || !b->config.ring)
		return;
	b->view = *view;
	device->step(device->context);
	if (b->phase == WAITING)
		blackbox_wait(b);
	else if (b->phase == ENDING)
		blackbox_end(b);
	else
		blackbox_go_on(b);
}
