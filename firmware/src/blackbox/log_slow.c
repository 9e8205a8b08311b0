#include <string.h>

#include "blackbox/log_encoding.h"
#include "blackbox/log_frames.h"
#include "storage/mode_range.h"

/* Boxes of the ecosystem, by the bits that its logs have them at. */
#define BOX_ARM 0
#define BOX_CHIRP 6 /* by which the ecosystem's analysis finds sweeps */
#define BOX_FAILSAFE 8
#define BOX_BEEPER 14

/* name, encoding, where its value is taken from. All are unsigned and predicted as 0. */
#define SLOW_FIELDS(X)                                                \
	X("flightModeFlags", LOG_UNSIGNED, slow->flags &LOG_BOXES)    \
	X("stateFlags", LOG_UNSIGNED, 0u)                             \
	X("failsafePhase", LOG_UNSIGNED, slow->failsafe_phase)        \
	X("rxSignalReceived", LOG_UNSIGNED, slow->receiver_good)      \
	X("rxFlightChannelsValid", LOG_UNSIGNED, slow->channels_good) \
	X("slowStep", LOG_UNSIGNED, slow->step)                       \
	X("nfFlags", LOG_UNSIGNED, slow->flags >> 16)                 \
	X("edgeForbidden", LOG_UNSIGNED, slow->forbidden)             \
	X("edgeGain", LOG_UNSIGNED, slow->gain)                       \
	X("edgeFlags", LOG_UNSIGNED, slow->edges)                     \
	X("dropped", LOG_UNSIGNED, slow->dropped)                     \
	X("motorFlags", LOG_UNSIGNED, slow->motors)                   \
	X("rxCount", LOG_UNSIGNED, slow->receiver_count)              \
	X("rxBytes[0]", LOG_TAG8_8SVB, slow->receiver[0])             \
	X("rxBytes[1]", LOG_TAG8_8SVB, slow->receiver[1])             \
	X("rxBytes[2]", LOG_TAG8_8SVB, slow->receiver[2])             \
	X("rxBytes[3]", LOG_TAG8_8SVB, slow->receiver[3])             \
	X("rxBytes[4]", LOG_TAG8_8SVB, slow->receiver[4])             \
	X("rxBytes[5]", LOG_TAG8_8SVB, slow->receiver[5])             \
	X("rxBytes[6]", LOG_TAG8_8SVB, slow->receiver[6])             \
	X("rxBytes[7]", LOG_TAG8_8SVB, slow->receiver[7])             \
	X("rxBytes[8]", LOG_UNSIGNED, slow->receiver[8])              \
	X("rxBytes[9]", LOG_UNSIGNED, slow->receiver[9])              \
	X("rxBytes[10]", LOG_UNSIGNED, slow->receiver[10])            \
	X("rxBytes[11]", LOG_UNSIGNED, slow->receiver[11])
_Static_assert(LOG_RECEIVER_WORDS == 12, "as the fields have them");

#define FIELD(name, encoding, value) { name, encoding },
static const struct slow_field {
	const char *name;
	uint8_t encoding;
} fields[] = { SLOW_FIELDS(FIELD) };
#define FIELDS (sizeof fields / sizeof fields[0])
_Static_assert(1 + FIELDS * LOG_VARIABLE_MAX + 1 <= NF_LOG_FRAME_BYTES_MAX, "a whole slow frame");

void log_slow_line(struct printer *out, enum log_field_line line)
{
	for (size_t i = 0; i < FIELDS; ++i) {
		if (i > 0)
			printer_say(out, ",");
		if (line == LOG_LINE_NAME)
			printer_say(out, "%s", fields[i].name);
		else
			printer_say(out, "%u", line == LOG_LINE_ENCODING ? fields[i].encoding : 0u);
	}
}

static uint32_t slow_box(bool on, unsigned box)
{
	return (uint32_t)on << box;
}

