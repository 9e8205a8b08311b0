#include "motors/dshot.h"

#include "common/limit.h"
#include "nf_contract.h"

uint16_t dshot_value(float fraction)
{
	if (fraction != fraction)
		return NF_DSHOT_STOP;
	const float steps = (float)NF_DSHOT_SPAN * limit(fraction, 0.0f, 1.0f);
	return (uint16_t)(NF_DSHOT_MIN + (uint16_t)(steps + 0.5f));
}

#define BOTH 0x00010001u

uint32_t dshot_frames(uint32_t values, bool telemetry, bool answered)
{
	const uint32_t data = (values & 0x7FFu * BOTH) << 1 | (telemetry ? BOTH : 0u);
	const uint32_t checksums = (data ^ data >> 4 ^ data >> 8 ^ (answered ? 0xFu * BOTH : 0u)) & 0xFu * BOTH;

	return data << 4 | checksums;
}
