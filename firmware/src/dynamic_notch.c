#include "dynamic_notch.h"

#include <stdbool.h>

#include "limit.h"
#include "nf_math.h"

#define HIGHEST_TURNS 0.45f  /* of the gyro rate */
#define SPAN_HZ 100.0f       /* least distance of low and high: below, bins lie closer than float32 tells apart */
#define MAIN_LOBE 2          /* bins on either side of a tone that Hann's weight lets it reach */
#define ABOVE_REST 6.0f      /* a peak's power over the mean of what is left: noise is seldom as uneven */
#define SHADOW 0.0025f       /* -26 dB: a smaller peak may be a side lobe of the largest */
#define FOLLOW 0.5f          /* how far a notch goes towards its peak at once */


static void listen(struct dynamic_notch *d)
{
	d->position = 0;
	d->placed = 0;
	d->found = 0;
	d->loudest = 0.0f;
	d->hann = 1.0f;
	d->hann_before = 0.5f * d->step;
	for (int i = 0; i < NOTCH_BINS; i++)
		d->s1[i] = d->s2[i] = 0.0f;
}

void dynamic_notch_init(struct dynamic_notch *d, const struct nf_settings *settings, unsigned gyro_rate_hz)
{
	const float rate_hz = (float)gyro_rate_hz;
	const float highest_hz = HIGHEST_TURNS * rate_hz;
	const float low_hz = limit(settings->dynamic_notch_low_hz, 0.0f, highest_hz - SPAN_HZ);
	const float high_hz = limit(settings->dynamic_notch_high_hz, low_hz + SPAN_HZ, highest_hz);
	const float window = rate_hz * (float)(NOTCH_BINS - 1) / (high_hz - low_hz);

	*d = (struct dynamic_notch){
		.count = (uint8_t)settings->dynamic_notch_count,
		.window = (uint16_t)window,
		.damping = 1.0f / settings->dynamic_notch_q,
		.low_turns = low_hz / rate_hz,
	};
	/* Whole samples, and neighbouring bins one turn a window apart: so the refinement wants them. */
	d->spacing = 1.0f / (float)d->window;
	d->first = 2.0f * nf_cos_turns(d->low_turns);
	d->step = 2.0f * nf_cos_turns(d->spacing);
	d->before = 2.0f * nf_cos_turns(d->low_turns > d->spacing ? d->low_turns - d->spacing :
								   d->spacing - d->low_turns);
	for (int axis = 0; axis < 3; axis++)
		for (int i = 0; i < NOTCH_MAX; i++)
			d->notch[axis][i] = section_at(0.0f, d->damping);
	listen(d);
}

/* One sample into every bin: s = x + 2 cos(w) s' - s''. The cosines follow from each other by Chebyshev's
 * recurrence, which costs less than the memory that would hold them. */
static void feed(struct dynamic_notch *d, float in)
{
	const float weighted = in * (1.0f - d->hann);
	const float hann = d->step * d->hann - d->hann_before;
	float before = d->before, coefficient = d->first;

	d->hann_before = d->hann;
	d->hann = hann;
	for (int i = 0; i < NOTCH_BINS; i++) {
		const float s = weighted + coefficient * d->s1[i] - d->s2[i];
		const float next = d->step * coefficient - before;
		d->s2[i] = d->s1[i];
		d->s1[i] = s;
		before = coefficient;
		coefficient = next;
	}
}

/* The window is over: what each bin has heard. */
static void read(struct dynamic_notch *d)
{
	float before = d->before, coefficient = d->first;

	for (int i = 0; i < NOTCH_BINS; i++) {
		const float s1 = d->s1[i], s2 = d->s2[i];
		const float next = d->step * coefficient - before;
		const float power = s1 * s1 + s2 * s2 - coefficient * s1 * s2;
		d->s1[i] = power > 0.0f ? power : 0.0f; /* rounding may leave less than nothing */
		before = coefficient;
		coefficient = next;
	}
}

/* The bin of the largest peak that has a lower neighbour on both sides; 0: there is none. */
static int largest_peak(const float power[NOTCH_BINS])
{
	int largest = 0;
	float height = 0.0f;

	for (int i = 1; i < NOTCH_BINS - 1; i++) {
		if (power[i] > height && power[i] >= power[i - 1] && power[i] >= power[i + 1]) {
			largest = i;
			height = power[i];
		}
	}
	return largest;
}

/* Where between the bins the tone lies that makes the peak [turns a sample]: under Hann's weight the larger
 * neighbour is (1 + f) / (2 - f) as high as the peak for a tone f bins away, 0 <= f <= 0.5. */
static float refine(const struct dynamic_notch *d, int peak)
{
	const float left = d->s1[peak - 1], right = d->s1[peak + 1];
	const float ratio = __builtin_sqrtf((right > left ? right : left) / d->s1[peak]);
	const float away = limit((2.0f * ratio - 1.0f) / (1.0f + ratio), 0.0f, 0.5f);

	return d->low_turns + d->spacing * ((float)peak + (right > left ? away : -away));
}

/* Silences a peak and what it spreads to; returns the mean power of all that is left. */
static float take_out(float power[NOTCH_BINS], int peak)
{
	float sum = 0.0f;

	for (int i = 0; i < NOTCH_BINS; i++) {
		if (i >= peak - MAIN_LOBE && i <= peak + MAIN_LOBE)
			power[i] = 0.0f;
		sum += power[i];
	}
	return sum * (1.0f / NOTCH_BINS);
}

/* Moves the nearest notch that has no peak of this window yet. */
static void place(struct dynamic_notch *d, float turns)
{
	struct section *notches = d->notch[d->axis];
	const float gain = nf_sin_turns(0.5f * turns) / nf_cos_turns(0.5f * turns);
	int nearest = -1;
	float shortest = 0.0f;

	for (int i = 0; i < d->count; i++) {
		const float way = gain > notches[i].gain ? gain - notches[i].gain : notches[i].gain - gain;
		if ((d->placed & 1u << i) == 0 && (nearest < 0 || way < shortest)) {
			nearest = i;
			shortest = way;
		}
	}
	struct section *notch = &notches[nearest];
	const bool new = !(notch->gain > 0.0f);
	*notch = section_at(new ? gain : notch->gain + FOLLOW * (gain - notch->gain), d->damping);
	d->placed |= (uint8_t)(1u << nearest);
}

static void find(struct dynamic_notch *d)
{
	const int peak = largest_peak(d->s1);
	if (peak == 0)
		return;
	const float power = d->s1[peak];
	const float turns = refine(d, peak);
	const float rest = take_out(d->s1, peak);

	d->loudest = power > d->loudest ? power : d->loudest;
	if (power >= ABOVE_REST * rest && power >= SHADOW * d->loudest)
		place(d, turns);
}

static void search(struct dynamic_notch *d, const float rate[3])
{
	if (d->position < d->window) {
		feed(d, rate[d->axis]);
		d->position++;
	} else if (d->position == d->window) {
		read(d);
		d->position++;
	} else if (d->found < d->count) {
		find(d);
		d->found++;
	} else {
		d->axis = d->axis < 2 ? d->axis + 1 : 0;
		listen(d);
	}
}

void dynamic_notch_step(struct dynamic_notch *d, float rate[3])
{
	if (d->count == 0)
		return;
	search(d, rate);
	for (int axis = 0; axis < 3; axis++)
		for (int i = 0; i < d->count; i++)
			rate[axis] = section_notch(&d->notch[axis][i], d->damping, &d->memory[axis][i], rate[axis]);
}
