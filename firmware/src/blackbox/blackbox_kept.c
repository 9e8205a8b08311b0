#include "blackbox/blackbox.h"

/* May the device be read, or erased, and does it have a log of that index? */
static enum nf_refusal blackbox_may(const struct blackbox *blackbox, bool can, unsigned index)
{
	struct blackbox_status status;

	if (!blackbox->config.device || !can)
		return NF_REFUSAL_ABSENT;
	blackbox_status(blackbox, &status);
	if (status.device.state == NF_LOG_STATE_LOGGING || status.device.state == NF_LOG_STATE_ENDING)
		return NF_REFUSAL_ORDER;
	return index < status.device.logs ? NF_REFUSAL_NONE : NF_REFUSAL_INDEX;
}

static enum nf_refusal blackbox_answer(enum log_answer answer, bool *later)
{
	*later = answer == LOG_LATER;
	return answer == LOG_FAILED ? NF_REFUSAL_LOG : NF_REFUSAL_NONE;
}

enum nf_refusal blackbox_entry(struct blackbox *blackbox, unsigned index, struct log_entry *entry, bool *later)
{
	const struct log_device *device = blackbox->config.device;
	const enum nf_refusal refusal = blackbox_may(blackbox, device && device->entry, index);

	return refusal == NF_REFUSAL_NONE ? blackbox_answer(device->entry(device->context, index, entry), later) :
					    refusal;
}

enum nf_refusal blackbox_read(struct blackbox *blackbox, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count,
			      bool *later)
{
	const struct log_device *device = blackbox->config.device;
	const enum nf_refusal refusal = blackbox_may(blackbox, device && device->read, index);

	return refusal == NF_REFUSAL_NONE ?
		       blackbox_answer(device->read(device->context, index, offset, bytes, count), later) :
		       refusal;
}

enum nf_refusal blackbox_erase(struct blackbox *blackbox, bool *later)
{
	const struct log_device *device = blackbox->config.device;
	const enum nf_refusal refusal = blackbox_may(blackbox, device && device->erase, 0);

	/* No log at all: there is nothing to erase, or it has just been done. */
	if (refusal != NF_REFUSAL_NONE && refusal != NF_REFUSAL_INDEX)
		return refusal;
	return blackbox_answer(device->erase(device->context), later);
}
