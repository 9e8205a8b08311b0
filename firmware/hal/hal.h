/* The one hardware boundary. main.c calls these functions and nobody else does; each chip directory
 * (hal/host, hal/stm32f7) implements all of them. Only a chip directory touches a register or a socket.
 *
 * Order of life: hal_init, hal_run. hal_run owns the program: it calls the handlers until the end. */
#ifndef NF_HAL_H
#define NF_HAL_H

#include <stddef.h>
#include <stdint.h>

#include "firmware.h"
#include "msp.h"

#define HAL_RUN (-1)            /* hal_init: go on to hal_run */
#define HAL_RECEIVER_BYTES 256  /* the most that one hal_receiver_read hands over */

/* What the board is. Filled by hal_init. */
struct hal_info {
	struct firmware_config config;  /* gyro rate, alignment */
	struct msp_identity identity;   /* its strings live as long as the program */
	uint32_t cycles_hz;             /* what hal_cycles counts in a second */
};

struct hal_handlers {
	void *context;
	/* Each gyro sample, chip axes, in order, none twice. Board: from the gyro interrupt, which nothing
	 * of the core preempts. Calls the hal_*_read and hal_*_write functions below before it returns. */
	void (*sample)(void *context, const int16_t counts[3]);
	/* Bytes from an MSP peer; returns how many reply bytes to send. Background, below `sample`. */
	size_t (*msp)(void *context, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity);
	/* A new MSP peer: a request half read from the last one is void. Same context as `msp`. */
	void (*msp_reset)(void *context);
};

/* Brings the chip up, motors stopped, no sample yet. Returns HAL_RUN, or the exit code (>= 0) with which
 * the program ends at once (host: 0 after --help, 1 after one line on stderr). Board: argc 0, argv NULL;
 * always HAL_RUN, also when the gyro does not answer: without samples nothing arms and MSP still tells why. */
int hal_init(int argc, char **argv, struct hal_info *info);

/* Runs the handlers. Board: never returns. Host: returns the program's exit code. */
int hal_run(const struct hal_handlers *handlers);

/* The core cannot fly with hal_info: say so where this chip can (host: one line on stderr; board: LED),
 * motors stopped. Board: never returns. Host: returns the program's exit code. */
int hal_refuse(enum nf_err why);

/* Receiver bytes since the last call, oldest first, at most `capacity` (the rest stays). Never waits.
 * Called from `sample`, once at the start of each control step. */
size_t hal_receiver_read(uint8_t *bytes, size_t capacity);

/* DShot values (11 bits, motor order, 0 stops) from `sample`, every gyro sample, held between control steps.
 * The chip sends them as frames (dshot_frame of dshot.h) or packets. Never waits: if the last frame is still
 * on the wire, this one is dropped. */
void hal_motors_write(const uint16_t dshot[], size_t count);

/* The control step just done, from `sample`, after hal_motors_write. A chip without a trace does nothing. */
void hal_trace_write(const struct control_trace *trace);

/* A free-running counter, wrapping at 2^32. Only measures; no decision of the core depends on it. */
uint32_t hal_cycles(void);

#endif
