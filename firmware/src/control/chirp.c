#include "control/chirp.h"

#include "common/limit.h"
#include "common/nf_math.h"

#define AXES 3u
#define RATE_MAX (NF_RATE_MAX_DEG_S * NF_RAD_PER_DEG) /* rad/s, of any setpoint */
#define HIGH_SHARE (NF_CHIRP_LAG_HZ / NF_CHIRP_LEAD_HZ) /* of the amplitude, at high frequencies */

/* exp(x) - 1. */
static float chirp_growth(float x)
{
	if (x < 0.0f)
		return -nf_one_minus_exp(-x);
	const float part = nf_one_minus_exp(x);
	return part / (1.0f - part);
}

void chirp_init(struct chirp *chirp, const struct nf_settings *settings, unsigned control_rate_hz)
{
	const float rate_hz = (float)control_rate_hz;
	const float most_hz = NF_CHIRP_RATE_PART * rate_hz;
	const float start_hz = limit(settings->chirp_start_hz, 0.0f, most_hz);
	const float end_hz = limit(settings->chirp_end_hz, 0.0f, most_hz);
	const float steps = settings->chirp_s * rate_hz;

	*chirp = (struct chirp){
		.amplitude = settings->chirp_amplitude * NF_RAD_PER_DEG,
		.start_hz = start_hz,
		.growth = chirp_growth(nf_log(end_hz / start_hz) / steps),
		.period_s = 1.0f / rate_hz,
		.smoothing = nf_one_minus_exp(NF_TAU * NF_CHIRP_LAG_HZ / rate_hz),
		.fading = nf_one_minus_exp(1000.0f / (NF_CHIRP_FADE_MS * rate_hz)),
		.length = (uint32_t)steps,
	};
}

static void chirp_begin(struct chirp *chirp, uint8_t controller)
{
	chirp->state = CHIRP_RUNNING;
	chirp->controller = controller;
	chirp->left = chirp->length;
	chirp->frequency_hz = chirp->start_hz;
	chirp->phase = 0.0f;
	chirp->low = 0.0f;
}

/* The next sweep excites the next axis, however this one ended. */
static void chirp_end(struct chirp *chirp)
{
	chirp->state = CHIRP_SPENT;
	chirp->room[chirp->axis] = 0.0f;
	chirp->axis = (uint8_t)((chirp->axis + 1u) % AXES);
	chirp->frequency_hz = 0.0f;
	chirp->phase = 0.0f;
	chirp->sine = 0.0f;
	chirp->added = 0.0f;
}

/* On to the next control step of the sweep. */
static void chirp_advance(struct chirp *chirp)
{
	--chirp->left;
	chirp->phase += chirp->frequency_hz * chirp->period_s;
	if (chirp->phase >= 1.0f)
		chirp->phase -= 1.0f;
	chirp->frequency_hz += chirp->frequency_hz * chirp->growth;
}

/* The sine through (1 + s / lead) / (1 + s / lag): a part of it as it is, the rest behind a low-pass. */
static void chirp_excite(struct chirp *chirp)
{
	const float phase = chirp->phase;

	chirp->sine = phase < 0.5f ? nf_sin_turns(phase) : -nf_sin_turns(phase - 0.5f);
	chirp->low += chirp->smoothing * (chirp->sine - chirp->low);
	chirp->added = chirp->amplitude * (HIGH_SHARE * chirp->sine + (1.0f - HIGH_SHARE) * chirp->low);
}

/* Follows the largest error that the excitation explains. */
static void chirp_make_room(struct chirp *chirp, float *room)
{
	const float size = NF_CHIRP_ERROR_FACTOR * (chirp->added < 0.0f ? -chirp->added : chirp->added);

	*room -= *room * chirp->fading;
	if (size > *room)
		*room = size;
}

void chirp_step(struct chirp *chirp, const struct chirp_input *input, float setpoint[3])
{
	const bool may = input->on && input->allowed;

	if (chirp->state == CHIRP_RUNNING) {
		chirp_advance(chirp);
		if (!may || input->controller != chirp->controller || chirp->left == 0)
			chirp_end(chirp);
	} else if (chirp->state == CHIRP_IDLE && may) {
		chirp_begin(chirp, input->controller);
	} else {
		chirp->state = CHIRP_SPENT; /* the mode came on where it may not begin */
	}
	if (!input->on)
		chirp->state = CHIRP_IDLE;
	if (chirp->state != CHIRP_RUNNING)
		return;
	chirp_excite(chirp);
	chirp_make_room(chirp, &chirp->room[chirp->axis]);
	setpoint[chirp->axis] = limit(setpoint[chirp->axis] + chirp->added, -RATE_MAX, RATE_MAX);
}

int chirp_axis(const struct chirp *chirp)
{
	return chirp->state == CHIRP_RUNNING ? (int)chirp->axis : -1;
}
