/* The firmware core: gyro counts and receiver bytes in, DShot values out. No register, no clock, no heap.
 *
 * Time is the gyro sample index. firmware_receive and firmware_sample are called from one context (the
 * gyro interrupt); firmware_status may be called from the background below it. */
#ifndef NF_FIRMWARE_H
#define NF_FIRMWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "arming.h"
#include "gyro.h"
#include "imu.h"
#include "mixer.h"
#include "nf_contract.h"
#include "nf_err.h"
#include "observation.h"
#include "policy.h"
#include "rates.h"
#include "receiver.h"
#include "status.h"

struct firmware_config {
	unsigned gyro_rate_hz;          /* 1000, 2000, 4000 or 8000, a multiple of POLICY_CONTROL_RATE_HZ */
	enum board_alignment alignment;
	const struct nf_settings *settings; /* must outlive the firmware */
};

struct firmware {
	_Alignas(8) float weights[POLICY_WEIGHT_COUNT]; /* the policy's working copy: DTCM on the board */
	struct policy policy;
	struct gyro gyro;
	struct receiver receiver;
	struct rates rates;
	struct arming arming;
	struct observation observation;
	struct mixer mixer;
	uint32_t control_divider;       /* gyro samples a control step */
	uint32_t until_control;         /* gyro samples until the next one, 0: the next sample is one */
	uint32_t control_steps;         /* since boot */
	uint32_t grace_left;            /* gyro samples until arming is allowed */
	float action[POLICY_ACTION_COUNT]; /* the policy's last output */
	bool policy_good;               /* cleared for good by a failed self-test or a refused output */
	struct firmware_status status;  /* written at control steps only */
	volatile uint32_t published;    /* counts writes of status */
};

/* Copies the weights, replays the policy's self-test, starts disarmed.
 * NF_ERR_GYRO_RATE, NF_ERR_ALIGNMENT, NF_ERR_IDLE, NF_ERR_OBSERVATION: do not run this firmware.
 * NF_ERR_POLICY: runs and answers, but never arms. */
enum nf_err firmware_init(struct firmware *fw, const struct firmware_config *config);

/* Is the next sample a control step? The first one is. */
bool firmware_control_due(const struct firmware *fw);

/* Receiver bytes, any number of any value; called once before each control step's sample,
 * with count 0 when the line was silent. */
void firmware_receive(struct firmware *fw, const uint8_t *bytes, size_t count);

/* One gyro sample (chip axes). Writes the DShot value of each motor; between control steps they are held. */
void firmware_sample(struct firmware *fw, const struct imu_sample *sample, uint16_t dshot[POLICY_ACTION_COUNT]);

/* The last control step. Same context as firmware_sample. */
const struct control_trace *firmware_trace(const struct firmware *fw);

/* A consistent copy of the status, also when a gyro interrupt falls into the copying. */
void firmware_status(const struct firmware *fw, struct firmware_status *status);

#endif
