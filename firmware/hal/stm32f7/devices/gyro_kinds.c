#include "hal/stm32f7/devices/gyro_kinds.h"

#include <string.h>

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/time.h"

#define READ 0x80u
#define SETTLE_MS 100u /* after a reset, and until a gyro that was switched on measures: the longest of all chips */

/* A register's value. Written and read back unless flags say otherwise. */
struct step {
	uint8_t address;
	uint8_t value;
	uint8_t flags;
};
#define UNREAD 1u /* it clears itself, or its reserved bits need not be told */
#define SETTLES 2u /* SETTLE_MS pass before the next */
#define RESETS (UNREAD | SETTLES)
#define WAITS 4u /* so do WAIT_MS */
#define WAIT_MS 25u
#define LOADS 8u /* instead of the value the maker's configuration is written there */
#define ASKS 16u /* it is not written: its lower half has to be the value */

/* --- InvenSense, first family -------------------------------------------------------------------------------
 * MPU-6500 register map and descriptions (RM-MPU-6500A-00), section 4; the ICM-20689 (DS-000143) has the same
 * registers there. MPU-6000 (RM-MPU-6000A-00), ICM-20602 (DS-000176), ICM-20608-G and MPU-9250 as PX4's register headers
 * tell of their data sheets, ICM-20601 as I2Cdev's of DS-000191: docs/guides/board-bring-up.md says what of it only
 * hardware can prove. */
enum mpu_register {
	MPU_SMPLRT_DIV = 0x19,
	MPU_CONFIG = 0x1A,
	MPU_GYRO_CONFIG = 0x1B,
	MPU_ACCEL_CONFIG = 0x1C,
	MPU_ACCEL_CONFIG2 = 0x1D, /* not the MPU-6000's, whose accelerometer goes through the gyro's filter */
	MPU_INT_PIN_CFG = 0x37,
	MPU_INT_ENABLE = 0x38,
	MPU_INT_STATUS = 0x3A, /* a read clears it */
	MPU_ACCEL_XOUT_H = 0x3B,
	MPU_SIGNAL_PATH_RESET = 0x68,
	MPU_USER_CTRL = 0x6A,
	MPU_PWR_MGMT_1 = 0x6B,
	MPU_PWR_MGMT_2 = 0x6C,
	MPU_I2C_IF = 0x70, /* the ICM-20602's alone */
	MPU_WHO_AM_I = 0x75,
};

/* First the bus, so that no level on its lines makes the chip take it for I2C; then awake with the clock of the gyro's
 * PLL (CLKSEL 1, which all of them ask for), as signal paths of a chip that sleeps need not be there to be reset.
 * full_scale: of gyro and accelerometer, FCHOICE_B 0. DLPF_CFG 0: 8 kHz, bandwidth 250 Hz; an ICM-20602 starts with
 * 0x80. The interrupt: active high, push-pull, 50 us pulse, for data ready. */
// clang-format off
#define MPU_STEPS(i2c_register, i2c_off, paths, full_scale)                                                     \
	{ MPU_PWR_MGMT_1, 0x80, RESETS }, { i2c_register, i2c_off, 0 }, { MPU_PWR_MGMT_1, 0x01, 0 },            \
	{ MPU_SIGNAL_PATH_RESET, paths, RESETS }, { MPU_GYRO_CONFIG, full_scale, 0 },                           \
	{ MPU_ACCEL_CONFIG, full_scale, 0 }, { MPU_PWR_MGMT_2, 0x00, 0 }, { MPU_SMPLRT_DIV, 0x00, 0 },          \
	{ MPU_CONFIG, 0x00, 0 }, { MPU_INT_PIN_CFG, 0x00, 0 }, { MPU_INT_ENABLE, 0x01, 0 }
// clang-format on
/* The accelerometer at 1 kHz, bandwidth about 95 Hz: attitude needs gravity, not vibration. */
#define MPU_CALM { MPU_ACCEL_CONFIG2, 0x02, 0 }
#define SCALE_3 0x18u /* +-2000 deg/s, +-16 g */
#define SCALE_2 0x10u /* the same of the ICM-20601, whose ranges are twice as wide */

