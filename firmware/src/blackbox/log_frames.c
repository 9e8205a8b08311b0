#include "blackbox/log_frames.h"

#include <string.h>

#include "blackbox/log_encoding.h"
#include "common/crc32.h"
#include "common/limit.h"
#include "common/nf_math.h"
#include "sensing/rotors.h"

/* Numbers of the predictors in a log's header. */
enum predictor {
	ZERO = 0,
	PREVIOUS = 1,
	STRAIGHT_LINE = 2,
	MOTOR_0 = 5,
	INCREMENT = 6,
	MIN_MOTOR = 11,
};

#define ALWAYS UINT8_MAX /* as a group */
#define SAMPLES 0        /* as a count: 3 a gyro sample */
#define DEBUGS UINT8_MAX /* as a count: the policy's outputs, and its inputs as far as they find room */
#define MOTORS POLICY_ACTION_COUNT

/* name, group, count, signed, bytes of a value at most, predictor and encoding of intra and of inter frames. A name that ends
 * with [ is an array's. */
#define ROWS(X)                                                                                                        \
	X(ITERATION, "loopIteration", ALWAYS, 1, 0, 5, ZERO, LOG_UNSIGNED, INCREMENT, LOG_NOTHING)                     \
	X(TIME, "time", ALWAYS, 1, 0, 5, ZERO, LOG_UNSIGNED, STRAIGHT_LINE, LOG_SIGNED)                                \
	X(ERROR, "axisError[", NF_LOG_GROUP_PID, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32)                   \
	X(COMMAND, "rcCommand[", NF_LOG_GROUP_COMMANDS, 4, 1, 2, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG8_8SVB)            \
	X(SETPOINT, "setpoint[", NF_LOG_GROUP_SETPOINT, 4, 1, 2, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG8_8SVB)            \
	X(VOLTS, "vbatLatest", NF_LOG_GROUP_BATTERY, 1, 0, 3, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)             \
	X(AMPS, "amperageLatest", NF_LOG_GROUP_BATTERY, 1, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG8_8SVB)            \
	X(RSSI, "rssi", NF_LOG_GROUP_RSSI, 1, 0, 2, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)                       \
	X(GYRO, "gyroADC[", NF_LOG_GROUP_GYRO, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32)                     \
	X(UNFILTERED, "gyroUnfilt[", NF_LOG_GROUP_GYRO_UNFILTERED, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32) \
	X(ATTITUDE, "imuQuaternion[", NF_LOG_GROUP_ATTITUDE, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32)       \
	X(ACC, "accSmooth[", NF_LOG_GROUP_ACC, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32)                     \
	X(MOTOR, "motor[", NF_LOG_GROUP_MOTOR, MOTORS, 0, 2, MOTOR_0, LOG_SIGNED, PREVIOUS, LOG_SIGNED)                \
	X(ERPM, "eRPM[", NF_LOG_GROUP_RPM, MOTORS, 0, 3, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_SIGNED)                     \
	X(CHIRP, "debug[", NF_LOG_GROUP_DEBUG, LOG_CHIRP_FIELDS, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG8_8SVB)      \
	X(DEBUG, "debug[", NF_LOG_GROUP_DEBUG, DEBUGS, 1, 2, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG8_8SVB)                \
	X(EXACT_GYRO, "gyroFloat[", NF_LOG_GROUP_EXACT, 3, 0, 5, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)          \
	X(EXACT_SETPOINT, "setpointFloat[", NF_LOG_GROUP_EXACT, 4, 0, 5, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)  \
	X(RAW, "gyroRaw[", NF_LOG_GROUP_REPLAY, SAMPLES, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_SIGNED)                 \
	X(RAW_ACC, "accRaw[", NF_LOG_GROUP_REPLAY, 3, 1, 3, ZERO, LOG_SIGNED, PREVIOUS, LOG_TAG2_3S32)                 \
	X(ROTORS, "rotorWord[", NF_LOG_GROUP_REPLAY, MOTORS, 0, 3, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_SIGNED)           \
	X(FLAGS, "sampleFlags", NF_LOG_GROUP_REPLAY, 1, 0, 3, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)             \
	X(LOST, "lost", NF_LOG_GROUP_REPLAY, 1, 0, 3, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_TAG8_8SVB)                     \
	X(CHECK, "inputCheck", NF_LOG_GROUP_REPLAY, 1, 0, 2, ZERO, LOG_UNSIGNED, ZERO, LOG_UNSIGNED)                   \
	X(CYCLES, "controlTime", NF_LOG_GROUP_TIMING, 1, 0, 4, ZERO, LOG_UNSIGNED, PREVIOUS, LOG_SIGNED)

