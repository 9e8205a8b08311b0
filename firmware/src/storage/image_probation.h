/* The trial of the image that runs: a new one must show that it runs well before it may arm and before the boot part
 * relies on it; and each one, new or not, compares its bank's checksum once after the boot, a piece at a time.
 *
 * On probation it has the control steps of NF_IMAGE_PROBATION_MS to go, with a policy that passes its self-test, before
 * it confirms itself; one that the ROM installed then numbers itself as well. It gives up when its policy is bad, its
 * checksum is wrong, or it was not confirmed after NF_IMAGE_PROBATION_MAX_MS in which the gyro spoke: it rejects itself,
 * and after a restart the other bank's image flies. Where that holds none that can be started it stays, unarmed, and
 * goes on trying.
 *
 * A silent gyro stops the clock: the fault may be the chip's, and neither image would do better. The board then stays on
 * the ground with the reasons PROBATION and GYRO_BAD, and answers MSP. If it is the image's fault, two more starts
 * bring the old one back, as the boot part counts the starts of an image that was not confirmed; if it is the chip's,
 * the image confirms itself once that is mended. */
#pragma once

#include "nf_contract.h"
#include "port/flash.h"

struct image_probation {
	const struct flash *flash;
	unsigned bank;                 /* that the image runs from */
	struct nf_image_header header;
	bool present;                  /* there is an image in that bank: not so on the host */
	bool confirmed;
	bool checked, whole;           /* the checksum has been compared, and is right */
	size_t offset;                 /* of the image's next byte to check */
	uint32_t crc;                  /* of those before */
	uint32_t steps;                /* control steps at the last call */
	uint32_t last_ms, ran_ms;      /* time of the last call; how long steps went on */
};

/* State of the firmware that the probation judges. */
struct image_report {
	bool policy_good;
	uint32_t steps; /* control steps since boot */
	uint32_t ms;    /* since boot */
};

enum image_verdict {
	IMAGE_STAYS,   /* nothing to do */
	IMAGE_CONFIRM, /* call image_probation_confirm */
	IMAGE_REJECT,  /* call image_probation_reject, then restart */
};

/* bank: that the image runs from. */
void image_probation_init(struct image_probation *probation, const struct flash *flash, unsigned bank);

/* Does the next piece. To be called about ten times a second. */
enum image_verdict image_probation_step(struct image_probation *probation, const struct image_report *report);

/* Is it on probation? Then nothing may arm. */
bool image_probation_holds(const struct image_probation *probation);

/* Was its checksum wrong? Then nothing may arm either. */
bool image_probation_spoilt(const struct image_probation *probation);

/* These write flash: nothing can arm meanwhile. False: flash did not take it. */
bool image_probation_confirm(struct image_probation *probation);
bool image_probation_reject(const struct image_probation *probation);
