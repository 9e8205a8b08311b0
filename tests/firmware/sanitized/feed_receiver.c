/* Feeds standard input to the receiver of each protocol, under the sanitizers.
 * Input: pieces of two bytes of length (the lower one first), one byte of gyro samples that pass before, and as many
 * bytes as the length says. Output, a line a protocol: pieces, frames, frames with the link good. Ends with 3 when a
 * channel leaves its range or a setpoint is none. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "receiver/rates.h"
#include "receiver/receiver.h"
#include "storage/settings.h"

#define PIECES_MAX 300000
#define SETPOINT_MAX 27.93f /* rad/s: 1600 deg/s and a hair */

static const struct piece {
	const uint8_t *bytes; /* a heap block of its own size, so that one byte too far is seen */
	size_t count;
	unsigned samples;
} *pieces;
static size_t piece_count;

static void read_pieces(void)
{
	struct piece *all = malloc(PIECES_MAX * sizeof *all);

	for (int low, high; all && piece_count < PIECES_MAX && (low = getchar()) != EOF && (high = getchar()) != EOF;) {
		struct piece *piece = &all[piece_count++];
		const size_t length = (size_t)(low | high << 8);
		uint8_t *bytes = malloc(length ? length : 1);
		piece->samples = (unsigned)getchar();
		piece->count = bytes ? fread(bytes, 1, length, stdin) : 0;
		piece->bytes = bytes;
	}
	pieces = all;
}

static void look(const struct receiver *receiver, const struct rates *rates)
{
	uint16_t channels_us[NF_CHANNEL_COUNT];
	float setpoint[3];

	receiver_channels(receiver, channels_us);
	for (int i = 0; i < NF_CHANNEL_COUNT; ++i)
		if (channels_us[i] < NF_CHANNEL_VALID_MIN_US || channels_us[i] > NF_CHANNEL_VALID_MAX_US)
			exit(3);
	rates_setpoint(rates, channels_us, setpoint);
	for (int i = 0; i < 3; ++i)
		if (!(setpoint[i] >= -SETPOINT_MAX && setpoint[i] <= SETPOINT_MAX))
			exit(3);
	if (receiver_quality(receiver) > 100)
		exit(3);
	if (receiver_modes(receiver) >= 1u << MODE_COUNT)
		exit(3);
	if (receiver_link(receiver) == RECEIVER_LOST && receiver_modes(receiver) != 0)
		exit(3);
}

/* What MSP would say with these bytes as channels. */
static unsigned long tell(struct receiver *receiver, const struct piece *piece)
{
	uint16_t channels_us[NF_CHANNEL_COUNT] = { 0 };

	memcpy(channels_us, piece->bytes, piece->count < sizeof channels_us ? piece->count : sizeof channels_us);
	return receiver_msp(receiver, channels_us);
}

/* A range in each slot: of any mode, channel, width and kind. */
static void every_slot(struct nf_settings *settings)
{
	const unsigned first = settings_find("mode1");

	for (uint8_t slot = 0; slot < NF_MODE_SLOT_COUNT; ++slot) {
		const struct mode_range range = {
			.mode = mode_range_mode(slot % MODE_COUNT),
			.aux = slot % NF_AUX_COUNT,
			.low = slot,
			.high = (uint8_t)(NF_MODE_STEPS - slot),
			.and_others = slot % 3 == 0,
		};
		const union setting_value value = { .as_mode = mode_range_pack(&range) };
		if (settings_set(settings, first + slot, &value) != NF_REFUSAL_NONE)
			exit(2);
	}
}

static void feed(unsigned protocol)
{
	struct nf_settings settings;
	struct receiver *receiver = malloc(sizeof *receiver);
	struct rates rates;
	unsigned long frames = 0, good = 0;

	if (!receiver)
		exit(2);
	settings_default(&settings);
	settings.receiver_protocol = protocol;
	settings.interpolation = 1;
	settings.map_roll = 7;
	settings.map_aux4 = 0;
	every_slot(&settings);
	settings.rates_style = protocol == NF_RECEIVER_PROTOCOL_CRSF ? NF_RATES_STYLE_BETAFLIGHT :
								       NF_RATES_STYLE_ACTUAL;
	receiver_init(receiver, &settings, 1000);
	rates_init(&rates, &settings);
	for (size_t i = 0; i < piece_count; ++i) {
		const uint8_t *bytes = pieces[i].bytes;
		size_t count = pieces[i].count;
		for (unsigned sample = 0; sample < pieces[i].samples; ++sample)
			receiver_tick(receiver);
		frames += tell(receiver, &pieces[i]);
		while (receiver_push(receiver, &bytes, &count)) {
			++frames;
			good += receiver_link(receiver) == RECEIVER_GOOD;
			look(receiver, &rates);
		}
		if (count != 0 || bytes != pieces[i].bytes + pieces[i].count)
			exit(3);
		look(receiver, &rates);
	}
	free(receiver);
	printf("%zu %lu %lu\n", piece_count, frames, good);
}

int main(void)
{
	read_pieces();
	feed(NF_RECEIVER_PROTOCOL_SBUS);
	feed(NF_RECEIVER_PROTOCOL_CRSF);
	feed(NF_RECEIVER_PROTOCOL_MSP);
	for (size_t i = 0; i < piece_count; ++i)
		free((void *)pieces[i].bytes);
	free((void *)pieces);
	return 0;
}
