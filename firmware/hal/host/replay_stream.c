#include "hal/host/replay_stream.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "hal/host/replay.h"

/* Prints why the stream is refused. */
static bool replay_stream_refuse(const char *what, unsigned long got, unsigned long expected)
{
	fprintf(stderr, "neuroflight: --replay: %s: got %lu, expected %lu; give what was made for this program\n", what,
		got, expected);
	return false;
}

static bool replay_stream_fits(const struct firmware *fw, const struct replay_stream *head)
{
	if (head->magic != NF_REPLAY_STREAM_MAGIC)
		return replay_stream_refuse("the first word", head->magic, NF_REPLAY_STREAM_MAGIC);
	if (head->state_bytes != sizeof *fw)
		return replay_stream_refuse("bytes of the state", head->state_bytes, sizeof *fw);
	if (head->layout != firmware_layout())
		return replay_stream_refuse("layout of the state", head->layout, firmware_layout());
	return true;
}

static bool replay_stream_begin(struct firmware *fw, FILE *in)
{
	struct replay_stream head;
	uint8_t state[sizeof *fw];
	size_t count;

	if ((count = fread(&head, 1, sizeof head, in)) != sizeof head)
		return replay_stream_refuse("bytes of its head", count, sizeof head);
	if (!replay_stream_fits(fw, &head))
		return false;
	if ((count = fread(state, 1, sizeof state, in)) != sizeof state)
		return replay_stream_refuse("bytes of its state", count, sizeof state);
	return firmware_restore(fw, state, sizeof state, head.layout);
}

static bool replay_stream_answer(const struct firmware *fw)
{
	const struct control_trace *trace = firmware_trace(fw);
	struct replay_answer answer = { .step = trace->step, .throttle = trace->throttle };

	memcpy(answer.setpoint, trace->setpoint, sizeof answer.setpoint);
	memcpy(answer.gyro, trace->gyro, sizeof answer.gyro);
	memcpy(answer.dshot, trace->dshot, sizeof answer.dshot);
	if (fwrite(&answer, sizeof answer, 1, stdout) == 1)
		return true;
	fprintf(stderr, "neuroflight: --replay: cannot write to stdout: %s\n", strerror(errno));
	return false;
}

static bool replay_stream_steps(struct firmware *fw, FILE *in)
{
	struct replay_step step;
	uint16_t dshot[POLICY_ACTION_COUNT];
	size_t count;

	for (unsigned long number = 0; (count = fread(&step, 1, sizeof step, in)) == sizeof step; ++number) {
		const enum replay_result result = replay_run(fw, &step, dshot);
		if (result != REPLAY_DONE) {
			fprintf(stderr,
				"neuroflight: --replay: control step %lu cannot be replayed (%d); give what a log holds\n",
				number, (int)result);
			return false;
		}
		if (!replay_stream_answer(fw))
			return false;
	}
	if (ferror(in)) {
		fprintf(stderr, "neuroflight: --replay: cannot read: %s\n", strerror(errno));
		return false;
	}
	return count == 0 || replay_stream_refuse("bytes of its last step", count, sizeof step);
}

int replay_stream_run(struct firmware *fw, const char *path)
{
	const bool piped = strcmp(path, "-") == 0;
	FILE *in = piped ? stdin : fopen(path, "rb");

	if (!in) {
		fprintf(stderr, "neuroflight: --replay: cannot open %s: %s\n", path, strerror(errno));
		return 1;
	}
	const bool done = replay_stream_begin(fw, in) && replay_stream_steps(fw, in);
	if (!piped)
		(void)fclose(in);
	return done && fflush(stdout) == 0 ? 0 : 1;
}
