/* Feeds standard input to everything of the core that reads bytes or counts, under the sanitizers.
 * Input: pieces of a length (two bytes, the lower one first) and as many bytes; each goes to the receiver, the
 * MSP server, the gyro and the check of policy blobs. Output: how many pieces, how many with MSP replies, how many
 * good blobs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "firmware.h"
#include "msp/msp_port.h"
#include "storage/policy_blob.h"
#include "services.h"

int main(void)
{
	const struct services services = board_services();
	const struct firmware_config config = {
		.gyro_rate_hz = 1000,
		.alignment = ALIGN_CW90,
		.settings = &settings,
		.weights = policy_weights,
		.policy_good = true,
		.pid = services.pid,
	};
	static const struct policy_blob_identity identity_of_blob = {
		.architecture_hash = 1,
		.filters_hash = NF_POLICY_FILTERS_NONE,
		.control_rate_hz = 1000,
		.weight_count = 1,
		.observation_count = 1,
		.action_count = 1,
	};
	struct firmware *fw = malloc(sizeof *fw);
	struct firmware_status status;
	struct msp_port port;
	unsigned long samples = 0, replies = 0, blobs = 0;

	if (!fw || firmware_init(fw, &config) != NF_OK)
		return 2;
	msp_port_init(&port, &services);
	for (int low, high; (low = getchar()) != EOF && (high = getchar()) != EOF;) {
		const int length = low | high << 8;
		/* Exact sizes on the heap, so that one byte too far is seen. */
		uint8_t *bytes = malloc((size_t)length + 1), *reply = malloc((size_t)length * 4 + 1);
		uint8_t *slot = malloc((size_t)length + 1);
		uint16_t *dshot = malloc(POLICY_ACTION_COUNT * sizeof *dshot);
		struct imu_sample sample = { .valid = true };
		if (!bytes || !reply || !slot || !dshot)
			return 2;
		const size_t count = fread(bytes, 1, (size_t)length, stdin);
		memcpy(sample.gyro, bytes, count < sizeof sample.gyro ? count : sizeof sample.gyro);
		firmware_receive(fw, bytes, count);
		firmware_sample(fw, &sample, dshot);
		firmware_status(fw, &status);
		replies += msp_port_serve(&port, &status, bytes, count, reply, (size_t)length * 4) > 0;
		memcpy(slot + 1, bytes, count); /* misaligned, and its end is the heap block's */
		blobs += policy_blob_check(slot + 1, count, &identity_of_blob) == NF_OK;
		++samples;
		free(bytes);
		free(reply);
		free(slot);
		free(dshot);
	}
	free(fw);
	free(model.bytes);
	printf("%lu %lu %lu\n", samples, replies, blobs);
	return 0;
}