#define NUMBER(id, ...) ROW_##id,
enum row_number { ROWS(NUMBER) ROW_COUNT };

#define ROW(id, name, group, count, sign, most, intra, intra_code, inter, inter_code) \
	{ name, sizeof name - 1, group, count, sign, most, { intra, inter }, { intra_code, inter_code } },
static const struct row {
	const char *name;
	uint8_t letters; /* of the name */
	uint8_t group, count, is_signed;
	uint8_t most; /* bytes of a value */
	uint8_t predictor[LOG_FRAME_COUNT], encoding[LOG_FRAME_COUNT];
} rows[] = { ROWS(ROW) };

/* Fields to omit first if frames would become too long; the policy's inputs contain the same information. */
static const uint8_t spare[] = { NF_LOG_GROUP_GYRO_UNFILTERED, NF_LOG_GROUP_ACC, NF_LOG_GROUP_PID,
				 NF_LOG_GROUP_ATTITUDE, NF_LOG_GROUP_DEBUG };

/* Fields that are written together with the present one. */
static unsigned frames_together(const struct log_frames *f, enum log_frame frame, unsigned first)
{
	const unsigned encoding = f->fields[first].encoding[frame];
	unsigned count = 1;

	if (encoding == LOG_TAG2_3S32)
		return 3;
	if (encoding != LOG_TAG8_8SVB)
		return 1;
	while (count < 8 && first + count < f->count && f->fields[first + count].encoding[frame] == encoding)
		++count;
	return count;
}

/* --- The header's lines ------------------------------------------------------------------------------------------ */
void log_frames_line(struct printer *out, const struct log_frames *f, enum log_frame frame, enum log_field_line line)
{
	for (unsigned i = 0; i < f->count; ++i) {
		const struct log_field *field = &f->fields[i];
		const struct row *row = &rows[field->row];
		const unsigned number = field->index + (field->row == ROW_DEBUG ? LOG_CHIRP_FIELDS : 0u);

		if (i > 0)
			printer_say(out, ",");
		if (line == LOG_LINE_NAME)
			printer_say(out, row->name[row->letters - 1u] == '[' ? "%s%u]" : "%s", row->name, number);
		else
			printer_say(out, "%u",
				    line == LOG_LINE_SIGNED    ? row->is_signed :
				    line == LOG_LINE_PREDICTOR ? field->predictor[frame] :
								 field->encoding[frame]);
	}
}

/* --- Which fields ------------------------------------------------------------------------------------------------ */
static void frames_add(struct log_frames *f, unsigned number, unsigned index)
{
	const struct row *row = &rows[number];
	struct log_field *field = &f->fields[f->count++];

	*field = (struct log_field){
		.row = (uint8_t)number,
		.index = (uint8_t)index,
		.predictor = { row->predictor[LOG_INTRA], row->predictor[LOG_INTER] },
		.encoding = { row->encoding[LOG_INTRA], row->encoding[LOG_INTER] },
	};
	if (number == ROW_MOTOR && index == 0)
		field->predictor[LOG_INTRA] = MIN_MOTOR;
}

/* Some decoders truncate a TAG8_8SVB group at the end of a frame, so no frame ends with one. */
static void frames_end(struct log_frames *f)
{
	for (unsigned i = f->count; i > 0 && f->fields[i - 1].encoding[LOG_INTER] == LOG_TAG8_8SVB; --i)
		f->fields[i - 1].encoding[LOG_INTER] = LOG_SIGNED;
}

