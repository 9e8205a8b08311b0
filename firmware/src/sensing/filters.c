#include "sensing/filters.h"

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "common/crc32.h"
#include "common/nf_math.h"
#include "policy.h"

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

/* A JSON text of which only the CRC is computed. */
static uint32_t filters_text(uint32_t crc, const char *words)
{
	for (; *words != '\0'; ++words)
		crc = crc32_more(crc, words, 1);
	return crc;
}

static uint32_t filters_number(uint32_t crc, uint32_t value)
{
	char digits[10]; /* of 2^32 - 1 */
	size_t from = sizeof digits;

	do {
		digits[--from] = (char)('0' + value % 10u);
		value /= 10u;
	} while (value > 0);
	crc = filters_text(crc, ",");
	return crc32_more(crc, digits + from, sizeof digits - from);
}

static uint32_t filters_thousandths(uint32_t crc, float value)
{
	return filters_number(crc, (uint32_t)(value * 1000.0f + 0.5f));
}

static uint32_t filters_hash_with(const struct nf_settings *settings, bool mean)
{
	uint32_t crc = filters_text(0, "[");
	const char *between = "[\"";

	for (size_t i = 0; i < NF_FILTER_STAGES; ++i) {
		const struct stage_settings s = filters_stage_settings(settings, i);
		if (s.kind == NF_FILTER_NONE)
			continue;
		crc = filters_text(filters_text(filters_text(crc, between), kinds[s.kind].name), "\"");
		crc = filters_thousandths(crc, s.hz);
		if (kinds[s.kind].has_q)
			crc = filters_thousandths(crc, s.q);
		crc = filters_text(crc, "]");
		between = ",[\"";
	}
	if (settings->dynamic_notch_count > 0) {
		crc = filters_text(filters_text(filters_text(crc, between), "dynamic"), "\"");
		crc = filters_number(crc, settings->dynamic_notch_count);
		crc = filters_thousandths(crc, settings->dynamic_notch_low_hz);
		crc = filters_thousandths(crc, settings->dynamic_notch_high_hz);
		crc = filters_thousandths(crc, settings->dynamic_notch_q);
		crc = filters_text(crc, "]");
		between = ",[\"";
	}
	if (mean)
		crc = filters_text(filters_text(filters_text(crc, between), NF_POLICY_FILTER_MEAN), "\"]");
	return filters_text(crc, "]");
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
