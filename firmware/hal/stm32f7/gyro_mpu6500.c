#include "gyro_mpu6500.h"

#include "core.h"
#include "dma.h"
#include "handlers.h"
#include "nf_contract.h"
#include "registers.h"
#include "spi.h"
#include "targets/MATEKF722/board.h"
#include "time.h"

#define AF_SPI1 5u
#define EXTI_PORT_C 2u /* SYSCFG_EXTICR1 */

/* MPU-6500 register map and descriptions (RM-MPU-6500A-00), section 4. */
enum mpu6500_register {
	SMPLRT_DIV = 0x19,
	CONFIG = 0x1A,
	GYRO_CONFIG = 0x1B,
	INT_PIN_CFG = 0x37,
	INT_ENABLE = 0x38,
	GYRO_XOUT_H = 0x43,
	SIGNAL_PATH_RESET = 0x68,
	USER_CTRL = 0x6A,
	PWR_MGMT_1 = 0x6B,
	PWR_MGMT_2 = 0x6C,
	WHO_AM_I = 0x75,
};
#define READ 0x80u
#define MPU6500_IDENTITY 0x70u
#define DEVICE_RESET 0x80u       /* PWR_MGMT_1 */
#define RESET_ALL_PATHS 0x07u    /* SIGNAL_PATH_RESET: gyro, accelerometer, temperature */
#define RESET_MS 100u            /* of the chip, and again of its signal paths */

/* Written in this order, each read back. An ICM20689, which some of these boards carry, is not taken:
 * sources disagree on how it is turned, and a wrong turn crashes. */
static const struct setting {
	uint8_t address;
	uint8_t value;
} settings[] = {
	{PWR_MGMT_1, 0x01},   /* awake, clock from the gyro's PLL */
	{USER_CTRL, 0x10},    /* SPI only */
	{PWR_MGMT_2, 0x00},   /* all axes on */
	{SMPLRT_DIV, 0x00},
	{CONFIG, 0x00},       /* DLPF_CFG 0: 8 kHz, bandwidth 250 Hz */
	{GYRO_CONFIG, 0x18},  /* +-2000 deg/s, FCHOICE_B 0 */
	{INT_PIN_CFG, 0x00},  /* active high, push-pull, 50 us pulse */
	{INT_ENABLE, 0x01},   /* data ready */
};

#define COUNTS_OFFSET 1u /* behind the address byte */
#define TRANSFER_BYTES 7u

static DMA_BUFFER uint8_t gyro_request[TRANSFER_BYTES];
static DMA_BUFFER uint8_t gyro_response[TRANSFER_BYTES];

/* Between gyro_run, the edge handler and the sample handler. */
static struct {
	const struct hal_handlers *handlers;
	uint32_t divider;       /* edges a sample */
	uint32_t until_read;    /* edges until the next read; the edge handler's alone */
	volatile bool reading;  /* a transfer was started and not yet taken */
} gyro;

static bool transfer(uint8_t *bytes, size_t count)
{
	gpio_write(BOARD_GYRO_CS, false);
	const bool moved = spi_exchange(bytes, count);
	gpio_write(BOARD_GYRO_CS, true);
	return moved;
}

static bool read_register(uint8_t address, uint8_t *value)
{
	uint8_t bytes[2] = {(uint8_t)(address | READ), 0};
	const bool moved = transfer(bytes, sizeof bytes);

	*value = bytes[1];
	return moved;
}

static bool write_register(uint8_t address, uint8_t value)
{
	uint8_t bytes[2] = {address, value};

	return transfer(bytes, sizeof bytes);
}

static bool identify(void)
{
	uint8_t identity;

	return read_register(WHO_AM_I, &identity) && identity == MPU6500_IDENTITY;
}

static bool configure(void)
{
	for (size_t i = 0; i < sizeof settings / sizeof settings[0]; ++i) {
		uint8_t kept;

		if (!write_register(settings[i].address, settings[i].value) ||
		    !read_register(settings[i].address, &kept) || kept != settings[i].value)
			return false;
	}
	return true;
}

