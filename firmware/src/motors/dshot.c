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

uint16_t dshot_frame(uint16_t value, bool telemetry, bool answered)
{
	const unsigned data = (value & 0x7FFu) << 1 | telemetry;
	const unsigned checksum = (data ^ data >> 4 ^ data >> 8 ^ (answered ? 0xFu : 0u)) & 0xFu;

	return (uint16_t)(data << 4 | checksum);
}
