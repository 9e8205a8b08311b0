/* Errors of input that the firmware cannot fly with. */
#ifndef NF_ERR_H
#define NF_ERR_H

enum nf_err {
	NF_OK = 0,
	NF_ERR_GYRO_RATE = -1,   /* gyro rate unknown, or no multiple of the policy's control rate */
	NF_ERR_ALIGNMENT = -2,   /* no such gyro alignment */
	NF_ERR_IDLE = -3,        /* idle outside [0, 1) */
	NF_ERR_OBSERVATION = -4, /* the policy asks for a term that this core does not compute */
	NF_ERR_POLICY = -5,      /* the self-test's results differ in a bit */

	/* A policy blob, in the order of the checks. */
	NF_ERR_BLOB_SHORT = -6,         /* fewer bytes than a header and a CRC */
	NF_ERR_BLOB_MAGIC = -7,         /* not a blob: an erased slot, for instance */
	NF_ERR_BLOB_LAYOUT = -8,        /* of another layout version */
	NF_ERR_BLOB_SIZE = -9,          /* sizes that contradict each other or exceed the bytes; no self-test */
	NF_ERR_BLOB_CRC = -10,          /* damaged */
	NF_ERR_BLOB_RATE = -11,         /* trained for another control rate */
	NF_ERR_BLOB_FILTERS = -12,      /* trained behind other gyro filters */
	NF_ERR_BLOB_ARCHITECTURE = -13, /* weights for other code */
	NF_ERR_BLOB_IDLE = -14,         /* an idle that no policy is trained with */

	NF_ERR_SETTINGS = -15, /* beyond their limits, or they contradict each other */

	/* -16 was a policy older than its image, before images named their policies. */

	/* An image for a bank, in the order of the checks. */
	NF_ERR_IMAGE_MAGIC = -17,  /* not an image */
	NF_ERR_IMAGE_LAYOUT = -18, /* of another layout version */
	NF_ERR_IMAGE_BOARD = -19,  /* for another board */
	NF_ERR_IMAGE_BANK = -20,   /* linked for another bank */
	NF_ERR_IMAGE_SIZE = -21,   /* a size that no image has, or that does not fit the bank */
	NF_ERR_IMAGE_HEADER = -22, /* flash has another header than the one that was told */
	NF_ERR_IMAGE_CRC = -23,    /* damaged, or not all of it is there */
	NF_ERR_IMAGE_SHA256 = -24, /* whole, but not the image of that SHA-256 */

	/* A policy blob again, behind NF_ERR_BLOB_IDLE. */
	NF_ERR_BLOB_MIX = -25,   /* a mix that this firmware does not know */
	NF_ERR_BLOB_MODEL = -26, /* a model of no aircraft, one too many, or none where a term needs it */

	NF_ERR_BLOB_BUILD = -27, /* it came with another image; behind NF_ERR_BLOB_CRC */
};

#endif
