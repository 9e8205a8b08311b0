#include "msp/msp_configure.h"

#include <stddef.h>
#include <string.h>

#include "policy.h"
#include "storage/mode_range.h"
#include "storage/settings.h"

/* --- Modes ---------------------------------------------------------------------------------------------- */
_Static_assert(SETTING_AT_mode20 - SETTING_AT_mode1 == NF_MODE_SLOT_COUNT - 1, "side by side");

static struct mode_range lists_mode(const struct nf_settings *s, unsigned slot)
{
	return mode_range_unpack(settings_whole(s, SETTING_AT_mode1 + slot));
}

static enum nf_refusal lists_modes(struct msp_request *q)
{
	for (unsigned slot = 0; slot < NF_MODE_SLOT_COUNT; ++slot) {
		const struct mode_range range = lists_mode(q->settings, slot);
		msp_put_u8(q->reply, range.mode);
		msp_put_u8(q->reply, range.aux);
		msp_put_u8(q->reply, range.low);
		msp_put_u8(q->reply, range.high);
	}
	return NF_REFUSAL_NONE;
}

static enum nf_refusal lists_modes_extra(struct msp_request *q)
{
	msp_put_u8(q->reply, NF_MODE_SLOT_COUNT);
	for (unsigned slot = 0; slot < NF_MODE_SLOT_COUNT; ++slot) {
		const struct mode_range range = lists_mode(q->settings, slot);
		msp_put_u8(q->reply, range.mode);
		msp_put_u8(q->reply, range.and_others);
		msp_put_u8(q->reply, 0); /* linked to no other mode */
	}
	return NF_REFUSAL_NONE;
}

/* Slot, mode, channel, low and high; newer peers tell logic and linked mode besides. */
#define MODE_BYTES 5u
#define MODE_BYTES_LOGIC 6u
#define STEP_MAX NF_MODE_STEPS

static enum nf_refusal lists_set_mode(struct msp_request *q)
{
	const size_t size = q->payload.left;
	const unsigned slot = msp_take_u8(&q->payload);

	if (size < MODE_BYTES)
		return NF_REFUSAL_PAYLOAD;
	if (slot >= NF_MODE_SLOT_COUNT)
		return NF_REFUSAL_INDEX;
	const struct mode_range told = lists_mode(q->settings, slot);
	struct mode_range range = { .and_others = told.and_others };
	range.mode = (uint8_t)msp_take_u8(&q->payload);
	range.aux = (uint8_t)msp_take_u8(&q->payload);
	range.low = (uint8_t)msp_take_u8(&q->payload);
	range.high = (uint8_t)msp_take_u8(&q->payload);
	const unsigned logic = size >= MODE_BYTES_LOGIC ? msp_take_u8(&q->payload) : range.and_others;
	const unsigned linked = msp_take_u8(&q->payload);
	range.and_others = logic == 1;
	/* The app assigns slots anew at each save. If this range is refused, the slot's old one, which the pilot may
	 * have deleted, must not stay. */
	(void)settings_set_whole(q->settings, SETTING_AT_mode1 + slot, 0);
	if (logic > 1 || linked != 0 || range.aux >= NF_AUX_COUNT || range.low > STEP_MAX || range.high > STEP_MAX)
		return NF_REFUSAL_RANGE; /* each must fit into its bits */
	return settings_set_whole(q->settings, SETTING_AT_mode1 + slot, mode_range_pack(&range));
}

/* --- Failsafe: what each channel is taken as while frames are missing ------------------------------------ */
#define RXFAIL_CENTRED 0u
#define RXFAIL_HELD 1u

static unsigned lists_rxfail_mode(unsigned channel)
{
	return channel == NF_CHANNEL_ROLL || channel == NF_CHANNEL_PITCH || channel == NF_CHANNEL_YAW ? RXFAIL_CENTRED :
													RXFAIL_HELD;
}

/* In the ecosystem's order the throttle comes after yaw. */
static unsigned lists_rxfail_told(unsigned place)
{
	return place == 2 ? NF_CHANNEL_YAW : place == 3 ? NF_CHANNEL_THROTTLE : place;
}

static enum nf_refusal lists_rxfail(struct msp_request *q)
{
	for (unsigned place = 0; place < NF_CHANNEL_COUNT; ++place) {
		msp_put_u8(q->reply, lists_rxfail_mode(lists_rxfail_told(place)));
		msp_put_u16(q->reply, NF_CHANNEL_MID_US);
	}
	return NF_REFUSAL_NONE;
}

