#include "world.h"

#include "control/pid.h"
#include "motors/dshot.h"
#include "storage/settings_store.h"

#define LONGEST_HALF_READ 530u /* bytes that a request cut short can still swallow */
#define REPLY_ROOM 8192u
#define LISTENS 300u /* lines of the command line's longest answer, and more */
#define FRAME_MS 10u

extern float scripted_action[POLICY_ACTION_COUNT];

static struct world world, begun[BEGINNING_COUNT];
static _Alignas(8) uint8_t flash_bytes[NF_FLASH_BYTES];
static uint8_t flash_begun[BEGINNING_COUNT][NF_FLASH_BYTES];

/* --- What the board does, and what it must never be asked ------------------------------------------------ */
static bool world_motors_stand(const struct world *w)
{
	for (size_t i = 0; i < w->board.motor_count; ++i)
		if (w->board.dshot[i] != NF_DSHOT_STOP)
			return false;
	return true;
}

/* Flash is written with the motors stopped, and while nothing can arm. */
static void world_check_flash(const struct world *w)
{
	PROMISE(!w->firmware.status.trace.armed);
	PROMISE(w->sample == 0 || w->firmware.forbidden & 1u << NF_ARMING_REASON_STORING);
	PROMISE(world_motors_stand(w));
}

static const uint8_t *world_at(void *context, uint32_t address)
{
	struct world *w = context;

	return flash_model_at(&w->board.flash, address);
}

static bool world_erase(void *context, unsigned sector)
{
	struct world *w = context;

	world_check_flash(w);
	return flash_model_erase(&w->board.flash, sector);
}

static bool world_program(void *context, uint32_t address, const void *words, size_t bytes)
{
	struct world *w = context;

	world_check_flash(w);
	return flash_model_program(&w->board.flash, address, words, bytes);
}

/* Motors that are not armed turn in a motor test only: within its limits, and not longer than its time-out after the
 * last values that it was given. A command is no turning. */
static void world_check_motors(struct world *w, const uint16_t dshot[], size_t count, bool telemetry)
{
	const struct motor_test *test = &w->firmware.motor_test;
	const uint16_t most = dshot_value(test->most);
	const uint32_t timeout = GYRO_HZ * NF_MOTOR_TEST_TIMEOUT_MS / 1000u;
	unsigned sum = 0;

	if (test->refreshed != w->refreshed) {
		w->refreshed = test->refreshed;
		w->refreshed_at = w->sample;
	}
	PROMISE(count == POLICY_ACTION_COUNT);
	for (size_t i = 0; i < count; ++i) {
		const uint16_t value = dshot[i];
		PROMISE(value <= NF_DSHOT_MAX);
		if (w->firmware.status.trace.armed) {
			PROMISE(value >= NF_DSHOT_MIN);
			continue;
		}
		if (value == NF_DSHOT_STOP)
			continue;
		if (value < NF_DSHOT_MIN) {
			PROMISE(telemetry);
			continue;
		}
		PROMISE(w->firmware.status.state == NF_FLIGHT_DISARMED);
		PROMISE(test->wish & 1u);
		PROMISE(w->sample - w->refreshed_at <= timeout);
		PROMISE(value <= most);
		sum += value - NF_DSHOT_MIN;
	}
	PROMISE((float)sum <= NF_MOTOR_TEST_SUM_MAX * NF_DSHOT_SPAN + (float)count || w->firmware.status.trace.armed);
	PROMISE(!(w->resets && w->firmware.status.trace.armed));
}

static bool world_motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry)
{
	struct world *w = context;

	world_check_motors(w, dshot, count, telemetry);
	w->board.motor_count = count;
	memcpy(w->board.dshot, dshot, count * sizeof dshot[0]);
	return true;
}

static bool world_reset(void *context, enum nf_reboot kind)
{
	struct world *w = context;

	PROMISE(!w->firmware.status.trace.armed);
	if (kind != NF_REBOOT_FIRMWARE)
		return false;
	w->resets = true;
	return true;
}