static const struct step mpu6500[] = { MPU_STEPS(MPU_USER_CTRL, 0x10, 0x07, SCALE_3), MPU_CALM };
static const struct step mpu6000[] = { MPU_STEPS(MPU_USER_CTRL, 0x10, 0x07, SCALE_3) };
static const struct step icm20602[] = { MPU_STEPS(MPU_I2C_IF, 0x40, 0x03, SCALE_3), MPU_CALM };
static const struct step icm20689[] = { MPU_STEPS(MPU_USER_CTRL, 0x10, 0x03, SCALE_3), MPU_CALM };
static const struct step icm20601[] = { MPU_STEPS(MPU_USER_CTRL, 0x10, 0x03, SCALE_2), MPU_CALM };
static const struct gyro_layout mpu_layouts[] = {
	{ MPU_ACCEL_XOUT_H | READ, 15, 7, 1, 9, 0, false, 0, 0 },
	{ MPU_INT_STATUS | READ, 16, 8, 2, 10, 0, false, 1, 0x01 },
};

/* --- InvenSense, second family ------------------------------------------------------------------------------
 * ICM-42688-P (DS-000347) as the register headers of PX4 and Zephyr tell of it, and ICM-42605 (DS-000292), whose map is
 * the same and whose filters' numbers mean a quarter. What is not a rate, a range or a mode may only be written while
 * both sensors are off. */
enum icm_register {
	ICM_GYRO_STATIC3 = 0x0C, /* bank 1: DELT, the lower bits of DELTSQR, its upper bits and BITSHIFT */
	ICM_GYRO_STATIC4 = 0x0D,
	ICM_GYRO_STATIC5 = 0x0E,
	ICM_ACCEL_STATIC2 = 0x03, /* bank 2, likewise; DELT from bit 1 on */
	ICM_ACCEL_STATIC3 = 0x04,
	ICM_ACCEL_STATIC4 = 0x05,
	ICM_DEVICE_CONFIG = 0x11,
	ICM_INT_CONFIG = 0x14,
	ICM_TEMP_DATA1 = 0x1D, /* then accelerometer and gyro */
	ICM_INTF_CONFIG0 = 0x4C,
	ICM_INTF_CONFIG1 = 0x4D,
	ICM_PWR_MGMT0 = 0x4E,
	ICM_GYRO_CONFIG0 = 0x4F,
	ICM_ACCEL_CONFIG0 = 0x50,
	ICM_GYRO_ACCEL_CONFIG0 = 0x52,
	ICM_INT_CONFIG1 = 0x64,
	ICM_INT_SOURCE0 = 0x65,
	ICM_REG_BANK_SEL = 0x76,
};
#define ICM_BANK_LAST 4u

/* Reset by DEVICE_CONFIG. INTF_CONFIG0: no I2C, values the upper byte first. INTF_CONFIG1: bits 7:6 at 01 keep the gyro
 * from pausing while it changes its range by itself, as its data sheet does not tell, but ArduPilot's and Betaflight's
 * pilots found. Anti-alias filters by number of their row, then the UI filters at their lowest latency, so that the
 * former decide. INT1: a pulse of 8 us with no dead time behind it, as 4 kHz and more ask for, active high, push-pull,
 * INT_ASYNC_RESET 0, as the data sheet asks; for data ready alone. +-2000 deg/s at 8 kHz, +-16 g at 1 kHz, both sensors
 * with low noise. */
// clang-format off
#define ICM_FILTER(first, shift, delt, square, bits)                                                            \
	{ first, (delt) << (shift), 0 }, { (first) + 1, (square) & 0xFF, 0 },                                   \
	{ (first) + 2, (bits) << 4 | (square) >> 8, 0 }
#define ICM_STEPS(gyro_delt, gyro_square, gyro_bits, accel_delt, accel_square, accel_bits)                      \
	{ ICM_REG_BANK_SEL, 0, 0 }, { ICM_DEVICE_CONFIG, 0x01, RESETS }, { ICM_INTF_CONFIG0, 0x33, 0 },         \
	{ ICM_INTF_CONFIG1, 0x51, UNREAD },                                                                     \
	{ ICM_REG_BANK_SEL, 1, 0 }, ICM_FILTER(ICM_GYRO_STATIC3, 0, gyro_delt, gyro_square, gyro_bits),         \
	{ ICM_REG_BANK_SEL, 2, 0 }, ICM_FILTER(ICM_ACCEL_STATIC2, 1, accel_delt, accel_square, accel_bits),     \
	{ ICM_REG_BANK_SEL, 0, 0 }, { ICM_GYRO_ACCEL_CONFIG0, 0xFF, 0 }, { ICM_INT_CONFIG, 0x03, 0 },           \
	{ ICM_INT_CONFIG1, 0x60, 0 }, { ICM_INT_SOURCE0, 0x08, 0 },                                             \
	{ ICM_GYRO_CONFIG0, 0x03, 0 }, { ICM_ACCEL_CONFIG0, 0x06, 0 }, { ICM_PWR_MGMT0, 0x0F, SETTLES }
