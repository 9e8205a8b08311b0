#include "storage/policy_slots.h"

#include <string.h>

#include "common/serial_number.h"
#include "storage/image_bank.h"

static const struct place {
	uint32_t address;
	uint32_t size;
	unsigned sector;
} places[] = {
	[POLICY_SLOT_A] = { NF_FLASH_POLICY_SLOTS_0_ADDRESS, NF_FLASH_POLICY_SLOTS_0_SIZE, 4 },
	[POLICY_SLOT_B] = { NF_FLASH_POLICY_SLOTS_1_ADDRESS, NF_FLASH_POLICY_SLOTS_1_SIZE, 7 },
};
_Static_assert(sizeof places / sizeof places[0] == NF_FLASH_POLICY_SLOTS_COUNT, "a place each");
_Static_assert(POLICY_SOURCE_COUNT == NF_FLASH_POLICY_SLOTS_COUNT, "each is a slot");
_Static_assert(NF_FLASH_POLICY_SLOTS_0_ADDRESS == NF_FLASH_SECTORS_4_ADDRESS, "the sector to erase");
_Static_assert(NF_FLASH_POLICY_SLOTS_1_ADDRESS == NF_FLASH_SECTORS_7_ADDRESS, "the sector to erase");
_Static_assert(NF_POLICY_BLOB_HEADER_BYTES % FLASH_WORD_BYTES == 0, "parts of a blob are whole words");

static const uint8_t *policy_slots_blob_of(const struct policy_slots *slots, enum policy_source source)
{
	return flash_at(slots->flash, places[source].address);
}

static struct nf_policy_blob_header policy_slots_header_of(const uint8_t *blob)
{
	struct nf_policy_blob_header header;

	memcpy(&header, blob, sizeof header);
	return header;
}

static uint32_t policy_slots_sequence_of(const uint8_t *blob)
{
	uint32_t sequence;

	memcpy(&sequence, blob + offsetof(struct nf_policy_blob_header, sequence), sizeof sequence);
	return sequence;
}

/* Returns the error that keeps that image from flying the blob in the slot; NF_OK if it can. */
static enum nf_err policy_slots_check_for(const struct policy_slots *slots, enum policy_source source,
					  const struct policy_blob_identity *image)
{
	return policy_blob_check(policy_slots_blob_of(slots, source), places[source].size, image);
}

static enum nf_err policy_slots_check(const struct policy_slots *slots, enum policy_source source)
{
	return policy_slots_check_for(slots, source, &slots->running);
}

/* Replays the policy's self-test vectors: they detect one wrong bit in weights, compiler or FPU. `header` has been
 * checked, so that rows are as wide as the image's. */
static bool policy_slots_selftest(struct policy *policy, const float *weights,
				  const struct nf_policy_blob_header *header, const uint8_t *blob)
{
	float observation[POLICY_OBSERVATION_COUNT], expected[POLICY_ACTION_COUNT], action[POLICY_ACTION_COUNT];
	const uint8_t *observations = blob + header->selftest_offset;
	const uint8_t *actions = observations + header->selftest_count * sizeof observation;
	bool same = true;

	for (unsigned i = 0; i < header->selftest_count; ++i) {
		if (i % header->selftest_steps == 0)
			policy_init(policy, weights);
		memcpy(observation, observations + i * sizeof observation, sizeof observation);
		memcpy(expected, actions + i * sizeof expected, sizeof expected);
		policy_step(policy, observation, action);
		same &= memcmp(action, expected, sizeof action) == 0;
	}
	return same;
}

/* Makes `source`, whose checks passed, the flown one if it passes its self-test. */
static bool policy_slots_use(struct policy_slots *slots, enum policy_source source, struct policy *policy,
			     float weights[POLICY_WEIGHT_COUNT])
{
	const uint8_t *blob = policy_slots_blob_of(slots, source);
	const struct nf_policy_blob_header header = policy_slots_header_of(blob);

	memcpy(weights, blob + header.weight_offset, POLICY_WEIGHT_COUNT * sizeof weights[0]);
	if (!policy_slots_selftest(policy, weights, &header, blob))
		return false;
	policy_init(policy, weights); /* forgets the self-test */
	slots->flown = source;
	slots->sequence = header.sequence;
	slots->idle = header.idle;
	slots->mix = (enum nf_mix)header.mix;
	return true;
}

