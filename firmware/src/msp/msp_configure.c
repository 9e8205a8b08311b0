#include "msp/msp_configure.h"

#include "msp/msp_fields.h"
#include "msp/msp_lists.h"
#include "storage/settings.h"

/* A bit for each message that a peer has read: those of msp_fields.h, and one for the modes, whose slots zeros clear. */
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

/* Carries out a SET; returns false if `command` is none. *told: the peer has read what it changes. */
static bool configure_set(const struct msp_view *view, const struct msp_peer *peer, uint16_t command,
			  struct msp_reader payload, enum nf_refusal *refusal, bool *told)
{
	const int message = msp_fields_find_set(command);

	if (message < 0) {
		if (!msp_lists_set(view, command, payload, refusal))
			return false;
		*told = command != NF_MSP_SET_MODE_RANGE || (peer->told & TOLD_MODES);
		if (!*told)
			*refusal = NF_REFUSAL_ORDER;
		return true;
	}
	*told = (peer->told & TOLD(message)) != 0;
	*refusal = msp_fields_read_first(message) && !*told ? NF_REFUSAL_ORDER : msp_fields_set(view, message, payload);
	return true;
}

/* Takes over the settings as a SET changed them, except those that conflict. *detail: the first that does. */
static void configure_take(const struct msp_services *services, struct nf_settings *changed, bool told,
			   enum nf_refusal *refusal, unsigned *detail)
{
	struct nf_settings *settings = services->settings;
	const unsigned conflict = settings_conflict(changed);

	if (conflict != NF_SETTING_COUNT && settings_conflict(settings) == NF_SETTING_COUNT) {
		settings_undo(changed, settings);
		told &= settings_conflict(changed) == NF_SETTING_COUNT;
		*refusal = NF_REFUSAL_CONFLICT;
		*detail = conflict;
	}
	if (*refusal == NF_REFUSAL_NONE || (told && *refusal != NF_REFUSAL_PAYLOAD))
		*settings = *changed;
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
	bool told;

	if (configure_set(&view, peer, command, payload, refusal, &told)) {
		if (status->trace.armed)
			*refusal = NF_REFUSAL_ARMED;
		else
			configure_take(services, &changed, told, refusal, &detail);
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
