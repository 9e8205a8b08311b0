#include "battery.h"

/* Straight lines between the points of the cell's curve. */
static double pack_cell_voltage(const struct pack *p, double left)
{
	const double *const at = p->state_of_charge, *const volts = p->voltage;
	uint32_t i = 1;

	if (!(left > at[0]))
		return left <= at[0] ? volts[0] : left;
	if (left >= at[p->points - 1u])
		return volts[p->points - 1u];
	while (at[i] <= left)
		++i;
	return (volts[i] - volts[i - 1u]) / (at[i] - at[i - 1u]) * (left - at[i - 1u]) + volts[i - 1u];
}

static double pack_rest_voltage(const struct pack *p, double left)
{
	return p->scale * pack_cell_voltage(p, left);
}

void pack_open_circuit(const struct pack *p, size_t count, const double *state_of_charge, double *voltage)
{
	for (size_t i = 0; i < count; ++i)
		voltage[i] = pack_rest_voltage(p, state_of_charge[i]);
}

/* Voltage V at which a pack gives `power`: P = V I with V = OCV - I R. Of the two solutions the one that small powers
 * reach, V >= OCV / 2. More than OCV^2 / 4R it cannot give: there V is OCV / 2. */
static double pack_voltage(double open_circuit, double power, double resistance)
{
	const double root = open_circuit * open_circuit - 4.0 * resistance * power;

	return 0.5 * (open_circuit + sqrt(root > 0.0 ? root : 0.0));
}

void pack_loaded(size_t count, const double *open_circuit, const double *power, double resistance, double *voltage)
{
	for (size_t i = 0; i < count; ++i)
		voltage[i] = pack_voltage(open_circuit[i], power[i], resistance);
}

/* Draws `power` at the pack's terminals for `dt`. */
void pack_draw(const struct pack *p, double dt, double power, double *charge, double *current, double *voltage)
{
	const double open_circuit = pack_rest_voltage(p, 1.0 - *charge / p->capacity);

	*voltage = pack_voltage(open_circuit, power, p->resistance);
	if (p->resistance > 0.0) {
		const double most = open_circuit * open_circuit / (4.0 * p->resistance);

		power = power < most ? power : most;
	}
	*current = *voltage > 0.0 ? power / *voltage : 0.0;
	*charge += *current * dt;
	*charge = *charge < p->charge_max ? *charge : p->charge_max;
}

void pack_step(const struct pack *p, size_t count, double dt, const double *power, double *charge, double *current,
	       double *voltage)
{
	for (size_t i = 0; i < count; ++i)
		pack_draw(p, dt, power[i], charge + i, current + i, voltage + i);
}
