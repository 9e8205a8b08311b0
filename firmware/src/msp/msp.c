#include "msp/msp.h"

#include "common/crc8.h"

#define JUMBO 255u        /* the v1 size that announces a 16-bit one */
#define FRAME_V1_BYTES 6u /* around a payload: "$M>", size, command, checksum */
#define FRAME_V2_BYTES 9u /* "$X>", flags, command, size, checksum */
_Static_assert(MSP_REPLY_MAX < JUMBO, "no reply of this server needs a jumbo frame");
_Static_assert(MSP_FRAME_MAX == MSP_REPLY_MAX + FRAME_V2_BYTES, "the longer frame of the two versions");

/* Named for the byte that is awaited. */
enum msp_state {
	MSP_DOLLAR,
	MSP_VERSION,
	MSP_DIRECTION,
	MSP_V1_SIZE,
	MSP_V1_COMMAND,
	MSP_V1_JUMBO_LOW,
	MSP_V1_JUMBO_HIGH,
	MSP_V2_FLAGS,
	MSP_V2_COMMAND_LOW,
	MSP_V2_COMMAND_HIGH,
	MSP_V2_SIZE_LOW,
	MSP_V2_SIZE_HIGH,
	MSP_PAYLOAD,
	MSP_CHECKSUM,
};

void msp_reset(struct msp *msp)
{
	msp->state = MSP_DOLLAR;
}

bool msp_idle(const struct msp *msp)
{
	return msp->state == MSP_DOLLAR;
}

static uint8_t msp_checksum_step(unsigned version, uint8_t checksum, uint8_t byte)
{
	return version == 1 ? checksum ^ byte : crc8(checksum, &byte, 1);
}

/* The state behind a complete header. A size that no request can have is noise: wait for the next '$'. */
static enum msp_state msp_after_header(struct msp *msp)
{
	if (msp->size > NF_MSP_PAYLOAD_MAX)
		return MSP_DOLLAR;
	msp->received = 0;
	return msp->size > 0 ? MSP_PAYLOAD : MSP_CHECKSUM;
}

bool msp_push(struct msp *msp, uint8_t byte)
{
	if (msp->state == MSP_CHECKSUM) {
		msp->state = MSP_DOLLAR;
		return byte == msp->checksum;
	}
	if (msp->state > MSP_DIRECTION)
		msp->checksum = msp_checksum_step(msp->version, msp->checksum, byte);

	switch ((enum msp_state)msp->state) {
	case MSP_DOLLAR:
		msp->state = byte == '$' ? MSP_VERSION : MSP_DOLLAR;
		break;
	case MSP_VERSION:
		msp->version = byte == 'X' ? 2 : 1;
		msp->state = byte == 'M' || byte == 'X' ? MSP_DIRECTION : byte == '$' ? MSP_VERSION : MSP_DOLLAR;
		break;
	case MSP_DIRECTION:
		msp->checksum = 0;
		msp->state = byte != '<' ? MSP_DOLLAR : msp->version == 1 ? MSP_V1_SIZE : MSP_V2_FLAGS;
		break;
	case MSP_V1_SIZE:
		msp->size = byte;
		msp->state = MSP_V1_COMMAND;
		break;
	case MSP_V1_COMMAND:
		msp->command = byte;
		msp->state = msp->size == JUMBO ? MSP_V1_JUMBO_LOW : (uint8_t)msp_after_header(msp);
		break;
	case MSP_V2_FLAGS:
		msp->state = MSP_V2_COMMAND_LOW;
		break;
	case MSP_V2_COMMAND_LOW:
		msp->command = byte;
		msp->state = MSP_V2_COMMAND_HIGH;
		break;
	case MSP_V2_COMMAND_HIGH:
		msp->command = (uint16_t)(msp->command | byte << 8);
		msp->state = MSP_V2_SIZE_LOW;
		break;
	case MSP_V1_JUMBO_LOW:
	case MSP_V2_SIZE_LOW:
		msp->size = byte;
		++msp->state;
		break;
	case MSP_V1_JUMBO_HIGH:
	case MSP_V2_SIZE_HIGH:
		msp->size = (uint16_t)(msp->size | byte << 8);
		msp->state = (uint8_t)msp_after_header(msp);
		break;
	case MSP_PAYLOAD:
		msp->payload[msp->received++] = byte;
		if (msp->received == msp->size)
			msp->state = MSP_CHECKSUM;
		break;
	case MSP_CHECKSUM: /* dealt with above */
		break;
	}
	return false;
}

size_t msp_frame(unsigned version, uint16_t command, bool refused, const uint8_t *payload, size_t size, uint8_t *frame,
		 size_t capacity)
{
	const size_t header_end = version == 1 ? FRAME_V1_BYTES - 1 : FRAME_V2_BYTES - 1;
	size_t n = 0;

	if (header_end + size + 1 > capacity)
		return 0;
	frame[n++] = '$';
	frame[n++] = version == 1 ? 'M' : 'X';
	frame[n++] = refused ? '!' : '>';
	const size_t checked_from = n;
	if (version == 1) {
		frame[n++] = (uint8_t)size;
		frame[n++] = (uint8_t)command;
	} else {
		frame[n++] = 0; /* flags */
		frame[n++] = (uint8_t)command;
		frame[n++] = (uint8_t)(command >> 8);
		frame[n++] = (uint8_t)size;
		frame[n++] = (uint8_t)(size >> 8);
	}
	for (size_t i = 0; i < size; ++i)
		frame[n++] = payload[i];
	uint8_t checksum = 0;
	for (size_t i = checked_from; i < n; ++i)
		checksum = msp_checksum_step(version, checksum, frame[i]);
	frame[n++] = checksum;
	return n;
}
