/* Rates: receiver channels to what the pilot asks for. Linear, no deadband, no expo. */
#ifndef NF_RATES_H
#define NF_RATES_H

#include <stdint.h>

#include "nf_contract.h"

/* Body rates [rad/s] for the channels [us]; a stick beyond its end counts as at its end. Channel high is
 * roll right, nose down, yaw right; the body's yaw is positive to the left. */
void rates_setpoint(const uint16_t channels_us[NF_CHANNEL_COUNT], float setpoint[3]);

/* Thrust 0..1. */
float rates_throttle(const uint16_t channels_us[NF_CHANNEL_COUNT]);

#endif
