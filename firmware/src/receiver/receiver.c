#include "receiver/receiver.h"

#include <string.h>

/* Longer than any pause between two bytes of a frame, shorter than the one between two frames. */
#define LINE_GAP_MS 2u

static const uint8_t sticks[RECEIVER_STICKS] = { NF_CHANNEL_ROLL, NF_CHANNEL_PITCH, NF_CHANNEL_YAW };
_Static_assert(NF_CHANNEL_AUX1 + 4 == NF_CHANNEL_MAPPED_COUNT, "the mapped channels are the first ones");

static void receiver_lose(struct receiver *receiver)
{
	receiver->age = receiver->lost_after;
	receiver->recovering = receiver->recovery;
	link_quality_reset(&receiver->quality);
}

enum { AUX2 = NF_CHANNEL_AUX1 + 1, AUX3, AUX4 };

void receiver_init(struct receiver *receiver, const struct nf_settings *settings, unsigned gyro_rate_hz)
{
	*receiver = (struct receiver){
		.protocol = (uint8_t)settings->receiver_protocol,
		.map = {
			[NF_CHANNEL_ROLL] = (uint8_t)settings->map_roll,
			[NF_CHANNEL_PITCH] = (uint8_t)settings->map_pitch,
			[NF_CHANNEL_THROTTLE] = (uint8_t)settings->map_throttle,
			[NF_CHANNEL_YAW] = (uint8_t)settings->map_yaw,
			[NF_CHANNEL_AUX1] = (uint8_t)settings->map_aux1,
			[AUX2] = (uint8_t)settings->map_aux2,
			[AUX3] = (uint8_t)settings->map_aux3,
			[AUX4] = (uint8_t)settings->map_aux4,
		},
		.interpolates = settings->interpolation != 0,
		.hold_after = gyro_rate_hz * settings->failsafe_hold_ms / 1000u,
		.lost_after = gyro_rate_hz * settings->failsafe_delay_ms / 1000u,
		.recovery = gyro_rate_hz * NF_RECEIVER_RECOVERY_MS / 1000u + 1u, /* the last one is a frame's */
		.pause_after = gyro_rate_hz * NF_RECEIVER_PAUSE_MS / 1000u,
		.flag_length = gyro_rate_hz * NF_RECEIVER_FLAG_MS / 1000u,
		.gap_after = gyro_rate_hz * LINE_GAP_MS / 1000u,
	};
	receiver->since = receiver->pause_after;
	modes_init(&receiver->modes, settings);
	link_quality_init(&receiver->quality, gyro_rate_hz);
	receiver_lose(receiver);
}

/* A complete frame arrived, even if it repeats the last one: it tells the time between frames. */
static void receiver_frame_heard(struct receiver *receiver, bool good)
{
	if (receiver->since > 0 && receiver->since < receiver->pause_after)
		receiver->interval = receiver->since;
	receiver->since = 0;
	link_quality_frame(&receiver->quality, good);
}

/* The modes as they count, for what a good frame switches on. */
static uint32_t receiver_switch(struct receiver *receiver, uint32_t told)
{
	const bool goes_off = (receiver->on & ~told & MODE_BIT(ARM)) != 0;

	receiver->offs = goes_off ? (uint8_t)(receiver->offs + 1u) : 0u;
	return goes_off && receiver->offs < NF_RECEIVER_OFF_FRAMES ? told | MODE_BIT(ARM) : told;
}

static void receiver_take(struct receiver *receiver, const uint16_t wire_us[NF_CHANNEL_COUNT])
{
	uint16_t flown_us[NF_CHANNEL_COUNT];

	if (receiver->interpolates) {
		receiver_channels(receiver, flown_us);
		for (int i = 0; i < RECEIVER_STICKS; ++i)
			receiver->from_us[i] = flown_us[sticks[i]];
	}
	memcpy(receiver->channels_us, wire_us, sizeof receiver->channels_us);
	for (int i = 0; i < NF_CHANNEL_MAPPED_COUNT; ++i)
		receiver->channels_us[i] = wire_us[receiver->map[i]];
	receiver->on = receiver_switch(receiver, modes_on(&receiver->modes, receiver->channels_us));
	receiver->age = 0;
	receiver->flagged = 0;
	if (receiver->recovering == 1)
		receiver->recovering = 0;
	receiver_frame_heard(receiver, true);
}

/* Repeated channels (frame_lost) keep their age, and so do those of a frame in failsafe. */
static bool receiver_push_sbus(struct receiver *receiver, uint8_t byte)
{
	struct sbus_frame frame;

	if (!sbus_push(&receiver->line.sbus, byte, &frame))
		return false;
	if (frame.failsafe)
		receiver->flagged = receiver->flag_length;
	if (frame.failsafe || frame.frame_lost)
		receiver_frame_heard(receiver, false);
	else
		receiver_take(receiver, frame.channels_us);
	return true;
}

static bool receiver_read_sbus(struct receiver *receiver, const uint8_t **bytes, size_t *count)
{
	const uint8_t *at = *bytes, *const end = at + *count;
	bool frame = false;

	while (at < end && !frame) {
		at += sbus_fill(&receiver->line.sbus, at, (size_t)(end - at));
		if (at < end)
			frame = receiver_push_sbus(receiver, *at++);
	}
	*bytes = at;
	*count = (size_t)(end - at);
	return frame;
}

/* Channels come without a flag: an uplink of no quality at all is what says that they are not the transmitter's. */
static void receiver_hear_quality(struct receiver *receiver, uint8_t percent)
{
	receiver->flagged = percent == 0 ? receiver->flag_length : 0;
	link_quality_tell(&receiver->quality, percent);
}