static unsigned frames_count(const struct log_frames *f, const struct row *row)
{
	if (row->count == SAMPLES)
		return 3 * f->samples;
	return row->count == DEBUGS ? POLICY_ACTION_COUNT + f->observed : row->count;
}

static void frames_choose(struct log_frames *f)
{
	f->count = 0;
	for (unsigned number = 0; number < ROW_COUNT; ++number) {
		const struct row *row = &rows[number];
		if (row->group != ALWAYS && f->left_out >> row->group & 1u)
			continue;
		if (!f->rotors && (number == ROW_ERPM || number == ROW_ROTORS))
			continue;
		for (unsigned i = 0; i < frames_count(f, row) && f->count < NF_LOG_FIELDS_MAX; ++i)
			frames_add(f, number, i);
	}
	frames_end(f);
}

/* Characters of the field's name, and a comma. */
static unsigned frames_letters(const struct log_field *field)
{
	const struct row *row = &rows[field->row];

	if (row->name[row->letters - 1u] != '[')
		return row->letters + 1u;
	return row->letters + (field->index + LOG_CHIRP_FIELDS < 10u ? 3u : 4u);
}

/* Returns whether the longest possible frame fits into NF_LOG_FRAME_BYTES_MAX. */
static bool frames_fit(const struct log_frames *f)
{
	size_t bytes = 1, characters = 0;

	for (unsigned i = 0; i < f->count; ++i)
		characters += frames_letters(&f->fields[i]);
	for (unsigned i = 0; i < f->count;) {
		const unsigned count = frames_together(f, LOG_INTER, i);
		bytes += count > 1;
		for (const unsigned end = i + count; i < end; ++i)
			bytes += rows[f->fields[i].row].most;
	}
	return f->count < NF_LOG_FIELDS_MAX && bytes <= NF_LOG_FRAME_BYTES_MAX && characters <= LOG_NAME_LINE_MAX;
}

void log_frames_init(struct log_frames *f, uint32_t left_out, unsigned samples, bool rotors)
{
	*f = (struct log_frames){
		.left_out = left_out, .samples = samples, .rotors = rotors, .observed = POLICY_OBSERVATION_COUNT
	};
	frames_choose(f);
	while (f->observed > 0 && !frames_fit(f)) {
		--f->observed;
		frames_choose(f);
	}
	for (size_t i = 0; i < sizeof spare && !frames_fit(f); ++i) {
		f->left_out |= 1u << spare[i];
		frames_choose(f);
	}
}

/* --- Values ------------------------------------------------------------------------------------------------------ */
static int32_t frames_rounded(float value, float scale, float most)
{
	const float scaled = limit(value * scale, -most, most);

	return (int32_t)(scaled + (scaled < 0.0f ? -0.5f : 0.5f));
}

#define DEG_S_MAX 4095.0f /* two bytes, with the step from one end to the other */
#define TWO_BYTES_MAX 4095.0f
#define THREE_BYTES_MAX 32767.0f
#define QUATERNION_SCALE 32767.0f
#define RSSI_MAX 1023u /* the ecosystem's 100 % */
#define CHECK_MASK 0x3FFFu
#define CYCLES_MAX 0x7FFFFFFu
#define ERPM_US 600000u /* electrical turns of 1 us in 100 a minute: the ecosystem's unit */
#define COUNTS_DEG_S ((float)NF_GYRO_FULL_SCALE_DEG_S / (float)NF_GYRO_COUNTS)

static void frames_deg_s(const float rad_s[3], int32_t out[3])
{
	for (unsigned i = 0; i < 3; ++i)
		out[i] = frames_rounded(rad_s[i], NF_DEG_PER_RAD, DEG_S_MAX);
}

