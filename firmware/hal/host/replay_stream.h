/* The host program's --replay: a flight comes as a stream, what comes of each control step goes to stdout. */
#ifndef NF_HOST_REPLAY_STREAM_H
#define NF_HOST_REPLAY_STREAM_H

#include <stdint.h>

#include "firmware.h"
#include "nf_contract.h"

#define REPLAY_STREAM_MAGIC 0x5052464Eu /* "NFRP" */

/* The stream: this, the state, and one struct replay_step a control step up to the end. All of it little-endian. */
struct replay_stream {
	uint32_t magic;
	uint32_t state_bytes;
	uint32_t layout; /* firmware_layout */
};

/* What came of a control step. */
struct replay_answer {
	uint32_t step; /* control steps since boot */
	float setpoint[3], gyro[3]; /* rad/s, body axes, as the controller had them */
	float throttle; /* 0..1 */
	uint16_t dshot[NF_MOTOR_COUNT_MAX]; /* motor order */
};
_Static_assert(sizeof(struct replay_answer) == 48, "without holes");

/* Reads a stream from the file `path`, "-" for stdin, and writes a struct replay_answer for each control step. Returns the
 * program's exit code: 0, or 1 after one line on stderr. */
int replay_stream_run(struct firmware *fw, const char *path);

#endif
