#include "sensing/dynamic_notch.h"

#include "common/limit.h"
#include "common/nf_math.h"
#include "sensing/svf_step.h"

#define HIGHEST_TURNS 0.45f  /* of the gyro rate */
#define SPAN_HZ 100.0f       /* least distance of low and high: below, bins lie closer than float32 tells apart */
#define MAIN_LOBE 2          /* bins on either side of a tone that Hann's weight lets it reach */
#define ABOVE_REST 6.0f      /* a peak's power over the mean of what is left: noise is seldom as uneven */
#define SHADOW 0.0025f       /* -26 dB: a smaller peak may be a side lobe of the largest */
#define READS 3              /* samples in which all bins are read */
#define FAR 1e9f             /* beyond the tangent of every frequency */
#define FOLLOW 0.5f          /* how far a notch goes towards its peak at once */
_Static_assert(NOTCH_BINS % READS == 0, "parts of equal size");

static void dynamic_notch_restart(struct dynamic_notch *d)
{
	d->position = 0;
	d->placed = 0;
	d->peak = 0;
	d->loudest = 0.0f;
	d->hann = 1.0f;
	d->hann_before = 0.5f * d->step;
	for (int i = 0; i < NOTCH_BINS; ++i)
		d->s1[i] = 0.0f; /* s2 are, since they were read */
}

void dynamic_notch_init(struct dynamic_notch *d, const struct nf_settings *settings, unsigned gyro_rate_hz)
{
	const float rate_hz = (float)gyro_rate_hz;
	const float highest_hz = HIGHEST_TURNS * rate_hz;
	const float lowest_hz = highest_hz - SPAN_HZ;
	const float low_hz = settings->dynamic_notch_low_hz < lowest_hz ? settings->dynamic_notch_low_hz : lowest_hz;
	const float high_hz = limit(settings->dynamic_notch_high_hz, low_hz + SPAN_HZ, highest_hz);
	const float window = rate_hz * (float)(NOTCH_BINS - 1) / (high_hz - low_hz);

	*d = (struct dynamic_notch){
		.count = (uint8_t)settings->dynamic_notch_count,
		.window = (uint16_t)window,
		.damping = 1.0f / settings->dynamic_notch_q,
		.low_turns = low_hz / rate_hz,
	};
	/* The window has whole samples and neighbouring bins are one turn per window apart, as the refinement requires. */
	d->spacing = 1.0f / (float)d->window;
	d->first = 2.0f * nf_cos_turns(d->low_turns);
	d->step = 2.0f * nf_cos_turns(d->spacing);
	d->before = 2.0f *
		    nf_cos_turns(d->low_turns > d->spacing ? d->low_turns - d->spacing : d->spacing - d->low_turns);
	for (int axis = 0; axis < 3; ++axis)
		for (int i = 0; i < NOTCH_MAX; ++i)
			d->notch[axis][i] = svf_at(0.0f, d->damping);
	dynamic_notch_restart(d);
}

/* One sample into every bin: s = x + 2 cos(w) s' - s''. The cosines follow from each other by Chebyshev's
 * recurrence, which costs less than the memory that would hold them. */
static void dynamic_notch_feed(struct dynamic_notch *d, float in)
{
	const float weighted = in * (1.0f - d->hann);
	const float hann = d->step * d->hann - d->hann_before;
	float before = d->before, coefficient = d->first;

	d->hann_before = d->hann;
	d->hann = hann;
	for (int i = 0; i < NOTCH_BINS; ++i) {
		const float s = weighted + coefficient * d->s1[i] - d->s2[i];
		const float next = d->step * coefficient - before;
		d->s2[i] = d->s1[i];
		d->s1[i] = s;
		before = coefficient;
		coefficient = next;
	}
}

/* The window is over: computes the power of the bins of one part. */
static void dynamic_notch_read(struct dynamic_notch *d, int part)
{
	const int from = part * NOTCH_BINS / READS, to = from + NOTCH_BINS / READS;
	float before = d->before, coefficient = d->first;

	for (int i = 0; i < to; ++i) {
		const float next = d->step * coefficient - before;
		if (i >= from) {
			const float s1 = d->s1[i], s2 = d->s2[i];
			const float power = s1 * s1 + s2 * s2 - coefficient * s1 * s2;
			d->s1[i] = power > 0.0f ? power : 0.0f; /* rounding may leave less than nothing */
			d->s2[i] = 0.0f;
		}
		before = coefficient;
		coefficient = next;
	}
}

