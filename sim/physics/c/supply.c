/* What N aircraft draw their power from: the bench supply, a battery each, or some of both. */
#include "battery.h"
#include "rotor.h"

/* What motors and electronics of each aircraft draw over a sample, whose ends have these rotor speeds; braking gives none
 * back. */
void supply_power(const struct supply *s, const struct propulsion *p, size_t count, const double *before,
		  const double *after, double *power)
{
	for (size_t i = 0; i < count; ++i) {
		double shaft = 0.0;

		for (size_t m = i * s->motors; m < (i + 1u) * s->motors; ++m) {
			const double gained = p->rotor_inertia * (after[m] - before[m]) * s->rate_hz;
			const double thrust = rotor_thrust(p, after[m]);
			const double factor = s->advance != NULL ? s->advance[m] * s->torque_factor[i] : s->torque_factor[i];
			const double torque = rotor_torque(p, after[m], thrust) * factor + gained;
			const double given = after[m] * torque;

			shaft += given > 0.0 ? given : 0.0;
		}
		power[i] = shaft / p->efficiency + s->electronics_power;
	}
}

/* Voltages as the rotors meet them. */
void supply_update(struct supply *s, size_t count)
{
	for (size_t i = 0; i < count; ++i)
		s->voltage_ratio[i] =
			s->pack == NULL || s->bench[i] ? 1.0 : s->pack_voltage[i] / s->bench_voltage;
}

/* Draws the power of one sample. */
void supply_step(struct supply *s, const struct propulsion *p, size_t count, const double *before, const double *after)
{
	if (s->pack == NULL)
		return;
	supply_power(s, p, count, before, after, s->power);
	pack_step(s->pack, count, 1.0 / s->rate_hz, s->power, s->charge, s->current, s->pack_voltage);
	supply_update(s, count);
}
