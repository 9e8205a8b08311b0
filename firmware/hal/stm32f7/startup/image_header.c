/* The header of the image, behind its vectors. Its size comes from the linker; toolchain/image/stamp.py writes board, build
 * and CRC into the linked image. */

#include "nf_contract.h"
#include "policy.h"

/* Linker script: their addresses are the values. */
extern const char image_bytes[], image_bank[];

extern const struct nf_image_header image_header;
__attribute__((section(".image_header"), used)) const struct nf_image_header image_header = {
	.magic = NF_IMAGE_MAGIC,
	.layout = NF_IMAGE_LAYOUT,
	.image_bytes = (uint32_t)image_bytes,
	.version = NF_VERSION,
	.architecture_hash = POLICY_ARCHITECTURE_HASH,
	.filters_hash = POLICY_FILTERS_HASH,
	.control_rate_hz = POLICY_CONTROL_RATE_HZ,
	.weight_count = POLICY_WEIGHT_COUNT,
	.observation_count = POLICY_OBSERVATION_COUNT,
	.action_count = POLICY_ACTION_COUNT,
};
