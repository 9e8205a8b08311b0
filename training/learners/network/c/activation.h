/* tanh and the logistic function, the same bits on every machine. */
#ifndef ACTIVATION_H
#define ACTIVATION_H

#include "lanes.h"

#ifdef FLOAT64

static inline real tanh_of(real x)
{
	return tanh(x);
}

#else

/* A rational function, within 4e-7 of tanh: Eigen's, a minimax fit on the range beyond which float's tanh is 1. */
static inline real tanh_of(real x)
{
	const real at = limited(x, -7.90531110763549805f, 7.90531110763549805f), square = at * at;
	real over = -2.76076847742355e-16f, under = 1.19825839466702e-06f;

	over = real_fma(over, square, 2.00018790482477e-13f);
	over = real_fma(over, square, -8.60467152213735e-11f);
	over = real_fma(over, square, 5.12229709037114e-08f);
	over = real_fma(over, square, 1.48572235717979e-05f);
	over = real_fma(over, square, 6.37261928875436e-04f);
	over = real_fma(over, square, 4.89352455891786e-03f);
	under = real_fma(under, square, 1.18534705686654e-04f);
	under = real_fma(under, square, 2.26843463243900e-03f);
	under = real_fma(under, square, 4.89352518554385e-03f);
	return at * over / under;
}

#endif

static inline real logistic_of(real x)
{
	return real_fma(tanh_of(R(0.5) * x), R(0.5), R(0.5));
}

#endif
