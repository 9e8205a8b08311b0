#include "sensing/rotors.h"

#include <string.h>

#include "common/words.h"

#define ELECTRICAL_TURN 12566370.6f /* 4 pi 10^6: rad/s times us, for one magnet; two of them are an electrical turn */
#define WORD_STEP 0.015625f /* of a speed: four steps of a word's nine bits at their coarsest */
#define MANTISSA ((1u << NF_ESC_MANTISSA_BITS) - 1u)
#define FULL 10000u /* 0.01 % */
#define NOT_JUMPED (-1.0f)
_Static_assert(POLICY_ACTION_COUNT <= 8, "a bit each");

void rotors_init(struct rotors *rotors, const struct nf_settings *settings, unsigned control_rate_hz)
{
	memset(rotors, 0, sizeof *rotors);
	rotors->on = settings->motor_telemetry != 0;
	rotors->silent = (uint8_t)((1u << POLICY_ACTION_COUNT) - 1u);
	rotors->hold = (uint8_t)(NF_ROTOR_HOLD_MS * control_rate_hz / 1000u);
	rotors->turn = ELECTRICAL_TURN / (float)settings->motor_poles;
	rotors->room = NF_ROTOR_ACCELERATION_MAX / (float)control_rate_hz;
	rotors->usual = NF_ROTOR_ACCELERATION_USUAL / (float)control_rate_hz;
	rotors->left = (uint16_t)control_rate_hz;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		rotors->age[i] = UINT8_MAX;
		rotors->jumped[i] = NOT_JUMPED;
		rotors->errors[i] = FULL;
	}
	for (int i = 0; i < NF_MOTOR_COUNT_MAX; ++i)
		rotors->words[i] = NF_ESC_SILENT;
}

unsigned rotors_errors(const struct rotors *rotors, unsigned motor)
{
	return rotors->silent >> motor & 1u ? FULL : rotors->errors[motor];
}

/* The kind of extended telemetry, or -1: such words would be speeds that are not in lowest terms. */
static inline int rotors_kind(unsigned word)
{
	const unsigned upper = word >> 8;

	return upper > 0 && upper % 2u == 0 ? (int)(upper / 2u) - 1 : -1;
}

bool rotors_tells_speed(unsigned word)
{
	return word > 0 && word <= NF_ESC_WORD_MAX && rotors_kind(word) < 0;
}

unsigned rotors_period_us(unsigned word)
{
	return word == NF_ESC_STANDS || !rotors_tells_speed(word) ? 0u :
								    (word & MANTISSA) << (word >> NF_ESC_MANTISSA_BITS);
}

/* A control step without a speed that counts. */
static inline void rotors_miss(struct rotors *rotors, unsigned motor)
{
	const unsigned age = rotors->age[motor];

	if (age < UINT8_MAX)
		rotors->age[motor] = (uint8_t)(age + 1u);
	if (age >= rotors->hold) {
		rotors->silent |= (uint8_t)(1u << motor);
		rotors->known[motor] = 0;
	}
}

static inline bool rotors_near(float speed, float other, float room)
{
	const float change = speed - other;

	return (change < 0.0f ? -change : change) <= room + speed * WORD_STEP;
}

/* Does that speed count? `jumped`: of the word before, which did not. */
static inline bool rotors_allows(const struct rotors *rotors, unsigned motor, float speed, float jumped)
{
	const float steps = (float)(rotors->age[motor] + 1u), last = rotors->speed[motor];
	const bool agrees = jumped >= 0.0f && rotors_near(speed, jumped, rotors->room);

	if (rotors->silent >> motor & 1u)
		return agrees;
	return rotors_near(speed, last, rotors->usual * steps) ||
	       (agrees && rotors_near(speed, last, rotors->room * steps));
}

/* A byte of extended telemetry, or nothing of use. */
static __attribute__((noinline)) void rotors_take_other(struct rotors *rotors, unsigned motor, unsigned word)
{
	const int kind = word <= NF_ESC_WORD_MAX ? rotors_kind(word) : -1;

	if (kind < 0) {
		++rotors->bad[motor];
	} else {
		rotors->told[motor][kind] = (uint8_t)word;
		rotors->known[motor] |= (uint8_t)(1u << kind);
	}
	rotors->jumped[motor] = NOT_JUMPED;
	rotors_miss(rotors, motor);
}

static inline void rotors_take(struct rotors *rotors, unsigned motor, unsigned word)
{
	if (!rotors_tells_speed(word)) {
		rotors_take_other(rotors, motor, word);
		return;
	}
	const unsigned period = rotors_period_us(word);
	const float speed = period > 0 ? rotors->turn / (float)period : 0.0f, jumped = rotors->jumped[motor];

	rotors->jumped[motor] = NOT_JUMPED;
	if (speed <= NF_ROTOR_SPEED_MAX) {
		if (rotors_allows(rotors, motor, speed, jumped)) {
			rotors->silent &= (uint8_t)~(1u << motor);
			rotors->speed[motor] = speed;
			rotors->age[motor] = 0;
			return;
		}
		rotors->jumped[motor] = speed;
	}
	++rotors->bad[motor];
	rotors_miss(rotors, motor);
}

/* A second is over. */
static __attribute__((noinline)) void rotors_count(struct rotors *rotors, unsigned steps)
{
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i) {
		rotors->errors[i] = (uint16_t)(FULL * rotors->bad[i] / steps);
		rotors->bad[i] = 0;
	}
	rotors->left = (uint16_t)steps;
}

void rotors_step(struct rotors *rotors, const uint16_t words[NF_MOTOR_COUNT_MAX],
		 const uint8_t outputs[POLICY_ACTION_COUNT])
{
	words_copy(rotors->words, words, sizeof rotors->words);
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
		rotors_take(rotors, i, words[outputs[i]]);
	if (--rotors->left == 0)
		rotors_count(rotors, POLICY_CONTROL_RATE_HZ);
}
