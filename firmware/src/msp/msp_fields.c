#include "msp/msp_configure.h"

#include <stddef.h>
#include <string.h>

#include "common/limit.h"
#include "storage/settings.h"

static const struct field {
	uint8_t bytes : 3, is_signed : 1;
	uint8_t how : 3; /* enum nf_msp_how */
	uint8_t index;   /* of the setting, or enum nf_msp_source */
	int16_t number;
	float gain;
} kinds[] = {
#define FIELD(...) { __VA_ARGS__ },
	NF_MSP_FIELDS(FIELD)
};
_Static_assert(NF_SETTING_COUNT <= UINT8_MAX, "an index fits");

/* The kind of each field of the messages. */
static const uint8_t order[] = NF_MSP_FIELD_ORDER;
_Static_assert(NF_MSP_FIELD_KINDS <= UINT8_MAX + 1, "a kind's number fits");

static const struct message {
	uint16_t get, set;         /* set 0: there is none */
	uint16_t first, set_first; /* in the order */
	uint8_t count, set_count, required;
	bool read_first;
} messages[] = {
#define MESSAGE(get_, first_, count_, set_, set_first_, set_count_, required_, read_first_) \
	{ .get = get_,                                                                      \
	  .first = first_,                                                                  \
	  .count = count_,                                                                  \
	  .set = set_,                                                                      \
	  .set_first = set_first_,                                                          \
	  .set_count = set_count_,                                                          \
	  .required = required_,                                                            \
	  .read_first = read_first_ },
	NF_MSP_CONFIGURATIONS(MESSAGE)
};

int msp_fields_find_get(uint16_t command)
{
	for (size_t i = 0; i < sizeof messages / sizeof messages[0]; ++i)
		if (messages[i].get == command)
			return (int)i;
	return -1;
}

int msp_fields_find_set(uint16_t command)
{
	for (size_t i = 0; i < sizeof messages / sizeof messages[0]; ++i)
		if (messages[i].set == command && command != 0)
			return (int)i;
	return -1;
}

bool msp_fields_read_first(int message)
{
	return messages[message].read_first;
}

/* --- One field: what it tells, and what it changes ---------------------------------------------------- */
/* `value` rounded and held within what the field can say; as its bits. */
static uint32_t fields_fit(const struct field *field, float value)
{
	const float span = field->bytes == 1 ? 256.0f : field->bytes == 2 ? 65536.0f : 4294967040.0f;
	const float low = field->is_signed ? -0.5f * span : 0.0f;
	const float high = field->bytes == 4 ? span : low + span - 1.0f;
	const float held = limit(value, low, high);

	if (held < 0.0f)
		return (uint32_t)(int32_t)(held - 0.5f);
	return field->bytes == 4 ? (uint32_t)held : (uint32_t)(held + 0.5f);
}

static uint32_t fields_mask(const struct field *field)
{
	return field->bytes == 4 ? UINT32_MAX : (1u << 8 * field->bytes) - 1u;
}

/* The number that stands for a choice, 4 bits for each of three; for another one it is UINT8_MAX. */
static uint32_t fields_choice(const struct field *field, uint32_t choice)
{
	return choice < 3 ? (uint32_t)field->number >> 4 * choice & 0xFu : UINT8_MAX;
}

static uint32_t fields_tell(const struct msp_request *q, const struct field *field)
{
	switch ((enum nf_msp_how)field->how) {
	case NF_MSP_HOW_CONSTANT:
	case NF_MSP_HOW_UNUSED:
		return (uint32_t)field->number & fields_mask(field);
	case NF_MSP_HOW_SOURCE: {
		const uint32_t told = msp_source_get(q, (enum nf_msp_source)field->index, (unsigned)field->number);
		return told < fields_mask(field) ? told : fields_mask(field);
	}
	case NF_MSP_HOW_SCALED:
	case NF_MSP_HOW_CHOICE:
		break;
	}
	if (field->how == NF_MSP_HOW_CHOICE)
		return fields_choice(field, settings_whole(q->settings, field->index));
	const float number = settings_info(field->index)->kind == SETTING_uint32_t ?
				     (float)settings_whole(q->settings, field->index) :
				     settings_number(q->settings, field->index);
	return fields_fit(field, number * field->gain + (float)field->number) & fields_mask(field);
}

static enum nf_refusal fields_put_choice(const struct msp_request *q, const struct field *field, uint32_t raw)
{
	const uint32_t last = settings_limits(settings_info(field->index))->high.as_uint32_t;

	for (uint32_t choice = 0; choice <= last; ++choice)
		if (fields_choice(field, choice) == raw)
			return settings_set_whole(q->settings, field->index, choice);
	return NF_REFUSAL_PAYLOAD;
}