static bool policy_slots_newer(const struct policy_slots *slots, enum policy_source a, enum policy_source b)
{
	return serial_number_newer(policy_slots_sequence_of(policy_slots_blob_of(slots, a)),
				   policy_slots_sequence_of(policy_slots_blob_of(slots, b)));
}

/* Returns the good slot with the newer policy, the first if neither is newer, POLICY_SOURCE_COUNT if none is good. */
static enum policy_source policy_slots_best(const struct policy_slots *slots)
{
	const bool a = slots->found[POLICY_SLOT_A] == NF_OK, b = slots->found[POLICY_SLOT_B] == NF_OK;

	if (a && b)
		return policy_slots_newer(slots, POLICY_SLOT_B, POLICY_SLOT_A) ? POLICY_SLOT_B : POLICY_SLOT_A;
	if (a || b)
		return a ? POLICY_SLOT_A : POLICY_SLOT_B;
	return POLICY_SOURCE_COUNT;
}

enum nf_err policy_slots_choose(struct policy_slots *slots, const struct flash *flash,
				const struct policy_blob_identity *running, unsigned bank, struct policy *policy,
				float weights[POLICY_WEIGHT_COUNT])
{
	*slots = (struct policy_slots){
		.flash = flash,
		.running = *running,
		.bank = bank,
		.flown = POLICY_SOURCE_COUNT,
		.update.target = POLICY_SOURCE_COUNT,
	};
	for (enum policy_source source = 0; source < POLICY_SOURCE_COUNT; ++source)
		slots->found[source] = policy_slots_check(slots, source);
	for (enum policy_source tries = 0; tries < POLICY_SOURCE_COUNT; ++tries) {
		const enum policy_source source = policy_slots_best(slots);
		if (source == POLICY_SOURCE_COUNT)
			break;
		if (policy_slots_use(slots, source, policy, weights))
			return NF_OK;
		slots->found[source] = NF_ERR_POLICY;
	}
	return NF_ERR_POLICY;
}

bool policy_slots_intact(const struct policy_slots *slots, const float weights[POLICY_WEIGHT_COUNT], size_t first,
			 size_t count)
{
	if (slots->flown == POLICY_SOURCE_COUNT)
		return true;
	const uint8_t *blob = policy_slots_blob_of(slots, slots->flown);
	const uint8_t *kept = blob + NF_POLICY_BLOB_HEADER_BYTES + first * sizeof weights[0];

	return memcmp(weights + first, kept, count * sizeof weights[0]) == 0;
}

bool policy_slots_restore(struct policy_slots *slots, struct policy *policy, float weights[POLICY_WEIGHT_COUNT])
{
	const enum policy_source source = slots->flown;

	if (source == POLICY_SOURCE_COUNT)
		return false;
	slots->found[source] = policy_slots_check(slots, source);
	if (slots->found[source] != NF_OK)
		return false;
	if (policy_slots_use(slots, source, policy, weights))
		return true;
	slots->found[source] = NF_ERR_POLICY;
	return false;
}

bool policy_slots_header(const struct policy_slots *slots, struct nf_policy_blob_header *header)
{
	if (slots->flown == POLICY_SOURCE_COUNT)
		return false;
	*header = policy_slots_header_of(policy_slots_blob_of(slots, slots->flown));
	return true;
}

/* --- Writing a slot ----------------------------------------------------------------------------------- */
/* Does the slot hold a policy now that can be flown? */
static bool policy_slots_holds(const struct policy_slots *slots, enum policy_source slot)
{
	return slots->found[slot] != NF_ERR_POLICY && policy_slots_check(slots, slot) == NF_OK;
}

static enum policy_source policy_slots_other(enum policy_source slot)
{
	return slot == POLICY_SLOT_A ? POLICY_SLOT_B : POLICY_SLOT_A;
}

