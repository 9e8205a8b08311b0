/* State of a command line session, and the services that its commands use. */
#ifndef NF_SESSION_H
#define NF_SESSION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "blackbox/blackbox.h"
#include "common/status.h"
#include "housekeeping/scheduler.h"
#include "nf_contract.h"
#include "port/board_identity.h"
#include "port/flash.h"
#include "storage/fault_log.h"
#include "storage/policy_slots.h"

#define COMMAND_LINE_BYTES 96u /* of a line, its end not counted */

enum command_line_mode { COMMAND_LINE_CLOSED, COMMAND_LINE_TYPED, COMMAND_LINE_FRAMED };

enum command_line_fault {
	COMMAND_LINE_GOOD,
	COMMAND_LINE_TOO_LONG,
	COMMAND_LINE_NO_TEXT,  /* a byte that is no character */
	COMMAND_LINE_UNENDED,  /* the frame ended before the line */
	COMMAND_LINE_LOST,
};

struct command;

/* Services for the commands; all of them belong to the background. */
struct command_line_services {
	const struct board_identity *identity;
	const struct flash *flash;
	struct nf_settings *settings;  /* as changed and perhaps not saved; not those that are flown */
	const struct policy_slots *slots;
	struct fault_log *faults;
	const struct blackbox *blackbox;
	const struct task_stats *tasks; /* [TASK_COUNT] */
	uint32_t cycles_hz;            /* of the cycles they tell */
	void *context;                 /* of the functions below */

	uint32_t (*samples)(void *context); /* gyro samples since boot; wraps */
	uint32_t (*motor_restarts)(void *context); /* as in struct hal */
	/* A session opens or ends. While one is open NF_ARMING_REASON_CLI forbids arming. NF_REFUSAL_ARMED: it must not
	 * open, and nothing has changed. */
	enum nf_refusal (*session)(void *context, bool open);
	/* These as in struct msp_services. */
	enum nf_refusal (*storing)(void *context, bool busy);
	enum nf_refusal (*motor_test)(void *context, uint32_t magic);
	enum nf_refusal (*motors)(void *context, const uint16_t values_us[], size_t count);
	enum nf_refusal (*acknowledge)(void *context);
	enum nf_refusal (*reboot)(void *context, enum nf_reboot kind);
};

/* The motor that a command runs. */
struct command_line_motor {
	bool allowed; /* `motor test on` was said */
	uint32_t allowed_since; /* gyro sample of the last motor command */
	uint8_t turning; /* number of the motor, from 1; 0: none */
	uint16_t value_us;
	uint32_t since, samples; /* it turns from that gyro sample on, for so many */
	uint32_t given; /* gyro sample at which its value was given last */
};

struct command_line {
	const struct command_line_services *services;
	uint8_t mode; /* enum command_line_mode */
	uint8_t fault; /* of the line: enum command_line_fault */
	uint8_t length; /* characters of `line` */
	bool after_cr; /* an LF would belong to the CR before it */
	bool failed; /* a command failed since the session, or its frame, began: `save` is refused */
	bool found; /* the command that runs has found something */
	bool frame_ended; /* only the output before it is outstanding */
	const struct command *running; /* has more to say; NULL: none */
	uint16_t row; /* of its output */
	uint32_t heard; /* gyro sample at which the last byte came */
	struct command_line_motor motor;
	char line[COMMAND_LINE_BYTES + 1];
};

/* Stops the motor that a command turns and closes its motor test. */
void command_stop_motor(struct command_line *cl);

/* A byte came that the command line does not take: a motor stops for it as for any. */
void command_line_stop(struct command_line *cl);

/* Forgets the line that is being typed. */
void command_line_clear(struct command_line *cl);

/* Ends the session because the peer speaks MSP or has gone: its motor stops, half a line is forgotten. */
void command_line_leave(struct command_line *cl);

#endif
