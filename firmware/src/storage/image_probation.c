#include "storage/image_probation.h"

#include "common/crc32.h"
#include "policy.h"
#include "storage/image_bank.h"

#define PIECE_BYTES 8192u /* 0.5 ms at 216 MHz: ten a second check the largest image within 1.6 s */
#define STEPS (NF_IMAGE_PROBATION_MS * POLICY_CONTROL_RATE_HZ / 1000u)

void image_probation_init(struct image_probation *probation, const struct flash *flash, unsigned bank)
{
	*probation = (struct image_probation){
		.flash = flash,
		.bank = bank,
		.header = image_bank_header(flash, bank),
		.confirmed = image_bank_marks(flash, bank).confirmed,
	};
	/* What runs is for this board: it says so itself. */
	probation->present = image_bank_fits(&probation->header, bank, probation->header.board);
}

/* The bytes from `offset` on, as many as fit into a piece, but for the checksum's own. */
static void image_probation_check(struct image_probation *probation)
{
	const size_t end = probation->offset < IMAGE_CRC_OFFSET ? IMAGE_CRC_OFFSET : probation->header.image_bytes;
	const size_t left = end - probation->offset, count = left < PIECE_BYTES ? left : PIECE_BYTES;
	const uint32_t address = image_bank_places[probation->bank].address + (uint32_t)probation->offset;

	probation->crc = crc32_more(probation->crc, flash_at(probation->flash, address), count);
	probation->offset += count;
	if (probation->offset == IMAGE_CRC_OFFSET)
		probation->offset = IMAGE_CRC_END;
	if (probation->offset < probation->header.image_bytes)
		return;
	probation->checked = true;
	probation->whole = probation->crc == probation->header.crc;
}

/* Is there an image in the other bank that the boot part would start instead? */
static bool image_probation_replaceable(const struct image_probation *probation)
{
	const unsigned other = 1u - probation->bank;
	const struct image_bank_marks marks = image_bank_marks(probation->flash, other);

	return image_bank_hopeful(&marks) && image_bank_whole(probation->flash, other, probation->header.board);
}

enum image_verdict image_probation_step(struct image_probation *probation, const struct image_report *report)
{
	if (!probation->present)
		return IMAGE_STAYS;
	if (!probation->checked)
		image_probation_check(probation);
	if (report->steps != probation->steps)
		probation->ran_ms += report->ms - probation->last_ms;
	probation->steps = report->steps;
	probation->last_ms = report->ms;
	if (probation->confirmed)
		return IMAGE_STAYS;
	if (probation->checked && probation->whole && report->policy_good && report->steps >= STEPS)
		return IMAGE_CONFIRM;
	const bool failed = !report->policy_good || image_probation_spoilt(probation) ||
			    probation->ran_ms >= NF_IMAGE_PROBATION_MAX_MS;
	return failed && image_probation_replaceable(probation) ? IMAGE_REJECT : IMAGE_STAYS;
}

bool image_probation_holds(const struct image_probation *probation)
{
	return probation->present && !probation->confirmed;
}

bool image_probation_spoilt(const struct image_probation *probation)
{
	return probation->checked && !probation->whole;
}

/* The number comes first: a loss of power between the two leaves an image on probation, which tries again. */
bool image_probation_confirm(struct image_probation *probation)
{
	const struct flash *flash = probation->flash;
	const bool installed = image_bank_marks(flash, probation->bank).installed;

	if (installed && !image_bank_number(flash, probation->bank))
		return false;
	probation->confirmed = image_bank_confirm(flash, probation->bank);
	return probation->confirmed;
}

bool image_probation_reject(const struct image_probation *probation)
{
	return image_bank_reject(probation->flash, probation->bank);
}