/* The flown slot stays. Where none flies, slots may have been written since boot: the best stays. */
static enum policy_source policy_slots_to_be_written(const struct policy_slots *slots)
{
	if (slots->flown != POLICY_SOURCE_COUNT)
		return policy_slots_other(slots->flown);
	const bool b_is_best = policy_slots_holds(slots, POLICY_SLOT_B) &&
			       policy_slots_newer(slots, POLICY_SLOT_B, POLICY_SLOT_A);
	return policy_slots_holds(slots, POLICY_SLOT_A) && !b_is_best ? POLICY_SLOT_B : POLICY_SLOT_A;
}

/* Does the header of a blob that was found so tell something? */
static bool policy_slots_told(enum nf_err found)
{
	switch (found) {
	case NF_ERR_BLOB_SHORT:
	case NF_ERR_BLOB_MAGIC:
	case NF_ERR_BLOB_LAYOUT:
	case NF_ERR_BLOB_SIZE:
	case NF_ERR_BLOB_CRC:
		return false;
	default:
		return true;
	}
}

/* The newest sequence of the whole policies in the slots, for whichever image they are, also of one that failed its
 * self-test; 0 where there is none. */
static uint32_t policy_slots_newest_sequence(const struct policy_slots *slots)
{
	uint32_t newest = 0;
	bool first = true;

	for (enum policy_source slot = POLICY_SLOT_A; slot <= POLICY_SLOT_B; ++slot) {
		if (!policy_slots_told(policy_slots_check(slots, slot)))
			continue;
		const uint32_t sequence = policy_slots_sequence_of(policy_slots_blob_of(slots, slot));
		if (first || serial_number_newer(sequence, newest))
			newest = sequence;
		first = false;
	}
	return newest;
}

uint32_t policy_slots_next_sequence(const struct policy_slots *slots)
{
	return policy_slots_newest_sequence(slots) + 1;
}

/* Gives the update up, and says why. */
static enum nf_refusal policy_slots_give_up(struct policy_slots *slots, enum nf_refusal why)
{
	slots->update.target = POLICY_SOURCE_COUNT;
	return why;
}

enum nf_refusal policy_slots_begin(struct policy_slots *slots, uint32_t total)
{
	const enum policy_source target = policy_slots_to_be_written(slots);

	if (slots->reverted)
		return policy_slots_give_up(slots, NF_REFUSAL_ORDER);
	if (total % FLASH_WORD_BYTES || total < NF_POLICY_BLOB_HEADER_BYTES || total > places[target].size)
		return policy_slots_give_up(slots, NF_REFUSAL_PAYLOAD);
	slots->update = (struct policy_update){ .target = target, .total = total };
	slots->found[target] = NF_ERR_BLOB_MAGIC;
	return flash_erase(slots->flash, places[target].sector) ? NF_REFUSAL_NONE :
								  policy_slots_give_up(slots, NF_REFUSAL_FLASH);
}

/* Are these the bytes that were written last? */
static bool policy_slots_repeated(const struct policy_slots *slots, uint32_t offset, const uint8_t *bytes, size_t count)
{
	const struct policy_update *update = &slots->update;
	const size_t kept = offset == 0 ? sizeof update->head : 0;

	return offset + count == update->written && (kept == 0 || memcmp(bytes, &update->head, kept) == 0) &&
	       memcmp(bytes + kept, policy_slots_blob_of(slots, update->target) + offset + kept, count - kept) == 0;
}

enum nf_refusal policy_slots_write(struct policy_slots *slots, uint32_t offset, const void *words, size_t bytes)
{
	struct policy_update *update = &slots->update;
	const uint8_t *from = words;

	if (update->target == POLICY_SOURCE_COUNT)
		return NF_REFUSAL_ORDER;
	if (bytes == 0 || bytes % FLASH_WORD_BYTES || bytes > update->total || offset > update->total - bytes)
		return NF_REFUSAL_PAYLOAD;
	if (policy_slots_repeated(slots, offset, from, bytes))
		return NF_REFUSAL_NONE;
	if (offset != update->written)
		return NF_REFUSAL_ORDER;
	update->written += (uint32_t)bytes;
	if (offset == 0) {
		memcpy(&update->head, from, sizeof update->head);
		from += sizeof update->head;
		offset += (uint32_t)sizeof update->head;
		bytes -= sizeof update->head;
	}
	if (!flash_program(slots->flash, places[update->target].address + offset, from, bytes))
		return policy_slots_give_up(slots, NF_REFUSAL_FLASH);
	return NF_REFUSAL_NONE;
}

