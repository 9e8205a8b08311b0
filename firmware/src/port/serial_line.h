/* A line that carries bytes both ways, whatever it is made of. All from the background; nothing waits. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum serial_news {
	SERIAL_LINE_GOOD,
	SERIAL_LINE_LOST, /* bytes of the peer were lost, and all that waited */
	SERIAL_LINE_NEW,  /* the peer has gone, or another is there: nothing of the last one's waits */
};

struct serial_line {
	void *context; /* the first argument of every function */
	/* Looks what has come. */
	enum serial_news (*look)(void *context);
	/* Bytes that wait to be read, as last looked at. */
	size_t (*waiting)(const void *context);
	/* Takes received bytes, oldest first, at most `capacity`. Returns how many. */
	size_t (*read)(void *context, uint8_t *bytes, size_t capacity);
	/* Where the next bytes to be sent go; *room: how many. */
	uint8_t *(*room)(const void *context, size_t *room);
	/* `count` of them were put there. */
	void (*fill)(void *context, size_t count);
	/* Sends what was put there, as far as the line takes it now. */
	void (*send)(void *context);
	/* Is anything on its way, its last bit not yet on the line? */
	bool (*sending)(const void *context);
};
