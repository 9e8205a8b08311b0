/* Channels as receivers pack them. */
#pragma once

#include "nf_contract.h"

#define CHANNELS_PACKED_BYTES 22 /* 16 channels of 11 bits */

/* Unpacks 16 values of 11 bits, least significant bit first, to 880..2159 us: 880 + (5 value + 4) / 8 in
 * integers. 992 is 1500 us; 172 and 1811, the ends of most transmitters, are 988 and 2012 us. */
void channels_unpack(const uint8_t packed[CHANNELS_PACKED_BYTES], uint16_t channels_us[NF_CHANNEL_COUNT]);
