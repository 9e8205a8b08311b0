#include "common/sha256.h"

#include <string.h>

#define BLOCK_BYTES 64u
#define ROUNDS 64u
#define WORDS 8u         /* of the state */
#define SCHEDULE 16u     /* the last words of the message schedule, which are all that the next one is made of */
#define LENGTH_BYTES 8u  /* at the end of the last block: the number of bits */
#define PADDING_FIRST 0x80u

/* The first 32 bits of the fractions of the first 64 primes' cube roots. */
static const uint32_t constants[ROUNDS] = {
	0x428A2F98u, 0x71374491u, 0xB5C0FBCFu, 0xE9B5DBA5u, 0x3956C25Bu, 0x59F111F1u, 0x923F82A4u, 0xAB1C5ED5u,
	0xD807AA98u, 0x12835B01u, 0x243185BEu, 0x550C7DC3u, 0x72BE5D74u, 0x80DEB1FEu, 0x9BDC06A7u, 0xC19BF174u,
	0xE49B69C1u, 0xEFBE4786u, 0x0FC19DC6u, 0x240CA1CCu, 0x2DE92C6Fu, 0x4A7484AAu, 0x5CB0A9DCu, 0x76F988DAu,
	0x983E5152u, 0xA831C66Du, 0xB00327C8u, 0xBF597FC7u, 0xC6E00BF3u, 0xD5A79147u, 0x06CA6351u, 0x14292967u,
	0x27B70A85u, 0x2E1B2138u, 0x4D2C6DFCu, 0x53380D13u, 0x650A7354u, 0x766A0ABBu, 0x81C2C92Eu, 0x92722C85u,
	0xA2BFE8A1u, 0xA81A664Bu, 0xC24B8B70u, 0xC76C51A3u, 0xD192E819u, 0xD6990624u, 0xF40E3585u, 0x106AA070u,
	0x19A4C116u, 0x1E376C08u, 0x2748774Cu, 0x34B0BCB5u, 0x391C0CB3u, 0x4ED8AA4Au, 0x5B9CCA4Fu, 0x682E6FF3u,
	0x748F82EEu, 0x78A5636Fu, 0x84C87814u, 0x8CC70208u, 0x90BEFFFAu, 0xA4506CEBu, 0xBEF9A3F7u, 0xC67178F2u,
};

static uint32_t sha256_right(uint32_t word, unsigned bits)
{
	return word >> bits | word << (32u - bits);
}

static uint32_t sha256_big_endian(const uint8_t *bytes)
{
	return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

/* Word `t` of the schedule from those 16, 15, 7 and 2 before it; it takes the place of the oldest. */
static uint32_t sha256_schedule(uint32_t schedule[SCHEDULE], unsigned t)
{
	const uint32_t w15 = schedule[(t - 15u) % SCHEDULE], w2 = schedule[(t - 2u) % SCHEDULE];
	const uint32_t s0 = sha256_right(w15, 7) ^ sha256_right(w15, 18) ^ w15 >> 3;
	const uint32_t s1 = sha256_right(w2, 17) ^ sha256_right(w2, 19) ^ w2 >> 10;

	return schedule[t % SCHEDULE] += s0 + schedule[(t - 7u) % SCHEDULE] + s1;
}

static void sha256_block(uint32_t state[WORDS], const uint8_t block[BLOCK_BYTES])
{
	uint32_t a = state[0], b = state[1], c = state[2], d = state[3], e = state[4], f = state[5], g = state[6],
		 h = state[7], schedule[SCHEDULE];

	for (unsigned t = 0; t < SCHEDULE; ++t)
		schedule[t] = sha256_big_endian(block + 4u * t);
	for (unsigned t = 0; t < ROUNDS; ++t) {
		const uint32_t word = t < SCHEDULE ? schedule[t] : sha256_schedule(schedule, t);
		const uint32_t sum1 = sha256_right(e, 6) ^ sha256_right(e, 11) ^ sha256_right(e, 25);
		const uint32_t first = h + sum1 + ((e & f) ^ (~e & g)) + constants[t] + word;
		const uint32_t sum0 = sha256_right(a, 2) ^ sha256_right(a, 13) ^ sha256_right(a, 22);
		const uint32_t second = sum0 + ((a & b) ^ (a & c) ^ (b & c));
		h = g, g = f, f = e, e = d + first;
		d = c, c = b, b = a, a = first + second;
	}
	const uint32_t after[WORDS] = { a, b, c, d, e, f, g, h };
	for (unsigned i = 0; i < WORDS; ++i)
		state[i] += after[i];
}

void sha256(const void *bytes, size_t count, uint8_t digest[SHA256_BYTES])
{
	/* The first 32 bits of the fractions of the first 8 primes' square roots. */
	uint32_t state[WORDS] = { 0x6A09E667u, 0xBB67AE85u, 0x3C6EF372u, 0xA54FF53Au,
				  0x510E527Fu, 0x9B05688Cu, 0x1F83D9ABu, 0x5BE0CD19u };
	const uint64_t bits = (uint64_t)count * 8u;
	const uint8_t *from = bytes;
	uint8_t last[2u * BLOCK_BYTES] = { 0 };

	for (; count >= BLOCK_BYTES; count -= BLOCK_BYTES, from += BLOCK_BYTES)
		sha256_block(state, from);
	const size_t padded = count < BLOCK_BYTES - LENGTH_BYTES ? BLOCK_BYTES : 2u * BLOCK_BYTES;
	memcpy(last, from, count);
	last[count] = PADDING_FIRST;
	for (unsigned i = 0; i < LENGTH_BYTES; ++i)
		last[padded - 1u - i] = (uint8_t)(bits >> 8u * i);
	for (size_t at = 0; at < padded; at += BLOCK_BYTES)
		sha256_block(state, last + at);
	for (unsigned i = 0; i < SHA256_BYTES; ++i)
		digest[i] = (uint8_t)(state[i / 4u] >> (24u - 8u * (i % 4u)));
}
