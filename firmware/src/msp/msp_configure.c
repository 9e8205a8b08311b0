#include "msp/msp_request.h"

#include "msp/msp_configure.h"
#include "storage/settings.h"

/* A bit for each message that a peer has read: those of msp_fields.c, and one for the modes, whose slots zeros clear. */
#define TOLD(message) ((uint64_t)1 << (message))
#define TOLD_MODES TOLD(63)

static bool configure_get(struct msp_request *q)
{
	const int message = msp_fields_find_get(q->command);

	if (message < 0) {
		if (q->command == NF_MSP_MODE_RANGES)
			q->peer->told |= TOLD_MODES;
		return msp_lists(q, false);
	}
	q->refusal = msp_fields_get(q, message);
	if (q->refusal == NF_REFUSAL_NONE)
		q->peer->told |= TOLD(message);
	return true;
}

/* Carries out a SET; returns false if the command is none. *told: the peer has read what it changes. */
static bool configure_set(struct msp_request *q, bool *told)
{
	const int message = msp_fields_find_set(q->command);

	if (message < 0) {
		if (!msp_lists(q, true))
			return false;
		*told = q->command != NF_MSP_SET_MODE_RANGE || (q->peer->told & TOLD_MODES);
		if (!*told)
			q->refusal = NF_REFUSAL_ORDER;
		return true;
	}
	*told = (q->peer->told & TOLD(message)) != 0;
	q->refusal = msp_fields_read_first(message) && !*told ? NF_REFUSAL_ORDER : msp_fields_set(q, message);
	return true;
}

/* Takes over the settings as a SET changed them, except those that conflict. The detail is the first that does. */
static void configure_take(struct msp_request *q, bool told)
{
	struct nf_settings *settings = q->services->settings;
	const unsigned conflict = settings_conflict(q->settings);

	if (conflict != NF_SETTING_COUNT && settings_conflict(settings) == NF_SETTING_COUNT) {
		settings_undo(q->settings, settings);
		told &= settings_conflict(q->settings) == NF_SETTING_COUNT;
		q->refusal = NF_REFUSAL_CONFLICT;
		q->detail = (int)conflict;
	}
	if (q->refusal == NF_REFUSAL_NONE || (told && q->refusal != NF_REFUSAL_PAYLOAD))
		*settings = *q->settings;
}

bool msp_configure(struct msp_request *q)
{
	struct nf_settings changed = *q->services->settings;
	bool told;

	q->settings = &changed;
	const bool sets = configure_set(q, &told);
	if (sets) {
		if (q->status->trace.armed)
			q->refusal = NF_REFUSAL_ARMED;
		else
			configure_take(q, told);
		q->peer->spoilt |= q->refusal != NF_REFUSAL_NONE;
	}
	q->settings = q->services->settings;
	return sets || configure_get(q);
}