static float fields_number(const struct field *field, uint32_t raw)
{
	if (!field->is_signed)
		return (float)raw;
	return field->bytes == 1 ? (float)(int8_t)raw : (float)(int16_t)raw;
}

static enum nf_refusal fields_put_scaled(const struct msp_request *q, const struct field *field, uint32_t raw)
{
	const float number = (fields_number(field, raw) - (float)field->number) / field->gain;

	if (settings_info(field->index)->kind == SETTING_float)
		return settings_set_number(q->settings, field->index, number);
	return number >= 0.0f ? settings_set_whole(q->settings, field->index, (uint32_t)(number + 0.5f)) :
				NF_REFUSAL_RANGE;
}

/* Applies a value that differs from the GET's: precision that the ecosystem's units lack is never written back. */
static enum nf_refusal fields_put(const struct msp_request *q, const struct field *field, uint32_t raw)
{
	if (field->how == NF_MSP_HOW_UNUSED || raw == fields_tell(q, field))
		return NF_REFUSAL_NONE;
	switch ((enum nf_msp_how)field->how) {
	case NF_MSP_HOW_SCALED:
		return fields_put_scaled(q, field, raw);
	case NF_MSP_HOW_CHOICE:
		return fields_put_choice(q, field, raw);
	case NF_MSP_HOW_SOURCE:
		return msp_source_set(q, (enum nf_msp_source)field->index, (unsigned)field->number, raw);
	case NF_MSP_HOW_CONSTANT:
	case NF_MSP_HOW_UNUSED:
		break;
	}
	return NF_REFUSAL_PAYLOAD;
}

/* --- Whole messages ---------------------------------------------------------------------------------- */
static bool fields_offered(const struct msp_request *q, const struct message *message)
{
	return (message->get != NF_MSP_FILTER_CONFIG && message->get != NF_MSP_SIMPLIFIED_TUNING) ||
	       msp_filters_fit(q->settings);
}

enum nf_refusal msp_fields_get(struct msp_request *q, int index)
{
	const struct message *message = &messages[index];

	if (!fields_offered(q, message))
		return NF_REFUSAL_ABSENT;
	for (unsigned i = 0; i < message->count; ++i) {
		const struct field *field = &kinds[order[message->first + i]];
		const uint32_t raw = fields_tell(q, field);
		for (unsigned byte = 0; byte < field->bytes; ++byte)
			msp_put_u8(q->reply, raw >> 8 * byte);
	}
	return NF_REFUSAL_NONE;
}

/* Another type of rates goes before the rates, as it sets them all; in the payload it is the last. */
static enum nf_refusal fields_put_rates_type(const struct msp_request *q, const struct message *message)
{
	unsigned at = 0;

	for (unsigned i = 0; i < message->set_count; ++i) {
		const struct field *field = &kinds[order[message->set_first + i]];
		if (field->how == NF_MSP_HOW_SOURCE && field->index == NF_MSP_SOURCE_RATES_TYPE && q->payload.left > at)
			return fields_put(q, field, q->payload.at[at]);
		at += field->bytes;
	}
	return NF_REFUSAL_NONE;
}

/* Fields that make one setting together go before all others, too. What is too short is refused behind this. */
static enum nf_refusal fields_put_voltage(const struct msp_request *q, const struct message *message)
{
	enum { PARTS = 1, BYTES = 4 }; /* behind the meter's number */

	if (message->set != NF_MSP_SET_VOLTAGE_METER_CONFIG || q->payload.left < BYTES)
		return NF_REFUSAL_NONE;
	return msp_source_set_voltage(q, q->payload.at + PARTS);
}

static uint32_t fields_take(struct msp_reader *payload, const struct field *field)
{
	uint32_t raw = 0;

	for (unsigned byte = 0; byte < field->bytes; ++byte)
		raw |= (uint32_t)msp_take_u8(payload) << 8 * byte;
	return raw;
}

enum nf_refusal msp_fields_set(struct msp_request *q, int index)
{
	const struct message *message = &messages[index];

	if (!fields_offered(q, message))
		return NF_REFUSAL_ABSENT;
	if (fields_put_rates_type(q, message) != NF_REFUSAL_NONE)
		return NF_REFUSAL_PAYLOAD;
	enum nf_refusal refusal = fields_put_voltage(q, message);
	for (unsigned i = 0; i < message->set_count && (q->payload.left > 0 || i < message->required); ++i) {
		const struct field *field = &kinds[order[message->set_first + i]];
		if (q->payload.left < field->bytes)
			return NF_REFUSAL_PAYLOAD;
		if (fields_put(q, field, fields_take(&q->payload, field)) != NF_REFUSAL_NONE)
			refusal = NF_REFUSAL_RANGE;
	}
	return refusal;
}
