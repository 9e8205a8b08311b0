#include "sensing/filters.h"

#include <string.h>

#include "common/crc32.h"
#include "common/nf_math.h"
#include "common/printer.h"
#include "policy.h"
#include "sensing/svf_step.h"

/* Of the longest list: each number has 10 digits at most, and a stage two of them. */
#define HASHED_BYTES (NF_FILTER_STAGES * sizeof ",[\"biquad\",4294967295,4294967295]" + 128u)

/* Composition of a kind. `widen`: n low-passes in a row reach 0.707 at f if each does at f widen, 1 / sqrt(2^(1/n) -
 * 1). */
static const struct kind {
	const char *name;
	uint8_t order;
	uint8_t notch;
	bool has_q;
	float widen;
} kinds[] = {
	[NF_FILTER_PT1] = { "pt1", 1, 0, false, 1.0f },        [NF_FILTER_PT2] = { "pt2", 2, 0, false, 1.55377397f },
	[NF_FILTER_PT3] = { "pt3", 3, 0, false, 1.96145918f }, [NF_FILTER_BIQUAD] = { "biquad", 0, 0, true, 1.0f },
	[NF_FILTER_NOTCH] = { "notch", 0, 1, true, 1.0f },
};

struct stage_settings {
	uint32_t kind; /* enum nf_filter_kind */
	float hz;
	float q;
};

static struct stage_settings filters_stage_settings(const struct nf_settings *s, size_t stage)
{
	const struct stage_settings stages[] = {
		{ s->filter1_kind, s->filter1_hz, s->filter1_q },
		{ s->filter2_kind, s->filter2_hz, s->filter2_q },
		{ s->filter3_kind, s->filter3_hz, s->filter3_q },
		{ s->filter4_kind, s->filter4_hz, s->filter4_q },
	};
	_Static_assert(sizeof stages / sizeof stages[0] == NF_FILTER_STAGES, "every stage");

	return stages[stage];
}

static bool filters_passes_all(const struct stage_settings *s, unsigned gyro_rate_hz)
{
	return s->kind == NF_FILTER_NONE || (kinds[s->kind].order == 0 && s->hz >= 0.5f * (float)gyro_rate_hz);
}

static struct filter_stage filters_stage_of(const struct stage_settings *s, unsigned gyro_rate_hz)
{
	const struct kind *kind = &kinds[s->kind];
	const float turns = s->hz / (float)gyro_rate_hz; /* a sample */
	struct filter_stage stage = { .order = kind->order, .notch = kind->notch };

	if (kind->order > 0) {
		stage.gain = nf_one_minus_exp(NF_TAU * kind->widen * turns);
		return stage;
	}
	stage.damping = 1.0f / s->q;
	stage.svf = svf_at(nf_sin_turns(0.5f * turns) / nf_cos_turns(0.5f * turns), stage.damping);
	return stage;
}

void filters_init(struct filters *filters, const struct nf_settings *settings, unsigned gyro_rate_hz)
{
	memset(filters, 0, sizeof *filters);
	for (size_t i = 0; i < NF_FILTER_STAGES; ++i) {
		const struct stage_settings s = filters_stage_settings(settings, i);
		if (!filters_passes_all(&s, gyro_rate_hz))
			filters->stages[filters->count++] = filters_stage_of(&s, gyro_rate_hz);
	}
	dynamic_notch_init(&filters->dynamic, settings, gyro_rate_hz);
}

static float filters_low_passes(const struct filter_stage *stage, float memory[FILTER_ORDER_MAX], float in)
{
	float out = in;

	for (int i = 0; i < stage->order; ++i) {
		memory[i] += stage->gain * (out - memory[i]);
		out = memory[i];
	}
	return out;
}

static float filters_second_order(const struct filter_stage *stage, struct svf_memory *memory, float in)
{
	return stage->notch ? svf_notch(&stage->svf, stage->damping, memory, in) :
			      svf_low_pass(&stage->svf, memory, in);
}

void filters_step(struct filters *filters, float rate[3])
{
	for (uint32_t i = 0; i < filters->count; ++i) {
		const struct filter_stage *stage = &filters->stages[i];
		for (int axis = 0; axis < 3; ++axis) {
			union filter_memory *memory = &filters->memory[i][axis];
			rate[axis] = stage->order > 0 ? filters_low_passes(stage, memory->first, rate[axis]) :
							filters_second_order(stage, &memory->second, rate[axis]);
		}
	}
	dynamic_notch_step(&filters->dynamic, rate);
}

static unsigned filters_thousandths(float value)
{
	return (unsigned)(value * 1000.0f + 0.5f);
}

/* The CRC of the JSON list, with the mean or without it. */
static uint32_t filters_hash_with(const struct nf_settings *settings, bool mean)
{
	char text[HASHED_BYTES];
	struct printer out = printer_init(text, sizeof text);
	const char *between = "";

	printer_say(&out, "[");
	if (settings->motor_telemetry && settings->rpm_filter_harmonics > 0) {
		printer_say(&out, "[\"rpm\",%u,%u,%u]", (unsigned)settings->rpm_filter_harmonics,
			    filters_thousandths(settings->rpm_filter_min_hz),
			    filters_thousandths(settings->rpm_filter_q));
		between = ",";
	}
	for (size_t i = 0; i < NF_FILTER_STAGES; ++i) {
		const struct stage_settings s = filters_stage_settings(settings, i);
		if (s.kind == NF_FILTER_NONE)
			continue;
		printer_say(&out, "%s[\"%s\",%u", between, kinds[s.kind].name, filters_thousandths(s.hz));
		if (kinds[s.kind].has_q)
			printer_say(&out, ",%u", filters_thousandths(s.q));
		printer_say(&out, "]");
		between = ",";
	}
	if (settings->dynamic_notch_count > 0) {
		printer_say(&out, "%s[\"dynamic\",%u,%u,%u,%u]", between, (unsigned)settings->dynamic_notch_count,
			    filters_thousandths(settings->dynamic_notch_low_hz),
			    filters_thousandths(settings->dynamic_notch_high_hz),
			    filters_thousandths(settings->dynamic_notch_q));
		between = ",";
	}
	if (mean)
		printer_say(&out, "%s[\"" NF_POLICY_FILTER_MEAN "\"]", between);
	printer_say(&out, "]");
	return crc32_more(0, text, (size_t)(out.at - text));
}

bool filters_take_mean(const struct nf_settings *settings)
{
	if (settings->gyro_mean != NF_GYRO_MEAN_POLICY)
		return settings->gyro_mean == NF_GYRO_MEAN_ON;
	return filters_hash_with(settings, true) == POLICY_FILTERS_HASH &&
	       filters_hash_with(settings, false) != POLICY_FILTERS_HASH;
}

uint32_t filters_hash(const struct nf_settings *settings)
{
	return filters_hash_with(settings, filters_take_mean(settings));
}
