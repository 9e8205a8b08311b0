/* Battery: cells, level, drawn charge and sag from the pack's voltage and current. Called from the background. */
#pragma once

#include "nf_contract.h"
#include "port/board_identity.h"

#define BATTERY_RATE_HZ NF_BATTERY_RATE_HZ /* of battery_step */

enum battery_level {
	BATTERY_UNKNOWN, /* not measured, or no pack: USB alone */
	BATTERY_GOOD,
	BATTERY_WARN,
	BATTERY_LOW,
};

struct battery {
	const struct nf_settings *settings;
	const struct board_identity *board; /* its scales where the settings have none */
	enum battery_level level; /* UNKNOWN also below 2.5 V a cell; it rises again 0.1 V a cell above its limit */
	unsigned cells;      /* of the pack; 0: not known yet */
	float volts;         /* of the pack, filtered; 0 until measured */
	float amps;          /* filtered */
	float rest_volts;    /* estimate of the voltage without load */
	uint32_t mah;        /* drawn since boot */
	uint32_t charge;     /* mA for 10 ms, drawn on top of that: less than 1 mAh */
	uint32_t watched;    /* steps with a pack whose cells are not known yet */
	uint32_t gone;       /* steps without a pack */
	bool measured;       /* volts hold a measurement */
};

/* Both must outlive the battery. */
void battery_init(struct battery *battery, const struct nf_settings *settings, const struct board_identity *board);

/* The scales of voltage and current: the settings', or where they are 0 the board's. */
float battery_volts_scale(const struct nf_settings *settings, const struct board_identity *board);
float battery_amps_scale(const struct nf_settings *settings, const struct board_identity *board);

/* A measurement, BATTERY_RATE_HZ times a second: millivolts at the pins of the divider and of the current sensor.
 * Not valid: the numbers are not read, and the level is unknown until one is.
 *
 * The number of cells is the setting, or the fewest that the voltage of the first half second allows; an empty pack
 * of many cells looks like a full one of fewer. Forgotten when the pack has been gone for two seconds. */
void battery_step(struct battery *battery, uint16_t volts_mv, uint16_t amps_mv, bool valid);
