/* MSP commands that take a payload, change something, or report what only the background has. */
#ifndef NF_MSP_COMMANDS_H
#define NF_MSP_COMMANDS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "blackbox/blackbox.h"
#include "command_line/session.h"
#include "common/status.h"
#include "control/pid.h"
#include "housekeeping/scheduler.h"
#include "msp/msp_payload.h"
#include "msp/msp_peer.h"
#include "nf_contract.h"
#include "port/flash.h"
#include "storage/fault_log.h"
#include "storage/image_update.h"
#include "storage/policy_slots.h"

/* Services for the commands. All of them belong to the context that msp_serve is called from, the background; the
 * functions reach everything else. NULL: the command is refused as absent. */
struct msp_services {
	const struct flash *flash;
	struct nf_settings *settings;   /* as changed and perhaps not saved; not those that are flown */
	const struct pid_gains *pid;    /* that are built in; NULL: none are */
	struct policy_slots *slots;
	struct image_update *image;     /* the bank that is not run; NULL: there is none */
	struct fault_log *faults;
	struct blackbox *blackbox;      /* NULL: there is none */
	const struct task_stats *tasks; /* [TASK_COUNT] */
	const struct command_line_services *command_line; /* NULL: ports have none */
	uint32_t cycles_hz;             /* of the cycles they tell */
	void *context;                  /* of the functions below */

	/* busy: from now on nothing may arm, as flash is about to be written (NF_ARMING_REASON_STORING); returns
	 * NF_REFUSAL_ARMED, and nothing has changed, if the motors are armed or under test. Not busy: it is done. */
	enum nf_refusal (*storing)(void *context, bool busy);
	/* Channels [us] in the contract's order, where the receiver is MSP. Also while armed. */
	enum nf_refusal (*channels)(void *context, const uint16_t channels_us[NF_CHANNEL_COUNT]);
	/* disabled: nothing may arm until the peer calls with false (NF_ARMING_REASON_MSP). test: also opens a motor
	 * test of that peer, limited to NF_MOTOR_WIZARD_MAX if `disabled`; if that is refused, nothing changes.
	 * Not test: a test that the peer opened so is closed. */
	enum nf_refusal (*arming)(void *context, struct msp_peer *peer, bool disabled, bool test);
	/* A peer has made a request, which keeps the motor test that it opened by `arming` alive. */
	void (*heard)(void *context, const struct msp_peer *peer);
	/* Opens the motor test with the right magic, closes it with any other. */
	enum nf_refusal (*motor_test)(void *context, uint32_t magic);
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
	/* The last control step. */
	void (*record)(void *context, struct control_record *record);
};

/* Carries out `command` of `peer`, with a payload of `size` bytes, aligned to 4, and writes the reply.
 * Returns false if the command is none of these. *refusal: NF_REFUSAL_NONE, or why it was refused; the reply then is
 * enum nf_refusal (1 byte) and a detail (2 bytes, signed): of BLOB and IMAGE the enum nf_err, of LOG the enum
 * nf_log_error, of CONFLICT the index of a setting, else 0. */
bool msp_command(const struct msp_services *services, struct msp_peer *peer, const struct firmware_status *status,
		 uint16_t command, const uint8_t *payload, size_t size, struct msp_writer *reply,
		 enum nf_refusal *refusal);

#endif
