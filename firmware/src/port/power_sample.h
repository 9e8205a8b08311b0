/* The board's measurement of the battery; the pilot's settings scale it. */
#ifndef NF_POWER_SAMPLE_H
#define NF_POWER_SAMPLE_H

#include <stdbool.h>
#include <stdint.h>

struct power_sample {
	uint16_t volts_mv; /* at the pin */
	uint16_t amps_mv;  /* at the pin */
	bool valid;
};

#endif
