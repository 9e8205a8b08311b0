/* Feeds standard input to everything that reads or writes flash, under the sanitizers.
 * Input: pieces of a kind (one byte), a length (two bytes, the lower one first) and as many bytes. Kind 'M': an MSP
 * peer's. Kind 'F': an address within flash (four bytes, from its beginning) and what stands there from then on, or,
 * cut short, a boot: settings, policy and faults are read. Kind 'C': power goes (operation, kind, seed: a byte each).
 * Output: replies, sets of settings found, boots that found a policy. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "msp/msp_port.h"
#include "services.h"

static unsigned long replies;

static void serve(struct msp_port *port, const uint8_t *bytes, size_t count)
{
	static const struct firmware_status status = { .gyro_rate_hz = 1000 };
	const size_t capacity = 4 * count + 16;
	uint8_t *reply = malloc(capacity);

	if (!reply)
		exit(2);
	replies += msp_port_serve(port, &status, bytes, count, reply, capacity) > 0;
	free(reply);
}

static void put(const uint8_t *bytes, size_t count)
{
	uint32_t at;

	if (count < sizeof at) {
		board_boot();
		return;
	}
	memcpy(&at, bytes, sizeof at);
	at %= NF_FLASH_BYTES;
	count -= sizeof at;
	memcpy(model.bytes + at, bytes + sizeof at, count < NF_FLASH_BYTES - at ? count : NF_FLASH_BYTES - at);
}

int main(void)
{
	const struct services services = board_services();
	struct msp_port port;

	msp_port_init(&port, &services);
	for (int kind, low, high; (kind = getchar()) != EOF && (low = getchar()) != EOF && (high = getchar()) != EOF;) {
		const size_t length = (size_t)(low | high << 8);
		uint8_t *bytes = malloc(length + 1); /* exact, so that one byte too far is seen */
		if (!bytes)
			return 2;
		const size_t count = fread(bytes, 1, length, stdin);
		if (kind == 'M')
			serve(&port, bytes, count);
		else if (kind == 'C' && count >= 3)
			flash_model_cut(&model, bytes[0], bytes[1] % FLASH_CUT_COUNT, bytes[2]);
		else
			put(bytes, count);
		free(bytes);
	}
	free(model.bytes);
	printf("%lu %lu %lu\n", replies, sets, policies);
	return 0;
}
