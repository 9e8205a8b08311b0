/* A filter section of second order as a state-variable filter integrated by the trapezoidal rule: the response of
 * the biquad that the bilinear transform makes of the analog prototype, warped to be exact at its frequency.
 *
 * Chosen over the direct forms: in float32 a direct form loses a low cutoff (1 Hz at 8 kHz: a tenth of its gain at
 * DC), this one does not; and its memory keeps its meaning when the coefficients change, as those of a notch that
 * follows a tone do. Source: V. Zavalishin, The Art of VA Filter Design (2012), section 4. */
#pragma once

struct svf {
	float gain;  /* tan(pi f / rate); 0: lets everything pass through a notch */
	float scale; /* 1 / (1 + gain (gain + damping)) */
};

struct svf_memory {
	float band, low; /* the two integrators */
};
