/* What can go wrong when the world hands the firmware something it cannot fly with. */
#ifndef NF_ERR_H
#define NF_ERR_H

enum nf_err {
	NF_OK = 0,
	NF_ERR_GYRO_RATE = -1,   /* gyro rate unknown, or no multiple of the policy's control rate */
	NF_ERR_ALIGNMENT = -2,   /* no such gyro alignment */
	NF_ERR_IDLE = -3,        /* idle outside [0, 1) */
	NF_ERR_OBSERVATION = -4, /* the policy asks for a block that this core does not compute */
	NF_ERR_POLICY = -5,      /* the self-test vectors do not come out bit for bit */
};

#endif
