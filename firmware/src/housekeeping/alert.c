#include "housekeeping/alert.h"

#define SLOT_MS 50u
#define FLASH_PAUSE 16u /* slots between two rounds of a fault's flashes */
#define BEEP_SLOTS 3u   /* a beep lasts as long as so many flashes: ears count more slowly */

/* Pattern of the count that tells why the aircraft does not arm: a buzz to recognise it by, then beeps. */
#define BUZZ_SLOTS 10u
#define LEAD_SLOTS 18u  /* the buzz and a pause */
#define COUNT_SLOTS 7u  /* from one beep to the next */
#define COUNT_PAUSE 24u /* slots between two rounds */

/* Pattern of a motor's number: long beeps. */
#define LONG_SLOTS 9u
#define LONG_STEP 14u   /* from one to the next */

/* '#' is on, '.' is off, each for SLOT_MS. */
struct rhythm {
	const char *slots; /* NULL: this condition leaves the output to the next one */
	uint8_t count;
	bool once;         /* then off; else over and over */
};

#define REPEATED(slots) { slots, sizeof slots - 1, false }
#define ONCE(slots) { slots, sizeof slots - 1, true }
#define NOTHING { 0, 0, false }

static const struct rhythm rhythms[ALERT_CONDITION_COUNT][ALERT_OUTPUT_COUNT] = {
	[ALERT_FAULT] = { NOTHING, REPEATED("#.") }, /* counted: see alert_flashing() */
	[ALERT_CRASHED] = { REPEATED("######....######........"), REPEATED("##..") },
	[ALERT_FIND_ME] = { REPEATED("#.#.#...#.#.#......."), REPEATED("#...") },
	[ALERT_NOT_ARMING] = { REPEATED("#."), REPEATED("#.") }, /* counted */
	[ALERT_RECEIVER_LOST] = { REPEATED("##..##.............."), REPEATED("##..##..............") },
	[ALERT_TOOK_OVER] = { REPEATED("##.##.##.##........."), REPEATED("##.") },
	[ALERT_BATTERY_LOW] = { REPEATED("########.."), REPEATED("########..") },
	[ALERT_MOTOR] = { REPEATED("#."), REPEATED("#.") }, /* counted */
	[ALERT_FAULT_TOLD] = { REPEATED("#."), NOTHING }, /* counted */
	[ALERT_POLICY_REFUSED] = { REPEATED("########..##..##...................."),
				   REPEATED("########..##..##........") },
	[ALERT_BATTERY_WARN] = { REPEATED("####................"), NOTHING },
	[ALERT_CALIBRATING] = { NOTHING, REPEATED("#.") },
	[ALERT_ARMED] = { ONCE("####"), REPEATED("#") },
	[ALERT_DISARMED] = { ONCE("#..#"), REPEATED("#...................") },
};

#define MUTED_IF_OFF(setting, condition) ((uint32_t)(settings->setting == 0) << (condition))

/* The pilot's own call cannot be muted. */
static uint32_t alert_muted(const struct nf_settings *settings)
{
	return MUTED_IF_OFF(beep_not_arming, ALERT_NOT_ARMING) | MUTED_IF_OFF(beep_crashed, ALERT_CRASHED) |
	       MUTED_IF_OFF(beep_receiver_lost, ALERT_RECEIVER_LOST) | MUTED_IF_OFF(beep_took_over, ALERT_TOOK_OVER) |
	       MUTED_IF_OFF(beep_battery_low, ALERT_BATTERY_LOW) | MUTED_IF_OFF(beep_motor, ALERT_MOTOR) |
	       MUTED_IF_OFF(beep_fault, ALERT_FAULT_TOLD) | MUTED_IF_OFF(beep_policy_refused, ALERT_POLICY_REFUSED) |
	       MUTED_IF_OFF(beep_battery_warn, ALERT_BATTERY_WARN) | MUTED_IF_OFF(beep_armed, ALERT_ARMED) |
	       MUTED_IF_OFF(beep_disarmed, ALERT_DISARMED);
}

