/* Rotor speeds that the motors' ESCs tell over the motor wires: from the words of their answers, one a motor and control
 * step, to rad/s. Words: toolchain/contract/motors.py.
 *
 * A wire has noise, and a checksum of four bits lets some of it pass. So a word counts only if physics allows its speed
 * after the last one that counted: the bound grows with the time since then. After a silence, and where the speed jumps by
 * more than rotors do in flight, it counts once the next word agrees. */
#pragma once

#include "nf_contract.h"
#include "policy.h"

#define ROTORS_TOLD (NF_ESC_STATE + 1) /* kinds of extended telemetry */

struct rotors {
	bool on; /* the setting motor_telemetry */
	uint8_t silent; /* bit field: motors whose speed is not known */
	uint8_t hold; /* control steps that a speed holds without a word */
	float turn; /* rad/s times the period of an electrical turn in us */
	float room, usual; /* rad/s, changes in a control step: the largest, and the largest that counts at once */
	uint16_t words[NF_MOTOR_COUNT_MAX]; /* as given to the last control step, by output */
	float speed[POLICY_ACTION_COUNT]; /* rad/s, of the last good word */
	float jumped[POLICY_ACTION_COUNT]; /* rad/s, of the last word, where it jumped; else less than 0 */
	uint8_t age[POLICY_ACTION_COUNT]; /* control steps since the last good word, up to 255 */
	uint16_t left; /* control steps of the second that is counted */
	uint16_t bad[POLICY_ACTION_COUNT]; /* words of it that were none or not good */
	uint16_t errors[POLICY_ACTION_COUNT]; /* of the second before, 0.01 % */
	uint8_t known[POLICY_ACTION_COUNT]; /* bit field of enum nf_esc_told: what has come since it was silent, of */
	uint8_t told[POLICY_ACTION_COUNT][ROTORS_TOLD]; /* extended telemetry, as it came last */
};

void rotors_init(struct rotors *rotors, const struct nf_settings *settings, unsigned control_rate_hz);

/* A control step begins with these words, by output. outputs: of each motor. */
void rotors_step(struct rotors *rotors, const uint16_t words[NF_MOTOR_COUNT_MAX],
		 const uint8_t outputs[POLICY_ACTION_COUNT]);

/* Errors of that motor's ESC in the second before [0.01 %]; all of them while it is silent. */
unsigned rotors_errors(const struct rotors *rotors, unsigned motor);

/* The period of an electrical turn in us of a word that is a speed; 0: the rotor stands, or the word is none. */
unsigned rotors_period_us(unsigned word);

/* Is the word a speed? */
bool rotors_tells_speed(unsigned word);
