/* The command line of one peer: typed bytes in, text out, a line at a time as there is room. Knows no device and no
 * clock: time is the gyro sample index.
 *
 * A typed session is opened by COMMAND_LINE_OPENS and echoes; a framed one, COMMAND_LINE_FRAME text LF
 * COMMAND_LINE_FRAME_END, is answered by lines between the same two bytes, and ends then. While a session is open
 * nothing can arm. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "command_line/session.h"
#include "common/status.h"

#define COMMAND_LINE_OPENS '#'
#define COMMAND_LINE_FRAME 0x02
#define COMMAND_LINE_FRAME_END 0x03
#define COMMAND_LINE_ROOM 248u /* bytes of output that each call must have room for, or it does nothing */

/* `services` must outlive the command line. No session is open. */
void command_line_init(struct command_line *cl, const struct services *services);

/* `byte` came outside of an MSP frame: opens a session if that byte does and nothing is armed. Returns whether one is
 * open. */
bool command_line_begin(struct command_line *cl, uint8_t byte);

bool command_line_open(const struct command_line *cl);

/* Is output outstanding? Then no byte may be taken. */
bool command_line_busy(const struct command_line *cl);

/* Does the next byte begin a line? */
bool command_line_at_start(const struct command_line *cl);

/* Bytes were lost, or came that are no text: the line that they belong to is not carried out, and `save` is refused. */
void command_line_lost(struct command_line *cl);
void command_line_spoil(struct command_line *cl);

/* Takes a byte of an open session that is not busy; writes the echo, returns its bytes. */
size_t command_line_take(struct command_line *cl, uint8_t byte, uint8_t *out, size_t capacity);

/* To be called again and again while a session is open: says what is outstanding as far as there is room, keeps a motor
 * turning for its time, ends a session after a long silence. Returns the bytes written. */
size_t command_line_continue(struct command_line *cl, const struct firmware_status *status, uint8_t *out,
			     size_t capacity);
