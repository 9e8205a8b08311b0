/* The firmware core: gyro counts and receiver bytes in, DShot values out. No register, no clock, no heap.
 *
 * Time is the gyro sample index. Functions are called from the gyro interrupt, unless they say "from the background",
 * which runs below it. */
#pragma once

#include "blackbox/log_record.h"
#include "common/status.h"
#include "control/chirp.h"
#include "control/control.h"
#include "control/pid.h"
#include "motors/dshot_command.h"
#include "motors/motor_test.h"
#include "nf_contract.h"
#include "port/imu.h"
#include "receiver/rates.h"
#include "receiver/receiver.h"
#include "safety/crash.h"
#include "safety/plausibility.h"
#include "safety/safety.h"
#include "safety/takeoff.h"
#include "safety/turning.h"
#include "safety/weak_motor.h"
#include "sensing/attitude.h"
#include "sensing/filters.h"
#include "sensing/gyro.h"
#include "sensing/gyro_mean.h"
#include "sensing/rotors.h"
#include "sensing/rpm_filter.h"

#define FIRMWARE_ANY_TILT (-2.0f) /* below every cosine */

struct firmware_config {
	unsigned gyro_rate_hz;              /* one of NF_GYRO_RATES_HZ, a multiple of POLICY_CONTROL_RATE_HZ */
	enum board_alignment alignment;
	const int16_t *turn_deg;            /* [3] of the board by its maker: roll, pitch, yaw; NULL: none */
	enum gyro_chip gyro_chip;           /* whose temperature is told */
	const struct nf_settings *settings; /* must outlive the firmware, as all that follows */
	const float *weights;               /* [POLICY_WEIGHT_COUNT], 8-byte aligned, where they are read in flight */
	const struct nf_policy_blob_header *policy; /* of the blob that the weights are of; NULL: none is good */
	bool policy_good;                   /* checked and self-tested */
	const struct pid_gains *pid;
};

/* Inputs from the background. A control step takes them once, at its begin, so that each input belongs to exactly one
 * step. */
struct firmware_edges {
	uint32_t forbidden;             /* arming reasons that the background knows */
	float voltage_gain;             /* of the PID, for the battery's voltage */
	uint32_t flags;                 /* enum log_edge */
};

/* The same on every target, its pointers included (held.h): a log holds it. */
struct firmware {
	struct gyro gyro;
	struct rpm_filter rpm;
	struct filters filters;              /* behind them */
	struct gyro_mean mean;               /* behind them */
	struct rotors rotors;
	struct attitude attitude;
	struct receiver receiver;
	struct rates rates;
	struct safety safety;
	struct takeoff takeoff;
	struct turning turning;
	struct plausibility plausibility;
	struct crash crash;
	struct weak_motor weak_motor;
	struct control control;
	struct chirp chirp;
	struct motor_test motor_test;        /* the background asks it for tests */
	struct dshot_command dshot_command;  /* and this for commands */
	uint8_t outputs[POLICY_ACTION_COUNT]; /* of each motor, 0 to POLICY_ACTION_COUNT - 1, none twice */
	bool rewired;                   /* a motor has another output than its own number */
	enum gyro_chip gyro_chip;
	uint32_t gyro_rate_hz;
	uint32_t control_divider;       /* gyro samples a control step */
	uint32_t until_control;         /* gyro samples until the next one, 0: the next sample is one */
	uint32_t overdue;               /* lost samples since it was due, less than control_divider */
	volatile uint32_t control_steps; /* since boot */
	uint32_t grace_left;            /* gyro samples until arming is allowed */
	float level_cosine;             /* of the largest tilt that arms; FIRMWARE_ANY_TILT: any, known or not */
	float failsafe_throttle;        /* 0..1 */
	bool rested;                    /* take-off, turning, plausibility and crash know nothing of a flight */
	bool doubts;                    /* the policy's outputs must be plausible */
	bool trial;                     /* the policy flies only while the switch of its trial is held */
	bool pid_wanted;                /* by the switches, as last heard */
	enum nf_gyro_health health;     /* of the last sample */
	/* The background's, for the next control step. */
	volatile uint32_t forbidden;    /* arming reasons that it knows */
	volatile float voltage_gain;    /* of the PID */
	uint16_t posted_us[NF_CHANNEL_COUNT]; /* channels */
	union {
		struct {
			volatile bool posted;       /* they wait to be taken up */
			volatile bool acknowledged; /* by the pilot */
			volatile bool calibrate;    /* the gyro anew */
			volatile uint8_t weights;   /* enum firmware_weights */
		};
		volatile uint32_t handed;           /* 0: none of it */
	};
	/* As the control step under way has taken it, or the last one had. */
	bool begun;                     /* it has taken it */
	bool heard;                     /* a receiver frame waits to be evaluated */
	struct firmware_edges edges;
	uint32_t silences;              /* since the last control step, as flags of its edges */
	struct firmware_status status;  /* written at control steps only */
	volatile uint32_t published;    /* counts writes of status */
	volatile uint32_t window;       /* what `samples` was after the last control step */
	volatile uint32_t samples;      /* gyro samples since boot, lost ones and the time of silences included */
};

