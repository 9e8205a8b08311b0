/* Functions of float32 without libm: the same bits on every target. Not for the inner loops of the control step: for
 * coefficients at start-up and for angles that are reported. No argument may be NaN unless said otherwise. */
#pragma once

#define NF_PI 3.14159265358979323846f
#define NF_TAU 6.28318530717958647693f
#define NF_DEG_PER_RAD 57.2957795130823208768f
#define NF_RAD_PER_DEG 0.017453292519943295f

/* sin and cos of `turns` full turns, 0 to 0.5. Error at most 2e-7 of the result. */
float nf_sin_turns(float turns);
float nf_cos_turns(float turns);

/* 1 - exp(-x), x >= 0: the gain of a first-order low-pass. Error at most 1e-6 of the result. */
float nf_one_minus_exp(float x);

/* Natural logarithm of x, 1e-6 to 1e6; beyond that of the nearer end. Error at most 1e-7 of the result, or 1e-7 where that
 * is more. */
float nf_log(float x);

/* Angle of the vector (x, y) from the x axis [rad], -pi to pi; 0 for the vector without length.
 * Error at most 5e-7 rad. */
float nf_atan2(float y, float x);

/* Angle whose sine is x [rad], -pi/2 to pi/2; x beyond -1 or 1 counts as that. Error at most 5e-7 rad. */
float nf_asin(float x);
