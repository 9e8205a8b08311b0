/* The SD card's answers that need no thought: none is fitted, it rests, or it is busy. All else is Python's
 * (sim/board/devices/sd_card). */
#include <string.h>

#include "peripherals.h"

enum { RELEASED = 0xFF }; /* the line, which a resistor pulls up */

bool card_exchange(struct native *n, uint8_t *bytes, uint32_t count, uint64_t cycle, uint32_t length)
{
	const struct card *const card = &n->s.card;

	if (!n->card_fitted) {
		memset(bytes, RELEASED, count);
		return true;
	}
	if (card->transaction != n->s.chips[n->log_chip].transaction || cycle + (uint64_t)count * length > card->until)
		return false;
	for (uint32_t i = 0; i < count; ++i)
		if (bytes[i] != RELEASED)
			return false;
	memset(bytes, card->answer, count);
	return true;
}

struct card *native_card(struct native *n)
{
	n->card_fitted = true;
	return &n->s.card;
}

bool native_card_selected(const struct native *n)
{
	return n->s.chips[n->log_chip].selected;
}

uint32_t native_card_transaction(const struct native *n)
{
	return n->s.chips[n->log_chip].transaction;
}
