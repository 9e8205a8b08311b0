/* Pointers inside struct firmware, whose layout must be the same on every target, because a log begins with its bytes
 * and a replay on a computer continues from them (hal/host/replay.h). */
#pragma once

#include <stdint.h>

/* A member `name` that takes 8 bytes whether addresses have 4 or 8. */
#define HELD(type, name)              \
	union {                       \
		type name;            \
		uint64_t name##_room; \
	}
