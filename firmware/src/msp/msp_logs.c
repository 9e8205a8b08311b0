#include "msp/msp_logs.h"

#include "msp/msp.h"

#define READ_HEAD 7u /* bytes of LOG_READ's reply before the log's */
#define READ_MAX (MSP_REPLY_MAX - READ_HEAD)

/* State of a reply that may come too early. */
enum reply_state { TOLD = 0, ASK_AGAIN = 1 };

static enum nf_refusal logs_refused(struct msp_request *q, enum nf_refusal refusal)
{
	struct blackbox_status status;

	if (refusal == NF_REFUSAL_LOG) {
		blackbox_status(q->services->blackbox, &status);
		q->detail = status.device.error;
	}
	return refusal;
}

enum nf_refusal command_log_info(struct msp_request *q)
{
	struct blackbox_status status;

	blackbox_status(q->services->blackbox, &status);
	msp_put_u8(q->reply, status.chosen);
	msp_put_u8(q->reply, status.device.state);
	msp_put_u8(q->reply, status.device.error);
	msp_put_u8(q->reply, (status.logging ? NF_LOG_INFO_LOGGING : 0u) | (status.lossy ? NF_LOG_INFO_LOSSY : 0u) |
				     (status.device.looking ? NF_LOG_INFO_LOOKING : 0u));
	msp_put_u16(q->reply, status.device.logs);
	msp_put_u16(q->reply, status.device.empty);
	msp_put_u32(q->reply, status.device.capacity_kb);
	msp_put_u32(q->reply, status.device.free_kb);
	msp_put_u32(q->reply, status.frames);
	msp_put_u32(q->reply, status.dropped);
	msp_put_u32(q->reply, status.bytes);
	return NF_REFUSAL_NONE;
}

enum nf_refusal command_log_entry(struct msp_request *q)
{
	const unsigned index = msp_take_u16(&q->payload);
	struct log_entry entry = { .bytes = 0 };
	bool later = false;
	const enum nf_refusal refusal = blackbox_entry(q->services->blackbox, index, &entry, &later);

	if (refusal != NF_REFUSAL_NONE)
		return logs_refused(q, refusal);
	if (later)
		entry = (struct log_entry){ .bytes = 0 };
	msp_put_u16(q->reply, index);
	msp_put_u8(q->reply, later ? ASK_AGAIN : TOLD);
	msp_put_bytes(q->reply, entry.name, NF_LOG_NAME_BYTES);
	msp_put_u32(q->reply, entry.bytes);
	return NF_REFUSAL_NONE;
}

enum nf_refusal command_log_read(struct msp_request *q)
{
	const unsigned index = msp_take_u16(&q->payload);
	const uint32_t offset = msp_take_u32(&q->payload);
	size_t count = msp_take_u16(&q->payload);
	bool later = false;
	uint8_t bytes[READ_MAX];

	if (count > READ_MAX)
		count = READ_MAX;
	const enum nf_refusal refusal = blackbox_read(q->services->blackbox, index, offset, bytes, &count, &later);
	if (refusal != NF_REFUSAL_NONE)
		return logs_refused(q, refusal);
	msp_put_u16(q->reply, index);
	msp_put_u32(q->reply, offset);
	msp_put_u8(q->reply, later ? ASK_AGAIN : TOLD);
	if (!later)
		msp_put_bytes(q->reply, bytes, count);
	return NF_REFUSAL_NONE;
}

enum nf_refusal command_log_erase(struct msp_request *q)
{
	bool later = false;

	if (msp_take_u32(&q->payload) != NF_LOG_ERASE_MAGIC)
		return NF_REFUSAL_PAYLOAD;
	const enum nf_refusal refusal = blackbox_erase(q->services->blackbox, &later);
	if (refusal != NF_REFUSAL_NONE)
		return logs_refused(q, refusal);
	msp_put_u8(q->reply, later ? ASK_AGAIN : TOLD);
	return NF_REFUSAL_NONE;
}

/* --- As the ecosystem tells a card ------------------------------------------------------------------------ */
enum card_state { CARD_ABSENT, CARD_FAULT, CARD_STARTING, CARD_READY = 4 };
enum card_error { CARD_GOOD, CARD_FAILED, CARD_UNFORMATTED = 3 };

static unsigned logs_card_state(const struct log_device_status *device)
{
	if (device->state == NF_LOG_STATE_ABSENT || device->error == NF_LOG_ERROR_NO_CARD)
		return CARD_ABSENT;
	return device->state == NF_LOG_STATE_FAULT    ? CARD_FAULT :
	       device->state == NF_LOG_STATE_STARTING ? CARD_STARTING :
							CARD_READY;
}

uint32_t msp_log_card(const struct blackbox *blackbox, unsigned part)
{
	struct blackbox_status status;

	blackbox_status(blackbox, &status);
	if (status.chosen != NF_LOG_DEVICE_CARD)
		return 0;
	const struct log_device_status *device = &status.device;
	switch (part) {
	case 0:
		return logs_card_state(device);
	case 1:
		return device->error == NF_LOG_ERROR_NONE        ? CARD_GOOD :
		       device->error == NF_LOG_ERROR_FILE_SYSTEM ? CARD_UNFORMATTED :
								   CARD_FAILED;
	default:
		return part == 2 ? device->free_kb : device->capacity_kb;
	}
}
