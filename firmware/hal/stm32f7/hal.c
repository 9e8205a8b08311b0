/* hal.h for the STM32F722: joins the drivers. */
#include "hal/hal.h"

#include "clock.h"
#include "core.h"
#include "gyro_mpu6500.h"
#include "motors.h"
#include "msp_uart.h"
#include "nf_contract.h"
#include "receiver_sbus.h"
#include "stop.h"
#include "targets/MATEKF722/board.h"
#include "time.h"

_Static_assert(POLICY_ACTION_COUNT <= BOARD_MOTOR_COUNT, "this board drives four motors");

/* Set by hal_init, used by hal_run. */
static bool gyro_good;

int hal_init(int argc, char **argv, struct hal_info *info)
{
	(void)argc;
	(void)argv;
	core_start();
	if (!time_cycles_start() || !clock_start())
		stop(LED_NO_CLOCK);
	clock_peripherals();
	motors_start();
	gpio_output(BOARD_LED0, true);
	time_tick_start();
	receiver_sbus_start();
	msp_uart_start();
	gyro_good = gyro_start();

	info->alignment = BOARD_GYRO_ALIGNMENT;
	info->gyro_rate_hz = 0;
	info->cycles_hz = CLOCK_CORE_HZ;
	info->identity = (struct msp_identity){
		.board = BOARD_ID,
		.target = BOARD_TARGET,
		.maker = BOARD_MAKER,
		.unique_id = {SIGNATURE_UID(0), SIGNATURE_UID(1), SIGNATURE_UID(2)},
	};
	return HAL_RUN;
}

/* Sleeps until the next interrupt, but never while DMA reads from DTCM: the vendor's errata for this family
 * say such reads return nothing while the core sleeps. The tick ends every sleep within a millisecond. */
static void rest(void)
{
	interrupts_disable();
	if (!motors_busy() && !gyro_busy() && !msp_uart_busy())
		__asm volatile("dsb\n\twfi" ::: "memory");
	interrupts_enable();
}

int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings)
{
	const enum led_code code = gyro_good ? LED_RUNNING : LED_NO_GYRO;

	if (gyro_good)
		gyro_run(handlers, settings->gyro_rate_hz);
	for (;;) {
		handlers->background(handlers->context);
		msp_uart_serve(handlers);
		gpio_write(BOARD_LED0, !led_lit(code, time_ms()));
		rest();
	}
}

int hal_refuse(enum nf_err why)
{
	(void)why;
	stop(LED_REFUSED);
}

size_t hal_receiver_read(uint8_t *bytes, size_t capacity)
{
	return receiver_sbus_read(bytes, capacity);
}

void hal_motors_write(const uint16_t dshot[], size_t count, bool telemetry)
{
	(void)telemetry;
	motors_write(dshot, count);
}

/* Traces leave the board by a log, which this target does not keep yet; MSP shows the last step. */
void hal_trace_write(const struct control_trace *trace)
{
	(void)trace;
}

uint32_t hal_cycles(void)
{
	return time_cycles();
}

bool hal_deadline_missed(uint32_t cycles)
{
	(void)cycles;
	return false;
}

void hal_power_read(struct power_sample *power)
{
	*power = (struct power_sample){ 0 };
}

void hal_beeper(bool on)
{
	(void)on;
}

void hal_led(bool on)
{
	(void)on;
}

void hal_watchdog_feed(void)
{
}

const uint8_t *hal_flash_at(uint32_t address)
{
	return (const uint8_t *)address;
}

bool hal_flash_erase(unsigned sector)
{
	(void)sector;
	return false;
}

bool hal_flash_program(uint32_t address, const void *words, size_t bytes)
{
	(void)address;
	(void)words;
	(void)bytes;
	return false;
}

bool hal_fault_take(struct fault_record *record)
{
	(void)record;
	return false;
}

void hal_fault_clear(void)
{
}

void hal_reset(void)
{
}
