#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/fault.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/core/watchdog.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "hal/stm32f7/peripherals/spi.h"
#include "nf_contract.h"

#define AF_SPI1 5u
#define EXTI_PORT_C 2u /* SYSCFG_EXTICR1 */

/* MPU-6500 register map and descriptions (RM-MPU-6500A-00), section 4; the ICM-20689 (DS-000143) has the same
 * registers there. ICM-20602 (DS-000176), ICM-20608-G and MPU-9250 as PX4's register headers tell of their data sheets,
 * ICM-20601 as I2Cdev's of DS-000191: docs/guides/board-bring-up.md says what of it only hardware can prove. */
enum chip_register {
	SMPLRT_DIV = 0x19,
	CONFIG = 0x1A,
	GYRO_CONFIG = 0x1B,
	ACCEL_CONFIG = 0x1C,
	ACCEL_CONFIG2 = 0x1D,
	INT_PIN_CFG = 0x37,
	INT_ENABLE = 0x38,
	ACCEL_XOUT_H = 0x3B, /* then temperature and gyro, two bytes each, the upper one first */
	SIGNAL_PATH_RESET = 0x68,
	USER_CTRL = 0x6A,
	PWR_MGMT_1 = 0x6B,
	PWR_MGMT_2 = 0x6C,
	I2C_IF = 0x70, /* the ICM-20602's alone */
	WHO_AM_I = 0x75,
};
#define READ 0x80u
#define DEVICE_RESET 0x80u /* PWR_MGMT_1 */
#define AWAKE 0x01u        /* PWR_MGMT_1: clock from the gyro's PLL (CLKSEL 1), which all of them ask for */
#define FULL_SCALE_3 0x18u /* GYRO_CONFIG: +-2000 deg/s, FCHOICE_B 0; ACCEL_CONFIG: +-16 g */
#define FULL_SCALE_2 0x10u /* the same of the ICM-20601, whose ranges are twice as wide */
#define START_MS 100u      /* at most, from power to the first access (PS-MPU-6500A-01, start-up time) */
#define RESET_MS 100u      /* of the chip, and again of its signal paths */

struct chip_setting {
	uint8_t address;
	uint8_t value;
};
#define SPI_ONLY_BY_USER_CTRL { USER_CTRL, 0x10 } /* I2C_IF_DIS */
#define SPI_ONLY_BY_I2C_IF { I2C_IF, 0x40 }       /* I2C_IF_DIS of the ICM-20602, whose USER_CTRL has no such bit */

/* Differences between the chips. */
static const struct chip {
	uint8_t identity;    /* WHO_AM_I */
	enum gyro_chip kind;
	enum board_alignment alignment;
	struct chip_setting spi_only;
	uint8_t reset_paths; /* SIGNAL_PATH_RESET: all there are */
	uint8_t full_scale;  /* GYRO_CONFIG and ACCEL_CONFIG */
	enum spi_speed speed;/* of data; registers take 1 MHz */
} chips[] = {
	/* 20 MHz at most */
	{ NF_GYRO_IDENTITY_MPU6500, GYRO_MPU6500, BOARD_GYRO_ALIGNMENT, SPI_ONLY_BY_USER_CTRL, 0x07, FULL_SCALE_3,
	  SPI_13M5 },
	/* 8 MHz at most */
	{ NF_GYRO_IDENTITY_ICM20689, GYRO_ICM20689, BOARD_ICM20689_ALIGNMENT, SPI_ONLY_BY_USER_CTRL, 0x03, FULL_SCALE_3,
	  SPI_6M75 },
	/* 10 MHz at most */
	{ NF_GYRO_IDENTITY_ICM20602, GYRO_ICM20602, BOARD_GYRO_ALIGNMENT, SPI_ONLY_BY_I2C_IF, 0x03, FULL_SCALE_3,
	  SPI_6M75 },
	/* 8 MHz at most */
	{ NF_GYRO_IDENTITY_ICM20601, GYRO_ICM20601, BOARD_GYRO_ALIGNMENT, SPI_ONLY_BY_USER_CTRL, 0x03, FULL_SCALE_2,
	  SPI_6M75 },
	{ NF_GYRO_IDENTITY_ICM20608G, GYRO_ICM20608G, BOARD_GYRO_ALIGNMENT, SPI_ONLY_BY_USER_CTRL, 0x03, FULL_SCALE_3,
	  SPI_6M75 },
	/* 20 MHz at most by its data sheet, but PX4 keeps to 10 */
	{ NF_GYRO_IDENTITY_MPU9250, GYRO_MPU9250, BOARD_GYRO_ALIGNMENT, SPI_ONLY_BY_USER_CTRL, 0x07, FULL_SCALE_3,
	  SPI_6M75 },
};

