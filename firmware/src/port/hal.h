/* The one hardware boundary. Each chip directory (hal/host, hal/stm32f7) implements all of it; only a chip directory
 * touches a register or a socket. main.c starts and runs the chip; the core calls it through a struct hal.
 *
 * Order of life: hal_init, hal_run. hal_run owns the program: it calls the handlers until the end. */
#pragma once

#include "nf_contract.h"
#include "port/board_identity.h"
#include "port/flash.h"
#include "port/imu.h"
#include "port/log_device.h"

/* The board's measurement of the battery; the pilot's settings scale it. */
struct power_sample {
	uint16_t volts_mv, amps_mv; /* at the pins */
	bool valid;
};

struct control_trace;
struct setting_change;

#define HAL_RUN (-1)            /* hal_init: go on to hal_run */
#define HAL_RECEIVER_BYTES 256  /* the most that one receiver_read hands over */

/* Functions of the chip for the core. None waits unless its comment says so. */
struct hal {
	void *context; /* the first argument of every function */

	/* From `sample`: receiver bytes since the last call, oldest first, at most `capacity` (the rest stays). Called
	 * once, at the start of each control step. */
	size_t (*receiver_read)(void *context, uint8_t *bytes, size_t capacity);
	/* From `sample` and `gyro_silent`, every gyro sample: DShot values (11 bits, by output, 0 stops), held
	 * between control steps; `telemetry` is the frame's telemetry bit, which commands need. The chip sends them as
	 * frames (dshot_frames of dshot.h) or packets. False: the last frame, or its answers, are still on the wire, and
	 * this one is dropped. */
	bool (*motors_write)(void *context, const uint16_t dshot[], size_t count, bool telemetry);
	/* From `sample`, at the start of each control step while the setting motor_telemetry is on: of each output the
	 * word of the ESC's answer to the last frame (toolchain/contract/motors.py): 12 bits, NF_ESC_SILENT or
	 * NF_ESC_DAMAGED. Outputs that are not in use are silent. */
	void (*rotors_read)(void *context, uint16_t words[NF_MOTOR_COUNT_MAX]);
	/* From `sample`, after motors_write: the control step just done. A chip without a trace does nothing. */
	void (*trace_write)(void *context, const struct control_trace *trace);
	/* From `sample`: returns whether the control step that took `cycles` missed its deadline, the next control
	 * step's sample. On the host only if a power packet says so, because the simulator's clock stands meanwhile. */
	bool (*deadline_missed)(void *context, uint32_t cycles);

	/* A free-running counter, wrapping at 2^32. Only for measurement; no decision of the core depends on it. */
	uint32_t (*cycles)(void *context);

	/* From `background`: the battery's last measurement. */
	void (*power_read)(void *context, struct power_sample *power);
	/* From `link`: how often outputs to the motors had stuck and were set up anew since boot. */
	uint32_t (*motor_restarts)(void *context);
	void (*beeper)(void *context, bool on);
	void (*led)(void *context, bool on);
	/* Feeds the watchdog; without it the board resets within a second. */
	void (*watchdog_feed)(void *context);
	/* From `link` and `background`: resets the board, motors stopped, after the MSP replies so far are sent: hal_run
	 * then never returns (board; 2.5 s from now at the latest) or returns with success (host). Nothing may arm from
	 * here on. False, and nothing happens: this chip knows no such restart. */
	bool (*reset)(void *context, enum nf_reboot kind);

	/* From the boot of the program: what takes the log, with `device` as set; it lives as long as the program. NULL:
	 * this chip has none of that kind. */
	const struct log_device *(*log)(void *context, enum nf_log_device device);

	/* Erasing and programming wait, feed the watchdog, and stop samples meanwhile. The caller ensures that the
	 * motors are stopped. */
	struct flash flash;
};