/* As the ecosystem has sticks: 500 to a side, its yaw to the left; throttle 1000 to 2000. */
static void frames_sticks(const uint16_t sticks_us[LOG_STICKS], int32_t out[4])
{
	const int32_t us[4] = { sticks_us[NF_CHANNEL_ROLL] - NF_CHANNEL_MID_US,
				sticks_us[NF_CHANNEL_PITCH] - NF_CHANNEL_MID_US,
				NF_CHANNEL_MID_US - sticks_us[NF_CHANNEL_YAW], sticks_us[NF_CHANNEL_THROTTLE] };

	for (unsigned i = 0; i < 4; ++i)
		out[i] = frames_rounded((float)us[i], 1.0f, TWO_BYTES_MAX);
}

static float frames_turned(const struct log_mount *mount, const int16_t counts[3], unsigned axis)
{
	const float *turn = mount->turn[axis];

	return turn[0] * counts[0] + turn[1] * counts[1] + turn[2] * counts[2];
}

/* The step's own sample. */
static void frames_unfiltered(const struct log_step *step, int32_t out[3])
{
	const struct log_record *r = step->record;
	const unsigned last = r->samples > 0 && r->samples <= LOG_SUBSAMPLES_MAX ? r->samples - 1u : 0u;

	for (unsigned i = 0; i < 3; ++i)
		out[i] = frames_rounded(frames_turned(step->mount, r->gyro[last].counts, i) * COUNTS_DEG_S -
						step->mount->bias[i] * NF_DEG_PER_RAD,
					1.0f, DEG_S_MAX);
}

static void frames_acceleration(const struct log_step *step, int32_t out[3])
{
	for (unsigned i = 0; i < 3; ++i)
		out[i] = frames_rounded(frames_turned(step->mount, step->record->accel, i), 1.0f, THREE_BYTES_MAX);
}

/* As the ecosystem's chirp analysis reads them: phase [0.2 mrad], axis, frequency [0.1 Hz], added setpoint [deg/s]. */
static void frames_chirp(const struct log_record *r, int32_t out[LOG_CHIRP_FIELDS])
{
	const bool runs = r->chirp.frequency_hz > 0.0f;

	out[0] = frames_rounded(r->chirp.phase, NF_TAU * LOG_CHIRP_PHASE_SCALE, THREE_BYTES_MAX);
	out[1] = runs ? r->chirp.axis : -1;
	out[2] = frames_rounded(r->chirp.frequency_hz, 10.0f, THREE_BYTES_MAX);
	out[3] = frames_rounded(r->chirp.added, NF_DEG_PER_RAD, THREE_BYTES_MAX);
}

/* By motor. A word that is no speed leaves the one before. */
static void frames_erpm(const struct log_step *step, const int32_t last[], int32_t out[])
{
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i) {
		const unsigned word = step->record->rotors[step->mount->outputs[i]];
		const unsigned period = rotors_period_us(word);
		const int32_t turns = period > 0 ? (int32_t)(ERPM_US / period) : 0;
		out[i] = rotors_tells_speed(word) ? turns : last[i];
	}
}

static void frames_debug(const struct log_frames *f, const struct log_record *r, int32_t out[])
{
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
		*out++ = frames_rounded(r->action[i], LOG_ACTION_SCALE, TWO_BYTES_MAX);
	for (unsigned i = 0; i < f->observed; ++i)
		*out++ = frames_rounded(r->observation[i], LOG_OBSERVATION_SCALE, TWO_BYTES_MAX);
}

static void frames_raw(const struct log_frames *f, const struct log_record *r, int32_t out[])
{
	for (unsigned i = 0; i < f->samples; ++i)
		for (unsigned axis = 0; axis < 3; ++axis)
			*out++ = i < r->samples ? r->gyro[i].counts[axis] : 0;
}

/* Bit i: sample i is not valid, 8 + i: it repeats the one before; from bit 16 on their number. */
static int32_t frames_flags(const struct log_frames *f, const struct log_record *r)
{
	uint32_t flags = (uint32_t)r->samples << 16;

	for (unsigned i = 0; i < r->samples && i < f->samples; ++i) {
		flags |= (uint32_t)((r->gyro[i].flags & LOG_SAMPLE_INVALID) != 0) << i;
		flags |= (uint32_t)((r->gyro[i].flags & LOG_SAMPLE_REPEATED) != 0) << (8 + i);
	}
	return (int32_t)flags;
}
_Static_assert(LOG_SUBSAMPLES_MAX <= 8, "a byte of bits");

