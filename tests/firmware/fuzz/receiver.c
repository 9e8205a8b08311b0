/* The receiver under any bytes; PROTOCOL says which. Input: pieces of a byte that tells, a length, and as many bytes.
 * Of what it tells, bits 0 to 5 are the gyro samples that pass before, times 8 with bit 6; bit 7: the bytes are a
 * frame's content, around which a true frame is made. Two receivers read the same, one a piece, the other a byte at a
 * time. */
#include "fuzz.h"

#include "common/crc8.h"
#include "receiver/rates.h"
#include "receiver/receiver.h"
#include "storage/settings.h"

#define SETPOINT_MAX 27.93f /* rad/s: 1600 deg/s and a hair */
#define GAP 16u /* gyro samples: longer than any pause within a frame */
#define GYRO_HZ 1000u
#define LOOK_EVERY 16u /* gyro samples without a byte */
#define FRAME_MAX 64u
#define SBUS_CONTENT 23u /* channels and flags */
#define ROLL_COUNTS 1234u /* of a frame's 11 bits */
#define ROLL_US (880u + (5u * ROLL_COUNTS + 4u) / 8u)

struct pair {
	struct receiver whole, bytewise;
	struct rates rates;
	unsigned long frames;
};

static void pair_init(struct pair *pair)
{
	/* It holds for the channels that stand in for a lost receiver's. */
	const struct mode_range low = { .mode = NF_MODE_ARM, .aux = 1, .low = 0, .high = 8 };
	struct nf_settings settings;

	settings_default(&settings);
	settings.mode5 = mode_range_pack(&low);
	settings.receiver_protocol = PROTOCOL;
	settings.interpolation = 1;
	receiver_init(&pair->whole, &settings, GYRO_HZ);
	receiver_init(&pair->bytewise, &settings, GYRO_HZ);
	rates_init(&pair->rates, &settings);
	pair->frames = 0;
}

/* What flies now lies within the channels' limits, whatever came. */
static void look(const struct receiver *receiver, const struct rates *rates)
{
	uint16_t channels_us[NF_CHANNEL_COUNT];
	float setpoint[3];

	receiver_channels(receiver, channels_us);
	for (int i = 0; i < NF_CHANNEL_COUNT; ++i)
		PROMISE(channels_us[i] >= NF_CHANNEL_VALID_MIN_US && channels_us[i] <= NF_CHANNEL_VALID_MAX_US);
	rates_setpoint(rates, channels_us, setpoint);
	for (int i = 0; i < 3; ++i)
		PROMISE(setpoint[i] >= -SETPOINT_MAX && setpoint[i] <= SETPOINT_MAX);
	PROMISE(receiver_quality(receiver) <= 100);
	PROMISE(receiver_modes(receiver) < 1u << MODE_COUNT);
	PROMISE(receiver_link(receiver) != RECEIVER_LOST || receiver_modes(receiver) == 0);
}

static unsigned push(struct receiver *receiver, const struct rates *rates, const uint8_t *bytes, size_t count)
{
	unsigned frames = 0;

	while (receiver_push(receiver, &bytes, &count)) {
		++frames;
		look(receiver, rates);
	}
	PROMISE(count == 0);
	return frames;
}

/* Where the bytes are cut makes no difference. */
static void feed(struct pair *pair, const uint8_t *bytes, size_t count)
{
	unsigned one_by_one = push(&pair->bytewise, &pair->rates, bytes, 0); /* a pause may bring frames, too */

	for (size_t i = 0; i < count; ++i)
		one_by_one += push(&pair->bytewise, &pair->rates, bytes + i, 1);
	const unsigned at_once = push(&pair->whole, &pair->rates, bytes, count);
	PROMISE(at_once == one_by_one);
	PROMISE(memcmp(pair->whole.channels_us, pair->bytewise.channels_us, sizeof pair->whole.channels_us) == 0);
	PROMISE(pair->whole.on == pair->bytewise.on);
	PROMISE(receiver_link(&pair->whole) == receiver_link(&pair->bytewise));
	PROMISE(receiver_quality(&pair->whole) == receiver_quality(&pair->bytewise));
	pair->frames += at_once;
}

static void pass(struct pair *pair, unsigned samples)
{
	while (samples-- > 0) {
		receiver_tick(&pair->whole);
		receiver_tick(&pair->bytewise);
		if (samples % LOOK_EVERY == 0)
			look(&pair->whole, &pair->rates);
	}
}

/* A true frame of `content`. Returns its size. */
static size_t frame_around(const uint8_t *content, size_t count, uint8_t frame[FRAME_MAX])
{
	memset(frame, 0, FRAME_MAX);
	if (PROTOCOL == NF_RECEIVER_PROTOCOL_SBUS) {
		frame[0] = NF_SBUS_HEADER;
		memcpy(frame + 1, content, count < SBUS_CONTENT ? count : SBUS_CONTENT);
		frame[SBUS_CONTENT] &= 0x0Fu;
		frame[NF_SBUS_FRAME_BYTES - 1] = NF_SBUS_FOOTER;
		return NF_SBUS_FRAME_BYTES;
	}
	const size_t most = NF_CRSF_FRAME_BYTES_MAX - 3u, body = count < 1 ? 1 : count < most ? count : most;
	frame[0] = NF_CRSF_SYNC;
	frame[1] = (uint8_t)(body + 1);
	memcpy(frame + 2, content, count < body ? count : body);
	frame[2 + body] = crc8(0, frame + 2, body);
	return body + 3;
}

/* After whatever came, a gap that ends it, and the time for which the receiver's word that it is in failsafe counts,
 * the next frame is read. */
static void expect_frame(struct pair *pair)
{
	uint8_t content[SBUS_CONTENT] = { 0 }, frame[FRAME_MAX] = { 0 };
	const bool sbus = PROTOCOL == NF_RECEIVER_PROTOCOL_SBUS;
	uint8_t *const channels = sbus ? content : content + 1;

	if (!sbus)
		content[0] = NF_CRSF_TYPE_CHANNELS;
	for (unsigned i = 0; i < NF_CHANNEL_COUNT; ++i)
		for (unsigned bit = 0; bit < 11; ++bit)
			channels[(11 * i + bit) / 8] |= (uint8_t)((ROLL_COUNTS >> bit & 1u) << (11 * i + bit) % 8);
	pass(pair, GAP + pair->whole.flagged);
	feed(pair, frame, 0);
	pass(pair, pair->whole.flagged);
	const unsigned long before = pair->frames;
	feed(pair, frame, frame_around(content, sizeof content, frame));
	PROMISE(pair->frames == before + 1);
	PROMISE(pair->whole.channels_us[NF_CHANNEL_ROLL] == ROLL_US);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input input = { data, size };
	struct pair *const pair = malloc(sizeof *pair);

	if (!pair)
		abort();
	pair_init(pair);
	while (input.left > 0) {
		const unsigned told = input_byte(&input);
		size_t count = input_byte(&input);
		uint8_t *const bytes = input_bytes(&input, &count), frame[FRAME_MAX];
		pass(pair, (told & 0x3F) * (told & 0x40 ? 8 : 1));
		if (told & 0x80)
			feed(pair, frame, frame_around(bytes, count, frame));
		else
			feed(pair, bytes, count);
		free(bytes);
	}
	expect_frame(pair);
	free(pair);
	return 0;
}
