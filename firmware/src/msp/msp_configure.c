#include "msp/msp_configure.h"

#include "msp/msp_fields.h"
#include "msp/msp_lists.h"
#include "storage/settings.h"
#include "storage/settings_store.h"

/* Bits of what a peer was told: by message of msp_fields.h, and one for the modes, whose slots zeros clear. */
#define TOLD(message) ((uint64_t)1 << (message))
#define TOLD_MODES TOLD(63)

static bool configure_get(const struct msp_view *view, struct msp_peer *peer, uint16_t command,
			  struct msp_reader payload, struct msp_writer *reply, enum nf_refusal *refusal)
{
	const int message = msp_fields_find_get(command);

	if (message < 0) {
		if (command == NF_MSP_MODE_RANGES)
			peer->told |= TOLD_MODES;
		return msp_lists_get(view, command, payload, reply, refusal);
	}
	*refusal = msp_fields_get(view, message, reply);
	if (*refusal == NF_REFUSAL_NONE)
		peer->told |= TOLD(message);
	return true;
}

static bool configure_set(const struct msp_view *view, const struct msp_peer *peer, uint16_t command,
			  struct msp_reader payload, enum nf_refusal *refusal)
{
	const int message = msp_fields_find_set(command);

	if (message < 0) {
		if (!msp_lists_set(view, command, payload, refusal))
			return false;
		if (command == NF_MSP_SET_MODE_RANGE && !(peer->told & TOLD_MODES))
			*refusal = NF_REFUSAL_ORDER;
		return true;
	}
	*refusal = msp_fields_read_first(message) && !(peer->told & TOLD(message)) ?
			   NF_REFUSAL_ORDER :
			   msp_fields_set(view, message, payload);
	return true;
}

/* Is the storing that is asked for refused? Then the edited settings are the stored ones again. */
static bool configure_spoilt(const struct msp_services *services, struct msp_peer *peer)
{
	if (!peer->spoilt)
		return false;
	peer->spoilt = false;
	(void)settings_load(services->settings, services->flash);
	return true;
}

/* Takes over what a SET has made of the settings, or refuses it. *detail: the setting that does not go with others. */
static void configure_take(const struct msp_services *services, const struct firmware_status *status,
			   const struct nf_settings *changed, enum nf_refusal *refusal, unsigned *detail)
{
	const unsigned conflict = settings_conflict(changed);

	if (status->trace.armed)
		*refusal = NF_REFUSAL_ARMED;
	if (*refusal != NF_REFUSAL_NONE)
		return;
	if (conflict != NF_SETTING_COUNT && settings_conflict(services->settings) == NF_SETTING_COUNT) {
		*refusal = NF_REFUSAL_CONFLICT;
		*detail = conflict;
		return;
	}
	*services->settings = *changed;
}

bool msp_configure(const struct msp_services *services, const struct firmware_status *status, struct msp_peer *peer,
		   uint16_t command, const uint8_t *bytes, size_t size, struct msp_writer *reply,
		   enum nf_refusal *refusal)
{
	const struct msp_reader payload = { bytes, size };
	struct nf_settings changed = *services->settings;
	static const struct pid_gains no_pid = { 0 };
	const struct msp_view view = {
		.status = status,
		.pid = services->pid ? services->pid : &no_pid,
		.blackbox = services->blackbox,
		.settings = &changed,
	};
	unsigned detail = 0;

	if (command == NF_MSP_EEPROM_WRITE && configure_spoilt(services, peer)) {
		*refusal = NF_REFUSAL_SPOILT;
	} else if (configure_set(&view, peer, command, payload, refusal)) {
		configure_take(services, status, &changed, refusal, &detail);
		peer->spoilt |= *refusal != NF_REFUSAL_NONE;
	} else if (!configure_get(&view, peer, command, payload, reply, refusal)) {
		return false;
	}
	if (*refusal != NF_REFUSAL_NONE) {
		msp_put_u8(reply, *refusal);
		msp_put_u16(reply, detail);
	}
	return true;
}