uint32_t log_flags(const struct log_record *r)
{
	const bool failsafe = r->state == NF_FLIGHT_FAILSAFE_HOLD || r->state == NF_FLIGHT_FAILSAFE_DROP;
	const uint32_t boxes = slow_box(r->trace.armed != 0, BOX_ARM) | slow_box(failsafe, BOX_FAILSAFE) |
			       slow_box((r->modes & MODE_BIT(CHIRP)) != 0, BOX_CHIRP) |
			       slow_box((r->modes & MODE_BIT(BEEPER)) != 0, BOX_BEEPER);
	const uint32_t ours = (uint32_t)(r->pid_flies != 0) | (r->state & 7u) << 1 | (r->stop_cause & 15u) << 4 |
			      (r->fallback_cause & 15u) << 8 | (r->refused_cause & 15u) << 12;

	return boxes | ours << 16;
}

uint32_t log_flags_stopped(uint32_t flags, unsigned state, unsigned stop_cause)
{
	const uint32_t stale = 1u << BOX_ARM | 7u << 17 | 15u << 20;

	return (flags & ~stale) | (state & 7u) << 17 | (stop_cause & 15u) << 20;
}

/* The ecosystem's: 0 idle, 1 the signal is lost, 2 landing. */
static uint32_t slow_failsafe(const struct log_record *r)
{
	return r->state == NF_FLIGHT_FAILSAFE_HOLD ? 1u : r->state == NF_FLIGHT_FAILSAFE_DROP ? 2u : 0u;
}

void log_slow_load(struct log_slow *slow, const struct log_step *step, const struct log_frames *frames,
		   uint32_t dropped)
{
	const struct log_record *r = step->record;

	*slow = (struct log_slow){
		.flags = log_flags(r),
		.failsafe_phase = slow_failsafe(r),
		.receiver_good = r->receiver_good != 0,
		.channels_good = r->receiver_good != 0,
		.step = step->iteration,
		.dropped = dropped,
		.motors = frames->rotors ? r->silent_motors | (uint32_t)r->weak_motors << 8 : 0u,
	};
	if (frames->left_out >> NF_LOG_GROUP_REPLAY & 1u)
		return;
	slow->forbidden = r->forbidden;
	memcpy(&slow->gain, &r->voltage_gain, sizeof slow->gain);
	slow->edges = r->edge_flags;
	slow->receiver_count = r->receiver_count < NF_LOG_RECEIVER_BYTES ? r->receiver_count : NF_LOG_RECEIVER_BYTES;
	memcpy(slow->receiver, r->receiver_bytes, slow->receiver_count);
}

bool log_slow_tells(const struct log_slow *slow, const struct log_slow *last)
{
	return slow->receiver_count != 0 || slow->edges != 0 || slow->flags != last->flags ||
	       slow->receiver_good != last->receiver_good || slow->forbidden != last->forbidden ||
	       slow->gain != last->gain || slow->dropped != last->dropped || slow->motors != last->motors;
}

size_t log_frames_slow(const struct log_slow *slow, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX])
{
#define VALUE(name, encoding, value) value,
	const uint32_t values[] = { SLOW_FIELDS(VALUE) };
	uint8_t *at = bytes;

	*at++ = 'S';
	for (size_t i = 0; i < FIELDS;) {
		int32_t group[8];
		if (fields[i].encoding == LOG_UNSIGNED) {
			log_put_unsigned(&at, values[i++]);
			continue;
		}
		memcpy(group, values + i, sizeof group);
		log_put_tag8_8svb(&at, group, 8);
		i += 8;
	}
	return (size_t)(at - bytes);
}

size_t log_frames_event(uint8_t bytes[NF_LOG_FRAME_BYTES_MAX], enum nf_log_event event, const uint32_t values[],
			unsigned count)
{
	static const char farewell[] = "End of log"; /* its 0 belongs to the event */
	uint8_t *at = bytes;

	*at++ = 'E';
	*at++ = (uint8_t)event;
	for (unsigned i = 0; i < count; ++i)
		log_put_unsigned(&at, values[i]);
	if (event == NF_LOG_EVENT_LOG_END)
		for (size_t i = 0; i < sizeof farewell; ++i)
			*at++ = (uint8_t)farewell[i];
	return (size_t)(at - bytes);
}