/* Written in this order behind the chip's own; the same numbers for all. */
static const struct chip_setting chip_settings[] = {
	{ PWR_MGMT_2, 0x00 },    /* all axes on */
	{ SMPLRT_DIV, 0x00 },    /* every sample */
	{ CONFIG, 0x00 },        /* DLPF_CFG 0: 8 kHz, bandwidth 250 Hz; an ICM-20602 starts with 0x80 */
	{ ACCEL_CONFIG2, 0x02 }, /* 1 kHz, bandwidth about 95 Hz: attitude needs gravity, not vibration */
	{ INT_PIN_CFG, 0x00 },   /* active high, push-pull, 50 us pulse */
	{ INT_ENABLE, 0x01 },    /* data ready */
};

#define AXES 3u
#define ACCEL_OFFSET 1u /* behind the address byte */
#define TEMPERATURE_OFFSET 7u
#define GYRO_OFFSET 9u
#define TRANSFER_BYTES 15u

static DMA_BUFFER_SLOW uint8_t gyro_request[TRANSFER_BYTES];
static DMA_BUFFER uint8_t gyro_response[TRANSFER_BYTES];

/* A sample whose handler takes longer than its period is followed by the next one at once, and nothing below runs in
 * between: no background, and nobody feeds the watchdog. What runs below is owed a cycle for each 8 that samples take,
 * and while it is owed more than a millisecond samples are left out, which counts as lost ones. A single slow sample
 * costs none. */
#define CYCLES_A_CYCLE 8u
#define OWED_MAX (CLOCK_CORE_HZ / 1000u)

/* Between gyro_run, the edge handler, the sample handler and the tick. */
static struct {
	const struct chip *chip; /* NULL: none that we know */
	const struct hal_handlers *handlers; /* NULL before gyro_run */
	uint32_t divider;        /* edges a sample */
	uint32_t until_read;     /* edges until the next read; the edge handler's alone */
	volatile uint32_t due;   /* reads since gyro_run, made or not; the edge handler's alone */
	volatile uint32_t read;  /* `due` of the read that is under way; likewise */
	uint32_t taken;          /* `due` of the last sample; sample handler and tick */
	uint32_t ended;          /* the last sample [cycle]; the sample handler's alone */
	uint32_t owed;           /* to what runs below [cycles]; likewise */
	uint32_t silent_ms;      /* since the last sample; sample handler and tick, which share a priority */
	volatile uint32_t samples; /* taken; written by the sample handler alone */
	volatile bool reading;   /* a transfer was started and not yet taken */
} gyro;

static bool gyro_transfer(uint8_t *bytes, size_t count)
{
	gpio_write(BOARD_GYRO_CS, false);
	const bool moved = spi_exchange(bytes, count);
	gpio_write(BOARD_GYRO_CS, true);
	return moved;
}

static bool gyro_read_register(uint8_t address, uint8_t *value)
{
	uint8_t bytes[2] = { (uint8_t)(address | READ), 0 };
	const bool moved = gyro_transfer(bytes, sizeof bytes);

	*value = bytes[1];
	return moved;
}

