/* What MSP and the command line act by: the background's state, and its functions, which reach everything else. */
#pragma once

#include "blackbox/blackbox.h"
#include "common/status.h"
#include "control/pid.h"
#include "housekeeping/scheduler.h"
#include "nf_contract.h"
#include "port/board_identity.h"
#include "port/flash.h"
#include "sensing/rotors.h"
#include "storage/fault_log.h"
#include "storage/image_update.h"
#include "storage/policy_slots.h"

struct msp_peer;

struct services {
	const struct board_identity *identity;
	const struct flash *flash;
	struct nf_settings *settings;   /* as changed and perhaps not saved; not those that are flown */
	const struct pid_gains *pid;    /* that are built in */
	struct policy_slots *slots;
	struct image_update *image;     /* the bank that is not run */
	struct fault_log *faults;
	struct blackbox *blackbox;
	const struct rotors *rotors;    /* speeds that the ESCs tell; each number may change at any time */
	const struct task_stats *tasks; /* [TASK_COUNT] */
	uint32_t cycles_hz;             /* of the cycles they tell */
	void *context;                  /* of the functions below */

	uint32_t (*samples)(void *context); /* gyro samples since boot; wraps */
	uint32_t (*motor_restarts)(void *context); /* as in struct hal */
	/* The last control step. */
	void (*record)(void *context, struct control_record *record);
	/* A session of the command line opens or ends. While one is open NF_ARMING_REASON_CLI forbids arming.
	 * NF_REFUSAL_ARMED: it must not open, and nothing has changed. */
	enum nf_refusal (*session)(void *context, bool open);
	/* busy: from now on nothing may arm, as flash is about to be written (NF_ARMING_REASON_STORING); returns
	 * NF_REFUSAL_ARMED, and nothing has changed, if the motors are armed or under test. Not busy: it is done. */
	enum nf_refusal (*storing)(void *context, bool busy);
	/* Channels [us] in the contract's order, where the receiver is MSP. Also while armed. */
	enum nf_refusal (*channels)(void *context, const uint16_t channels_us[NF_CHANNEL_COUNT]);
	/* disabled: nothing may arm until the peer calls with false (NF_ARMING_REASON_MSP). test: also opens a motor
	 * test of that peer, limited to NF_MOTOR_WIZARD_MAX if `disabled`; if that is refused, nothing changes.
	 * Not test: a test that the peer opened, so or by motor_test, is closed. */
	enum nf_refusal (*arming)(void *context, struct msp_peer *peer, bool disabled, bool test);
	/* A peer has made a request, which keeps the motor test that it opened by `arming` alive. */
	void (*heard)(void *context, const struct msp_peer *peer);
	/* Opens the motor test with the right magic, closes it with any other. peer: with whom it ends; NULL: with
	 * nobody. */
	enum nf_refusal (*motor_test)(void *context, struct msp_peer *peer, uint32_t magic);
	/* A motor test's values, 1000 to 2000 us each; 1000 stops. */
	enum nf_refusal (*motors)(void *context, const uint16_t values_us[], size_t count);
	/* A DShot command for the motor of that index, UINT8_MAX: for all. */
	enum nf_refusal (*dshot_command)(void *context, unsigned motor, unsigned command);
	/* The gyro's calibration anew. */
	enum nf_refusal (*calibrate)(void *context);
	/* The pilot knows of all logged faults and of the refused policy. While `storing`. */
	enum nf_refusal (*acknowledge)(void *context);
	/* Starts anew, once the reply is on its way. NF_REFUSAL_ABSENT: not into what `kind` says. */
	enum nf_refusal (*reboot)(void *context, enum nf_reboot kind);
};
