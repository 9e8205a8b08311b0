#include "storage/policy_blob.h"

#include <stdbool.h>
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

/* Do the last of its `total` bytes say the CRC of those before? `magic` stands for the first four. */
static bool policy_blob_whole(uint32_t magic, const uint8_t *blob, size_t total)
{
	const size_t checked = total - NF_POLICY_BLOB_CRC_BYTES;
	uint32_t told;

	memcpy(&told, blob + checked, sizeof told);
	return crc32_more(crc32_more(0, &magic, sizeof magic), blob + sizeof magic, checked - sizeof magic) == told;
}

/* The counts stand beside the hash because tables are copied by them: no collision may write past an array. */
static bool policy_blob_same_architecture(const struct nf_policy_blob_header *header,
					  const struct policy_blob_identity *running)
{
	return header->architecture_hash == running->architecture_hash &&
	       header->weight_count == running->weight_count &&
	       header->observation_count == running->observation_count && header->action_count == running->action_count;
}

/* Is it at least 0 and at most NF_IDLE_MAX? By its bits: positive numbers are in order, whatever is negative or
 * no number lies above them. */
static bool policy_blob_idles(const struct nf_policy_blob_header *header)
{
	static const float most = NF_IDLE_MAX;
	uint32_t bits, most_bits;

	memcpy(&bits, &header->idle, sizeof bits);
	memcpy(&most_bits, &most, sizeof most_bits);
	return bits <= most_bits;
}

enum nf_err policy_blob_check_behind(uint32_t magic, const void *bytes, size_t size,
				     const struct policy_blob_identity *running)
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
	/* Before the architecture, whose hash covers both: the answer should name what to mend. */
	if (header.control_rate_hz != running->control_rate_hz)
		return NF_ERR_BLOB_RATE;
	if (header.filters_hash != running->filters_hash)
		return NF_ERR_BLOB_FILTERS;
	if (!policy_blob_same_architecture(&header, running))
		return NF_ERR_BLOB_ARCHITECTURE;
	if (!policy_blob_idles(&header))
		return NF_ERR_BLOB_IDLE;
	return NF_OK;
}

enum nf_err policy_blob_check(const void *bytes, size_t size, const struct policy_blob_identity *running)
{
	uint32_t magic = 0;

	if (size >= sizeof magic)
		memcpy(&magic, bytes, sizeof magic);
	return policy_blob_check_behind(magic, bytes, size, running);
}