// clang-format on

static const struct step icm42688p[] = { ICM_STEPS(6, 36, 10, 3, 9, 12) };   /* 258 Hz, 126 Hz */
static const struct step icm42605[] = { ICM_STEPS(21, 440, 6, 11, 122, 8) }; /* 249 Hz, 122 Hz */
static const struct gyro_layout icm_layouts[] = {
	{ ICM_TEMP_DATA1 | READ, 15, 1, 3, 9, 0, false, 0, 0 },
	{ ICM_TEMP_DATA1 | READ, 18, 1, 3, 9, 0, false, 17, 0x08 }, /* up to INT_STATUS, which a read clears */
};

/* --- ST -----------------------------------------------------------------------------------------------------
 * LSM6DSV16X as ST's driver tells of it, and LSM6DSK320X, whose registers are taken for the same here. */
enum lsm_register {
	LSM_IF_CFG = 0x03,
	LSM_INT1_CTRL = 0x0D,
	LSM_WHO_AM_I = 0x0F,
	LSM_CTRL1 = 0x10, /* of the accelerometer: mode and rate */
	LSM_CTRL2 = 0x11, /* of the gyro, likewise */
	LSM_CTRL3 = 0x12,
	LSM_CTRL4 = 0x13,
	LSM_CTRL6 = 0x15,
	LSM_CTRL7 = 0x16,
	LSM_CTRL8 = 0x17,
	LSM_CTRL9 = 0x18,
	LSM_STATUS = 0x1E,
	LSM_OUT_TEMP_L = 0x20, /* then gyro and accelerometer */
	LSM_HAODR_CFG = 0x62,
};
static const struct step lsm6dsv[] = {
	{ LSM_CTRL1, 0x00, 0 }, /* off, before a reset and before HAODR_CFG */
	{ LSM_CTRL2, 0x00, 0 },       { LSM_CTRL3, 0x01, RESETS },
	{ LSM_CTRL3, 0x44, 0 },     /* a value's bytes of one sample, addresses count up */
	{ LSM_IF_CFG, 0x01, 0 },    /* neither I2C nor I3C; INT1 active high, push-pull */
	{ LSM_HAODR_CFG, 0x01, 0 }, /* rates of high accuracy are 1000 Hz times powers of 2 */
	{ LSM_CTRL6, 0x04, 0 },     /* +-2000 deg/s, LPF1 of 288 Hz */
	{ LSM_CTRL7, 0x01, 0 },     /* with LPF1 */
	{ LSM_CTRL8, 0x23, 0 },     /* +-16 g, LPF2 of a tenth of the rate */
	{ LSM_CTRL9, 0x08, 0 },     /* with LPF2 */
	{ LSM_CTRL4, 0x02, 0 },     /* data ready is a pulse of 65 us */
	{ LSM_INT1_CTRL, 0x02, 0 }, /* the gyro's */
	{ LSM_CTRL1, 0x19, 0 },     /* high accuracy, 1 kHz */
	{ LSM_CTRL2, 0x1C, SETTLES }, /* high accuracy, 8 kHz */
};
static const struct gyro_layout lsm_layouts[] = {
	{ LSM_OUT_TEMP_L | READ, 15, 1, 9, 3, 1, true, 0, 0 },
	{ LSM_STATUS | READ, 17, 3, 11, 5, 1, true, 1, 0x02 }, /* which a read of the gyro clears */
};

/* --- Bosch --------------------------------------------------------------------------------------------------
 * BMI270 as Bosch's BMI270_SensorAPI tells of it (registers, the order of the load, 450 us behind power save, 20 ms until
 * INTERNAL_STATUS, STATUS as the word that data are new), and Betaflight, whose pilots fly it so (the short configuration,
 * the filter). It comes out of a reset listening to I2C, until a transaction on SPI has ended. Its gyro has 3200 Hz at most,
 * which no control rate divides: it is read at a timer's beat. */
