#include "storage/policy_blob.h"

#include <string.h>

#include "common/crc32.h"
#include "nf_contract.h"

_Static_assert(sizeof(struct nf_policy_blob_header) == NF_POLICY_BLOB_HEADER_BYTES, "the contract's own size");
_Static_assert(NF_POLICY_BLOB_HEADER_BYTES % 8 == 0, "the weights behind it are 8-byte aligned");
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "a blob's numbers are read as they lie");

/* Are all sizes and offsets those that follow from the counts, and does the blob end within `size`? In 64 bits,
 * where the largest counts that the header can say do not overflow. */
static bool policy_blob_sized(const struct nf_policy_blob_header *header, size_t size)
{
	const uint64_t row = (uint64_t)header->observation_count + header->action_count;
	const uint64_t selftest = NF_POLICY_BLOB_HEADER_BYTES + (uint64_t)header->weight_count * sizeof(float);
	const uint64_t total = selftest + header->selftest_count * row * sizeof(float) + NF_POLICY_BLOB_CRC_BYTES;

	return header->header_bytes == NF_POLICY_BLOB_HEADER_BYTES &&
	       header->weight_offset == NF_POLICY_BLOB_HEADER_BYTES && header->selftest_offset == selftest &&
	       header->total_bytes == total && total <= size;
}

/* Is there a self-test, in whole runs of steps? Whoever replays it divides by them. */
static bool policy_blob_tested(const struct nf_policy_blob_header *header)
{
	return header->selftest_count > 0 && header->selftest_steps > 0 &&
	       header->selftest_count % header->selftest_steps == 0;
}

/* Returns whether the last of `total` bytes are the CRC of those before, with `magic` in place of the first four. */
static bool policy_blob_whole(uint32_t magic, const uint8_t *blob, size_t total)
{
	const size_t checked = total - NF_POLICY_BLOB_CRC_BYTES;
	uint32_t told;

	memcpy(&told, blob + checked, sizeof told);
	return crc32_more(crc32_more(0, &magic, sizeof magic), blob + sizeof magic, checked - sizeof magic) == told;
}

/* Returns whether the blob came with that image or is for any image of its architecture. */
static bool policy_blob_meant_for(const struct nf_policy_blob_header *header, const struct policy_blob_identity *image)
{
	static const uint8_t any[NF_IMAGE_BUILD_BYTES];

	return memcmp(header->build, any, sizeof any) == 0 || memcmp(header->build, image->build, sizeof any) == 0;
}

/* The counts stand beside the hash because tables are copied by them: no collision may write past an array. */
static bool policy_blob_same_architecture(const struct nf_policy_blob_header *header,
					  const struct policy_blob_identity *image)
{
	return header->architecture_hash == image->architecture_hash && header->weight_count == image->weight_count &&
	       header->observation_count == image->observation_count && header->action_count == image->action_count;
}

static uint32_t policy_blob_bits(float value)
{
	uint32_t bits;

	memcpy(&bits, &value, sizeof bits);
	return bits;
}

/* Is it at least 0 and at most `most`, which is above 0? By their bits: positive numbers are in order, whatever is negative or
 * no number lies above them. */
static bool policy_blob_within(float value, float most)
{
	return policy_blob_bits(value) <= policy_blob_bits(most);
}

static bool policy_blob_positive(float value, float most)
{
	return policy_blob_bits(value) != 0 && policy_blob_within(value, most);
}

/* Is it a number, of any sign, of that size at most? */
static bool policy_blob_number(float value)
{
	return (policy_blob_bits(value) & 0x7FFFFFFFu) <= policy_blob_bits(NF_MODEL_NUMBER_MAX);
}

/* Are all fields of a model numbers that an aircraft can have? */
static bool policy_blob_models(const struct nf_policy_blob_header *header)
{
	enum { CURVE, RISE = 3, FALL, GAIN, LOSS, CORRECTION };
	const float *rotor = header->model_rotor;
	bool good = header->model_delay <= NF_ESTIMATOR_DELAY_MAX;

	for (unsigned i = CURVE; i < RISE; ++i)
		good &= policy_blob_number(rotor[i]);
	for (unsigned i = 0; i < sizeof header->model_turn / sizeof header->model_turn[0]; ++i)
		good &= policy_blob_number(header->model_turn[i]) && policy_blob_number(header->model_reaction[i]);
	return good && policy_blob_positive(rotor[RISE], 1.0f) && policy_blob_positive(rotor[FALL], 1.0f) &&
	       policy_blob_positive(rotor[GAIN], NF_MODEL_NUMBER_MAX) &&
	       policy_blob_positive(rotor[LOSS], NF_MODEL_NUMBER_MAX) && policy_blob_positive(rotor[CORRECTION], 1.0f);
}

