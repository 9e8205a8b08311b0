#include "aircraft.h"

/* The rested pack's voltage over the bench supply's: straight lines between points. */
static void supply_rest(const struct pack *pack, const real *restrict left, real *restrict volts)
{
	FOR_LANES(l)
		volts[l] = pack->volts[0];
	for (uint32_t i = 1; i < pack->points; ++i) {
		const real span = pack->left[i] - pack->left[i - 1u];
		const real slope = (pack->volts[i] - pack->volts[i - 1u]) / span;

		FOR_LANES(l)
			volts[l] = real_fma(slope, limited(left[l] - pack->left[i - 1u], R(0), span), volts[l]);
	}
}

/* Packs without load. */
void supply_begin(struct supply *s, const struct plan *p, const struct block *b, real *ratio)
{
	FOR_LANES(l)
		s->used[l] = R(0);
	supply_rest(&p->pack, b->charge, ratio);
	FOR_LANES(l)
		ratio[l] = b->charge[l] < R(0) ? R(1) : ratio[l];
}

/* Draws the power of a sample; ratio: that the next one meets. */
void supply_step(struct supply *s, const struct plan *p, const struct block *b, const struct turning *t, real *ratio)
{
	const struct pack *const pack = &p->pack;
	real power[LANES] = {0}, thrust[LANES], lever[LANES], left[LANES], rest[LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const after = t->after + m * LANES;

		rotor_loads(&p->propulsion, after, thrust, lever);
		FOR_LANES(l) {
			const real gained = pack->rotor_inertia * t->gained[m * LANES + l];

			power[l] += most(after[l] * real_fma(lever[l] * thrust[l], b->load[l], gained), R(0));
		}
	}
	FOR_LANES(l)
		left[l] = b->charge[l] - s->used[l] / pack->capacity;
	supply_rest(pack, left, rest);
	FOR_LANES(l) {
		const real square = rest[l] * rest[l], drawn = power[l] / pack->efficiency + pack->electronics;
		const real volts =
			R(0.5) * (rest[l] + real_sqrt(most(square - R(4) * pack->resistance * drawn, R(0))));
		const real given = pack->resistance > R(0) ? least(drawn, square / (R(4) * pack->resistance)) : drawn;
		const real amperes = volts > R(0) ? given * pack->amperes / volts : R(0);

		s->used[l] = least(s->used[l] + amperes * p->dt, (b->charge[l] - pack->left[0]) * pack->capacity);
		ratio[l] = b->charge[l] < R(0) ? R(1) : volts;
	}
}
