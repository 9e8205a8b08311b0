/* A board for MSP: its state over erased flash, and services that do nothing of what is asked. No session of the command
 * line opens. */
#pragma once

#include <stdlib.h>
#include <string.h>

#include "hal/host/flash_model.h"
#include "msp/msp_request.h"
#include "policy.h"
#include "storage/settings_store.h"

static struct flash_model model;
static struct flash flash;
static struct nf_settings settings;
static struct policy_slots slots;
static struct image_update image;
static struct fault_log faults;
static struct task_stats tasks[TASK_COUNT];
static struct gyro gyro;
static struct rotors rotors;
static struct blackbox blackbox;
static unsigned long sets, policies; /* of settings, found at a boot; boots that found a policy */

static void board_boot(void)
{
	static const struct policy_blob_identity running = {
		.architecture_hash = POLICY_ARCHITECTURE_HASH,
		.filters_hash = POLICY_FILTERS_HASH,
		.control_rate_hz = POLICY_CONTROL_RATE_HZ,
		.weight_count = POLICY_WEIGHT_COUNT,
		.observation_count = POLICY_OBSERVATION_COUNT,
		.action_count = POLICY_ACTION_COUNT,
	};
	static const struct fault_record record = { .kind = FAULT_ASSERT, .line = 1, .file = "x.c" };
	static struct policy policy;
	static _Alignas(8) float weights[POLICY_WEIGHT_COUNT];

	flash_model_init(&model, model.bytes);
	sets += settings_load(&settings, &flash);
	policies += policy_slots_choose(&slots, &flash, &running, 0, &policy, weights) == NF_OK;
	fault_log_boot(&faults, &flash, faults.boots % 3 ? NULL : &record);
}

static enum nf_refusal board_switch(void *context, bool on)
{
	return NF_REFUSAL_NONE;
}

static enum nf_refusal board_session(void *context, bool open)
{
	return NF_REFUSAL_ARMED;
}

static enum nf_refusal board_channels(void *context, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	return channels_us[NF_CHANNEL_COUNT - 1] ? NF_REFUSAL_NONE : NF_REFUSAL_ABSENT;
}

static enum nf_refusal board_arming(void *context, struct msp_peer *peer, bool disabled, bool test)
{
	peer->locks = disabled;
	return NF_REFUSAL_NONE;
}

static void board_heard(void *context, const struct msp_peer *peer)
{
}

static enum nf_refusal board_motor_test(void *context, struct msp_peer *peer, uint32_t magic)
{
	return magic ? NF_REFUSAL_NONE : NF_REFUSAL_ORDER;
}

static enum nf_refusal board_motors(void *context, const uint16_t values_us[], size_t count)
{
	return count > 0 && values_us[count - 1] ? NF_REFUSAL_NONE : NF_REFUSAL_RANGE;
}

static enum nf_refusal board_dshot_command(void *context, unsigned motor, unsigned command)
{
	return motor < command ? NF_REFUSAL_NONE : NF_REFUSAL_RANGE;
}

static enum nf_refusal board_act(void *context)
{
	return NF_REFUSAL_NONE;
}

static enum nf_refusal board_reboot(void *context, enum nf_reboot kind)
{
	return NF_REFUSAL_ABSENT;
}

static void board_record(void *context, struct control_record *record)
{
	*record = (struct control_record){ .trace.motor_count = NF_MOTOR_COUNT_MAX };
}

/* The board after its first boot; its flash, model.bytes, is the caller's to free. */
static struct services board_services(void)
{
	static const struct board_identity identity = {
		.board = "FUZZ", .target = "FUZZ", .maker = "FUZZ", .mcu = "FUZZ"
	};
	static const struct pid_gains no_pid = { .motor_count = 0 };
	const struct blackbox_config no_device = { .gyro = &gyro, .about = { .settings = &settings } };

	model.bytes = aligned_alloc(8, NF_FLASH_BYTES);
	if (!model.bytes)
		exit(2);
	memset(model.bytes, 0xFF, NF_FLASH_BYTES);
	flash = flash_model_interface(&model);
	board_boot();
	blackbox_init(&blackbox, &no_device);
	image_update_init(&image, &flash, 0, identity.target);
	return (struct services){
		.identity = &identity,
		.flash = &flash,
		.settings = &settings,
		.pid = &no_pid,
		.slots = &slots,
		.image = &image,
		.faults = &faults,
		.blackbox = &blackbox,
		.rotors = &rotors,
		.tasks = tasks,
		.record = board_record,
		.session = board_session,
		.storing = board_switch,
		.channels = board_channels,
		.arming = board_arming,
		.heard = board_heard,
		.motor_test = board_motor_test,
		.motors = board_motors,
		.dshot_command = board_dshot_command,
		.calibrate = board_act,
		.acknowledge = board_act,
		.reboot = board_reboot,
	};
}
