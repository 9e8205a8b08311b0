#include "msp/msp_request.h"

#include <string.h>

#include "common/sha256.h"
#include "msp/msp_logs.h"
#include "policy.h"
#include "storage/settings.h"
#include "storage/settings_store.h"

static enum nf_refusal command_tasks(struct msp_request *q)
{
	const struct services *s = q->services;

	msp_put_u32(q->reply, s->cycles_hz);
	msp_put_u8(q->reply, TASK_COUNT);
	for (unsigned i = 0; i < TASK_COUNT; ++i) {
		const struct task_stats *task = &s->tasks[i];
		msp_put_u16(q->reply, task->rate_hz);
		msp_put_u32(q->reply, task->runs);
		msp_put_u32(q->reply, task->misses);
		msp_put_u32(q->reply, task->worst);
		msp_put_u32(q->reply, task->best);
		msp_put_u32(q->reply, task_stats_mean(task));
	}
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_faults(struct msp_request *q)
{
	const struct fault_log *log = q->services->faults;

	msp_put_u32(q->reply, log->boots);
	msp_put_u8(q->reply, log->pending);
	if (!log->pending)
		return NF_REFUSAL_NONE;
	msp_put_u32(q->reply, log->boot);
	msp_put_bytes(q->reply, &log->record, sizeof log->record);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_faults_acknowledge(struct msp_request *q)
{
	return fault_log_acknowledge(q->services->faults, msp_take_u32(&q->payload));
}

static enum nf_refusal command_acknowledge(struct msp_request *q)
{
	return q->services->acknowledge(q->services->context);
}

static enum nf_refusal command_setting_info(struct msp_request *q)
{
	const struct setting *setting = settings_info_beside(q->services->settings, msp_take_u16(&q->payload));

	if (!setting)
		return NF_REFUSAL_INDEX;
	msp_put_u16(q->reply, NF_SETTING_COUNT);
	msp_put_u8(q->reply, setting->kind);
	msp_put_bytes(q->reply, settings_limits(setting), sizeof(struct setting_limits));
	msp_put_counted_text(q->reply, setting->name, MSP_TEXT_MAX);
	msp_put_counted_text(q->reply, settings_unit(setting), MSP_TEXT_MAX);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_setting_get(struct msp_request *q)
{
	const unsigned index = msp_take_u16(&q->payload);
	const struct setting *setting = settings_info(index);
	union setting_value value;

	if (!setting)
		return NF_REFUSAL_INDEX;
	settings_get(q->services->settings, index, &value);
	msp_put_u8(q->reply, setting->kind);
	msp_put_bytes(q->reply, &value, settings_size(setting));
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_setting_set(struct msp_request *q)
{
	const unsigned index = msp_take_u16(&q->payload);
	const struct setting *setting = settings_info(index);
	union setting_value value;

	if (!setting)
		return NF_REFUSAL_INDEX;
	if (q->payload.left != settings_size(setting))
		return NF_REFUSAL_PAYLOAD;
	memset(&value, 0, sizeof value);
	memcpy(&value, q->payload.at, q->payload.left);
	return settings_set(q->services->settings, index, &value);
}

static enum nf_refusal command_eeprom_write(struct msp_request *q)
{
	const enum nf_refusal refusal = settings_save(q->services->settings, q->services->flash);

	if (refusal == NF_REFUSAL_CONFLICT)
		q->detail = (int)settings_conflict(q->services->settings);
	if (refusal != NF_REFUSAL_NONE || !q->peer->spoilt)
		return refusal;
	q->peer->spoilt = false;
	return NF_REFUSAL_SPOILT;
}

/* In a receiver's order, which the channel map is laid over, as the ecosystem's clients expect. */
static enum nf_refusal command_set_raw_rc(struct msp_request *q)
{
	const struct services *s = q->services;
	uint16_t channels_us[NF_CHANNEL_COUNT];

	for (unsigned i = 0; i < NF_CHANNEL_COUNT; ++i) {
		const bool told = q->payload.left >= sizeof channels_us[0];
		channels_us[i] = told ? (uint16_t)msp_take_u16(&q->payload) : NF_CHANNEL_UNTOLD_US;
	}
	return s->channels(s->context, channels_us);
}

static enum nf_refusal command_motor_test(struct msp_request *q)
{
	return q->services->motor_test(q->services->context, q->peer, msp_take_u32(&q->payload));
}

/* The peer forbids arming, or opens the motor test as the ecosystem's app does. */
static enum nf_refusal command_arming_disable(struct msp_request *q)
{
	const unsigned disabled = msp_take_u8(&q->payload), test = msp_take_u8(&q->payload);

	return q->services->arming(q->services->context, q->peer, disabled != 0, disabled == 0 && test != 0);
}

/* Opens or closes a motor test for the Betaflight app's wizards (motor order, direction). They ask the user for consent
 * but send the board no sign of it, so a wizard is recognised by its requests: the peer holds the arming lock and sends
 * one value for each motor of the aircraft, none above NF_MOTOR_WIZARD_MAX. (The app's sliders send eight values.) Such
 * a SET_MOTOR opens a test of that peer, limited to NF_MOTOR_WIZARD_MAX; values that stop all motors, or a DShot
 * command, close it. */
static enum nf_refusal command_wizard(const struct msp_request *q, bool opens)
{
	return q->peer->locks ? q->services->arming(q->services->context, q->peer, true, opens) : NF_REFUSAL_ORDER;
}
#define WIZARD_MAX_US (NF_CHANNEL_MIN_US + (unsigned)(NF_MOTOR_WIZARD_MAX * (NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US)))

/* As many values as there may be motors; a motor that is not there may only be stopped, by 1000 or 0. */
static enum nf_refusal command_set_motor(struct msp_request *q)
{
	const struct services *s = q->services;
	bool wizard = q->payload.left == POLICY_ACTION_COUNT * sizeof(uint16_t);
	uint16_t values_us[NF_MOTOR_COUNT_MAX];
	size_t count = 0, turning = 0;

	while (count < NF_MOTOR_COUNT_MAX && q->payload.left >= sizeof values_us[0]) {
		const uint16_t us = (uint16_t)msp_take_u16(&q->payload);
		if (us != 0 && (us < NF_CHANNEL_MIN_US || us > NF_CHANNEL_MAX_US))
			return NF_REFUSAL_PAYLOAD;
		values_us[count++] = us == 0 ? NF_CHANNEL_MIN_US : us;
		if (us > NF_CHANNEL_MIN_US)
			turning = count;
		wizard &= us <= WIZARD_MAX_US;
	}
	if (turning > POLICY_ACTION_COUNT)
		return NF_REFUSAL_INDEX;
	count = count < POLICY_ACTION_COUNT ? count : POLICY_ACTION_COUNT;
	enum nf_refusal refusal = s->motors(s->context, values_us, count);
	if (turning == 0) {
		(void)command_wizard(q, false);
		/* Without a test the motors stand already. */
		return refusal == NF_REFUSAL_ORDER ? NF_REFUSAL_NONE : refusal;
	}
	if (wizard && refusal == NF_REFUSAL_ORDER) {
		refusal = command_wizard(q, true);
		if (refusal == NF_REFUSAL_NONE)
			refusal = s->motors(s->context, values_us, count);
	}
	return refusal;
}

static enum nf_refusal command_dshot_command(struct msp_request *q)
{
	const unsigned motor = msp_take_u8(&q->payload);

	return q->services->dshot_command(q->services->context, motor, msp_take_u8(&q->payload));
}

/* Type, motor, count, commands. The frames of a command take time on the wire, so one command is taken at a time, or
 * one followed by SAVE. The type tells the ecosystem's firmware whether to wait for it and makes no difference here.
 * The app's wizard sends commands while motors turn: they stop, and the wizard turns them again. */
static enum nf_refusal command_send_dshot_command(struct msp_request *q)
{
	(void)msp_take_u8(&q->payload);
	const unsigned motor = msp_take_u8(&q->payload), count = msp_take_u8(&q->payload);
	if (count == 0 || count > 2 || q->payload.left != count)
		return NF_REFUSAL_PAYLOAD;
	(void)command_wizard(q, false);
	return q->services->dshot_command(q->services->context, motor, msp_take_u16(&q->payload));
}

static enum nf_refusal command_calibrate(struct msp_request *q)
{
	return q->services->calibrate(q->services->context);
}

static enum nf_refusal command_settings_default(struct msp_request *q)
{
	settings_default(q->services->settings);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_reset_conf(struct msp_request *q)
{
	settings_default(q->services->settings);
	return settings_save(q->services->settings, q->services->flash);
}

/* Does each of two images need the policy that it has? */
static bool command_slots_held(const struct msp_request *q)
{
	return image_update_holds_slots(q->services->image);
}

static enum nf_refusal command_policy_slot_begin(struct msp_request *q)
{
	if (command_slots_held(q))
		return NF_REFUSAL_ORDER;
	const enum nf_refusal refusal = policy_slots_begin(q->services->slots, msp_take_u32(&q->payload));

	if (refusal == NF_REFUSAL_NONE)
		msp_put_u32(q->reply, policy_slots_next_sequence(q->services->slots));
	return refusal;
}

static enum nf_refusal command_policy_slot_write(struct msp_request *q)
{
	const uint32_t offset = msp_take_u32(&q->payload);

	return policy_slots_write(q->services->slots, offset, q->payload.at, q->payload.left);
}

static enum nf_refusal command_policy_slot_end(struct msp_request *q)
{
	enum nf_err why;
	const enum nf_refusal refusal = policy_slots_end(q->services->slots, &why);

	q->detail = why;
	return refusal;
}

static enum nf_refusal command_policy_slot_revert(struct msp_request *q)
{
	return command_slots_held(q) ? NF_REFUSAL_ORDER : policy_slots_revert(q->services->slots);
}

static enum nf_refusal command_policy_slot_info(struct msp_request *q)
{
	const struct policy_slots *slots = q->services->slots;
	const unsigned source = msp_take_u8(&q->payload);
	struct nf_policy_blob_header header;

	if (source >= POLICY_SOURCE_COUNT)
		return NF_REFUSAL_INDEX;
	/* An enum nf_err: a signed byte. */
	msp_put_u8(q->reply, (unsigned)policy_slots_info(slots, (enum policy_source)source, &header));
	msp_put_u8(q->reply, slots->flown == source);
	msp_put_u32(q->reply, header.sequence);
	msp_put_u32(q->reply, header.architecture_hash);
	msp_put_u32(q->reply, header.filters_hash);
	msp_put_u32(q->reply, header.control_rate_hz);
	msp_put_float(q->reply, header.idle);
	msp_put_counted_text(q->reply, header.aircraft, sizeof header.aircraft);
	msp_put_bytes(q->reply, header.policy_sha256, sizeof header.policy_sha256);
	msp_put_bytes(q->reply, header.build, sizeof header.build);
	return NF_REFUSAL_NONE;
}

/* --- Images ------------------------------------------------------------------------------------------- */
/* Flags of a bank with an image. */
static unsigned command_image_flags(const struct image_bank_marks *marks)
{
	return NF_MSP_IMAGE_FITS | (marks->numbered ? NF_MSP_IMAGE_NUMBERED : 0u) |
	       (marks->confirmed ? NF_MSP_IMAGE_CONFIRMED : 0u) | (marks->rejected ? NF_MSP_IMAGE_REJECTED : 0u) |
	       (marks->installed ? NF_MSP_IMAGE_INSTALLED : 0u);
}

static enum nf_refusal command_image_info(struct msp_request *q)
{
	const struct image_update *image = q->services->image;

	msp_put_u8(q->reply, image->running);
	msp_put_u8(q->reply, IMAGE_BANK_COUNT);
	for (unsigned bank = 0; bank < IMAGE_BANK_COUNT; ++bank) {
		struct nf_image_header header = image_bank_header(image->flash, bank);
		struct image_bank_marks marks = image_bank_marks(image->flash, bank);
		const bool fits = image_bank_fits(&header, bank, image->board);
		if (!fits) {
			header = (struct nf_image_header){ 0 };
			marks = (struct image_bank_marks){ 0 };
		}
		msp_put_u8(q->reply, fits ? command_image_flags(&marks) : 0);
		msp_put_u8(q->reply, marks.starts);
		msp_put_u32(q->reply, marks.sequence);
		msp_put_u32(q->reply, header.image_bytes);
		msp_put_u32(q->reply, header.crc);
		msp_put_bytes(q->reply, header.version, sizeof header.version);
		msp_put_bytes(q->reply, header.build, sizeof header.build);
	}
	msp_put_u8(q->reply, NF_IMAGE_LAYOUT);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_image_begin(struct msp_request *q)
{
	struct nf_image_header header;
	uint32_t offset;
	enum nf_err why = NF_OK;

	memcpy(&header, q->payload.at, sizeof header);
	const enum nf_refusal refusal = image_update_begin(q->services->image, &header, &offset, &why);
	q->detail = why;
	if (refusal == NF_REFUSAL_NONE)
		msp_put_u32(q->reply, offset);
	return refusal;
}

static enum nf_refusal command_image_write(struct msp_request *q)
{
	const uint32_t offset = msp_take_u32(&q->payload);

	return image_update_write(q->services->image, offset, q->payload.at, q->payload.left);
}

static enum nf_refusal command_image_end(struct msp_request *q)
{
	uint32_t crc;
	enum nf_err why = NF_OK;

	const enum nf_refusal refusal = image_update_end(q->services->image, &crc, &why);
	q->detail = why;
	if (refusal == NF_REFUSAL_NONE)
		msp_put_u32(q->reply, crc);
	return refusal;
}

static enum nf_refusal command_image_hash(struct msp_request *q)
{
	const unsigned bank = msp_take_u8(&q->payload);
	uint8_t digest[SHA256_BYTES];

	if (bank >= IMAGE_BANK_COUNT)
		return NF_REFUSAL_INDEX;
	q->detail = image_update_hash(q->services->image, bank, digest);
	if (q->detail != NF_OK)
		return NF_REFUSAL_IMAGE;
	msp_put_bytes(q->reply, digest, sizeof digest);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_image_switch(struct msp_request *q)
{
	const struct services *s = q->services;
	uint8_t told[SHA256_BYTES];
	uint32_t sequence;
	enum nf_err why = NF_OK;

	memcpy(told, q->payload.at, sizeof told);
	const enum nf_refusal refusal = image_update_switch(s->image, s->slots, told, &sequence, &why);
	q->detail = why;
	if (refusal == NF_REFUSAL_NONE)
		msp_put_u32(q->reply, sequence);
	return refusal;
}

static enum nf_refusal command_stream(struct msp_request *q)
{
	const unsigned rate_hz = msp_take_u16(&q->payload);

	msp_put_u16(q->reply, msp_stream_start(&q->peer->stream, rate_hz, q->status->trace.step));
	return NF_REFUSAL_NONE;
}

static enum nf_refusal command_reboot(struct msp_request *q)
{
	const unsigned kind = msp_take_u8(&q->payload);

	if (kind > NF_REBOOT_CARD_UTC)
		return NF_REFUSAL_PAYLOAD;
	return q->services->reboot(q->services->context,
				   kind == NF_REBOOT_CARD_UTC ? NF_REBOOT_CARD : (enum nf_reboot)kind);
}

/* When a command may be carried out. */
enum when {
	ALWAYS,
	STOPPED, /* not armed, as the last control step saw it */
	STORING, /* not armed, and nothing arms before it is done: flash is written */
};

static const struct command {
	enum nf_msp code;
	enum when when;
	uint16_t shortest, longest; /* payload [bytes] */
	enum nf_refusal (*run)(struct msp_request *q);
} commands[] = {
#define COMMAND(message, when, shortest, longest, function) \
	{ NF_MSP_##message, when, shortest, longest, command_##function },
	NF_MSP_COMMANDS(COMMAND)
};

/* The row of a command with a payload of that size; one of another size, *fits false, or NULL. */
static const struct command *command_find(uint16_t code, size_t size, bool *fits)
{
	const struct command *found = NULL;

	*fits = false;
	for (size_t i = 0; i < sizeof commands / sizeof commands[0] && !*fits; ++i) {
		if (commands[i].code != code)
			continue;
		found = &commands[i];
		*fits = size >= found->shortest && size <= found->longest;
	}
	return found;
}

static enum nf_refusal command_run(const struct command *command, struct msp_request *q)
{
	const struct services *s = q->services;

	if (command->when == ALWAYS)
		return command->run(q);
	if (q->status->trace.armed)
		return NF_REFUSAL_ARMED;
	if (command->when == STOPPED)
		return command->run(q);
	/* The status is some time old: the motors may have been armed since. */
	const enum nf_refusal refusal = s->storing(s->context, true);
	if (refusal != NF_REFUSAL_NONE)
		return refusal;
	const enum nf_refusal result = command->run(q);
	(void)s->storing(s->context, false);
	return result;
}

bool msp_command(struct msp_request *q)
{
	bool fits;
	const struct command *command = command_find(q->command, q->payload.left, &fits);

	if (!command)
		return false;
	q->refusal = fits ? command_run(command, q) : NF_REFUSAL_PAYLOAD;
	return true;
}
