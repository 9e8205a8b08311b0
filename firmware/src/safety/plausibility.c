#include "safety/plausibility.h"

#include "common/limit.h"
#include "common/nf_math.h"
#include "policy.h"

#define WRONG_WAY_ERROR (NF_WRONG_WAY_ERROR_DEG_S * NF_RAD_PER_DEG)
#define WRONG_WAY_ANGLE (NF_WRONG_WAY_DEG * NF_RAD_PER_DEG)
#define TAKEOFF_ANGLE (NF_WRONG_WAY_TAKEOFF_DEG * NF_RAD_PER_DEG)
#define NO_RESPONSE_ERROR (NF_NO_RESPONSE_ERROR_DEG_S * NF_RAD_PER_DEG)
/* Limits for all motors together: movement within the remembered time, and movement per rad/s of error change. */
#define MOVED_MAX (NF_OSCILLATION_MOTORS * NF_OSCILLATION_MOTORS_MS * POLICY_ACTION_COUNT)
#define MOVED_BY_ERROR (NF_OSCILLATION_MOTORS_BY_ERROR * POLICY_ACTION_COUNT)
#define SWING (NF_OSCILLATION_ERROR_DEG_S * NF_RAD_PER_DEG)

void plausibility_init(struct plausibility *plausibility, unsigned control_rate_hz)
{
	*plausibility = (struct plausibility){
		.wrong_way_after = control_rate_hz * NF_WRONG_WAY_MS / 1000u,
		.no_response_after = control_rate_hz * NF_NO_RESPONSE_MS / 1000u,
		.period_s = 1.0f / (float)control_rate_hz,
		.half_longest = control_rate_hz * NF_OSCILLATION_HALF_MS / 1000u,
		.kept = 1.0f - nf_one_minus_exp(1000.0f / (float)(control_rate_hz * NF_OSCILLATION_MOTORS_MS)),
		.smoothing = nf_one_minus_exp(NF_TAU * NF_OSCILLATION_HZ / (float)control_rate_hz),
	};
}

void plausibility_reset(struct plausibility *plausibility)
{
	plausibility->moved = 0.0f;
	for (int i = 0; i < 3; ++i) {
		plausibility->wrong_way[i] = 0;
		plausibility->astray[i] = 0.0f;
		plausibility->no_response[i] = 0;
		plausibility->error[i] = 0.0f;
		plausibility->side[i] = 0;
		plausibility->since[i] = 0;
		plausibility->swings[i] = 0;
	}
}

/* Counts a step in which `holds`. Returns whether it held for `limit` steps in a row. */
static bool plausibility_lasts(uint32_t *steps, bool holds, uint32_t limit)
{
	*steps = holds ? *steps + 1u : 0u;
	return *steps >= limit;
}

/* Counts a step in which the outputs leave an error of axis i, `size` large, unanswered, or not. Returns whether that lasts,
 * or has turned the axis by more than `furthest` [rad]. */
static bool plausibility_leads_astray(struct plausibility *p, int i, bool unanswered, bool grows, float size,
				      float furthest)
{
	if (!unanswered)
		p->astray[i] = 0.0f;
	else if (grows)
		p->astray[i] += size * p->period_s;
	return plausibility_lasts(&p->wrong_way[i], unanswered, p->wrong_way_after) || p->astray[i] > furthest;
}

/* Does the error of axis i swing to and fro, faster than a pilot's sticks, and further than a chirp explains? */
static bool plausibility_swings(struct plausibility *p, int i, float error, float room)
{
	const float swing = SWING + room;

	p->error[i] += p->smoothing * (error - p->error[i]);
	const int side = p->error[i] > swing ? 1 : p->error[i] < -swing ? -1 : p->side[i];

	if (++p->since[i] > p->half_longest)
		p->swings[i] = 0;
	if (side == p->side[i])
		return false;
	p->side[i] = side;
	p->since[i] = 0;
	return ++p->swings[i] >= NF_OSCILLATION_SWINGS;
}

/* `largest`: the largest error of the three. Beside an axis with more than twice its error one may stray for a while: motors
 * are at their ends then, and a network that was never so far off couples the axes. */
static enum nf_fallback_cause plausibility_axis(struct plausibility *p, int i, const struct plausibility_input *input,
						float largest)
{
	const float rate = input->rate[i];
	const float error = input->setpoint[i] - rate;
	const float size = magnitude(error);
	const bool turns = turning_towards(input->turning, i, error);
	const bool strays = 2.0f * size >= largest && !turns;
	const bool unanswered = strays && size > WRONG_WAY_ERROR && input->demand && input->demand[i] * error <= 0.0f;
	const bool idle = strays && size > NO_RESPONSE_ERROR && input->thrust && !turning_at_limit(rate, error);
	const bool grows = turning_towards(input->turning, i, -error);

	if (plausibility_leads_astray(p, i, unanswered, grows, size, input->standing ? TAKEOFF_ANGLE : WRONG_WAY_ANGLE))
		return NF_FALLBACK_WRONG_WAY;
	if (plausibility_lasts(&p->no_response[i], idle, p->no_response_after))
		return NF_FALLBACK_NO_RESPONSE;
	return plausibility_swings(p, i, error, input->room[i]) ? NF_FALLBACK_OSCILLATION : NF_FALLBACK_NONE;
}

/* Do the motors move to and fro by more, and for longer, than what errors moved, `seen` [rad/s], explains? */
static bool plausibility_trembles(struct plausibility *p, float moved, float seen)
{
	const float sum = p->kept * (p->moved + moved - MOVED_BY_ERROR * seen);

	p->moved = sum > 0.0f ? sum : 0.0f;
	return sum > MOVED_MAX;
}

enum nf_fallback_cause plausibility_step(struct plausibility *plausibility, const struct plausibility_input *input)
{
	enum nf_fallback_cause found = NF_FALLBACK_NONE;
	float largest = 0.0f, seen = 0.0f;

	for (int i = 0; i < 3; ++i) {
		const float error = input->setpoint[i] - input->rate[i], size = magnitude(error);
		largest = size > largest ? size : largest;
		seen += magnitude(error - plausibility->before[i]);
		plausibility->before[i] = error;
	}
	for (int i = 0; i < 3; ++i) {
		const enum nf_fallback_cause cause = plausibility_axis(plausibility, i, input, largest);
		found = found == NF_FALLBACK_NONE ? cause : found;
	}
	const bool trembles = plausibility_trembles(plausibility, input->moved, seen);
	return found == NF_FALLBACK_NONE && trembles ? NF_FALLBACK_OSCILLATION : found;
}