/* --- Beginnings ------------------------------------------------------------------------------------------ */
static void world_boot(struct world *w, bool msp)
{
	struct setting_change change = { .index = settings_find("receiver_protocol") };
	const struct background_config config = {
		.board = {
			.hal = &w->hal,
			.alignment = HOST_GYRO_ALIGNMENT,
			.identity = host_identity,
			.changes = &change,
			.change_count = msp,
			.gyro_rate_hz = GYRO_HZ,
			.cycles_hz = 1000000000u,
		},
		.firmware = &w->firmware,
		.weights = w->weights,
		.stats = w->stats,
		.pid = &pid_gains_built_in,
	};

	memset(w, 0, sizeof *w);
	memset(flash_bytes, 0xFF, sizeof flash_bytes);
	host_board_install(flash_bytes);
	change.value.as_uint32_t = NF_RECEIVER_PROTOCOL_MSP;
	host_board_init(&w->board, flash_bytes);
	w->hal = host_board_hal(&w->board);
	w->hal.motors_write = world_motors_write;
	w->hal.reset = world_reset;
	w->hal.flash = (struct flash){ .context = w, .at = world_at, .erase = world_erase, .program = world_program };
	w->runtime = (struct runtime){
		.hal = &w->hal,
		.firmware = &w->firmware,
		.stats = w->stats,
		.background = &w->background,
		.log = &w->log,
	};
	w->msp = msp;
	for (int i = 0; i < NF_CHANNEL_COUNT; ++i)
		w->channels_us[i] = NF_CHANNEL_MIN_US;
	for (int i = NF_CHANNEL_ROLL; i <= NF_CHANNEL_YAW; ++i)
		w->channels_us[i] = i == NF_CHANNEL_THROTTLE ? NF_CHANNEL_MIN_US : NF_CHANNEL_MID_US;
	PROMISE(background_start(&w->background, &config) == NF_OK);
}

static void world_arm(struct world *w)
{
	w->channels_us[NF_CHANNEL_AUX1] = NF_CHANNEL_MAX_US;
	world_pass(w, 3 * FRAME_MS);
	w->channels_us[NF_CHANNEL_THROTTLE] = NF_CHANNEL_MID_US;
	world_pass(w, 3 * FRAME_MS);
	PROMISE(w->firmware.status.trace.armed);
}

static void world_act(float action)
{
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		scripted_action[i] = action;
}

static void world_reach(enum beginning beginning)
{
	struct world *const w = &world;

	world_act(0.0f); /* as its self-test expects */
	world_boot(w, beginning >= READY_MSP);
	world_act(0.25f);
	world_pass(w, beginning == BOOTING ? 5 : NF_ARMING_DELAY_MS + NF_CALIBRATION_MS);
	if (beginning == READY || beginning == READY_MSP)
		PROMISE(w->firmware.status.arming_reasons == 0);
	if (beginning == FLYING || beginning == FLYING_MSP)
		world_arm(w);
	begun[beginning] = *w;
	memcpy(flash_begun[beginning], flash_bytes, sizeof flash_bytes);
}

struct world *world_begin(enum beginning beginning)
{
	static bool reached;
	static uint32_t written;

	for (int i = 0; i < BEGINNING_COUNT && !reached; ++i)
		world_reach((enum beginning)i);
	/* Flash is large: it is copied only when the input before has changed it. */
	if (!reached || written != beginning || world.board.flash.operations != begun[beginning].board.flash.operations)
		memcpy(flash_bytes, flash_begun[beginning], sizeof flash_bytes);
	reached = true;
	written = beginning;
	world = begun[beginning];
	return &world;
}

/* --- Frames ---------------------------------------------------------------------------------------------- */
static uint8_t world_checksum(unsigned version, const uint8_t *bytes, size_t count)
{
	uint8_t sum = 0;

	for (size_t i = 0; i < count; ++i) {
		sum ^= bytes[i];
		for (int bit = 0; version == 2 && bit < 8; ++bit)
			sum = (uint8_t)(sum << 1 ^ (sum & 0x80 ? NF_CRC8_DVB_S2_POLY : 0));
	}
	return sum;
}

size_t world_request(unsigned version, unsigned command, const uint8_t *payload, size_t count,
		     uint8_t frame[WORLD_FRAME_MAX])
{
	const bool jumbo = version == 1 && count >= 255;
	const uint8_t low = (uint8_t)count, high = (uint8_t)(count >> 8);
	const uint8_t v2[] = { '$', 'X', '<', 0, (uint8_t)command, (uint8_t)(command >> 8), low, high };
	const uint8_t v1[] = { '$', 'M', '<', jumbo ? 255 : low, (uint8_t)command, low, high };
	size_t n = version == 2 ? sizeof v2 : jumbo ? sizeof v1 : 5;

	memcpy(frame, version == 2 ? v2 : v1, n);
	memcpy(frame + n, payload, count);
	n += count;
	frame[n] = world_checksum(version, frame + 3, n - 3);
	return n + 1;
}

/* Could these bytes have opened the command line, and ended it again? */
static bool world_may_open(const uint8_t *bytes, size_t count)
{
	for (size_t i = 0; i < count; ++i)
		if (bytes[i] == COMMAND_LINE_OPENS || bytes[i] == COMMAND_LINE_FRAME)
			return true;
	return false;
}

static bool world_is_text(uint8_t byte)
{
	return (byte >= ' ' && byte <= '~') || byte == '\r' || byte == '\n' || byte == '\b' ||
	       byte == COMMAND_LINE_FRAME || byte == COMMAND_LINE_FRAME_END;
}

