#include "receiver/gesture.h"

void gesture_init(struct gesture *gesture)
{
	*gesture = (struct gesture){ 0 };
}

static bool gesture_seen(const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	return channels_us[NF_CHANNEL_THROTTLE] <= NF_THROTTLE_LOW_US &&
	       channels_us[NF_CHANNEL_YAW] <= NF_STICK_LOW_US && channels_us[NF_CHANNEL_PITCH] <= NF_STICK_LOW_US &&
	       channels_us[NF_CHANNEL_ROLL] >= NF_STICK_HIGH_US;
}

bool gesture_step(struct gesture *gesture, const uint16_t channels_us[NF_CHANNEL_COUNT], bool allowed, uint32_t ms)
{
	if (!allowed || !gesture_seen(channels_us)) {
		gesture_init(gesture);
		return false;
	}
	if (!gesture->shown)
		gesture->since_ms = ms;
	gesture->shown = true;
	if (gesture->told || ms - gesture->since_ms < NF_GESTURE_MS)
		return false;
	gesture->told = true;
	return true;
}