static enum nf_refusal lists_set_rxfail(struct msp_request *q)
{
	const size_t size = q->payload.left;
	const unsigned place = msp_take_u8(&q->payload), mode = msp_take_u8(&q->payload),
		       us = msp_take_u16(&q->payload);

	if (size < 4)
		return NF_REFUSAL_PAYLOAD;
	if (place >= NF_CHANNEL_COUNT)
		return NF_REFUSAL_INDEX;
	return mode == lists_rxfail_mode(lists_rxfail_told(place)) && us == NF_CHANNEL_MID_US ? NF_REFUSAL_NONE :
												NF_REFUSAL_PAYLOAD;
}

/* --- Ports ------------------------------------------------------------------------------------------------ */
#define FUNCTION_MSP 1u
#define FUNCTION_RECEIVER (1u << 6)
#define FUNCTION_BLACKBOX (1u << 7)
#define PORT_BYTES 9u
#define BAUD_AUTO 0u

/* The ecosystem's index of a baud rate; of those that it has, ours are the ones below. */
static const struct rate {
	uint8_t index;
	uint16_t hectobaud;
} rates[] = {
	{ 1, 96 },   { 2, 192 },   { 3, 384 },    { 4, 576 },    { 5, 1152 },   { 6, 2304 },
	{ 9, 4608 }, { 11, 9216 }, { 12, 10000 }, { 13, 15000 }, { 14, 20000 },
};
#define HECTOBAUD 100u

/* UART1 and USB are always MSP's, UART2 the receiver's, UART3 is what its setting says. */
#define LINE_COUNT 4u
#define LINE_UART2 1u
#define LINE_UART3 2u
#define LINE_USB 3u
#define IDENTIFIER_USB 20u /* the ecosystem's, of a virtual serial port; UARTs have their number less one */
#define BAUD_USB 5u        /* 115200, as any rate will do */

static unsigned lists_identifier(unsigned number)
{
	return number == LINE_USB ? IDENTIFIER_USB : number;
}

/* By the setting uart3_function: it does one of them. */
static const uint8_t uart3_functions[] = { 0, FUNCTION_MSP, FUNCTION_BLACKBOX };
_Static_assert(NF_UART3_FUNCTION_MSP == 1 && NF_UART3_FUNCTION_BLACKBOX == 2, "in the order of the setting");

static uint32_t lists_functions(const struct nf_settings *s, unsigned number)
{
	if (number == LINE_UART3)
		return uart3_functions[s->uart3_function];
	return number != LINE_UART2                             ? FUNCTION_MSP :
	       s->receiver_protocol == NF_RECEIVER_PROTOCOL_MSP ? 0u :
								  FUNCTION_RECEIVER;
}

/* Return the setting of a line's baud rate for MSP and for a log; NF_SETTING_COUNT: there is none. */
static unsigned lists_baud(unsigned number)
{
	return number == LINE_UART3 ? SETTING_AT_uart3_baud : number == 0u ? SETTING_AT_msp_baud : NF_SETTING_COUNT;
}

static unsigned lists_log_baud(unsigned number)
{
	return number == LINE_UART3 ? SETTING_AT_blackbox_baud : NF_SETTING_COUNT;
}

static unsigned lists_baud_index(const struct nf_settings *s, unsigned setting)
{
	for (size_t i = 0; i < sizeof rates / sizeof rates[0] && setting != NF_SETTING_COUNT; ++i)
		if (rates[i].hectobaud * HECTOBAUD == settings_whole(s, setting))
			return rates[i].index;
	return BAUD_AUTO;
}

/* old: the form of older peers, which tells fewer functions and no count. */
static enum nf_refusal lists_ports(struct msp_request *q, bool old)
{
	if (!old)
		msp_put_u8(q->reply, LINE_COUNT);
	for (unsigned number = 0; number < LINE_COUNT; ++number) {
		const uint32_t functions = lists_functions(q->settings, number);
		msp_put_u8(q->reply, lists_identifier(number));
		if (old)
			msp_put_u16(q->reply, functions);
		else
			msp_put_u32(q->reply, functions);
		msp_put_u8(q->reply, number == LINE_USB ? BAUD_USB : lists_baud_index(q->settings, lists_baud(number)));
		msp_put_zeros(q->reply, 2); /* of GPS and telemetry: there are none */
		msp_put_u8(q->reply, lists_baud_index(q->settings, lists_log_baud(number)));
	}
	return NF_REFUSAL_NONE;
}