static bool gyro_write_register(uint8_t address, uint8_t value)
{
	uint8_t bytes[2] = { address, value };

	return gyro_transfer(bytes, sizeof bytes);
}

/* The chip of that identity; NULL: this driver does not know it. */
static const struct chip *gyro_find(uint8_t identity)
{
	for (size_t i = 0; i < sizeof chips / sizeof chips[0]; ++i)
		if (chips[i].identity == identity)
			return &chips[i];
	return NULL;
}

/* Writes a register and reads it back. */
static bool gyro_set(struct chip_setting setting)
{
	uint8_t kept;

	return gyro_write_register(setting.address, setting.value) && gyro_read_register(setting.address, &kept) &&
	       kept == setting.value;
}

/* First the bus, so that no level on its lines makes the chip take it for I2C; then awake, as signal paths of a chip that
 * sleeps need not be there to be reset. */
static bool gyro_wake(const struct chip *chip)
{
	return gyro_set(chip->spi_only) && gyro_set((struct chip_setting){ PWR_MGMT_1, AWAKE }) &&
	       gyro_write_register(SIGNAL_PATH_RESET, chip->reset_paths);
}

static bool gyro_configure(const struct chip *chip)
{
	if (!gyro_set((struct chip_setting){ GYRO_CONFIG, chip->full_scale }) ||
	    !gyro_set((struct chip_setting){ ACCEL_CONFIG, chip->full_scale }))
		return false;
	for (size_t i = 0; i < sizeof chip_settings / sizeof chip_settings[0]; ++i)
		if (!gyro_set(chip_settings[i]))
			return false;
	return true;
}