/* What the image in the bank that is not run asks of a policy. Returns whether there is one. */
static bool policy_slots_other_image(const struct policy_slots *slots, struct policy_blob_identity *image)
{
	const unsigned bank = IMAGE_BANK_COUNT - 1u - slots->bank;
	const struct nf_image_header header = image_bank_header(slots->flash, bank);

	*image = policy_blob_identity_of(&header);
	return image_bank_fits(&header, bank, header.board);
}

/* Returns the error of the written blob, whose first word is still held back: checked for this image, or for the
 * other bank's if it came with that one. */
static enum nf_err policy_slots_judge(const struct policy_slots *slots, const struct policy_update *update)
{
	const uint8_t *blob = policy_slots_blob_of(slots, update->target);
	const enum nf_err why = policy_blob_check_behind(update->head, blob, update->total, &slots->running);
	struct policy_blob_identity other;

	if (why != NF_ERR_BLOB_BUILD || !policy_slots_other_image(slots, &other))
		return why;
	return policy_blob_check_behind(update->head, blob, update->total, &other);
}

enum nf_refusal policy_slots_end(struct policy_slots *slots, enum nf_err *why)
{
	const struct policy_update update = slots->update;

	*why = NF_OK;
	if (update.ended)
		return NF_REFUSAL_NONE;
	if (update.target == POLICY_SOURCE_COUNT || update.written != update.total)
		return NF_REFUSAL_ORDER;
	const uint8_t *blob = policy_slots_blob_of(slots, update.target);
	*why = policy_slots_judge(slots, &update);
	if (*why != NF_OK)
		return policy_slots_give_up(slots, NF_REFUSAL_BLOB);
	if (!serial_number_newer(policy_slots_sequence_of(blob), policy_slots_newest_sequence(slots)))
		return policy_slots_give_up(slots, NF_REFUSAL_SEQUENCE);
	if (!flash_program(slots->flash, places[update.target].address, &update.head, sizeof update.head))
		return policy_slots_give_up(slots, NF_REFUSAL_FLASH);
	slots->found[update.target] = policy_slots_check(slots, update.target);
	slots->update = (struct policy_update){ .target = POLICY_SOURCE_COUNT, .ended = true };
	return NF_REFUSAL_NONE;
}

/* --- Going back, and what there is -------------------------------------------------------------------- */
enum nf_refusal policy_slots_revert(struct policy_slots *slots)
{
	static const uint32_t none = 0;
	const enum policy_source source = slots->flown;

	if (slots->reverted)
		return NF_REFUSAL_NONE;
	if (source == POLICY_SOURCE_COUNT || slots->update.ended ||
	    !policy_slots_holds(slots, policy_slots_other(source)))
		return NF_REFUSAL_ORDER;
	if (!flash_program(slots->flash, places[source].address, &none, sizeof none))
		return NF_REFUSAL_FLASH;
	slots->found[source] = NF_ERR_BLOB_MAGIC;
	slots->reverted = true;
	return policy_slots_give_up(slots, NF_REFUSAL_NONE);
}

enum nf_err policy_slots_info(const struct policy_slots *slots, enum policy_source source,
			      struct nf_policy_blob_header *header)
{
	const enum nf_err now = policy_slots_check(slots, source);

	*header = (struct nf_policy_blob_header){ 0 };
	if (policy_slots_told(now))
		*header = policy_slots_header_of(policy_slots_blob_of(slots, source));
	return now == NF_OK && slots->found[source] == NF_ERR_POLICY ? NF_ERR_POLICY : now;
}

enum nf_err policy_slots_for_other_bank(const struct policy_slots *slots)
{
	struct policy_blob_identity image;
	enum nf_err why = NF_ERR_BLOB_MAGIC;

	if (!policy_slots_other_image(slots, &image))
		return NF_ERR_BLOB_BUILD;
	for (enum policy_source slot = POLICY_SLOT_A; slot <= POLICY_SLOT_B; ++slot) {
		const enum nf_err found = policy_slots_check_for(slots, slot, &image);
		if (found == NF_OK)
			return NF_OK;
		if (found != NF_ERR_BLOB_MAGIC)
			why = found;
	}
	return why;
}