enum bmi_register {
	BMI_CHIP_ID = 0x00,
	BMI_STATUS = 0x03, /* then, among others, accelerometer, gyro and temperature */
	BMI_INTERNAL_STATUS = 0x21,
	BMI_ACC_CONF = 0x40,
	BMI_ACC_RANGE = 0x41,
	BMI_GYR_CONF = 0x42,
	BMI_GYR_RANGE = 0x43,
	BMI_INIT_CTRL = 0x59,
	BMI_INIT_DATA = 0x5E,
	BMI_PWR_CONF = 0x7C,
	BMI_PWR_CTRL = 0x7D,
	BMI_CMD = 0x7E,
};
static const struct step bmi270[] = {
	{ BMI_CMD, 0xB6, UNREAD | WAITS }, /* a reset */
	{ BMI_CHIP_ID, 0x00, UNREAD }, /* which cannot be written: a transaction, so that it listens to SPI */
	{ BMI_PWR_CONF, 0x00, UNREAD | WAITS }, /* no power save */
	{ BMI_INIT_CTRL, 0x00, 0 },
	{ BMI_INIT_DATA, 0x00, LOADS },
	{ BMI_INIT_CTRL, 0x01, UNREAD | WAITS },
	{ BMI_INTERNAL_STATUS, 0x01, ASKS }, /* it runs what was loaded */
	{ BMI_ACC_CONF, 0x8B, 0 }, /* 800 Hz, the strongest low-pass */
	{ BMI_ACC_RANGE, 0x03, 0 }, /* +-16 g */
	{ BMI_GYR_CONF, 0xCD, 0 }, /* 3200 Hz, low noise, the strongest low-pass */
	{ BMI_GYR_RANGE, 0x00, 0 }, /* +-2000 deg/s */
	{ BMI_PWR_CTRL, 0x0E, SETTLES }, /* gyro, accelerometer, temperature */
};
/* A dummy byte comes first. */
static const struct gyro_layout bmi_layouts[] = {
	{ BMI_STATUS | READ, 35, 33, 11, 17, 1, false, 2, 0x40 },
	{ BMI_STATUS | READ, 35, 33, 11, 17, 1, false, 2, 0x40 },
};

/* --- All of them -------------------------------------------------------------------------------------------- */

#define STEPS_OF(list) list, sizeof list / sizeof list[0]

static const struct kind {
	uint8_t told_at; /* the register of NF_GYRO_IDENTITIES */
	enum spi_speed speed;
	const struct gyro_layout *layouts; /* of reads at edges, and timed ones */
	const struct step *steps;
	size_t count;
} kinds[] = {
	/* 20 MHz at most */
	[GYRO_MPU6500] = { MPU_WHO_AM_I, SPI_13M5, mpu_layouts, STEPS_OF(mpu6500) },
	[GYRO_MPU6000] = { MPU_WHO_AM_I, SPI_13M5, mpu_layouts, STEPS_OF(mpu6000) },
	/* likewise by its data sheet, but PX4 keeps to 10 */
	[GYRO_MPU9250] = { MPU_WHO_AM_I, SPI_6M75, mpu_layouts, STEPS_OF(mpu6500) },
	/* 10 MHz */
	[GYRO_ICM20602] = { MPU_WHO_AM_I, SPI_6M75, mpu_layouts, STEPS_OF(icm20602) },
	/* 8 MHz */
	[GYRO_ICM20689] = { MPU_WHO_AM_I, SPI_6M75, mpu_layouts, STEPS_OF(icm20689) },
	[GYRO_ICM20601] = { MPU_WHO_AM_I, SPI_6M75, mpu_layouts, STEPS_OF(icm20601) },
	[GYRO_ICM20608G] = { MPU_WHO_AM_I, SPI_6M75, mpu_layouts, STEPS_OF(icm20689) },
	/* 24 MHz */
	[GYRO_ICM42688P] = { MPU_WHO_AM_I, SPI_13M5, icm_layouts, STEPS_OF(icm42688p) },
	[GYRO_ICM42605] = { MPU_WHO_AM_I, SPI_13M5, icm_layouts, STEPS_OF(icm42605) },
	/* 10 MHz */
	[GYRO_LSM6DSV16X] = { LSM_WHO_AM_I, SPI_6M75, lsm_layouts, STEPS_OF(lsm6dsv) },
	[GYRO_LSM6DSK320X] = { LSM_WHO_AM_I, SPI_6M75, lsm_layouts, STEPS_OF(lsm6dsv) },
	[GYRO_BMI270] = { BMI_CHIP_ID, SPI_6M75, bmi_layouts, STEPS_OF(bmi270) },
};
_Static_assert(sizeof kinds / sizeof kinds[0] == NF_GYRO_IDENTITIES_COUNT, "a kind for each chip");

