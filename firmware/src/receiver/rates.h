/* Rates: receiver channels to setpoint rates and throttle. */
#pragma once

#include "nf_contract.h"

/* One stick. */
struct rates_axis {
	float deadband;    /* us to either side of the centre that count as the centre */
	float per_us;      /* from the edge of the deadband to the end of the stick is 1 */
	float expo;        /* 0..1 */
	float slope;       /* rad/s at full stick of the curve's tangent at the centre */
	float rise;        /* actual: the rate at full stick above that [rad/s]; betaflight: super rate */
};

struct rates {
	uint32_t style;    /* NF_RATES_STYLE_... */
	struct rates_axis axes[3];
};

/* `settings` within their limits; what is needed of them is copied. The two styles are those that pilots know:
 *
 *	actual      x c + max(0, m - c) x (x^5 e + x (1 - e))
 *	betaflight  200 r x (x^3 e + 1 - e) / (1 - x s), r above 2 counts r + 14.54 (r - 2)
 *
 * for the stick's way x from 0 to 1, in deg/s; c, m: rate at the centre and at full stick; r, s: RC rate and super
 * rate; e: expo. */
void rates_init(struct rates *rates, const struct nf_settings *settings);

/* Body rates [rad/s] for the channels [us], at most NF_RATE_MAX_DEG_S; a stick beyond its end counts as at its end.
 * Channel high is roll right, nose down, yaw right; the body's yaw is positive to the left. */
void rates_setpoint(const struct rates *rates, const uint16_t channels_us[NF_CHANNEL_COUNT], float setpoint[3]);

/* Thrust 0..1. */
float rates_throttle(const uint16_t channels_us[NF_CHANNEL_COUNT]);
