#include "receiver.h"

void receiver_init(struct receiver *receiver, unsigned gyro_rate_hz)
{
	*receiver = (struct receiver){
		.hold_after = gyro_rate_hz * NF_RECEIVER_HOLD_MS / 1000u,
		.lost_after = gyro_rate_hz * NF_RECEIVER_LOST_MS / 1000u,
	};
	receiver->age = receiver->lost_after;
}

void receiver_frame(struct receiver *receiver, const struct sbus_frame *frame)
{
	if (frame->failsafe) {
		receiver->age = receiver->lost_after;
		return;
	}
	if (frame->frame_lost)
		return;
	for (int i = 0; i < NF_CHANNEL_COUNT; i++)
		receiver->channels_us[i] = frame->channels_us[i];
	receiver->age = 0;
}

void receiver_tick(struct receiver *receiver)
{
	if (receiver->age < receiver->lost_after)
		receiver->age++;
}

enum receiver_link receiver_link(const struct receiver *receiver)
{
	if (receiver->age >= receiver->lost_after)
		return RECEIVER_LOST;
	return receiver->age >= receiver->hold_after ? RECEIVER_HOLD : RECEIVER_GOOD;
}

void receiver_channels(const struct receiver *receiver, uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const enum receiver_link link = receiver_link(receiver);

	for (int i = 0; i < NF_CHANNEL_COUNT; i++)
		channels_us[i] = link == RECEIVER_LOST ? NF_CHANNEL_MIN_US : receiver->channels_us[i];
	if (link == RECEIVER_GOOD)
		return;
	channels_us[NF_CHANNEL_ROLL] = NF_CHANNEL_MID_US;
	channels_us[NF_CHANNEL_PITCH] = NF_CHANNEL_MID_US;
	channels_us[NF_CHANNEL_YAW] = NF_CHANNEL_MID_US;
}
