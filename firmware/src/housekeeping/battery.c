#include "housekeeping/battery.h"

#include "common/limit.h"

#define PERIOD (1.0f / (float)BATTERY_RATE_HZ) /* s */
#define VOLTS_PER_MV 0.001f
#define MILLI 1000.0f

/* Gains of first-order low-passes; period / (period + time constant). */
#define FILTER (PERIOD / (PERIOD + NF_BATTERY_FILTER_S))
#define REST (PERIOD / (PERIOD + 30.0f)) /* 30 s: slower than a manoeuvre, faster than the pack's discharge */

#define CELL_FULL_V 4.35f /* and a hair: a charged LiHV cell */
#define CELL_EMPTY_V 2.5f /* below this there is no pack */
#define HYSTERESIS_V 0.1f /* a cell */
#define CELLS_MAX 6u
#define WATCH_STEPS (BATTERY_RATE_HZ / 2)
#define GONE_STEPS (2 * BATTERY_RATE_HZ)
#define AMPS_MAX 1000.0f
#define CHARGE_PER_MAH (3600u * BATTERY_RATE_HZ)

void battery_init(struct battery *battery, const struct nf_settings *settings, const struct board_identity *board)
{
	*battery = (struct battery){ .settings = settings, .board = board, .level = BATTERY_UNKNOWN };
}

float battery_volts_scale(const struct nf_settings *settings, const struct board_identity *board)
{
	return settings->battery_scale > 0.0f ? settings->battery_scale : board->volts_scale;
}

float battery_amps_scale(const struct nf_settings *settings, const struct board_identity *board)
{
	return settings->current_scale > 0.0f ? settings->current_scale : board->amps_scale;
}

static void battery_measure(struct battery *battery, float volts, float amps)
{
	if (!battery->measured) {
		battery->measured = true;
		battery->volts = volts;
		battery->amps = amps;
		battery->rest_volts = volts;
	}
	battery->volts += FILTER * (volts - battery->volts);
	battery->amps += FILTER * (amps - battery->amps);
	battery->rest_volts += REST * (battery->volts - battery->rest_volts);
	if (battery->volts > battery->rest_volts)
		battery->rest_volts = battery->volts;
}

/* The fewest cells that are not overcharged by this voltage. */
static unsigned battery_count_cells(float volts)
{
	unsigned cells = 1;

	while (cells < CELLS_MAX && volts > CELL_FULL_V * (float)cells)
		++cells;
	return cells;
}

/* Is a pack connected, and its number of cells known? */
static bool battery_known(struct battery *battery)
{
	const unsigned cells = battery->cells > 0 ? battery->cells : battery_count_cells(battery->volts);

	if (battery->volts < CELL_EMPTY_V * (float)cells) {
		battery->watched = 0;
		battery->measured = false; /* a pack that is plugged in is seen at once */
		if (battery->gone < GONE_STEPS)
			++battery->gone;
		else
			battery->cells = battery->settings->battery_cells;
		return false;
	}
	battery->gone = 0;
	if (battery->cells > 0)
		return true;
	if (battery->watched < WATCH_STEPS) {
		++battery->watched;
		return false;
	}
	battery->cells = cells;
	return true;
}

/* The level of a cell's voltage; a better level needs a margin (hysteresis). */
static enum battery_level battery_update_level(const struct battery *battery)
{
	const struct nf_settings *settings = battery->settings;
	const float cell = battery->volts / (float)battery->cells;
	const float low = settings->battery_low_v + (battery->level >= BATTERY_LOW ? HYSTERESIS_V : 0.0f);
	const float warn = settings->battery_warn_v + (battery->level >= BATTERY_WARN ? HYSTERESIS_V : 0.0f);

	if (cell < low)
		return BATTERY_LOW;
	if (cell < warn)
		return BATTERY_WARN;
	return BATTERY_GOOD;
}

void battery_step(struct battery *battery, uint16_t volts_mv, uint16_t amps_mv, bool valid)
{
	const struct nf_settings *settings = battery->settings;

	if (!valid) {
		battery->level = BATTERY_UNKNOWN;
		return;
	}
	const float amps = limit((float)amps_mv / battery_amps_scale(settings, battery->board), 0.0f, AMPS_MAX);
	battery_measure(battery, (float)volts_mv * VOLTS_PER_MV * battery_volts_scale(settings, battery->board), amps);
	battery->charge += (uint32_t)(amps * MILLI + 0.5f);
	battery->mah += battery->charge / CHARGE_PER_MAH;
	battery->charge %= CHARGE_PER_MAH;
	if (battery->cells == 0)
		battery->cells = settings->battery_cells;
	battery->level = battery_known(battery) ? battery_update_level(battery) : BATTERY_UNKNOWN;
}