static bool kinds_write(gyro_exchange *exchange, uint8_t address, uint8_t value)
{
	uint8_t bytes[2] = { address, value };

	return exchange(bytes, sizeof bytes);
}

/* dummies: bytes before the value. */
static bool kinds_read(gyro_exchange *exchange, uint8_t address, size_t dummies, uint8_t *value)
{
	uint8_t bytes[3] = { (uint8_t)(address | READ), 0, 0 };
	const size_t count = 2u + dummies;
	const bool moved = exchange(bytes, count);

	*value = bytes[count - 1u];
	return moved;
}

/* Which of those that tell themselves there says `identity`? */
static bool kinds_find(uint8_t told_at, uint8_t identity, enum gyro_chip *chip)
{
	static const uint8_t identities[NF_GYRO_IDENTITIES_COUNT] = NF_GYRO_IDENTITIES;

	for (size_t i = 0; i < NF_GYRO_IDENTITIES_COUNT; ++i)
		if (kinds[i].told_at == told_at && identities[i] == identity) {
			*chip = (enum gyro_chip)i;
			return true;
		}
	return false;
}

/* The first family's register comes first: at ST's place it has a value that its factory gave it. Last the second family's
 * register bank, which a reset of the processor may have left at another: asked for first, so that no chip that is not
 * known is written to. */
__attribute__((cold)) bool gyro_identify(gyro_exchange *exchange, uint8_t *identity, enum gyro_chip *chip)
{
	static const uint8_t places[] = { MPU_WHO_AM_I, LSM_WHO_AM_I, BMI_CHIP_ID };
	uint8_t told;

	if (!kinds_read(exchange, MPU_WHO_AM_I, 0, identity))
		return false;
	for (size_t i = 0; i < sizeof places; ++i)
		if (kinds_read(exchange, places[i], places[i] == BMI_CHIP_ID, &told) &&
		    kinds_find(places[i], told, chip)) {
			*identity = told;
			return true;
		}
	if (!kinds_read(exchange, ICM_REG_BANK_SEL, 0, &told) || told < 1u || told > ICM_BANK_LAST ||
	    !kinds_write(exchange, ICM_REG_BANK_SEL, 0) || !kinds_read(exchange, MPU_WHO_AM_I, 0, &told) ||
	    !kinds_find(MPU_WHO_AM_I, told, chip))
		return false;
	*identity = told;
	return true;
}

/* In one transaction, as the chip counts the bytes from INIT_CTRL on. */
static __attribute__((noinline)) bool kinds_load(gyro_exchange *exchange, uint8_t address)
{
	uint8_t bytes[1u + NF_GYRO_FILE_BYTES] = { address };

	memcpy(bytes + 1, gyro_file, NF_GYRO_FILE_BYTES);
	return gyro_file[0] != 0u && exchange(bytes, sizeof bytes);
}

static bool kinds_step(gyro_exchange *exchange, const struct step *step, size_t dummies)
{
	uint8_t kept = step->value;

	if ((step->flags & LOADS) != 0u)
		return kinds_load(exchange, step->address);
	if ((step->flags & ASKS) == 0u && !kinds_write(exchange, step->address, step->value))
		return false;
	if ((step->flags & UNREAD) == 0u && !kinds_read(exchange, step->address, dummies, &kept))
		return false;
	if ((step->flags & ASKS) != 0u)
		kept &= 0x0Fu;
	if ((step->flags & (SETTLES | WAITS)) != 0u)
		time_delay_ms((step->flags & SETTLES) != 0u ? SETTLE_MS : WAIT_MS);
	return kept == step->value;
}

__attribute__((cold)) bool gyro_set_up(gyro_exchange *exchange, enum gyro_chip chip)
{
	const struct kind *const kind = &kinds[chip];
	bool right = true;

	for (size_t i = 0; i < kind->count && right; ++i)
		right = kinds_step(exchange, &kind->steps[i], chip == GYRO_BMI270);
	return right;
}

const struct gyro_layout *gyro_layout(enum gyro_chip chip, bool timed)
{
	return &kinds[chip].layouts[timed];
}

enum spi_speed gyro_speed(enum gyro_chip chip)
{
	return kinds[chip].speed;
}