/* Starts disarmed, the battery not known. NF_ERR_GYRO_RATE, NF_ERR_ALIGNMENT, NF_ERR_IDLE, NF_ERR_OBSERVATION: do
 * not run this firmware. */
enum nf_err firmware_init(struct firmware *fw, const struct firmware_config *config);

/* Fills in the status that MSP reports beside the trace. For firmware_init.c alone. */
void firmware_report(struct firmware *fw);

/* Flies a control step without a sample, to measure how long controller and checks take: with the PID, or the policy. Only
 * between two firmware_init, as it leaves anything behind. */
void firmware_rehearse_init(struct firmware *fw, bool pid);

/* Is the next sample a control step? The first one is. */
bool firmware_control_due(const struct firmware *fw);

/* Accounts for `count` samples of the chip, up to 65,535, that were not processed: time advances by as much. Called
 * before firmware_control_due of the sample that was taken after them. That sample makes up for one control step that
 * was due among them; the following steps keep their times. */
void firmware_lost(struct firmware *fw, uint32_t count);

/* Receiver bytes, any number of any value; called once before each control step's sample, with count 0 when the line
 * was silent. */
void firmware_receive(struct firmware *fw, const uint8_t *bytes, size_t count);

/* The words of the ESCs, by output, called before each control step's sample where the setting motor_telemetry is on. */
void firmware_rotors(struct firmware *fw, const uint16_t words[NF_MOTOR_COUNT_MAX]);

/* One gyro sample (chip axes). Writes the DShot value of each output; between control steps they are held. Returns
 * the telemetry bit of their frames. */
bool firmware_sample(struct firmware *fw, const struct imu_sample *sample, uint16_t dshot[POLICY_ACTION_COUNT]);

/* No sample came for NF_GYRO_BAD_MS: as much time has passed. Writes the DShot values as firmware_sample does. */
void firmware_gyro_silent(struct firmware *fw, uint16_t dshot[POLICY_ACTION_COUNT]);

/* Did the last control step end after its deadline, or were samples lost since the one before? Called after each. */
void firmware_deadline(struct firmware *fw, bool missed);

/* Fills in what the last control step was given and what came of it, as far as the firmware knows: all but its samples, its time,
 * lost samples and the receiver's bytes. Called after each. */
void firmware_log(const struct firmware *fw, struct log_record *record);

/* The last control step. */
const struct control_trace *firmware_trace(const struct firmware *fw);

/* From the background: does `reason` forbid arming? BATTERY_UNKNOWN, FAULT and STORING are asked of it. It takes effect
 * with the next control step; armed motors stay armed. */
void firmware_forbid(struct firmware *fw, enum nf_arming_reason reason, bool holds);

/* From the background: the pilot knows why the policy was refused in flight. It may fly again, unless the next control
 * step finds the motors armed: then nothing happens. */
void firmware_acknowledge(struct firmware *fw);

/* From the background, while nothing can arm: rates and PID are those of `settings` from the next control step on. */
void firmware_tune_init(struct firmware *fw, const struct nf_settings *settings);

/* From the background: the gyro is calibrated anew from the next control step on, unless that finds the motors armed. Until
 * it is, nothing arms; rates go on with the bias from before. */
void firmware_calibrate(struct firmware *fw);

/* From the background: are the policy's weights what flash has? If not, the PID takes over at the next control step, and the
 * policy is bad until they are again; only while nothing can arm. */
void firmware_weights(struct firmware *fw, bool good);

/* From the background: the battery's voltage, filtered [V], 0 where it is not known. The PID flies by it. */
void firmware_power(struct firmware *fw, float voltage);

/* From the background: do the motors obey a pilot? */
bool firmware_armed(const struct firmware *fw);

/* From the background: are the motors stopped, with no test and no command under way? */
bool firmware_stopped(const struct firmware *fw);

/* From the background: channels [us] that came by MSP, for the next control step. NF_REFUSAL_ORDER: the last ones have
 * not been taken yet. NF_REFUSAL_ABSENT: the receiver is not MSP. */
enum nf_refusal firmware_post(struct firmware *fw, const uint16_t channels_us[NF_CHANNEL_COUNT]);

/* From the background: gyro samples since boot, lost ones and those that silence swallowed included. Wraps. */
uint32_t firmware_samples(const struct firmware *fw);

/* From the background: a consistent copy of the last control step. `cycles`: the variable in which the caller of
 * firmware_sample stores the duration of the step before the background continues. */
void firmware_record(const struct firmware *fw, const uint32_t *cycles, struct control_record *record);

/* From the background: a consistent copy of the status, also when a gyro interrupt falls into the copying. */
void firmware_status(const struct firmware *fw, struct firmware_status *status);
