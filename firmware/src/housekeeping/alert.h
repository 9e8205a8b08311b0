/* Alert: rhythms of beeper and LED for the most urgent condition. */
#pragma once

#include "nf_contract.h"

/* Conditions, the most urgent first. On each output the first that holds and has a rhythm for it plays. */
enum alert_condition {
	ALERT_FAULT,         /* something is broken: the LED flashes as often as its number says */
	ALERT_CRASHED,
	ALERT_FIND_ME,       /* the pilot's beeper switch */
	ALERT_NOT_ARMING,    /* the arm switch is on and a reason holds: its count (NF_ARMING_COUNTS) */
	ALERT_RECEIVER_LOST, /* after it was heard */
	ALERT_TOOK_OVER,     /* the PID, a moment ago and in flight */
	ALERT_BATTERY_LOW,
	ALERT_MOTOR,         /* a motor is weak, or its ESC silent: its number in long beeps and flashes */
	ALERT_FAULT_TOLD,    /* what forbids arming for good: the beeper beeps as often as the LED flashes */
	ALERT_POLICY_REFUSED,/* it fell back in flight, and nobody acknowledged that */
	ALERT_BATTERY_WARN,
	ALERT_CALIBRATING,
	ALERT_ARMED,
	ALERT_DISARMED,
	ALERT_CONDITION_COUNT,
};

enum alert_output {
	ALERT_BEEPER,
	ALERT_LED,
	ALERT_OUTPUT_COUNT,
};

struct alert {
	uint8_t playing[ALERT_OUTPUT_COUNT]; /* enum alert_condition, ALERT_CONDITION_COUNT: silence */
	uint32_t since_ms[ALERT_OUTPUT_COUNT];
	unsigned counted;                    /* by ALERT_NOT_ARMING, when last looked at */
	uint32_t muted; /* bit field of enum alert_condition: those that the beeper does not tell */
};

struct alert_state {
	bool beeper, led;
};

/* Conditions whose setting beep_... is off are not for the beeper: it plays the next one that holds. */
void alert_init(struct alert *alert, const struct nf_settings *settings);

/* Numbers that beeper and LED count out. */
struct alert_counts {
	unsigned fault;      /* 0 counts as 1 */
	unsigned not_arming;
	unsigned motor;      /* 0 counts as 1 */
};

/* The count of the most urgent of these reasons, a bit field of enum nf_arming_reason; 0: none is counted. */
unsigned alert_count(uint32_t reasons);

/* Beeper and LED at `ms` since any moment, wrapping. conditions: bit field of enum alert_condition. A rhythm begins when its
 * condition is the first to play, and the count of ALERT_NOT_ARMING anew when it changes. */
struct alert_state alert_step(struct alert *alert, uint32_t conditions, const struct alert_counts *counts, uint32_t ms);
