/* The host program's --replay: a flight comes as a stream, what comes of each control step goes to stdout. */
#pragma once

#include "firmware.h"
#include "nf_contract.h"

/* The stream: a struct replay_stream, the state, and one struct replay_step a control step up to the end. All of it
 * little-endian. */

/* Reads a stream from the file `path`, "-" for stdin, and writes a struct replay_answer for each control step. Returns the
 * program's exit code: 0, or 1 after one line on stderr. */
int replay_stream_run(struct firmware *fw, const char *path);
