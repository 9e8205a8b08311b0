/* Rotors that turn as in flight, whose ESCs answer over noisy wires: what of that the firmware believes, by its own decoder
 * (motors/dshot_telemetry.c) and its own gate (sensing/rotors.c). The encoder is written from the format's public
 * description, as in test_dshot_telemetry.py. */
#include <math.h>
#include <string.h>

#include "motors/dshot_telemetry.h"
#include "sensing/rotors.h"

#define LINES DSHOT_PORT_LINES
#define QUADS (LINES / POLICY_ACTION_COUNT)
#define ANSWER_EDGES (DSHOT_ANSWER_BITS + 1u)
#define STEP_S 0.001
#define POLES 14
#define SAMPLES_MAX 256

struct noise {
	double jitter; /* samples, standard deviation of each edge */
	double glitches; /* share of the samples that are wrong */
	double bursts; /* share of the answers with `burst` samples of any level somewhere */
	int burst;
	double white, stuck, cut; /* shares of the answers: noise alone; the line stays from some sample on; breaks off */
	double told; /* share of words that are extended telemetry */
	double shortest, longest; /* an ESC's bits, of what they should be */
	int samples, earliest; /* as motors.c takes them */
};

struct tally {
	long answers, read, wrong; /* of the decoder: words as sent, other words */
	long believed, misled; /* of the core: speeds that the ESC told, others */
	double off, off_share; /* the farthest of those [rad/s], and of the speed */
};

static uint64_t random_state[2];

static uint64_t any(void)
{
	uint64_t a = random_state[0];
	const uint64_t b = random_state[1];

	random_state[0] = b;
	a ^= a << 23;
	random_state[1] = a ^ b ^ (a >> 17) ^ (b >> 26);
	return random_state[1] + b;
}

static double between(double low, double high)
{
	return low + (high - low) * ((double)(any() >> 11) * 0x1p-53);
}

static bool happens(double share)
{
	return share > 0.0 && between(0.0, 1.0) < share;
}

static double normal(void)
{
	return sqrt(-2.0 * log(between(0x1p-53, 1.0))) * cos(2.0 * 3.14159265358979 * between(0.0, 1.0));
}

/* A rotor that goes to one speed after the other, as quickly as the quickest of our twins. */
struct rotor {
	double speed, wanted, lag_s, bit;
};

static void turn(struct rotor *rotor)
{
	if (happens(0.01)) {
		rotor->wanted = between(100.0, 4000.0);
		rotor->lag_s = between(0.015, 0.065);
	}
	rotor->speed += STEP_S * fmax(-5e4, fmin(5e4, (rotor->wanted - rotor->speed) / rotor->lag_s));
}

static unsigned speed_word(double speed)
{
	unsigned period = (unsigned)(4e6 * 3.14159265358979 / POLES / speed), exponent = 0;

	while (period >> exponent >= 1u << NF_ESC_MANTISSA_BITS)
		++exponent;
	return exponent << NF_ESC_MANTISSA_BITS | period >> exponent;
}

static const uint8_t groups[16] = { 0x19, 0x1B, 0x12, 0x13, 0x1D, 0x15, 0x16, 0x17, 0x1A, 0x09, 0x0A, 0x0B, 0x1E, 0x0D, 0x0E, 0x0F };

/* Which of the samples the line changes before. */
static void send(unsigned word, const struct rotor *rotor, const struct noise *noise, bool changes[])
{
	const unsigned all = word << 4 | (~(word ^ word >> 4 ^ word >> 8) & 15u);
	const double latest = noise->samples - (double)DSHOT_ANSWER_SAMPLES, begin = between(noise->earliest + 4.0, latest - 1.0);
	const unsigned end = happens(noise->cut) ? 1u + (unsigned)(any() % (DSHOT_ANSWER_BITS - 1u)) : DSHOT_ANSWER_BITS;
	bool low = false;

	memset(changes, 0, SAMPLES_MAX * sizeof changes[0]);
	for (unsigned bit = 0; bit <= end; ++bit) {
		const unsigned place = DSHOT_ANSWER_BITS - 1u - bit;
		const bool one = bit == 0 || (bit == end ? low : (bool)(groups[all >> place / 5u * 4u & 15u] >> place % 5u & 1u));
		const double at = begin + bit * DSHOT_ANSWER_OVERSAMPLING * rotor->bit + noise->jitter * (noise->jitter > 0.0 ? normal() : 0.0);

		if (!one)
			continue;
		low = !low;
		if (at >= 0.0 && at < noise->samples - 1)
			changes[(int)ceil(at)] ^= true;
	}
}

