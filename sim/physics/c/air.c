#include "air.h"
#include "random.h"
#include "rotor.h"

/* Drag force on the body: -1/2 rho |v| (C_D A) v, each axis with its own C_D A. */
void air_body_drag(double density, const double *air_velocity, const double *drag_area, double *force)
{
	const double *const v = air_velocity;
	const double pressure = -0.5 * density * sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);

	for (size_t j = 0; j < 3; ++j)
		force[j] = pressure * v[j] * drag_area[j];
}

/* The air's velocity from the states of the gusts. */
void wind_blow(struct wind *w, size_t count)
{
	for (size_t i = 0; i < count; ++i) {
		const double *const first = w->first + 3u * i, *const second = w->second + 3u * i;
		double gust[3], blown[3];

		gust[0] = first[0] * w->gain[0];
		for (size_t j = 1; j < 3; ++j)
			gust[j] = (sqrt(1.5) * first[j] + (1.0 - sqrt(3.0)) / sqrt(2.0) * second[j]) * w->gain[j];
		row_times(gust, w->axes, 3, 3, blown);
		for (size_t j = 0; j < 3; ++j)
			w->velocity[3u * i + j] = w->mean[j] + blown[j];
	}
}

/* One axis of the gusts, stepped exactly; ratio: of the step to the time that the turbulence takes. */
static void wind_step_axis(double ratio, double draw, double other, double *first, double *second)
{
	const double kept = exp(-ratio);
	/* Covariance that the new noise adds: the stationary one less what is kept of it. */
	const double noise = -expm1(-2.0 * ratio);
	const double shared = 0.5 * (noise - 2.0 * ratio * kept * kept);
	const double own = shared - (ratio * kept) * (ratio * kept);
	const double scale = sqrt(noise);
	const double along = scale > 0.0 ? shared / scale : 0.0;
	const double rest = own - along * along;

	*second = kept * (*second + ratio * *first) + along * draw + sqrt(rest > 0.0 ? rest : 0.0) * other;
	*first = kept * *first + scale * draw;
}

/* Advances the gusts by a sample around aircraft that move through the air at `airspeed` (N). */
void wind_step(struct wind *w, size_t count, const double *airspeed)
{
	if (w->steady)
		return;
	random_standard_normal_fill(w->random, (ptrdiff_t)(6u * count), w->draws);
	for (size_t i = 0; i < 3u * count; ++i)
		wind_step_axis(airspeed[i / 3u] * w->decay[i % 3u], w->draws[i], w->draws[3u * count + i], w->first + i,
			       w->second + i);
	wind_blow(w, count);
}

/* Advances every rotor's noise by a sample. It goes on in level flight too, so that it is as the seed says wherever a
 * descent begins. */
void wash_step(struct wash *w, size_t count, uint32_t motors)
{
	const size_t all = count * motors;

	random_standard_normal_fill(w->random, (ptrdiff_t)(2u * all), w->draws);
	for (size_t i = 0; i < all; ++i) {
		const double lag = w->lag[i], noise = w->noise[i], draw = w->draws[i], other = w->draws[all + i];

		w->lag[i] = w->turn[0] * lag + w->turn[1] * noise + w->gain[0] * draw;
		w->noise[i] = w->turn[2] * lag + w->turn[3] * noise + w->gain[1] * draw + w->gain[2] * other;
	}
}

/* Standard deviation of a rotor's thrust over its thrust [N], at `sink` along its axis and `sideways` across it [m/s]. */
static double wash_share(const struct wash *w, double thrust, double sink, double sideways)
{
	const double induced = thrust > 0.0 ? w->root * sqrt(thrust) : 0.0;

	if (!(sink > w->begin * induced && sink < w->end * induced && sideways < w->sideways * induced))
		return 0.0;
	const double deep = (sink / induced - w->begin) / (w->end - w->begin);
	const double away = sideways / (w->sideways * induced);

	return w->share * 4.0 * deep * (1.0 - deep) * (1.0 - away * away);
}

/* Multiplies thrust_factor (count, M) of rotors that turn at `speed` (count, M) on aircraft that move at `velocity` through
 * the air (count, 3), body axes, by the fluctuation of their own wash. */
void wash_shake(const struct wash *w, const struct propulsion *p, size_t count, uint32_t motors, const double *speed,
		const double *velocity, const double *load_factor, double *thrust_factor)
{
	for (size_t i = 0; i < count; ++i) {
		const double *const v = velocity + 3u * i;
		const double sideways = sqrt(v[0] * v[0] + v[1] * v[1]);

		for (size_t m = i * motors; v[2] < 0.0 && m < (i + 1u) * motors; ++m) {
			const double thrust = rotor_thrust(p, speed[m]) * thrust_factor[m] * load_factor[6u * i + 2u];
			const double factor = 1.0 + wash_share(w, thrust, -v[2], sideways) * w->noise[m];

			thrust_factor[m] *= factor > 0.0 ? factor : 0.0;
		}
	}
}
