#include "hal/host/board.h"

#include <string.h>

#include "hal/host/convert.h"
#include "policy.h"

const struct board_identity host_identity = {
	.board = "HOST",
	.target = "HOST",
	.maker = "NRFL",
	.mcu = "HOST",
	.unique_id = { 0x484F5354u, 0, 0 }, /* "HOST" */
	.volts_scale = NF_SIM_VOLTS_SCALE,
	.amps_scale = NF_SIM_AMPS_SCALE,
};

static void host_board_silence(struct host_board *board)
{
	for (size_t i = 0; i < NF_MOTOR_COUNT_MAX; ++i)
		board->rotors[i] = NF_ESC_SILENT;
}

void host_board_init(struct host_board *board, uint8_t *bytes)
{
	*board = (struct host_board){ .power = convert_power(NF_SIM_BATTERY_MV / 1000.0, 0.0) };
	host_board_silence(board);
	flash_model_init(&board->flash, bytes);
	board->flash.running = HOST_BANK;
}

void host_board_install(uint8_t *bytes)
{
	_Static_assert(sizeof policy_blob <= NF_FLASH_POLICY_SLOTS_0_SIZE, "it fits the slot");

	memcpy(bytes + (NF_FLASH_POLICY_SLOTS_0_ADDRESS - NF_FLASH_BASE), &policy_blob, sizeof policy_blob);
}

struct imu_sample host_board_sample(const double rates_frd[3], const double force_frd[3])
{
	struct imu_sample sample = { 0 };

	sample.valid = convert_rates(rates_frd, HOST_GYRO_ALIGNMENT, sample.gyro);
	convert_force(force_frd, HOST_GYRO_ALIGNMENT, sample.accel);
	return sample;
}

static size_t host_board_receiver_read(void *context, uint8_t *bytes, size_t capacity)
{
	struct host_board *board = context;

	return receiver_line_take(&board->line, bytes, capacity);
}

static bool host_board_motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry)
{
	struct host_board *board = context;

	board->motor_count = count < NF_MOTOR_COUNT_MAX ? count : NF_MOTOR_COUNT_MAX;
	memcpy(board->dshot, dshot, board->motor_count * sizeof dshot[0]);
	return true;
}

/* Each control step has answers of its own. */
static void host_board_rotors_read(void *context, uint16_t words[NF_MOTOR_COUNT_MAX])
{
	struct host_board *board = context;

	memcpy(words, board->rotors, sizeof board->rotors);
	host_board_silence(board);
}

static void host_board_trace_write(void *context, const struct control_trace *trace)
{
}

static bool host_board_deadline_missed(void *context, uint32_t cycles)
{
	const struct host_board *board = context;

	return board->control_us > 1e6 / POLICY_CONTROL_RATE_HZ;
}

static uint32_t host_board_cycles(void *context)
{
	return 0;
}

static void host_board_power_read(void *context, struct power_sample *power)
{
	const struct host_board *board = context;

	*power = board->power;
}

static void host_board_switch(void *context, bool on)
{
}

static void host_board_nothing(void *context)
{
}

static bool host_board_reset(void *context, enum nf_reboot kind)
{
	return kind == NF_REBOOT_FIRMWARE;
}

static const struct log_device *host_board_log(void *context, enum nf_log_device device)
{
	const struct host_board *board = context;

	return device == NF_LOG_DEVICE_NONE ? NULL : board->log;
}

/* Packets leave at once. */
static uint32_t host_board_motor_restarts(void *context)
{
	return 0;
}

struct hal host_board_hal(struct host_board *board)
{
	return (struct hal){
		.context = board,
		.receiver_read = host_board_receiver_read,
		.motors_write = host_board_motors_write,
		.rotors_read = host_board_rotors_read,
		.trace_write = host_board_trace_write,
		.deadline_missed = host_board_deadline_missed,
		.cycles = host_board_cycles,
		.power_read = host_board_power_read,
		.motor_restarts = host_board_motor_restarts,
		.beeper = host_board_switch,
		.led = host_board_switch,
		.watchdog_feed = host_board_nothing,
		.reset = host_board_reset,
		.log = host_board_log,
		.flash = flash_model_interface(&board->flash),
	};
}