/* Takes waiting frames up to the first with channels; returns whether there was one. */
static bool receiver_take_crsf(struct receiver *receiver, bool paused)
{
	struct crsf_frame frame;

	while (crsf_take(&receiver->line.crsf, paused, &frame)) {
		if (frame.kind == CRSF_CHANNELS) {
			if (receiver->flagged > 0)
				receiver_frame_heard(receiver, false);
			else
				receiver_take(receiver, frame.channels_us);
			return true;
		}
		receiver_hear_quality(receiver, frame.quality);
	}
	return false;
}

/* One byte may complete several frames: waiting ones are taken before the next byte is read. */
static bool receiver_read_crsf(struct receiver *receiver, const uint8_t **bytes, size_t *count)
{
	const uint8_t *at = *bytes, *const end = at + *count;
	bool frame = receiver_take_crsf(receiver, false);

	while (at < end && !frame) {
		at += crsf_put(&receiver->line.crsf, at, (size_t)(end - at));
		frame = receiver_take_crsf(receiver, false);
	}
	*bytes = at;
	*count = (size_t)(end - at);
	return frame;
}

/* Ends what was received before a silence: an incomplete frame is none. Returns whether the bytes held back contained a
 * frame with channels. */
static bool receiver_pause(struct receiver *receiver)
{
	if (receiver->protocol == NF_RECEIVER_PROTOCOL_CRSF)
		return receiver_take_crsf(receiver, true);
	sbus_reset(&receiver->line.sbus);
	return false;
}

bool receiver_push(struct receiver *receiver, const uint8_t **bytes, size_t *count)
{
	if (receiver->silent >= receiver->gap_after && receiver_pause(receiver))
		return true;
	if (*count > 0)
		receiver->silent = 0;
	if (receiver->protocol == NF_RECEIVER_PROTOCOL_SBUS)
		return receiver_read_sbus(receiver, bytes, count);
	if (receiver->protocol == NF_RECEIVER_PROTOCOL_CRSF)
		return receiver_read_crsf(receiver, bytes, count);
	*bytes += *count; /* MSP has its own serial line: bytes on this one are noise */
	*count = 0;
	return false;
}

bool receiver_waits(const struct receiver *receiver)
{
	return receiver->protocol == NF_RECEIVER_PROTOCOL_CRSF && receiver->line.crsf.count > 0;
}

static bool receiver_valid(uint16_t us)
{
	return us >= NF_CHANNEL_VALID_MIN_US && us <= NF_CHANNEL_VALID_MAX_US;
}

bool receiver_msp(struct receiver *receiver, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	if (receiver->protocol != NF_RECEIVER_PROTOCOL_MSP)
		return false;
	for (int i = 0; i < NF_CHANNEL_COUNT; ++i)
		if (channels_us[i] != NF_CHANNEL_UNTOLD_US && !receiver_valid(channels_us[i]))
			return false;
	for (int i = 0; i < NF_CHANNEL_AUX1; ++i)
		if (channels_us[receiver->map[i]] == NF_CHANNEL_UNTOLD_US)
			return false;
	receiver_take(receiver, channels_us);
	for (int i = NF_CHANNEL_AUX1; i < NF_CHANNEL_COUNT; ++i)
		if (receiver->channels_us[i] == NF_CHANNEL_UNTOLD_US)
			receiver->channels_us[i] = NF_CHANNEL_MIN_US;
	return true;
}

void receiver_tick(struct receiver *receiver)
{
	link_quality_tick(&receiver->quality);
	if (receiver->silent < receiver->gap_after)
		++receiver->silent;
	if (receiver->since < receiver->pause_after)
		++receiver->since;
	if (receiver->age < receiver->lost_after && ++receiver->age == receiver->lost_after)
		receiver_lose(receiver);
	else if (receiver->recovering > 0 && (receiver->flagged > 0 || receiver->age >= receiver->pause_after))
		receiver->recovering = receiver->recovery;
	else if (receiver->recovering > 1)
		receiver->recovering--;
	if (receiver->flagged > 0)
		--receiver->flagged;
}

enum receiver_link receiver_link(const struct receiver *receiver)
{
	if (receiver->recovering > 0)
		return RECEIVER_LOST;
	return receiver->flagged > 0 || receiver->age >= receiver->hold_after ? RECEIVER_HOLD : RECEIVER_GOOD;
}

uint32_t receiver_modes(const struct receiver *receiver)
{
	return receiver_link(receiver) == RECEIVER_LOST ? 0u : receiver->on;
}

/* Linear from the previous stick value to the new one, over the expected time to the next frame. */
static uint16_t receiver_ramp(const struct receiver *receiver, int from_us, int to_us)
{
	if (receiver->age >= receiver->interval)
		return (uint16_t)to_us;
	return (uint16_t)(from_us + (to_us - from_us) * (int)receiver->age / (int)receiver->interval);
}

void receiver_channels(const struct receiver *receiver, uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const enum receiver_link link = receiver_link(receiver);

	memcpy(channels_us, receiver->channels_us, sizeof receiver->channels_us);
	if (link == RECEIVER_LOST)
		for (int i = 0; i < NF_CHANNEL_COUNT; ++i)
			channels_us[i] = NF_CHANNEL_MIN_US;
	if (link == RECEIVER_GOOD && !receiver->interpolates)
		return;
	for (int i = 0; i < RECEIVER_STICKS; ++i) {
		uint16_t *stick_us = &channels_us[sticks[i]];
		*stick_us = link == RECEIVER_GOOD ? receiver_ramp(receiver, receiver->from_us[i], *stick_us) :
						    NF_CHANNEL_MID_US;
	}
}

unsigned receiver_quality(const struct receiver *receiver)
{
	return link_quality_percent(&receiver->quality);
}
