/* Background: the boot, then the tasks that can wait. It runs below the gyro interrupt; the two exchange data only
 * through the functions of firmware.h that say so. */
#pragma once

#include "blackbox/blackbox.h"
#include "common/status.h"
#include "firmware.h"
#include "housekeeping/alert.h"
#include "housekeeping/battery.h"
#include "housekeeping/scheduler.h"
#include "msp/msp_port.h"
#include "nf_contract.h"
#include "port/hal.h"
#include "receiver/gesture.h"
#include "storage/fault_log.h"
#include "storage/image_probation.h"
#include "storage/image_update.h"
#include "storage/policy_slots.h"
#include "storage/settings.h"

struct background_config {
	struct hal_info board;
	struct firmware *firmware;        /* started by background_start */
	float *weights;                   /* [POLICY_WEIGHT_COUNT], 8-byte aligned: filled with the flown policy's */
	struct task_stats *stats;         /* [TASK_COUNT], by enum nf_task */
	const struct pid_gains *pid;
	const struct fault_record *fault; /* what ended the run before; NULL: no fault did */
	struct log_ring *log;             /* of control steps; NULL: they are not recorded */
};

/* What is used most comes first, where short instructions reach it. */
struct background {
	bool mended; /* some of what is stored is not flown */
	bool weights_bad; /* not what flash has */
	bool weights_lost; /* flash has no good ones either */
	bool flying, flown; /* armed when the load was looked at last; ever since boot */
	bool heard; /* the receiver, since boot */
	bool refused; /* a policy, when alerts were last looked at */
	bool rebooting; /* was asked to, and is about to */
	uint32_t refused_since_ms;
	uint32_t overloaded; /* runs of the storage task until a load above 100 % is forgiven */
	uint32_t controller_cycles; /* what a control step takes longer while armed, at most; 0: not measured */
	size_t weights_checked; /* those before this one, since the check last began at the first */
	unsigned sessions; /* of command lines that are open */
	uint8_t escs_asked; /* times that ESCs which tell their speed alone were asked for more */
	uint8_t escs_wait; /* runs of the storage task until the next time */
	struct background_config config;
	struct scheduler scheduler;
	struct battery battery;
	struct alert alert;
	struct gesture gesture;
	struct policy_slots slots;
	struct image_update image;
	struct fault_log faults;
	struct image_probation probation;
	struct services services;
	struct nf_settings settings; /* as flown: of this boot */
	struct nf_settings edited; /* as stored, with changes that may not be saved yet */
	uint32_t motor_key; /* of this boot */
	struct nf_settings tuned; /* of those flown at once: as edited when background_tune last took them */
	struct blackbox blackbox;
	struct log_snapshot snapshot; /* of the firmware, before a log */
	struct msp_port ports[NF_MSP_PORT_COUNT];
	struct firmware kept; /* its bytes */
};

/* Boots: loads the settings, chooses the policy, starts the firmware, logs the boot. `config` and the data that it
 * points to must outlive the background. NF_ERR_SETTINGS: the changes are beyond limits or contradict the other
 * settings. For any error, as for those of firmware_init, do not run. */
enum nf_err background_start(struct background *background, const struct background_config *config);

/* Runs at most one task that is due; called again and again. */
void background_step(struct background *background);

/* The firmware's status with the background's part filled in. */
void background_status(const struct background *background, struct firmware_status *status);

/* Writes the board's target and the policy's name, "none" where none is good; ended by 0. */
void background_name(const struct background *background, char *text, size_t capacity);

/* Takes bytes from the peer of that port, possibly none, and writes the output for it. Returns the bytes written. */
size_t background_link(struct background *background, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply,
		       size_t capacity);

/* --- For the background's own files ------------------------------------------------------------------------------ */
/* background_start.c: the settings of this boot, as stored, then changed; then the policy for them, and the firmware. */
enum nf_err background_boot(struct background *background);

/* background_services.c: fills in what MSP and the command line act by. */
void background_offer_services(struct background *background);
/* Flash is written only between background_storing(.., true), if that returns NF_REFUSAL_NONE, and (.., false): nothing can
 * arm meanwhile. `context` is the background. */
enum nf_refusal background_storing(void *context, bool busy);
enum nf_refusal background_acknowledge(void *context);
enum nf_refusal background_reboot(void *context, enum nf_reboot kind);

/* background_blackbox.c: initialises the blackbox, once settings, slots and firmware are final; then runs a part of
 * its work each round. */
void background_init_blackbox(struct background *background);
void background_run_blackbox(struct background *background);
