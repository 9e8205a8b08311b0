/* Policy slots: which policy this boot flies, and how a slot gets a new one.
 *
 * Two slots of flash hold blobs (docs/reference/policy-blob.md); the image itself has no weights. At boot the blob with the newest
 * sequence number that is whole, made for this image and passes its own self-test is taken; without one no policy flies.
 * Numbers wrap (common/serial_number.h): whatever number a policy has, another one can follow. A slot's first word is
 * written last, so that one half written is none. A blob may name the build that it came with: no other image flies it.
 * That of the bank which is not run is checked against the image there. */
#pragma once

#include "nf_contract.h"
#include "policy.h"
#include "port/flash.h"
#include "storage/policy_blob.h"

/* Where a policy can come from. */
enum policy_source {
	POLICY_SLOT_A,
	POLICY_SLOT_B,
	POLICY_SOURCE_COUNT, /* as a source: none */
};

/* A slot being written. */
struct policy_update {
	enum policy_source target; /* POLICY_SOURCE_COUNT: no slot is */
	uint32_t total;            /* bytes that the blob will have */
	uint32_t written;          /* bytes so far, the first word included, which is kept here */
	uint32_t head;             /* that word */
	bool ended;                /* the last update arrived whole, and none has begun since */
};

struct policy_slots {
	const struct flash *flash;
	struct policy_blob_identity running;
	unsigned bank; /* of images, that this one runs from */
	/* NF_OK, or what was wrong with it at boot, NF_ERR_POLICY being its self-test; NF_OK once written anew. */
	enum nf_err found[POLICY_SOURCE_COUNT];
	enum policy_source flown;               /* POLICY_SOURCE_COUNT: none is good */
	uint32_t sequence;                      /* of the flown one */
	float idle;                             /* of the flown one: motor fraction at zero thrust */
	enum nf_mix mix;                        /* of the flown one */
	struct policy_update update;
	bool reverted;                          /* the flown slot's policy is none any more */
};

/* Chooses for this boot: leaves the chosen one's weights in `weights` and `policy` initialized with them. `running`:
 * what this image and its settings ask for; `bank`: where it lies. Flash outlives `slots`.
 * NF_ERR_POLICY: none is good, do not fly `policy`; slots->found tells why, and a slot can still be written. */
enum nf_err policy_slots_choose(struct policy_slots *slots, const struct flash *flash,
				const struct policy_blob_identity *running, unsigned bank, struct policy *policy,
				float weights[POLICY_WEIGHT_COUNT]);

/* Header of the flown blob. Returns false, `header` unset, if none is flown. */
bool policy_slots_header(const struct policy_slots *slots, struct nf_policy_blob_header *header);

/* Are `count` of `weights`, from number `first` on, bit for bit those of the flown blob in flash? True where none is flown. */
bool policy_slots_intact(const struct policy_slots *slots, const float weights[POLICY_WEIGHT_COUNT], size_t first,
			 size_t count);

/* Makes the flown blob's weights anew in `weights`, and `policy` initialized with them, if the blob still passes all checks
 * and its self-test. Returns whether it does. */
bool policy_slots_restore(struct policy_slots *slots, struct policy *policy, float weights[POLICY_WEIGHT_COUNT]);

/* Begins an update with a blob of `total` bytes: erases the slot that is not flown; if none is, one that does not hold
 * the best policy. Waits for the flash, as the next two do; only while nothing can arm.
 * NF_REFUSAL_PAYLOAD: no blob has that size. NF_REFUSAL_ORDER: after a revert, when that slot has what is flown next.
 * NF_REFUSAL_FLASH. */
enum nf_refusal policy_slots_begin(struct policy_slots *slots, uint32_t total);

/* Writes the blob's bytes from `offset` on, in order; both are multiples of 4, `words` is aligned to 4. The last
 * write may be repeated, because its reply may have been lost. NF_REFUSAL_ORDER, NF_REFUSAL_PAYLOAD,
 * NF_REFUSAL_FLASH. */
enum nf_refusal policy_slots_write(struct policy_slots *slots, uint32_t offset, const void *words, size_t bytes);

/* Ends the update: checks all of it, then makes it valid. One that names the build of the other bank's image is checked against
 * that and is for it alone; another is flown by this image from the next boot on. May be repeated.
 * NF_REFUSAL_ORDER, NF_REFUSAL_FLASH; NF_REFUSAL_BLOB: *why tells what is wrong; NF_REFUSAL_SEQUENCE: not newer than
 * the one that stays. A slot that is refused stays empty until it is begun again. */
enum nf_refusal policy_slots_end(struct policy_slots *slots, enum nf_err *why);

/* The sequence number that the next policy has to have, or a newer one. Reads all blobs: some milliseconds. */
uint32_t policy_slots_next_sequence(const struct policy_slots *slots);

/* Goes back to the policy before the flown one, from the next boot on: the flown slot's first word becomes 0. A loss of power
 * leaves either. May be repeated. NF_REFUSAL_ORDER: no slot is flown, one has been written since the boot, or the other one
 * holds no policy that this image can fly. NF_REFUSAL_FLASH. */
enum nf_refusal policy_slots_revert(struct policy_slots *slots);

/* Returns the error of the policy in the slot, and its header; zeros if that is not trustworthy. Reads the whole
 * blob, which takes some milliseconds. */
enum nf_err policy_slots_info(const struct policy_slots *slots, enum policy_source source,
			      struct nf_policy_blob_header *header);

/* Does a slot hold a policy that the image in the bank which is not run can fly? Its self-test cannot be run here. NF_OK, or why
 * not. Reads all blobs. */
enum nf_err policy_slots_for_other_bank(const struct policy_slots *slots);
