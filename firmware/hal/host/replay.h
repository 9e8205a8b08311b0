/* A flight again: the control path goes on from a snapshot and is given what a log says that it was given. On computers only.
 *
 * Of the accelerometer a log has the control step's words alone, which are all that the control path uses; those of the samples
 * between are made so that they repeat the one before, or not, as the log says. */
#pragma once

#include "blackbox/log_record.h"
#include "firmware.h"
#include "nf_contract.h"

enum replay_result {
	REPLAY_DONE = 0,
	REPLAY_SIZE = -1, /* a count is beyond its array, or there is no sample */
	REPLAY_EARLY = -2, /* a control step was due before the last sample: records are missing */
	REPLAY_LATE = -3, /* none was due at the last sample */
	REPLAY_UNKNOWN = -4, /* receiver bytes are missing, or a motor test or a DShot command was under way */
};

/* Returns a number made of sizes and offsets in struct firmware and of the policy's architecture: states are compatible if it
 * is equal. */
uint32_t firmware_layout(void);

/* `fw`, which was initialised with the log's settings, goes on from these bytes of another one; what it points to stays its own.
 * Returns false, and changes nothing, where size or layout are others. */
bool firmware_restore(struct firmware *fw, const uint8_t *bytes, size_t count, uint32_t layout);

/* One control step and the samples since the one before. Writes the DShot values of each output. What came of it is told by
 * firmware_log. Not REPLAY_DONE: `fw` is to be restored anew. */
enum replay_result replay_run(struct firmware *fw, const struct replay_step *step, uint16_t dshot[POLICY_ACTION_COUNT]);