bool gyro_start(void)
{
	gpio_output(BOARD_GYRO_CS, true);
	gpio_input(BOARD_GYRO_READY, GPIO_PULL_DOWN);
	/* The pull-up keeps the clock at its rest level while the SPI is off (RM0431 SPI, clock polarity). */
	gpio_alternate(BOARD_GYRO_SCK, AF_SPI1, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(BOARD_GYRO_MISO, AF_SPI1, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(BOARD_GYRO_MOSI, AF_SPI1, GPIO_FLOATING, GPIO_FAST);
	spi_configure(SPI_844K); /* registers: 1 MHz at most */

	if (!write_register(PWR_MGMT_1, DEVICE_RESET))
		return false;
	time_delay_ms(RESET_MS);
	if (!identify() || !write_register(SIGNAL_PATH_RESET, RESET_ALL_PATHS))
		return false;
	time_delay_ms(RESET_MS);
	return configure();
}

void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz)
{
	gyro.handlers = handlers;
	gyro.divider = NF_GYRO_EDGE_RATE_HZ / rate_hz;
	gyro.until_read = 1;
	gyro.reading = false;
	gyro_request[0] = GYRO_XOUT_H | READ;

	spi_configure(SPI_13M5); /* data: 20 MHz at most */
	spi_dma_setup();
	interrupt_enable(IRQ_DMA2_STREAM2, PRIORITY_SAMPLE);

	SYSCFG_EXTICR1 = (SYSCFG_EXTICR1 & ~SYSCFG_EXTICR1_EXTI3) | FIELD(SYSCFG_EXTICR1_EXTI3, EXTI_PORT_C);
	EXTI_RTSR |= EXTI_RTSR_TR3;
	EXTI_PR = EXTI_PR_PR3;
	EXTI_IMR |= EXTI_IMR_IM3;
	interrupt_enable(IRQ_EXTI3, PRIORITY_GYRO_EDGE);
}

bool gyro_busy(void)
{
	return dma_busy(DMA_GYRO_TX);
}

static void end_transfer(void)
{
	(void)spi_finish(); /* a stream that is still stuck makes the next spi_start refuse, and samples stop */
	gpio_write(BOARD_GYRO_CS, true);
	gyro.reading = false;
}

static void start_transfer(void)
{
	gyro.reading = true;
	gpio_write(BOARD_GYRO_CS, false);
	if (!spi_start(gyro_request, gyro_response, TRANSFER_BYTES))
		end_transfer();
}

/* Samples only ever come from the chip: if edges or transfers stop, so do motor frames, and the ESCs stop
 * their motors by themselves. */
void gyro_edge_handler(void)
{
	EXTI_PR = EXTI_PR_PR3;
	barrier(); /* cleared before the handler can return, or it would run twice */
	if (--gyro.until_read != 0u)
		return;
	gyro.until_read = gyro.divider;
	if (gyro.reading && dma_complete(DMA_GYRO_RX))
		return; /* read but not yet taken: the control path is late, and this sample is lost */
	if (gyro.reading)
		end_transfer(); /* a read takes 5 us: this one is stuck */
	start_transfer();
}

static int16_t big_endian(const volatile uint8_t *bytes)
{
	return (int16_t)(uint16_t)(bytes[0] << 8 | bytes[1]);
}

void gyro_sample_handler(void)
{
	struct imu_sample sample = { 0 };

	/* The edge handler may not come between: it would take the half-ended transfer for a stuck one. */
	interrupts_disable();
	const bool complete = sample.valid = dma_complete(DMA_GYRO_RX);
	end_transfer();
	for (uint32_t axis = 0; axis < 3u; ++axis)
		sample.gyro[axis] = big_endian(gyro_response + COUNTS_OFFSET + 2u * axis);
	interrupts_enable();
	if (complete)
		gyro.handlers->sample(gyro.handlers->context, &sample);
}
