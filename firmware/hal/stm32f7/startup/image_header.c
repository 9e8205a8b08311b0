/* The header of the image, behind its vectors. Its size comes from the linker; toolchain/image/stamp.py writes build and CRC into
 * the linked image. */
#include <stdint.h>

#include "board.h"
#include "nf_contract.h"
#include "policy.h"

/* Linker script: their addresses are the values. */
extern const char image_bytes[], image_bank[];

extern const struct nf_image_header image_header;
__attribute__((section(".image_header"), used)) const struct nf_image_header image_header = {
	.magic = NF_IMAGE_MAGIC,
	.layout = NF_IMAGE_LAYOUT,
	.image_bytes = (uint32_t)image_bytes,
	.policy_address = (uint32_t)&policy_blob,
	.version = NF_VERSION,
	.board = BOARD_TARGET,
};
