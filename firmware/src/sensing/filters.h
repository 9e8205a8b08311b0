/* The gyro's filters behind the notches on the rotors' turns (rpm_filter.h): a chain of up to NF_FILTER_STAGES, the same on each axis, then the dynamic notches, then the mean of a
 * control period's samples (gyro_mean.h). Default: the mean where the policy was trained behind it, else none. A policy
 * flies behind the filters that it was trained with, so their hash is part of it. */
#pragma once

#include "nf_contract.h"
#include "sensing/dynamic_notch.h"
#include "sensing/svf.h"

#define FILTER_ORDER_MAX 3

/* PTn: n low-passes of first order in a row, y += a (x - y), a = 1 - exp(-2 pi f' / rate), which together let 0.707
 * through at f. Biquad: low-pass of second order; notch: 1 but at f; both as their analog prototypes of quality Q
 * under the bilinear transform, warped to be exact at f. */
struct filter_stage {
	uint8_t order; /* of a PTn; 0: of second order */
	uint8_t notch; /* of those of second order: 1 a notch, 0 a low-pass */
	float damping; /* 1 / Q of those of second order */
	union {
		float gain; /* a of a PTn */
		struct svf svf;
	};
};

union filter_memory {
	float first[FILTER_ORDER_MAX];
	struct svf_memory second;
};

struct filters {
	struct filter_stage stages[NF_FILTER_STAGES];
	uint32_t count; /* used stages */
	union filter_memory memory[NF_FILTER_STAGES][3];
	struct dynamic_notch dynamic;
};

/* At rest at 0 rad/s. A biquad or notch at or above half the gyro rate has no effect and is left out. */
void filters_init(struct filters *filters, const struct nf_settings *settings, unsigned gyro_rate_hz);

/* One gyro sample, in place [rad/s], body axes, up to the dynamic notches. Without a stage not a bit changes. */
void filters_step(struct filters *filters, float rate[3]);

/* Do controllers see the mean of the samples of a control period? As set; left to the policy, where that with the other
 * filters as set makes the chain of the image's policy, and without it does not. */
bool filters_take_mean(const struct nf_settings *settings);

/* What a policy blob says of the filters that it was trained behind (filters_hash): CRC-32 of the JSON list of the
 * filters as set. One list a filter, in order: first the notches on the rotors' turns,
 * ["rpm",harmonics,least hertz,quality]; then of each stage its kind, then hertz and, where it has one, quality, both times 1000
 * and rounded: [["pt1",100000],["notch",180000,3000]]; behind them the notches that follow tones,
 * ["dynamic",count,low,high,quality], and last the mean, ["mean"]. NF_POLICY_FILTERS_NONE for [], no filter. */
uint32_t filters_hash(const struct nf_settings *settings);
