/* DShot commands: values 1..47 tell a motor's controller something. Only with the motors stopped, and only those of
 * enum nf_dshot_command. A command is a sequence on the wire: stops, the command as often as the controllers require,
 * stops while they execute it. */
#pragma once

#include "common/held.h"
#include "nf_contract.h"

struct dshot_command {
	volatile uint32_t asked;  /* outputs and command, 0: none; written by dshot_command_ask, taken by the step */
	volatile uint32_t left;   /* gyro samples of the sequence, 0: none is under way */
	uint32_t from, until;     /* the command is sent while `left` is in [until, from) */
	uint8_t command;          /* enum nf_dshot_command */
	uint8_t wanted;           /* bit field of the outputs that get it */
	uint8_t next;             /* command that they get after it; 0: none */
	uint8_t motor_count;
	HELD(const uint8_t *, outputs); /* of each motor */
	uint32_t gyro_rate_hz;
};

/* motor_count at most NF_MOTOR_COUNT_MAX. outputs: [motor_count], where each motor's controller is wired to, a permutation
 * of 0 to motor_count - 1; it must outlive the commands. */
void dshot_command_init(struct dshot_command *self, unsigned gyro_rate_hz, unsigned motor_count,
			const uint8_t outputs[]);

/* From the background: asks for `command` to the motor of that index, or to all (NF_DSHOT_ALL_MOTORS). Bits 8 to 15 of
 * `command` are 0 or NF_DSHOT_COMMAND_SAVE, which is then sent after it. `stopped`: the motors are stopped and not
 * under test. NF_DSHOT_COMMAND_STOP ends what is under way and is never refused. Refusals: PAYLOAD for an unsupported
 * command, INDEX for no such motor, ARMED, ORDER while another is under way. */
enum nf_refusal dshot_command_ask(struct dshot_command *self, unsigned command, unsigned motor, bool stopped);

/* One gyro sample, in the interrupt: while a sequence is under way, writes each output's value. Returns the telemetry
 * bit that these frames need. Not `stopped`: the sequence is over and `dshot` left alone. */
bool dshot_command_step(struct dshot_command *self, bool stopped, uint16_t dshot[]);

/* The frames of the last step, which asked for the telemetry bit, were not sent: the next one is as that. The wire is busy
 * with answers at some samples, and each command wants its count of frames. */
void dshot_command_unsent(struct dshot_command *self);

/* Returns whether a command is requested or in progress; nothing should arm until it has ended. */
bool dshot_command_busy(const struct dshot_command *self);
