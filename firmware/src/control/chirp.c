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
	chirp->sweep.state = CHIRP_RUNNING;
	chirp->sweep.controller = controller;
	chirp->sweep.left = chirp->length;
	chirp->sweep.frequency_hz = chirp->start_hz;
	chirp->sweep.phase = 0.0f;
	chirp->sweep.low = 0.0f;
}

/* The next sweep excites the next axis, however this one ended. */
static void chirp_end(struct chirp *chirp)
{
	chirp->sweep.state = CHIRP_SPENT;
	chirp->room[chirp->sweep.axis] = 0.0f;
	chirp->sweep.axis = (uint8_t)((chirp->sweep.axis + 1u) % AXES);
	chirp->sweep.frequency_hz = 0.0f;
	chirp->sweep.phase = 0.0f;
	chirp->sweep.sine = 0.0f;
	chirp->sweep.added = 0.0f;
}

/* On to the next control step of the sweep. */
static void chirp_advance(struct chirp *chirp)
{
	--chirp->sweep.left;
	chirp->sweep.phase += chirp->sweep.frequency_hz * chirp->period_s;
	if (chirp->sweep.phase >= 1.0f)
		chirp->sweep.phase -= 1.0f;
	chirp->sweep.frequency_hz += chirp->sweep.frequency_hz * chirp->growth;
}

/* The sine through (1 + s / lead) / (1 + s / lag): a part of it as it is, the rest behind a low-pass. */
static void chirp_excite(struct chirp *chirp)
{
	const float phase = chirp->sweep.phase;

	chirp->sweep.sine = phase < 0.5f ? nf_sin_turns(phase) : -nf_sin_turns(phase - 0.5f);
	chirp->sweep.low += chirp->smoothing * (chirp->sweep.sine - chirp->sweep.low);
	chirp->sweep.added = chirp->amplitude *
			     (HIGH_SHARE * chirp->sweep.sine + (1.0f - HIGH_SHARE) * chirp->sweep.low);
}

/* Follows the largest error that the excitation explains. */
static void chirp_make_room(struct chirp *chirp, float *room)
{
	const float size = NF_CHIRP_ERROR_FACTOR * magnitude(chirp->sweep.added);

	*room -= *room * chirp->fading;
	if (size > *room)
		*room = size;
}

void chirp_step(struct chirp *chirp, const struct chirp_input *input, float setpoint[3])
{
	const bool may = input->on && input->allowed;

	if (chirp->sweep.state == CHIRP_RUNNING) {
		chirp_advance(chirp);
		if (!may || input->controller != chirp->sweep.controller || chirp->sweep.left == 0)
			chirp_end(chirp);
	} else if (chirp->sweep.state == CHIRP_IDLE && may) {
		chirp_begin(chirp, input->controller);
	} else {
		chirp->sweep.state = CHIRP_SPENT; /* the mode came on where it may not begin */
	}
	if (!input->on)
		chirp->sweep.state = CHIRP_IDLE;
	if (chirp->sweep.state != CHIRP_RUNNING)
		return;
	chirp_excite(chirp);
	chirp_make_room(chirp, &chirp->room[chirp->sweep.axis]);
	setpoint[chirp->sweep.axis] = limit(setpoint[chirp->sweep.axis] + chirp->sweep.added, -RATE_MAX, RATE_MAX);
}

int chirp_axis(const struct chirp *chirp)
{
	return chirp->sweep.state == CHIRP_RUNNING ? (int)chirp->sweep.axis : -1;
}
