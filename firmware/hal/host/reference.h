/* The firmware as a library, for callers in another language: no socket, no clock, no global state. */
#ifndef NF_HOST_REFERENCE_H
#define NF_HOST_REFERENCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "nf_contract.h"

/* The last control step. */
struct reference_trace {
	uint32_t step;       /* control steps since init, the first is 0 */
	float setpoint[3];   /* rad/s, body axes */
	float gyro[3];       /* rad/s, body axes, as the policy used it */
	float throttle;      /* 0..1 */
	uint8_t armed;
	uint8_t motors;      /* used entries of dshot */
	uint16_t pad;        /* 0 */
	uint16_t dshot[NF_MOTOR_COUNT_MAX];
};

/* Bytes of one instance. The caller allocates them, aligned to 8, and does not move them after init. */
size_t reference_size(void);

/* Boots, with erased flash and these settings, each a NAME=VALUE. Returns 0, or a negative enum nf_err:
 * NF_ERR_SETTINGS if one of them is none. */
int reference_init(void *self, unsigned gyro_hz, const char *const settings[], size_t count);

/* One receiver packet: taken up at the next control step. */
void reference_receiver(void *self, const uint16_t channels_us[NF_CHANNEL_COUNT]);

/* The battery from now on, and how long each control step takes [us], 0: no time. Until then: full. */
void reference_power(void *self, double volts, double amps, double control_us);

/* One gyro sample: body rates [rad/s] and specific force [m/s^2], axes forward, left, up. Writes one DShot value a motor
 * and returns whether one of them is another than `dshot` held. */
bool reference_sample(void *self, const double rates[3], const double force[3], uint16_t dshot[]);

/* The gyro has said nothing for NF_GYRO_BAD_MS. Writes one DShot value a motor. */
void reference_silent(void *self, uint16_t dshot[]);

void reference_trace(const void *self, struct reference_trace *out);

/* MSP bytes in by that port, perhaps none, bytes for its peer out; returns how many. */
size_t reference_link(void *self, unsigned port, const uint8_t *in, size_t n, uint8_t *out, size_t cap);

/* Another peer is on that port. */
void reference_link_reset(void *self, unsigned port);

/* The peer of that port has paused; bytes of its were lost. */
void reference_link_pause(void *self, unsigned port);
void reference_link_lost(void *self, unsigned port);

/* Is there more to say on that port before it takes more bytes? */
bool reference_link_busy(void *self, unsigned port);

#endif