/* A checksum of all inputs of the step and of its motor values, in the two bytes of a field: a wrong bit in a file is
 * found at its step, even if no motor value depends on it. */
static int32_t frames_check(const struct log_frames *f, const struct log_step *step)
{
	const struct log_record *r = step->record;
	const uint16_t counts[2] = { r->samples, r->receiver_count };
	uint32_t crc = crc32_more(0, &step->iteration, sizeof step->iteration);

	crc = crc32_more(crc, &r->forbidden, sizeof r->forbidden);
	crc = crc32_more(crc, &r->voltage_gain, sizeof r->voltage_gain);
	crc = crc32_more(crc, &r->edge_flags, sizeof r->edge_flags);
	crc = crc32_more(crc, &r->lost, sizeof r->lost);
	crc = crc32_more(crc, counts, sizeof counts);
	crc = crc32_more(crc, r->gyro, r->samples * sizeof r->gyro[0]);
	crc = crc32_more(crc, r->accel, sizeof r->accel);
	if (f->rotors)
		crc = crc32_more(crc, r->rotors, POLICY_ACTION_COUNT * sizeof r->rotors[0]);
	crc = crc32_more(crc, r->receiver_bytes, r->receiver_count);
	crc = crc32_more(crc, r->trace.dshot, POLICY_ACTION_COUNT * sizeof r->trace.dshot[0]);
	return (int32_t)(crc & CHECK_MASK);
}

/* last: of the frame before. */
static void frames_load_row(const struct log_frames *f, const struct log_step *step, unsigned row, const int32_t last[],
			    int32_t out[])
{
	const struct log_record *r = step->record;
	const struct control_trace *t = &r->trace;

	switch ((enum row_number)row) {
	case ROW_ITERATION:
		out[0] = (int32_t)step->iteration;
		break;
	case ROW_TIME:
		out[0] = (int32_t)step->time_us;
		break;
	case ROW_ERROR:
		for (unsigned i = 0; i < 3; ++i)
			out[i] = frames_rounded(t->setpoint[i] - t->gyro[i], NF_DEG_PER_RAD, THREE_BYTES_MAX);
		break;
	case ROW_COMMAND:
		frames_sticks(r->sticks_us, out);
		break;
	case ROW_SETPOINT:
		frames_deg_s(t->setpoint, out);
		out[3] = frames_rounded(t->throttle, 1000.0f, TWO_BYTES_MAX);
		break;
	case ROW_VOLTS:
		out[0] = step->volts_cv;
		break;
	case ROW_AMPS:
		out[0] = step->amps_ca;
		break;
	case ROW_RSSI:
		out[0] = (int32_t)((r->receiver_quality < 100u ? r->receiver_quality : 100u) * RSSI_MAX / 100u);
		break;
	case ROW_GYRO:
		frames_deg_s(t->gyro, out);
		break;
	case ROW_UNFILTERED:
		frames_unfiltered(step, out);
		break;
	case ROW_ATTITUDE:
		/* Of the two quaternions of an attitude the one with w >= 0, which the ecosystem leaves out. */
		for (unsigned i = 0; i < 3; ++i)
			out[i] = frames_rounded(r->attitude[1 + i],
						r->attitude[0] < 0.0f ? -QUATERNION_SCALE : QUATERNION_SCALE,
						QUATERNION_SCALE);
		break;
	case ROW_ACC:
		frames_acceleration(step, out);
		break;
	case ROW_MOTOR:
		for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
			out[i] = t->dshot[i];
		break;
	case ROW_ERPM:
		frames_erpm(step, last, out);
		break;
	case ROW_CHIRP:
		frames_chirp(r, out);
		break;
	case ROW_DEBUG:
		frames_debug(f, r, out);
		break;
	case ROW_EXACT_GYRO:
		memcpy(out, t->gyro, sizeof t->gyro);
		break;
	case ROW_EXACT_SETPOINT:
		memcpy(out, t->setpoint, sizeof t->setpoint);
		memcpy(out + 3, &t->throttle, sizeof t->throttle);
		break;
	case ROW_RAW:
		frames_raw(f, r, out);
		break;
	case ROW_RAW_ACC:
		for (unsigned i = 0; i < 3; ++i)
			out[i] = r->accel[i];
		break;
	case ROW_ROTORS:
		for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
			out[i] = r->rotors[i];
		break;
	case ROW_FLAGS:
		out[0] = frames_flags(f, r);
		break;
	case ROW_LOST:
		out[0] = (int32_t)(r->lost < UINT16_MAX ? r->lost : UINT16_MAX);
		break;
	case ROW_CHECK:
		out[0] = frames_check(f, step);
		break;
	case ROW_CYCLES:
		out[0] = (int32_t)(r->cycles < CYCLES_MAX ? r->cycles : CYCLES_MAX);
		break;
	case ROW_COUNT:
		break;
	}
}

