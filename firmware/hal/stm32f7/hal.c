/* hal.h for the STM32F722: joins the drivers. */
#include "port/hal.h"

#include "common/status.h"
#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/fault.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/led.h"
#include "hal/stm32f7/core/motor_pins.h"
#include "hal/stm32f7/core/stop.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/core/watchdog.h"
#include "hal/stm32f7/devices/devices.h"
#include "hal/stm32f7/peripherals/flash_memory.h"
#include "nf_contract.h"
#include "policy.h"
#include "storage/settings_store.h"

#define BOARD_ID "S7X2" /* what configurators know F72x boards by */
#define CONTROL_CYCLES (CLOCK_CORE_HZ / POLICY_CONTROL_RATE_HZ)
#define BROWN_OUT_OFF 3u /* FLASH_OPTCR BOR_LEV; 2, 1, 0: levels 1 to 3 (RM0431, option bytes) */
_Static_assert(NF_MSP_PORT_USB + 1u == NF_MSP_PORT_COUNT, "two UARTs, and USB");
#define RESET_WAIT_MS 2500u /* the two buffers of a line take 2.2 s at 9600 baud */

extern const char bank_start[]; /* linker script */

/* The background's alone. */
static struct {
	bool wanted;
	enum nf_reboot kind;
	uint32_t since_ms;
} restart;

/* The handlers of hal_run write motor frames; before, the tick does. */
static volatile bool program_runs;

/* Traces leave the board by a log, which this target does not keep yet; MSP shows the last step. */
static void hal_trace_write(void *context, const struct control_trace *trace)
{
	fault_note_steps(trace->step, trace->armed != 0u);
}

static uint32_t hal_cycles(void *context)
{
	return time_cycles();
}

static bool hal_deadline_missed(void *context, uint32_t cycles)
{
	return cycles > CONTROL_CYCLES;
}

static void hal_beeper(void *context, bool on)
{
	gpio_write(pin_of(board.beeper), on == (board.beeper_high != 0u));
}

static void hal_led(void *context, bool on)
{
	led_light(on);
}

static void hal_watchdog_feed(void *context)
{
	watchdog_feed();
}

static const uint8_t *hal_flash_at(void *context, uint32_t address)
{
	return (const uint8_t *)address;
}

/* A card that no host could see is not shown. */
static bool hal_reset(void *context, enum nf_reboot kind)
{
	if (kind == NF_REBOOT_CARD && !(log_spi_has_card() && usb_bus_seen()))
		return false;
	restart.wanted = true;
	restart.kind = kind;
	restart.since_ms = time_ms();
	return true;
}

static const struct log_device *hal_log(void *context, enum nf_log_device device);

static const struct hal functions = {
	.receiver_read = receiver_line_read,
	.motors_write = motors_write,
	.rotors_read = motors_read,
	.trace_write = hal_trace_write,
	.deadline_missed = hal_deadline_missed,
	.cycles = hal_cycles,
	.power_read = power_read,
	.motor_restarts = motors_restarts,
	.beeper = hal_beeper,
	.led = hal_led,
	.watchdog_feed = hal_watchdog_feed,
	.reset = hal_reset,
	.log = hal_log,
	.flash = { .at = hal_flash_at, .erase = flash_memory_erase, .program = flash_memory_program },
};

/* With the settings that the program reads as well. */
static const struct log_device *hal_log(void *context, enum nf_log_device device)
{
	struct nf_settings settings;

	if (device == NF_LOG_DEVICE_CARD)
		return log_spi_start();
	(void)settings_load(&settings, &functions.flash);
	if (device == NF_LOG_DEVICE_SERIAL && settings.uart3_function == NF_UART3_FUNCTION_BLACKBOX)
		return log_uart_start(settings.blackbox_baud);
	return NULL;
}

/* In the protocol that the settings say, as the program will read them. */
static void hal_start_motors(void)
{
	struct nf_settings settings;

	(void)settings_load(&settings, &functions.flash);
	motor_pins_start();
	motors_run(settings.motor_protocol, settings.motor_telemetry != 0u, POLICY_ACTION_COUNT);
}

/* A frame that is cut short is none, and the ESC may take the line's end for anything. */
static _Noreturn void hal_start_anew(enum nf_reboot kind)
{
	interrupts_disable();
	motors_finish();
	fault_reset(kind);
}

/* Of the chips that share a bus each hears all that is said, but for its select line. Which of them are used is found out
 * later, if at all. */
