/* The firmware's notches on the rotors' turns, once for each of many aircraft. */
#include "api.h"

#include "sensing/rpm_filter.h"

struct rpm_filters {
	unsigned gyro_rate_hz;
	struct nf_settings settings;
	struct rotors rotors; /* of the aircraft at hand */
	struct rpm_filter each[];
};

size_t rpm_filters_size(size_t count)
{
	return sizeof(struct rpm_filters) + count * sizeof(struct rpm_filter);
}

void rpm_filters_init(struct rpm_filters *filters, unsigned harmonics, float min_hz, float q, unsigned gyro_rate_hz)
{
	filters->settings = (struct nf_settings){
		.motor_telemetry = 1,
		.rpm_filter_harmonics = harmonics,
		.rpm_filter_min_hz = min_hz,
		.rpm_filter_q = q,
	};
	filters->rotors = (struct rotors){0};
	filters->gyro_rate_hz = gyro_rate_hz;
}

void rpm_filters_reset(struct rpm_filters *filters, size_t count, const int64_t which[])
{
	for (size_t k = 0; k < count; ++k)
		rpm_filter_init(&filters->each[which[k]], &filters->settings, filters->gyro_rate_hz);
}

void rpm_filters_step(struct rpm_filters *filters, size_t count, const int64_t which[], const float speed[],
		      float rate[])
{
	for (size_t k = 0; k < count; ++k) {
		for (size_t m = 0; m < POLICY_ACTION_COUNT; ++m)
			filters->rotors.speed[m] = speed[POLICY_ACTION_COUNT * k + m];
		rpm_filter_step(&filters->each[which[k]], &filters->rotors, &rate[3 * k]);
	}
}