enum model_use { MODEL_UNUSED, MODEL_WELCOME, MODEL_NEEDED };

/* What the observation's terms need a model for: estimates are made by it, and rotor speeds taken from it where an ESC is
 * silent. The terms are this image's, which has the same architecture. */
static enum model_use policy_blob_model_use(const struct nf_policy_blob_header *header)
{
	enum model_use use = MODEL_UNUSED;

	for (uint32_t i = 0; i < header->observation_term_count && i < NF_OBSERVATION_TERMS_MAX; ++i) {
		const unsigned block = header->observation_blocks[i];
		if (block == NF_OBSERVATION_ROTOR_ESTIMATE || block == NF_OBSERVATION_RATE_ESTIMATE ||
		    block == NF_OBSERVATION_RATE_ESTIMATE_ERROR || block == NF_OBSERVATION_ROTOR_MEASURED)
			return MODEL_NEEDED;
		if (block == NF_OBSERVATION_ROTOR_SPEED)
			use = MODEL_WELCOME;
	}
	return use;
}

/* Is there a good model where one is used, or none where none is needed? */
static bool policy_blob_modelled(const struct nf_policy_blob_header *header)
{
	const enum model_use use = policy_blob_model_use(header);

	if (header->model_delay == 0)
		return use != MODEL_NEEDED;
	return use != MODEL_UNUSED && policy_blob_models(header);
}

enum nf_err policy_blob_check_behind(uint32_t magic, const void *bytes, size_t size,
				     const struct policy_blob_identity *image)
{
	struct nf_policy_blob_header header; /* a copy: a slot may begin at any address */

	if (size < sizeof header + NF_POLICY_BLOB_CRC_BYTES)
		return NF_ERR_BLOB_SHORT;
	memcpy(&header, bytes, sizeof header);
	if (magic != NF_POLICY_BLOB_MAGIC)
		return NF_ERR_BLOB_MAGIC;
	if (header.layout != NF_POLICY_BLOB_LAYOUT)
		return NF_ERR_BLOB_LAYOUT;
	if (!policy_blob_sized(&header, size) || !policy_blob_tested(&header))
		return NF_ERR_BLOB_SIZE;
	if (!policy_blob_whole(magic, bytes, header.total_bytes))
		return NF_ERR_BLOB_CRC;
	if (!policy_blob_meant_for(&header, image))
		return NF_ERR_BLOB_BUILD;
	/* Before the architecture, whose hash covers both: the answer should name what to mend. */
	if (header.control_rate_hz != image->control_rate_hz)
		return NF_ERR_BLOB_RATE;
	if (header.filters_hash != image->filters_hash)
		return NF_ERR_BLOB_FILTERS;
	if (!policy_blob_same_architecture(&header, image))
		return NF_ERR_BLOB_ARCHITECTURE;
	if (!policy_blob_within(header.idle, NF_IDLE_MAX))
		return NF_ERR_BLOB_IDLE;
	if (header.mix > NF_MIX_CENTRED)
		return NF_ERR_BLOB_MIX;
	if (!policy_blob_modelled(&header))
		return NF_ERR_BLOB_MODEL;
	return NF_OK;
}

struct policy_blob_identity policy_blob_identity_of(const struct nf_image_header *image)
{
	struct policy_blob_identity identity = {
		.architecture_hash = image->architecture_hash,
		.filters_hash = image->filters_hash,
		.control_rate_hz = image->control_rate_hz,
		.weight_count = image->weight_count,
		.observation_count = image->observation_count,
		.action_count = image->action_count,
	};

	memcpy(identity.build, image->build, sizeof identity.build);
	return identity;
}

enum nf_err policy_blob_check(const void *bytes, size_t size, const struct policy_blob_identity *image)
{
	uint32_t magic = 0;

	if (size >= sizeof magic)
		memcpy(&magic, bytes, sizeof magic);
	return policy_blob_check_behind(magic, bytes, size, image);
}