/* Bytes of the whole and good frame of a reply that begins here; 0: none does. */
static size_t world_frame(const uint8_t *reply, size_t count)
{
	if (count < 6 || reply[0] != '$' || (reply[1] != 'M' && reply[1] != 'X') ||
	    (reply[2] != '>' && reply[2] != '!'))
		return 0;
	const unsigned version = reply[1] == 'X' ? 2 : 1;
	const bool jumbo = version == 1 && reply[3] == 255;
	const size_t header = version == 2 ? 8 : jumbo ? 7 : 5;
	if (count <= header)
		return 0;
	const size_t size = version == 2 || jumbo ? reply[header - 2] | (size_t)reply[header - 1] << 8 : reply[3];
	if (count <= header + size || reply[header + size] != world_checksum(version, reply + 3, header + size - 3))
		return 0;
	return header + size + 1;
}

/* What a port says is whole frames of MSP, and while its command line is open text between them. */
static void world_check_said(const uint8_t *reply, size_t count, bool typing)
{
	for (size_t at = 0; at < count;) {
		const size_t frame = world_frame(reply + at, count - at);
		PROMISE(frame > 0 || (typing && world_is_text(reply[at])));
		at += frame > 0 ? frame : 1;
	}
}

/* --- Time and lines -------------------------------------------------------------------------------------- */
static void world_pilot(struct world *w)
{
	if (w->silent || w->sample % (GYRO_HZ * FRAME_MS / 1000u) != 0)
		return;
	if (w->msp)
		(void)firmware_post(&w->firmware, w->channels_us);
	else
		receiver_line_put(&w->board.line, w->channels_us);
}

void world_pass(struct world *w, unsigned samples)
{
	while (samples-- > 0) {
		const double down = -9.80665 - 0.01 * (w->sample % 2); /* the chip's least bit moves */
		const double force[3] = { 0.0, 0.0, down }, rates[3] = { w->shaken, w->shaken, w->shaken };
		const struct imu_sample sample = host_board_sample(rates, force);
		world_pilot(w);
		runtime_sample(&w->runtime, &sample);
		runtime_background(&w->runtime);
		++w->sample;
	}
}

static bool world_typing(const struct world *w, unsigned port)
{
	return command_line_open(&w->background.ports[port].command_line);
}

size_t world_talk(struct world *w, unsigned port, const uint8_t *bytes, size_t count, size_t capacity, uint8_t **reply)
{
	bool typing = world_typing(w, port);

	*reply = malloc(capacity ? capacity : 1);
	if (!*reply)
		abort();
	const size_t written = runtime_link(&w->runtime, port, bytes, count, *reply, capacity);
	PROMISE(written <= capacity);
	typing |= world_typing(w, port);
	world_check_said(*reply, written, typing || world_may_open(bytes, count));
	return written;
}

void world_pause(struct world *w, unsigned port)
{
	runtime_link_pause(&w->runtime, port);
}

void world_hang_up(struct world *w, unsigned port)
{
	runtime_link_reset(&w->runtime, port);
}

/* --- The end --------------------------------------------------------------------------------------------- */
static bool world_has_version(const uint8_t *reply, size_t count)
{
	for (size_t at = 0; at + 9 <= count; ++at)
		if (memcmp(reply + at, "$M>\3\1", 5) == 0)
			return true;
	return false;
}

/* A request that was cut short takes what comes as its payload; once it is full, requests are read again. */
static void world_expect_answer(struct world *w, unsigned port)
{
	static const uint8_t request[] = { '$', 'M', '<', 0, NF_MSP_API_VERSION, NF_MSP_API_VERSION };
	bool answered = false;

	for (size_t sent = 0; sent < LONGEST_HALF_READ && !answered; sent += sizeof request) {
		uint8_t *reply;
		size_t count = world_talk(w, port, request, sizeof request, REPLY_ROOM, &reply);
		answered = world_has_version(reply, count);
		free(reply);
		/* What the command line has to say before it reads on. */
		for (unsigned i = 0; i < LISTENS && !answered && runtime_link_busy(&w->runtime, port); ++i) {
			count = world_talk(w, port, NULL, 0, REPLY_ROOM, &reply);
			answered = world_has_version(reply, count);
			free(reply);
		}
	}
	PROMISE(answered);
}

static void world_check_settings(const struct nf_settings *settings)
{
	struct nf_settings copy = *settings;
	union setting_value value;

	for (unsigned i = 0; i < NF_SETTING_COUNT; ++i) {
		settings_get(settings, i, &value);
		PROMISE(settings_set(&copy, i, &value) == NF_REFUSAL_NONE);
	}
}

void world_end(struct world *w)
{
	struct nf_settings loaded;

	for (unsigned port = 0; port < NF_MSP_PORT_COUNT; ++port)
		world_expect_answer(w, port);
	world_pass(w, 5);
	world_check_settings(&w->background.edited);
	(void)settings_load(&loaded, &w->hal.flash);
	world_check_settings(&loaded);
	PROMISE(settings_conflict(&loaded) == NF_SETTING_COUNT);
}
