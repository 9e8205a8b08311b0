/* The gyro chips that this firmware knows: how each tells itself, how it is set up, and where a sample lies in it. The bus
 * is gyro_chip.c's. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hal/stm32f7/peripherals/spi.h"
#include "nf_contract.h"

#define GYRO_TRANSFER_BYTES \
	35u /* at most: an address, then accelerometer, temperature and gyro in some order, two bytes each,
				 * and in front of or behind them what says whether they are new */
#define GYRO_START_MS 100u /* that every chip is up after, from the supply's rise on */

/* What the maker of a BMI270 has it run, if the build was given that; else zeros. */
extern const uint8_t gyro_file[NF_GYRO_FILE_BYTES];

/* Exchanges bytes with the chip in one transaction, in place, at 1 MHz at most. False: the bus did not answer. */
typedef bool gyro_exchange(uint8_t *bytes, size_t count);

/* Where in a transfer the words of a sample lie, in bytes. */
struct gyro_layout {
	uint8_t request; /* the transfer's first byte: the address to read from */
	uint8_t bytes; /* of the transfer */
	uint8_t temperature, accel, gyro;
	uint8_t upper; /* of a word's two bytes the upper one: 0 or 1 */
	bool coarse; /* 70 mdeg/s a count instead of 2000 / 32768 deg/s */
	uint8_t status; /* where the register lies that says whether the gyro has measured since the last transfer, */
	uint8_t fresh; /* and its bit; 0: not asked for */
};

/* What answers. False: a chip that is not known, or none; *identity is what it said, 0xFF where none answers. Looked for
 * one after the other, as identities are not unique: a chip's register is read only if it is none of those before. */
bool gyro_identify(gyro_exchange *exchange, uint8_t *identity, enum gyro_chip *chip);

/* Resets the chip and sets it up to sample at NF_GYRO_EDGE_RATE_HZ (a BMI270 at 3200 Hz), +-2000 deg/s and +-16 g (0.2 s at
 * most). False: it does not keep what is written to it, or lacks its maker's configuration. */
bool gyro_set_up(gyro_exchange *exchange, enum gyro_chip chip);

/* timed: of reads that do not follow the data-ready line. One that asks for `fresh` is read so in any case. */
const struct gyro_layout *gyro_layout(enum gyro_chip chip, bool timed);

/* Of reading samples. */
enum spi_speed gyro_speed(enum gyro_chip chip);
