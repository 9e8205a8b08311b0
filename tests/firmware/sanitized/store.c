/* Feeds standard input to everything that reads or writes flash, under the sanitizers.
 * Input: pieces of a kind (one byte), a length (two bytes, the lower one first) and as many bytes. Kind 'M': an MSP
 * peer's. Kind 'F': an address within flash (four bytes, from its beginning) and what stands there from then on, or,
 * cut short, a boot: settings, policy and faults are read. Kind 'C': power goes (operation, kind, seed: a byte each).
 * Output: replies, sets of settings found, boots that found a policy. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "blackbox/blackbox.h"
#include "hal/host/flash_model.h"
#include "msp/msp_commands.h"
#include "msp/msp_port.h"
#include "policy.h"
#include "storage/settings_store.h"

static struct flash_model model;
static struct flash flash;
static struct nf_settings settings;
static struct policy_slots slots;
static struct fault_log faults;
static struct task_stats tasks[TASK_COUNT];
static struct gyro gyro;
static struct blackbox blackbox;
static struct policy policy;
static _Alignas(8) float weights[POLICY_WEIGHT_COUNT];
static unsigned long replies, sets, policies;

static enum nf_refusal storing(void *context, bool busy)
{
	(void)context;
	(void)busy;
	return NF_REFUSAL_NONE;
}

static enum nf_refusal channels(void *context, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	(void)context;
	return channels_us[NF_CHANNEL_COUNT - 1] ? NF_REFUSAL_NONE : NF_REFUSAL_ABSENT;
}

static enum nf_refusal motors(void *context, const uint16_t values_us[], size_t count)
{
	(void)context;
	return count > 0 && values_us[count - 1] ? NF_REFUSAL_NONE : NF_REFUSAL_RANGE;
}

static void boot(void)
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

	flash_model_init(&model, model.bytes);
	sets += settings_load(&settings, &flash);
	policies += policy_slots_choose(&slots, &flash, &running, 0, &policy, weights) == NF_OK;
	fault_log_boot(&faults, &flash, faults.boots % 3 ? NULL : &record);
}

static void serve(struct msp_port *port, const uint8_t *bytes, size_t count)
{
	static const struct firmware_status status = { .gyro_rate_hz = 1000 };
	const size_t capacity = 4 * count + 16;
	uint8_t *reply = malloc(capacity);

	if (!reply)
		exit(2);
	replies += msp_port_serve(port, &status, bytes, count, reply, capacity) > 0;
	free(reply);
}

static void put(const uint8_t *bytes, size_t count)
{
	uint32_t at;

	if (count < sizeof at) {
		boot();
		return;
	}
	memcpy(&at, bytes, sizeof at);
	at %= NF_FLASH_BYTES;
	count -= sizeof at;
	memcpy(model.bytes + at, bytes + sizeof at, count < NF_FLASH_BYTES - at ? count : NF_FLASH_BYTES - at);
}

int main(void)
{
	static const struct board_identity identity = {
		.board = "FUZZ", .target = "FUZZ", .maker = "FUZZ", .mcu = "FUZZ"
	};
	const struct msp_services services = {
		.flash = &flash,
		.settings = &settings,
		.slots = &slots,
		.faults = &faults,
		.tasks = tasks,
		.storing = storing,
		.channels = channels,
		.motors = motors,
		.blackbox = &blackbox,
	};
	const struct blackbox_config no_device = { .gyro = &gyro, .about = { .settings = &settings } };
	struct msp_port port;

	model.bytes = aligned_alloc(8, NF_FLASH_BYTES);
	if (!model.bytes)
		return 2;
	memset(model.bytes, 0xFF, NF_FLASH_BYTES);
	flash = flash_model_interface(&model);
	boot();
	blackbox_init(&blackbox, &no_device);
	msp_port_init(&port, &identity, &services);
	for (int kind, low, high; (kind = getchar()) != EOF && (low = getchar()) != EOF && (high = getchar()) != EOF;) {
		const size_t length = (size_t)(low | high << 8);
		uint8_t *bytes = malloc(length + 1); /* exact, so that one byte too far is seen */
		if (!bytes)
			return 2;
		const size_t count = fread(bytes, 1, length, stdin);
		if (kind == 'M')
			serve(&port, bytes, count);
		else if (kind == 'C' && count >= 3)
			flash_model_cut(&model, bytes[0], bytes[1] % FLASH_CUT_COUNT, bytes[2]);
		else
			put(bytes, count);
		free(bytes);
	}
	free(model.bytes);
	printf("%lu %lu %lu\n", replies, sets, policies);
	return 0;
}