/* Runs once: small rather than quick, unlike the transfers. */
__attribute__((cold)) bool gyro_start(struct gyro_found *found)
{
	gpio_output(BOARD_GYRO_CS, true);
	gpio_input(BOARD_GYRO_READY, GPIO_PULL_DOWN);
	/* The pull-up keeps the clock at its rest level while the SPI is off (RM0431 SPI, clock polarity). */
	gpio_alternate(BOARD_GYRO_SCK, AF_SPI1, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(BOARD_GYRO_MISO, AF_SPI1, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(BOARD_GYRO_MOSI, AF_SPI1, GPIO_FLOATING, GPIO_FAST);
	spi_configure(SPI_844K);

	time_delay_ms(START_MS); /* the chip's supply may have come with the processor's */
	watchdog_feed();         /* its half second may be a third, and resets follow */
	if (!gyro_write_register(PWR_MGMT_1, DEVICE_RESET))
		return false;
	time_delay_ms(RESET_MS);
	if (!gyro_read_register(WHO_AM_I, &found->identity))
		return false;
	const struct chip *const chip = gyro_find(found->identity);
	if (chip == NULL || !gyro_wake(chip))
		return false;
	time_delay_ms(RESET_MS); /* an ICM-20602's gyro takes 35 ms from sleep, and its kin no longer */
	if (!gyro_configure(chip))
		return false;
	gyro.chip = chip;
	found->alignment = chip->alignment;
	found->kind = chip->kind;
	return true;
}

void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz)
{
	HAL_ASSERT(NF_GYRO_EDGE_RATE_HZ % rate_hz == 0u); /* a 0 traps by itself */
	gyro.divider = NF_GYRO_EDGE_RATE_HZ / rate_hz;
	gyro.until_read = 1;
	gyro.reading = false;
	gyro.ended = time_cycles();
	gyro_request[0] = ACCEL_XOUT_H | READ;
	barrier();
	gyro.handlers = handlers; /* from here on the tick watches */
	if (gyro.chip == NULL)
		return;

	spi_configure(gyro.chip->speed);
	spi_dma_setup();
	interrupt_enable(IRQ_DMA2_STREAM2, PRIORITY_SAMPLE);

	SYSCFG_EXTICR1 = (SYSCFG_EXTICR1 & ~SYSCFG_EXTICR1_EXTI3) | FIELD(SYSCFG_EXTICR1_EXTI3, EXTI_PORT_C);
	EXTI_RTSR |= EXTI_RTSR_TR3;
	EXTI_PR = EXTI_PR_PR3;
	EXTI_IMR |= EXTI_IMR_IM3;
	interrupt_enable(IRQ_EXTI3, PRIORITY_GYRO_EDGE);
}

uint32_t gyro_samples(void)
{
	return gyro.samples;
}

void gyro_tick(void)
{
	if (gyro.handlers == NULL || ++gyro.silent_ms < NF_GYRO_BAD_MS)
		return;
	gyro.silent_ms = 0;
	gyro.taken = gyro.due; /* the silence counts for the reads that failed in it */
	gyro.handlers->gyro_silent(gyro.handlers->context);
}

static void gyro_end_transfer(void)
{
	(void)spi_finish(); /* a stream that is still stuck makes the next spi_start refuse, and samples stop */
	gpio_write(BOARD_GYRO_CS, true);
	gyro.reading = false;
}

static void gyro_start_transfer(void)
{
	gyro.reading = true;
	gyro.read = gyro.due;
	gpio_write(BOARD_GYRO_CS, false);
	if (!spi_start(gyro_request, gyro_response, TRANSFER_BYTES))
		gyro_end_transfer();
}

/* Samples come only from the chip. If edges or transfers stop, the tick reports silence; if the tick stops too, motor
 * frames end, and the ESCs stop their motors. */
void gyro_edge_handler(void)
{
	EXTI_PR = EXTI_PR_PR3;
	barrier(); /* cleared before the handler can return, or it would run twice */
	if (--gyro.until_read != 0u)
		return;
	gyro.until_read = gyro.divider;
	++gyro.due;
	if (gyro.reading && dma_complete(DMA_GYRO_RX))
		return; /* read but not yet taken: the control path is late, and this sample is lost */
	if (gyro.reading)
		gyro_end_transfer(); /* a read takes 9 or 18 us: this one is stuck */
	gyro_start_transfer();
}

static int16_t gyro_big_endian(const volatile uint8_t *bytes)
{
	return (int16_t)(uint16_t)(bytes[0] << 8 | bytes[1]);
}

/* Has what runs below had its share up to now? */
static bool gyro_share(uint32_t now)
{
	const uint32_t had = now - gyro.ended;

	gyro.owed -= had < gyro.owed ? had : gyro.owed;
	gyro.ended = now;
	return gyro.owed <= OWED_MAX;
}

void gyro_sample_handler(void)
{
	struct imu_sample sample;
	const uint32_t begun = time_cycles();

	/* The edge handler may not come between: it would take the half-ended transfer for a stuck one. */
	interrupts_disable();
	if (!gyro_share(begun)) {
		gyro_end_transfer();
		interrupts_enable();
		return;
	}
	sample.valid = dma_complete(DMA_GYRO_RX); /* or it ended in an error of the bus */
	const uint32_t lost = gyro.read - gyro.taken - 1u;

	gyro.taken = gyro.read;
	gyro_end_transfer();
	for (uint32_t axis = 0; axis < AXES; ++axis) {
		sample.accel[axis] = gyro_big_endian(gyro_response + ACCEL_OFFSET + 2u * axis);
		sample.gyro[axis] = gyro_big_endian(gyro_response + GYRO_OFFSET + 2u * axis);
	}
	sample.temperature = gyro_big_endian(gyro_response + TEMPERATURE_OFFSET);
	interrupts_enable();
	/* A read that was under way in a silence has been counted by it: then this is -1. */
	sample.lost = lost < NF_GYRO_EDGE_RATE_HZ ? (uint16_t)lost : 0u;
	gyro.silent_ms = 0;
	++gyro.samples;
	gyro.handlers->sample(gyro.handlers->context, &sample);
	gyro.ended = time_cycles();
	gyro.owed += (gyro.ended - begun) / CYCLES_A_CYCLE;
}