/* Properties of the board, filled in by hal_init. */
struct hal_info {
	const struct hal *hal; /* lives as long as the program */
	enum board_alignment alignment; /* of the gyro chip found, where the settings say "board" */
	const int16_t *turn_deg; /* [3] of the board by its maker: roll, pitch, yaw; NULL: none */
	enum gyro_chip gyro_chip; /* which one that is, if it says so by gyro_identity */
	uint8_t gyro_identity; /* what the chip says it is, known or not; 0: nothing was read */
	uint8_t brown_out; /* the detector's level + 1, 1: it is off; 0: this chip tells of none */
	unsigned gyro_rate_hz; /* 0: as set; else the rate of this start, which overrides the settings */
	const struct setting_change *changes; /* to the stored settings, of this start; they live as long */
	size_t change_count;
	unsigned bank; /* that this image runs from: 0 A, 1 B; the host program stands for one in bank A */
	struct board_identity identity; /* its strings live as long as the program */
	uint32_t cycles_hz; /* what struct hal's `cycles` counts in a second */
	bool clock_inexact; /* no crystal makes it: the board may talk, but not arm */
	bool alignment_disputed; /* `alignment` is one of several that are said: arming asks for the pilot's setting */
	bool real_time; /* samples come whether the processor is ready or not: a load above 100 % loses some */
};

struct hal_handlers {
	void *context;
	/* Each gyro sample, chip axes, in order, none twice; `lost` of it says how many the processor was not ready
	 * for. Board: from the gyro interrupt, which nothing
	 * of the core preempts. Calls the functions of struct hal that say so before it returns. */
	void (*sample)(void *context, const struct imu_sample *sample);
	/* No sample came for NF_GYRO_BAD_MS. Same context as `sample`; called again each time as long passes. */
	void (*gyro_silent)(void *context);
	/* Everything that can wait, a little at a time. Below `sample`; called again and again, and at least
	 * once between two samples when the processor has time. */
	void (*background)(void *context);
	/* Bytes from the MSP peer of port 0..NF_MSP_PORT_COUNT - 1; returns how many bytes go to it. Also called with
	 * count 0 again and again while the port can send, for what is said unasked. No reply is dropped where
	 * MSP_FRAME_MAX bytes fit and `count` is MSP_REQUEST_MIN at most. Same context as `background`. */
	size_t (*link)(void *context, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply,
		       size_t capacity);
	/* The peer of that port has gone, or a new one has come: all that was the last one's is void. Called as soon
	 * as it is known. Same context as `background`. */
	void (*link_reset)(void *context, unsigned port);
	/* The peer, which may still be there, has paused: a request half read is void. Only of lines that cannot tell
	 * one peer from the next. Same context as `background`. */
	void (*link_pause)(void *context, unsigned port);
	/* Bytes from the peer were lost, the line being faster than the program: a request half read is void. Same
	 * context as `background`. */
	void (*link_lost)(void *context, unsigned port);
	/* Writes what a host is to call the board: its target and the policy that it flies, ended by 0. `capacity`: 3 at
	 * least; what does not fit is cut. Before the first of the others. */
	void (*name)(void *context, char *text, size_t capacity);
	/* Has the program more to say on that port before it takes more bytes? They stay in the line until then, and
	 * `link` is called with count 0. Same context as `background`. */
	bool (*link_busy)(void *context, unsigned port);
};

/* Brings the chip up, no sample yet, motors stopped: from here until hal_run a board sends them stop frames. Returns
 * HAL_RUN, or the exit code (>= 0) with which the program ends at once (host: 0 after --help, 1 after one line on
 * stderr). Board: argc 0, argv NULL; always HAL_RUN, also when the gyro does not answer: without samples nothing arms
 * and MSP still tells why. */
int hal_init(int argc, char **argv, struct hal_info *info);

/* Runs the handlers with gyro rate, receiver and motor protocol as in `settings`, which outlive the program.
 * Board: never returns. Host: returns the program's exit code. */
int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings);

/* The core cannot fly with hal_info and the settings: reports it (host: one line on stderr; board: LED), motors
 * stopped. Board: never returns. Host: returns the program's exit code. */
int hal_refuse(enum nf_err why);

/* The record of a fault before this boot, if there was one. hal_fault_clear deletes it. */
bool hal_fault_take(struct fault_record *record);
void hal_fault_clear(void);