static void hal_deselect_chips(void)
{
	const struct board_chip *const chips[] = { &board.gyros[0], &board.gyros[1], &board.log_chip, &board.osd };

	for (size_t i = 0; i < sizeof chips / sizeof chips[0]; ++i)
		gpio_output(pin_of(chips[i]->select), true);
}

/* A board that does not say it measures nothing. */
static float hal_scale(uint16_t tenths)
{
	return tenths != 0u ? (float)tenths / 10.0f : 1.0f;
}

/* The place of the gyro chip that the settings choose. */
static const struct board_chip *hal_gyro(void)
{
	struct nf_settings settings;

	(void)settings_load(&settings, &functions.flash);
	return &board.gyros[settings.gyro_select];
}

int hal_init(int argc, char **argv, struct hal_info *info)
{
	core_start();
	fault_start();
	if (!time_cycles_start() || !clock_start())
		stop(LED_NO_CLOCK);
	if (!board_is_known(&board) || board.motor_count < POLICY_ACTION_COUNT)
		stop(LED_REFUSED);
	clock_peripherals();
	/* ESCs keep the last value that they were sent before a reset: stop frames come first, and from here on each
	 * millisecond, whatever the gyro does. */
	hal_start_motors();
	time_tick_start(CLOCK_CORE_HZ / 1000u);
	watchdog_start();
	led_start();
	led_light(true);
	gpio_output(pin_of(board.beeper), board.beeper_high == 0u);
	hal_deselect_chips();
	if (fault_shows_card()) {
		usb_card_run();
		hal_start_anew(NF_REBOOT_FIRMWARE);
	}
	power_start();
	struct gyro_found found = { GYRO_MPU6500, 0 }; /* without a chip it does not matter */
	const struct board_chip *const gyro = hal_gyro();
	(void)gyro_start(gyro, &found); /* the core hears of its silence */
	watchdog_feed();
	info->alignment = gyro->alignment;
	info->turn_deg = board.turn_deg;
	info->gyro_chip = found.kind;
	info->gyro_identity = found.identity;
	info->brown_out = (uint8_t)(1u + BROWN_OUT_OFF - VALUE(FLASH_OPTCR_BOR_LEV, FLASH_OPTCR));

	info->hal = &functions;
	info->bank = (uint32_t)bank_start == NF_FLASH_BANK_B_ADDRESS;
	info->gyro_rate_hz = 0;
	info->cycles_hz = CLOCK_CORE_HZ;
	info->clock_inexact = !clock_is_exact();
	info->alignment_disputed = (board.gyro_kinds >> info->gyro_chip & 1u) == 0u; /* of other chips nobody tells */
	info->real_time = true;
	info->identity = (struct board_identity){
		.board = BOARD_ID,
		.target = board.name,
		.maker = board.maker,
		.mcu = "STM32F722",
		.osd_chip = board.osd.spi != 0u,
		.unique_id = { SIGNATURE_UID(0), SIGNATURE_UID(1), SIGNATURE_UID(2) },
		.volts_scale = hal_scale(board.volts_scale),
		.amps_scale = hal_scale(board.amps_scale),
	};
	return HAL_RUN;
}

int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings)
{
	static char product[USB_TEXT_MAX + 1u];
	struct serial_line line;

	if (msp_uart_open(0, settings->msp_baud, &line))
		msp_lines_start(0, line);
	if (settings->uart3_function == NF_UART3_FUNCTION_MSP && msp_uart_open(1, settings->uart3_baud, &line))
		msp_lines_start(1, line);
	handlers->name(handlers->context, product, sizeof product);
	if (usb_line_open(product, &line))
		msp_lines_start(NF_MSP_PORT_USB, line);
	receiver_line_start(settings->receiver_protocol);
	gyro_run(handlers, settings->gyro_rate_hz);
	program_runs = true;
	for (;;) {
		const uint32_t samples = gyro_samples(), milliseconds = time_ms();
		const bool awake = usb_bus_step();

		handlers->background(handlers->context);
		if (!restart.wanted)
			msp_lines_serve(handlers);
		else if (!msp_lines_finish() || time_ms() - restart.since_ms > RESET_WAIT_MS)
			hal_start_anew(restart.kind);
		/* Most interrupts only begin to read a sample: there is work after a sample or a millisecond, and while a host
		 * talks. */
		while (!awake && gyro_samples() == samples && time_ms() == milliseconds)
			wait_for_interrupt();
	}
}

int hal_refuse(enum nf_err why)
{
	stop(LED_REFUSED);
}

void tick_handler(void)
{
	time_tick();
	if (!program_runs)
		(void)motors_write(NULL, NULL, 0, false); /* missing values stop */
	gyro_tick();
}
