/* The firmware as a library, for callers in another language: no socket, no clock, no global state. */
#pragma once

#include "blackbox/log_record.h"
#include "hal/host/replay.h"
#include "nf_contract.h"

/* Bytes of one instance. The caller allocates them, aligned to 8, and does not move them after init. */
size_t reference_size(void);

/* Boots, with flash as installed and these settings, each a NAME=VALUE. Returns 0, or a negative enum nf_err:
 * NF_ERR_SETTINGS if one of them is none. */
int reference_init(void *self, unsigned gyro_hz, const char *const settings[], size_t count);

/* One receiver packet: taken up at the next control step. */
void reference_receiver(void *self, const uint16_t channels_us[NF_CHANNEL_COUNT]);

/* The battery from now on, and how long each control step takes [us], 0: no time. Until then: full. */
void reference_power(void *self, double volts, double amps, double control_us);

/* What each ESC, by output, answered to the last frame: for the next control step. Not called before one: all are silent. */
void reference_rotors(void *self, const uint16_t words[NF_MOTOR_COUNT_MAX]);

/* One gyro sample: body rates [rad/s] and specific force [m/s^2], axes forward, left, up. Writes one DShot value a motor
 * and returns whether one of them is another than `dshot` held. */
bool reference_sample(void *self, const double rates[3], const double force[3], uint16_t dshot[]);

/* Bytes of the log, at most `capacity`, since the last call; returns how many. What is not taken soon enough is dropped. Nobody
 * calls it: no log is written. */
size_t reference_blackbox(void *self, uint8_t *bytes, size_t capacity);

/* Reports that no gyro sample came for NF_GYRO_BAD_MS. Writes one DShot value a motor. */
void reference_silent(void *self, uint16_t dshot[]);

void reference_trace(const void *self, struct reference_trace *out);

/* Results of the last control step besides its trace. */
struct reference_answer {
	float observation[NF_OBSERVATION_COUNT_MAX]; /* what the policy was given last; then 0 */
	float action[NF_MOTOR_COUNT_MAX];            /* the controller's last answer, before the throttle; then 0 */
	uint32_t arming_reasons;                     /* bit field of enum nf_arming_reason, 0 when armed */
	uint8_t state, stop_cause, fallback_cause, pid_flies;
};

void reference_answer(const void *self, struct reference_answer *out);

/* From now on records go to the caller, by reference_record, instead of the blackbox. */
void reference_watch(void *self);

/* The oldest record of a control step that was not taken yet; false: there is none. */
bool reference_record(void *self, struct log_record *record);

/* The control path's state, as a log begins with it: bytes, and what they mean (firmware_layout). */
size_t reference_state_size(void);
uint32_t reference_layout(void);

/* Copies the state. Returns false if samples came since the last control step; only the next one can be asked. */
bool reference_state(const void *self, uint8_t *bytes);

/* Goes on from another one's state; false: it has another size or layout, and nothing is changed. The settings must be the
 * same. */
bool reference_restore(void *self, const uint8_t *bytes, size_t count, uint32_t layout);

/* One control step again, and the samples before it: 0, or a negative enum replay_result. Writes one DShot value a motor. The
 * background does not run: only the control path is that of the flight. */
int reference_replay(void *self, const struct replay_step *step, uint16_t dshot[]);

/* MSP bytes in by that port, perhaps none, bytes for its peer out; returns how many. */
size_t reference_link(void *self, unsigned port, const uint8_t *in, size_t n, uint8_t *out, size_t cap);

/* Another peer is on that port. */
void reference_link_reset(void *self, unsigned port);

/* The peer of that port has paused; bytes from it were lost. */
void reference_link_pause(void *self, unsigned port);
void reference_link_lost(void *self, unsigned port);

/* Is there more to say on that port before it takes more bytes? */
bool reference_link_busy(void *self, unsigned port);
