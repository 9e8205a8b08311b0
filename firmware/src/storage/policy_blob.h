/* Policy blob: checks whether this image can fly the bytes of a policy slot. Layout: docs/reference/policy-blob.md. */
#pragma once

#include "nf_contract.h"

/* Properties of a policy that an image's code requires. */
struct policy_blob_identity {
	uint32_t architecture_hash;
	uint32_t filters_hash;      /* of the gyro filters before the policy, NF_POLICY_FILTERS_NONE for none */
	uint32_t control_rate_hz;   /* Hz */
	uint32_t weight_count;      /* floats of the table */
	uint32_t observation_count; /* floats */
	uint32_t action_count;      /* floats */
	uint8_t build
		[NF_IMAGE_BUILD_BYTES]; /* of the image; zeros: it has none, and flies no policy that came with one */
};

/* Of the image that has this header, as it was built: its filters are those that its policy was trained behind. */
struct policy_blob_identity policy_blob_identity_of(const struct nf_image_header *image);

/* Checks the blob that begins at `bytes`, of any alignment and any value; `size` [bytes] is all that may be read there,
 * and may be more than the blob. Returns NF_OK, or the first of these that is wrong: NF_ERR_BLOB_SHORT, _MAGIC,
 * _LAYOUT, _SIZE, _CRC, _BUILD, _RATE, _FILTERS, _ARCHITECTURE, _IDLE, _MIX, _MODEL.
 *
 * NF_OK: the blob is whole and ends within `size`; its weights are weight_count floats behind the header, its
 * self-test follows them and is yet to be replayed. Its idle, mix and model come with its weights: whoever flies them flies
 * these.
 * Integers only; about 12 cycles a byte of the blob, 3 ms for the largest at 216 MHz: for boot and background, not
 * for an interrupt. */
enum nf_err policy_blob_check(const void *bytes, size_t size, const struct policy_blob_identity *image);

/* The same, as if the first word at `bytes` were `magic`: of a blob whose first word is not written yet. */
enum nf_err policy_blob_check_behind(uint32_t magic, const void *bytes, size_t size,
				     const struct policy_blob_identity *image);