/* Samples of the line. */
static void hear(const bool changes[], const struct noise *noise, uint16_t samples[], uint16_t line)
{
	const int burst = happens(noise->bursts) ? (int)(any() % (unsigned)noise->samples) : SAMPLES_MAX;
	const int stuck = happens(noise->stuck) ? (int)(any() % (unsigned)noise->samples) : SAMPLES_MAX;
	const bool white = happens(noise->white), level = any() & 1u;
	bool high = true;

	for (int i = 0; i < noise->samples; ++i) {
		high ^= changes[i];
		bool seen = i >= stuck ? level : high;

		if (white || (i >= burst && i < burst + noise->burst))
			seen = any() & 1u;
		seen ^= happens(noise->glitches);
		samples[i] |= seen ? line : 0u;
	}
}

static void count(struct tally *tally, const struct rotors *rotors, unsigned motor, unsigned sent, unsigned read, double speed)
{
	const unsigned period = rotors_period_us(sent);

	++tally->answers;
	tally->read += read == sent;
	tally->wrong += read != sent && read <= NF_ESC_WORD_MAX;
	if (rotors->age[motor] != 0)
		return;
	if (rotors_tells_speed(sent) && rotors->speed[motor] == (period > 0 ? rotors->turn / (float)period : 0.0f)) {
		++tally->believed;
		return;
	}
	const double off = fabs((double)rotors->speed[motor] - speed);

	++tally->misled;
	tally->off = fmax(tally->off, off);
	tally->off_share = fmax(tally->off_share, off / speed);
}

/* At least `answers` of them; each control step, of 1 ms, has one of each rotor. */
void noisy_wires(const struct noise *noise, long answers, uint64_t seed, struct tally *tally)
{
	static const uint8_t outputs[POLICY_ACTION_COUNT] = { 0, 1, 2, 3 };
	const struct nf_settings settings = { .motor_telemetry = 1, .motor_poles = POLES };
	int16_t learned[LINES] = { 0 };
	struct rotors heard[QUADS];
	struct rotor rotors[LINES];

	random_state[0] = seed;
	random_state[1] = 0x9E3779B97F4A7C15u;
	memset(tally, 0, sizeof *tally);
	for (unsigned i = 0; i < QUADS; ++i)
		rotors_init(&heard[i], &settings, 1000u);
	for (unsigned i = 0; i < LINES; ++i)
		rotors[i] = (struct rotor){ 1000.0, 1000.0, 0.02, between(noise->shortest, noise->longest) };
	while (tally->answers < answers) {
		uint32_t samples[SAMPLES_MAX / 2] = { 0 };
		uint16_t sent[LINES], read[LINES];

		for (unsigned i = 0; i < LINES; ++i) {
			bool changes[SAMPLES_MAX];

			turn(&rotors[i]);
			sent[i] = (uint16_t)(happens(noise->told) ? (1u + any() % 7u) << NF_ESC_MANTISSA_BITS | (any() & 255u) :
								    speed_word(rotors[i].speed));
			send(sent[i], &rotors[i], noise, changes);
			hear(changes, noise, (uint16_t *)samples, (uint16_t)(1u << i));
		}
		dshot_telemetry_decode(samples, (size_t)noise->samples / 2u, (uint32_t)noise->earliest, 0xFFFFu, learned, read);
		for (unsigned i = 0; i < LINES; ++i) {
			const unsigned motor = i % POLICY_ACTION_COUNT;
			struct rotors *const quad = &heard[i / POLICY_ACTION_COUNT];

			if (motor == 0) {
				uint16_t words[NF_MOTOR_COUNT_MAX] = { 0 };

				memcpy(words, &read[i], POLICY_ACTION_COUNT * sizeof words[0]);
				rotors_step(quad, words, outputs);
			}
			count(tally, quad, motor, sent[i], read[i], rotors[i].speed);
		}
	}
}
