/* Background: the boot, then the tasks that can wait. It runs below the gyro interrupt; the two exchange data only
 * through the functions of firmware.h that say so. */
#ifndef NF_BACKGROUND_H
#define NF_BACKGROUND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "blackbox/blackbox.h"
#include "common/status.h"
#include "firmware.h"
#include "housekeeping/alert.h"
#include "housekeeping/battery.h"
#include "housekeeping/scheduler.h"
#include "msp/msp_commands.h"
#include "msp/msp_port.h"
#include "nf_contract.h"
#include "port/flash.h"
#include "port/hal.h"
#include "port/power_sample.h"
#include "receiver/gesture.h"
#include "storage/fault_log.h"
#include "storage/image_probation.h"
#include "storage/image_update.h"
#include "storage/policy_slots.h"
#include "storage/settings.h"
#include "storage/settings_store.h"

struct background_config {
	const struct hal *hal;
	struct firmware *firmware;          /* started by background_start */
	float *weights; /* [POLICY_WEIGHT_COUNT], 8-byte aligned: filled with the flown policy's */
	struct task_stats *stats; /* [TASK_COUNT], by enum nf_task */
	enum board_alignment alignment; /* of the gyro chip, where the settings say "board" */
	enum gyro_chip gyro_chip;
	uint8_t gyro_identity, brown_out; /* as in struct hal_info */
	const struct pid_gains *pid;
	const struct board_identity *identity;
	unsigned bank; /* of images, that this one runs from */
	const struct fault_record *fault; /* what ended the run before; NULL: no fault did */
	const struct setting_change *changes;
	size_t change_count;
	unsigned gyro_rate_hz; /* of this start; 0: as set */
	uint32_t cycles_hz; /* of hal->cycles */
	bool clock_inexact, alignment_disputed, real_time; /* as in struct hal_info */
	struct log_ring *log; /* of control steps; NULL: they are not recorded */
};

struct background {
	struct background_config config;
	struct nf_settings settings; /* as flown: of this boot */
	bool mended; /* some of what is stored is not flown */
	struct nf_settings edited; /* as stored, with changes that may not be saved yet */
	struct nf_settings tuned; /* of those flown at once: as edited when background_tune last took them */
	struct policy_slots slots;
	size_t weights_checked; /* those before this one, since the check last began at the first */
	bool weights_bad; /* not what flash has */
	bool weights_lost; /* flash has no good ones either */
	struct image_update image;
	struct fault_log faults;
	struct image_probation probation;
	struct scheduler scheduler;
	struct battery battery;
	struct alert alert;
	struct gesture gesture;
	struct blackbox blackbox;
	struct log_snapshot snapshot; /* of the firmware, before a log */
	struct firmware kept; /* its bytes */
	uint32_t controller_cycles; /* what a control step takes longer while armed, at most; 0: not measured */
	bool flying, flown; /* armed when the load was looked at last; ever since boot */
	uint32_t overloaded; /* runs of the storage task until a load above 100 % is forgiven */
	bool heard; /* the receiver, since boot */
	bool refused; /* a policy, when alerts were last looked at */
	uint32_t refused_since_ms;
	bool rebooting; /* was asked to, and is about to */
	struct msp_services services;
	struct command_line_services commands;
	unsigned sessions; /* of command lines that are open */
	struct msp_port ports[NF_MSP_PORT_COUNT];
};

/* Boots: loads the settings, chooses the policy, starts the firmware, logs the boot. `config` and the data that it
 * points to must outlive the background. NF_ERR_SETTINGS: the changes are beyond limits or contradict the other
 * settings. For any error, as for those of firmware_init, do not run. */
enum nf_err background_start(struct background *background, const struct background_config *config);

/* Runs at most one task that is due; called again and again. */
void background_step(struct background *background);

/* The firmware's status with the background's part filled in. */
void background_status(const struct background *background, struct firmware_status *status);

/* Takes bytes from the peer of that port, possibly none, and writes the output for it. Returns the bytes written. */
size_t background_link(struct background *background, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply,
		       size_t capacity);

/* The peer of that port has disconnected, or another one has connected. */
void background_link_reset(struct background *background, unsigned port);

/* The peer paused so long that a partly read request is discarded. */
void background_link_pause(struct background *background, unsigned port);

/* Returns whether output for the peer is pending, so that no more bytes may be read yet. */
bool background_link_busy(const struct background *background, unsigned port);

/* Bytes from the peer were lost. */
void background_link_lost(struct background *background, unsigned port);

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

#endif