static void frames_load(struct log_frames *f, const struct log_step *step)
{
	int32_t *now = f->values[f->present];
	const int32_t *last = f->values[(f->present + 1) % 3];

	for (unsigned i = 0; i < f->count; i += frames_count(f, &rows[f->fields[i].row]))
		frames_load_row(f, step, f->fields[i].row, last + i, now + i);
}

/* --- Frames ------------------------------------------------------------------------------------------------------ */
/* Returns the predicted value of the field, modulo 2^32. */
static uint32_t frames_predict(const struct log_frames *f, enum log_frame frame, unsigned i)
{
	const int32_t *now = f->values[f->present], *last = f->values[(f->present + 1) % 3],
		      *before = f->values[(f->present + 2) % 3];

	switch (f->fields[i].predictor[frame]) {
	case PREVIOUS:
		return (uint32_t)last[i];
	case STRAIGHT_LINE:
		return 2u * (uint32_t)last[i] - (uint32_t)before[i];
	case MOTOR_0:
		return (uint32_t)now[i - f->fields[i].index];
	case MIN_MOTOR:
		return NF_DSHOT_MIN;
	default:
		return 0; /* what an increment makes of a field is not written */
	}
}

static size_t frames_write(struct log_frames *f, enum log_frame frame, uint8_t bytes[])
{
	const int32_t *now = f->values[f->present];
	uint8_t *at = bytes;
	int32_t rest[8];

	*at++ = frame == LOG_INTRA ? 'I' : 'P';
	for (unsigned i = 0; i < f->count;) {
		const unsigned count = frames_together(f, frame, i), encoding = f->fields[i].encoding[frame];
		for (unsigned k = 0; k < count; ++k)
			rest[k] = (int32_t)((uint32_t)now[i + k] - frames_predict(f, frame, i + k));
		i += count;
		switch (encoding) {
		case LOG_UNSIGNED:
			log_put_unsigned(&at, (uint32_t)rest[0]);
			break;
		case LOG_SIGNED:
			log_put_signed(&at, rest[0]);
			break;
		case LOG_TAG8_8SVB:
			log_put_tag8_8svb(&at, rest, count);
			break;
		case LOG_TAG2_3S32:
			log_put_tag2_3s32(&at, rest);
			break;
		default:
			break;
		}
	}
	return (size_t)(at - bytes);
}

size_t log_frames_intra(struct log_frames *f, const struct log_step *step, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX])
{
	const unsigned now = f->present = (f->present + 2) % 3;

	frames_load(f, step);
	memcpy(f->values[(now + 1) % 3], f->values[now], sizeof f->values[now]);
	return frames_write(f, LOG_INTRA, bytes);
}

size_t log_frames_inter(struct log_frames *f, const struct log_step *step, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX])
{
	f->present = (f->present + 2) % 3;
	frames_load(f, step);
	return frames_write(f, LOG_INTER, bytes);
}