static enum nf_refusal lists_old_ports(struct msp_request *q)
{
	return lists_ports(q, true);
}

static enum nf_refusal lists_new_ports(struct msp_request *q)
{
	return lists_ports(q, false);
}

static enum nf_refusal lists_set_baud(struct nf_settings *s, unsigned setting, unsigned index)
{
	if (index == lists_baud_index(s, setting))
		return NF_REFUSAL_NONE;
	for (size_t i = 0; i < sizeof rates / sizeof rates[0]; ++i)
		if (rates[i].index == index)
			return settings_set_whole(s, setting, rates[i].hectobaud * HECTOBAUD);
	return NF_REFUSAL_RANGE;
}

/* The link that is spoken over, and the receiver, which the features choose, cannot be taken away. */
static enum nf_refusal lists_set_functions(struct nf_settings *s, unsigned number, uint32_t functions)
{
	if (functions == lists_functions(s, number))
		return NF_REFUSAL_NONE;
	for (unsigned choice = 0; number == LINE_UART3 && choice < sizeof uart3_functions; ++choice)
		if (uart3_functions[choice] == functions)
			return settings_set_whole(s, SETTING_AT_uart3_function, choice);
	return NF_REFUSAL_RANGE;
}

/* Baud rates of functions that the line does not have are ignored: the app sends one for each function. */
static enum nf_refusal lists_set_port(struct nf_settings *settings, struct msp_reader payload)
{
	const unsigned identifier = msp_take_u8(&payload);
	const unsigned number = identifier == IDENTIFIER_USB ? LINE_USB : identifier;
	const uint32_t functions = msp_take_u32(&payload);
	const unsigned baud = msp_take_u8(&payload);

	(void)msp_take_u16(&payload); /* of GPS and telemetry */
	if (number >= LINE_COUNT || lists_identifier(number) != identifier)
		return NF_REFUSAL_INDEX;
	const enum nf_refusal refusal = lists_set_functions(settings, number, functions);
	if (refusal != NF_REFUSAL_NONE)
		return refusal;
	if (functions == FUNCTION_MSP && number != LINE_USB)
		return lists_set_baud(settings, lists_baud(number), baud);
	return functions == FUNCTION_BLACKBOX ?
		       lists_set_baud(settings, SETTING_AT_blackbox_baud, msp_take_u8(&payload)) :
		       NF_REFUSAL_NONE;
}

/* Takes the ports that exist and refuses the others. Newer peers may send longer rows. */
static enum nf_refusal lists_set_ports(struct msp_request *q)
{
	const unsigned count = msp_take_u8(&q->payload);
	enum nf_refusal refusal = NF_REFUSAL_NONE;

	if (count == 0 || q->payload.left < (size_t)count * PORT_BYTES)
		return NF_REFUSAL_PAYLOAD;
	const size_t bytes = q->payload.left / count;
	for (unsigned i = 0; i < count; ++i)
		if (lists_set_port(q->settings, (struct msp_reader){ q->payload.at + i * bytes, bytes }) !=
		    NF_REFUSAL_NONE)
			refusal = NF_REFUSAL_RANGE;
	return refusal;
}

/* --- Motor outputs: counted from 0 on the wire, from 1 in the settings ------------------------------------ */
static enum nf_refusal lists_outputs(struct msp_request *q)
{
	msp_put_u8(q->reply, NF_MOTOR_COUNT_MAX);
	for (unsigned motor = 0; motor < NF_MOTOR_COUNT_MAX; ++motor)
		msp_put_u8(q->reply, settings_whole(q->settings, SETTING_AT_motor1_output + motor) - 1u);
	return NF_REFUSAL_NONE;
}

/* Takes all outputs or none: a part of a motor order means another order. */
static enum nf_refusal lists_set_outputs(struct msp_request *q)
{
	const unsigned count = msp_take_u8(&q->payload);

	if (count == 0 || count > NF_MOTOR_COUNT_MAX || q->payload.left < count)
		return NF_REFUSAL_PAYLOAD;
	for (unsigned motor = 0; motor < count; ++motor)
		if (settings_set_whole(q->settings, SETTING_AT_motor1_output + motor, msp_take_u8(&q->payload) + 1u) !=
		    NF_REFUSAL_NONE)
			return NF_REFUSAL_PAYLOAD;
	return NF_REFUSAL_NONE;
}

/* --- Texts ------------------------------------------------------------------------------------------------ */
enum text_kind { TEXT_PILOT = 1, TEXT_CRAFT = 2, TEXT_PID_PROFILE = 3, TEXT_RATE_PROFILE = 4, TEXT_RELEASE = 6 };