/* Finds the largest local maximum. The outermost bins are none: tones beyond the band may leak into them. */
static void dynamic_notch_find_peak(struct dynamic_notch *d)
{
	const float *power = d->s1;
	float height = 0.0f;

	d->peak = 0;
	d->total = power[0] + power[NOTCH_BINS - 1];
	for (int i = 1; i < NOTCH_BINS - 1; ++i) {
		d->total += power[i];
		if (power[i] > height && power[i] >= power[i - 1] && power[i] >= power[i + 1]) {
			d->peak = (uint8_t)i;
			height = power[i];
		}
	}
}

/* Where between the bins the tone lies that makes the peak [turns a sample]: under Hann's weight the larger
 * neighbour is (1 + f) / (2 - f) as high as the peak for a tone f bins away, 0 <= f <= 0.5. */
static float dynamic_notch_refine(const struct dynamic_notch *d)
{
	const int peak = d->peak;
	const float left = d->s1[peak - 1], right = d->s1[peak + 1];
	const float ratio = __builtin_sqrtf((right > left ? right : left) / d->s1[peak]);
	const float away = limit((2.0f * ratio - 1.0f) / (1.0f + ratio), 0.0f, 0.5f);

	return d->low_turns + d->spacing * ((float)peak + (right > left ? away : -away));
}

/* Clears the peak and the bins it leaks into; returns the mean power of the rest. */
static float dynamic_notch_take_out(struct dynamic_notch *d)
{
	const int from = d->peak > MAIN_LOBE ? d->peak - MAIN_LOBE : 0;
	const int to = d->peak + MAIN_LOBE < NOTCH_BINS ? d->peak + MAIN_LOBE : NOTCH_BINS - 1;

	for (int i = from; i <= to; ++i) {
		d->total -= d->s1[i];
		d->s1[i] = 0.0f;
	}
	return d->total * (1.0f / NOTCH_BINS);
}

/* Moves the nearest notch that has no peak of this window yet; one exists, as at most as many peaks are searched as
 * there are notches. */
static void dynamic_notch_move(struct dynamic_notch *d, float turns)
{
	struct svf *notches = d->notch[d->axis];
	const float gain = nf_sin_turns(0.5f * turns) / nf_cos_turns(0.5f * turns);
	float shortest = FAR;
	int nearest = 0;

	for (int i = 0; i < d->count; ++i) {
		const float way = gain > notches[i].gain ? gain - notches[i].gain : notches[i].gain - gain;
		if ((d->placed & 1u << i) == 0 && way < shortest) {
			nearest = i;
			shortest = way;
		}
	}
	const float from = notches[nearest].gain;
	const bool first = !(from > 0.0f);
	notches[nearest] = svf_at(first ? gain : from + FOLLOW * (gain - from), d->damping);
	d->placed |= (uint8_t)(1u << nearest);
}

/* Assigns a notch to the peak if it stands out. */
static void dynamic_notch_place(struct dynamic_notch *d)
{
	if (d->peak == 0)
		return;
	const float power = d->s1[d->peak];
	const float turns = dynamic_notch_refine(d);
	const float rest = dynamic_notch_take_out(d);

	d->loudest = power > d->loudest ? power : d->loudest;
	if (power >= ABOVE_REST * rest && power >= SHADOW * d->loudest)
		dynamic_notch_move(d, turns);
}

static void dynamic_notch_search(struct dynamic_notch *d, const float rate[3])
{
	const int step = d->position - d->window; /* from 0 on: behind the window */
	const int peaks = step - READS;

	++d->position;
	if (step < 0) {
		dynamic_notch_feed(d, rate[d->axis]);
	} else if (peaks < 0) {
		dynamic_notch_read(d, step);
	} else if (peaks < 2 * d->count) {
		if (peaks % 2 == 0)
			dynamic_notch_find_peak(d);
		else
			dynamic_notch_place(d);
	} else {
		d->axis = d->axis < 2 ? d->axis + 1 : 0;
		dynamic_notch_restart(d);
	}
}

void dynamic_notch_step(struct dynamic_notch *d, float rate[3])
{
	if (d->count == 0)
		return;
	dynamic_notch_search(d, rate);
	for (int axis = 0; axis < 3; ++axis)
		for (int i = 0; i < d->count; ++i)
			rate[axis] = svf_notch(&d->notch[axis][i], d->damping, &d->memory[axis][i], rate[axis]);
}
