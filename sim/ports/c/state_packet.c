/* State packets of the simulator link. Axes of the wire: forward, right, down; attitude is a quaternion w x y z from the
 * body (x forward, y left, z up) to the world (north, west, up); velocity and position are east, north, up. */
#include <math.h>
#include <string.h>

#include "api.h"

#define SEA_LEVEL_PA 101325.0
#define SCALE_HEIGHT_M 8434.5 /* of an isothermal atmosphere at 15 degC */

enum { GYRO = 0, FORCE = 3, ROTATION = 6, VELOCITY = 15, POSITION = 18 }; /* in the values of a Sample */
enum { RATES = 1, FORCES = 4, ATTITUDE = 7, SPEED = 11, PLACE = 14, PRESSURE = 17 }; /* in a state packet */

/* Unit quaternion of a rotation matrix by its largest component (Shepperd 1978), to the bits of
 * sim/physics/rotation.py. */
static void state_quaternion(const double m[9], double q[4])
{
	const double a = m[0], b = m[1], c = m[2], d = m[3], e = m[4], f = m[5], g = m[6], h = m[7], i = m[8];
	const double w2 = 1 + a + e + i, x2 = 1 + a - e - i, y2 = 1 - a + e - i, z2 = 1 - a - e + i;
	const double largest = fmax(fmax(w2, x2), fmax(y2, z2));
	const double forms[4][4] = {
		{ w2, h - f, c - g, d - b },
		{ h - f, x2, b + d, c + g },
		{ c - g, b + d, y2, f + h },
		{ d - b, c + g, f + h, z2 },
	};
	const int form = largest == w2 ? 0 : largest == x2 ? 1 : largest == y2 ? 2 : 3;
	const double scale = 0.5 / sqrt(largest);

	for (int k = 0; k < 4; ++k)
		q[k] = forms[form][k] * scale;
}

static void state_turn(const double north_west_up[3], double east_north_up[3])
{
	east_north_up[0] = -north_west_up[1];
	east_north_up[1] = north_west_up[0];
	east_north_up[2] = north_west_up[2];
}

void link_state(double time_s, const double rates[], const double force[], const double values[], double pressure,
		double packet[])
{
	packet[0] = time_s;
	memcpy(packet + RATES, rates, 3 * sizeof packet[0]);
	memcpy(packet + FORCES, force, 3 * sizeof packet[0]);
	state_quaternion(values + ROTATION, packet + ATTITUDE);
	state_turn(values + VELOCITY, packet + SPEED);
	state_turn(values + POSITION, packet + PLACE);
	packet[PRESSURE] = pressure;
}

void link_host_state(double time_s, const double values[], double packet[])
{
	const double *gyro = values + GYRO, *body = values + FORCE;
	const double rates[] = { gyro[0], -gyro[1], -gyro[2] }, force[] = { body[0], -body[1], -body[2] };

	link_state(time_s, rates, force, values, SEA_LEVEL_PA * exp(-values[POSITION + 2] / SCALE_HEIGHT_M), packet);
}