void alert_init(struct alert *alert, const struct nf_settings *settings)
{
	*alert = (struct alert){
		.playing = { ALERT_CONDITION_COUNT, ALERT_CONDITION_COUNT },
		.muted = alert_muted(settings),
	};
}

/* The first condition that holds and has a rhythm for the output. */
static uint8_t alert_first(uint32_t conditions, enum alert_output output)
{
	uint8_t condition = 0;

	while (condition < ALERT_CONDITION_COUNT && !(conditions >> condition & 1u && rhythms[condition][output].slots))
		++condition;
	return condition;
}

static bool alert_flashing(unsigned flashes, uint32_t slot)
{
	const uint32_t round = 2u * (flashes > 0 ? flashes : 1u);
	const uint32_t place = slot % (round + FLASH_PAUSE);

	return place < round && place % 2u == 0;
}

static bool alert_counting(unsigned count, uint32_t slot)
{
	const uint32_t round = LEAD_SLOTS + COUNT_SLOTS * count;
	const uint32_t place = slot % (round + COUNT_PAUSE);

	if (place < BUZZ_SLOTS)
		return place % 2u == 0;
	return place >= LEAD_SLOTS && place < round && (place - LEAD_SLOTS) % COUNT_SLOTS < BEEP_SLOTS;
}

static bool alert_numbering(unsigned number, uint32_t slot)
{
	const uint32_t round = LONG_STEP * (number > 0 ? number : 1u);
	const uint32_t place = slot % (round + COUNT_PAUSE);

	return place < round && place % LONG_STEP < LONG_SLOTS;
}

unsigned alert_count(uint32_t reasons)
{
	static const uint8_t told[] = NF_ARMING_COUNTS;
	unsigned count = 0;

	_Static_assert(sizeof told == NF_ARMING_REASON_COUNT, "one for each reason");
	for (unsigned reason = 0; reason < NF_ARMING_REASON_COUNT; ++reason)
		if (reasons >> reason & 1u && told[reason] > count)
			count = told[reason];
	return count;
}

static bool alert_on(const struct rhythm *rhythm, uint32_t slot)
{
	if (rhythm->once && slot >= rhythm->count)
		return false;
	return rhythm->slots[slot % rhythm->count] == '#';
}

static bool alert_play(struct alert *alert, enum alert_output output, uint32_t conditions,
		       const struct alert_counts *counts, uint32_t ms)
{
	const uint8_t condition = alert_first(conditions, output);

	if (condition != alert->playing[output] ||
	    (condition == ALERT_NOT_ARMING && counts->not_arming != alert->counted)) {
		alert->playing[output] = condition;
		alert->since_ms[output] = ms;
	}
	const uint32_t slot = (ms - alert->since_ms[output]) / SLOT_MS;
	if (condition == ALERT_CONDITION_COUNT)
		return false;
	if (condition == ALERT_FAULT)
		return alert_flashing(counts->fault, slot);
	if (condition == ALERT_FAULT_TOLD)
		return alert_flashing(counts->fault, slot / BEEP_SLOTS);
	if (condition == ALERT_NOT_ARMING)
		return alert_counting(counts->not_arming, slot);
	if (condition == ALERT_MOTOR)
		return alert_numbering(counts->motor, slot);
	return alert_on(&rhythms[condition][output], slot);
}

struct alert_state alert_step(struct alert *alert, uint32_t conditions, const struct alert_counts *counts, uint32_t ms)
{
	const struct alert_state state = {
		.beeper = alert_play(alert, ALERT_BEEPER, conditions & ~alert->muted, counts, ms),
		.led = alert_play(alert, ALERT_LED, conditions, counts, ms),
	};

	alert->counted = counts->not_arming;
	return state;
}