static const char *lists_text(const struct nf_settings *s, unsigned kind)
{
	switch (kind) {
	case TEXT_PILOT:
		return s->pilot_name;
	case TEXT_CRAFT:
		return s->craft_name;
	case TEXT_PID_PROFILE:
		return MSP_PID_PROFILE;
	case TEXT_RATE_PROFILE:
		return MSP_RATE_PROFILE;
	case TEXT_RELEASE:
		return NF_MSP_FIRMWARE " " NF_VERSION_TEXT;
	default:
		return NULL;
	}
}

static enum nf_refusal lists_get_text(struct msp_request *q)
{
	const unsigned kind = msp_take_u8(&q->payload);
	const char *text = lists_text(q->settings, kind);

	if (!text)
		return NF_REFUSAL_INDEX;
	msp_put_u8(q->reply, kind);
	msp_put_counted_text(q->reply, text, kind == TEXT_RELEASE ? MSP_TEXT_MAX : NF_SETTING_TEXT_BYTES);
	return NF_REFUSAL_NONE;
}

static bool lists_same_text(const char *text, const union setting_value *value)
{
	unsigned i = 0;

	while (i < NF_SETTING_TEXT_BYTES && text[i] && text[i] == value->as_text[i])
		++i;
	return i == NF_SETTING_TEXT_BYTES || text[i] == value->as_text[i];
}

static enum nf_refusal lists_set_text(struct msp_request *q)
{
	const size_t size = q->payload.left;
	const unsigned kind = msp_take_u8(&q->payload), length = msp_take_u8(&q->payload);
	const char *text = lists_text(q->settings, kind);
	union setting_value value;

	if (!text)
		return NF_REFUSAL_INDEX;
	if (size < 2 || q->payload.left < length)
		return NF_REFUSAL_PAYLOAD;
	if (length > NF_SETTING_TEXT_BYTES)
		return NF_REFUSAL_RANGE;
	memset(&value, 0, sizeof value);
	memcpy(value.as_text, q->payload.at, length);
	if (lists_same_text(text, &value))
		return NF_REFUSAL_NONE;
	if (kind != TEXT_PILOT && kind != TEXT_CRAFT)
		return NF_REFUSAL_PAYLOAD;
	return settings_set(q->settings, kind == TEXT_PILOT ? SETTING_AT_pilot_name : SETTING_AT_craft_name, &value);
}

/* --- All of them ------------------------------------------------------------------------------------------ */
#define ADJUSTMENT_BYTES (6u * NF_MSP_ADJUSTMENT_SLOTS)

static enum nf_refusal lists_adjustments(struct msp_request *q)
{
	msp_put_zeros(q->reply, ADJUSTMENT_BYTES);
	return NF_REFUSAL_NONE;
}

static const struct list {
	uint16_t command;
	bool sets;
	enum nf_refusal (*run)(struct msp_request *q);
} lists[] = {
	{ NF_MSP_MODE_RANGES, false, lists_modes },
	{ NF_MSP_MODE_RANGES_EXTRA, false, lists_modes_extra },
	{ NF_MSP_SET_MODE_RANGE, true, lists_set_mode },
	{ NF_MSP_ADJUSTMENT_RANGES, false, lists_adjustments },
	{ NF_MSP_RXFAIL_CONFIG, false, lists_rxfail },
	{ NF_MSP_SET_RXFAIL_CONFIG, true, lists_set_rxfail },
	{ NF_MSP_SERIAL_CONFIG, false, lists_old_ports },
	{ NF_MSP_COMMON_SERIAL_CONFIG, false, lists_new_ports },
	{ NF_MSP_COMMON_SET_SERIAL_CONFIG, true, lists_set_ports },
	{ NF_MSP_MOTOR_OUTPUT_REORDERING, false, lists_outputs },
	{ NF_MSP_SET_MOTOR_OUTPUT_REORDERING, true, lists_set_outputs },
	{ NF_MSP_GET_TEXT, false, lists_get_text },
	{ NF_MSP_SET_TEXT, true, lists_set_text },
};

bool msp_lists(struct msp_request *q, bool sets)
{
	for (size_t i = 0; i < sizeof lists / sizeof lists[0]; ++i) {
		if (lists[i].command == q->command && lists[i].sets == sets) {
			q->refusal = lists[i].run(q);
			return true;
		}
	}
	return false;
}
