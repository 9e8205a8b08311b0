/* Link quality: the share of frames that arrived in the last second. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define LINK_QUALITY_SLOTS 10 /* of a tenth of a second */

/* How many frames a receiver sends in a second is not known: it is the most that any second had so far. */
struct link_quality {
	uint16_t good[LINK_QUALITY_SLOTS]; /* frames with news, a slot */
	uint16_t all[LINK_QUALITY_SLOTS];  /* and those that the receiver marks as lost */
	uint16_t good_sum, all_sum;        /* of the slots before this one */
	uint16_t most;                     /* of `all` in a second */
	uint8_t slot;                      /* the one being counted */
	uint8_t percent;
	uint8_t told;                      /* by the receiver, 0..100 % */
	uint32_t told_left;                /* gyro samples until that is out of date, 0: it is */
	uint32_t slot_left;                /* gyro samples until the next slot begins */
	uint32_t slot_length;              /* gyro samples */
};

/* gyro_rate_hz at least LINK_QUALITY_SLOTS. */
void link_quality_init(struct link_quality *quality, unsigned gyro_rate_hz);

/* The link is lost: starts anew, as the next one may have another frame rate. */
void link_quality_reset(struct link_quality *quality);

/* A frame arrived; `good`: with new channels, not marked as lost. */
void link_quality_frame(struct link_quality *quality, bool good);

/* The receiver reported its own link quality, 0..100 %: it is used for a second. */
void link_quality_tell(struct link_quality *quality, uint8_t percent);

/* One gyro sample has passed. */
void link_quality_tick(struct link_quality *quality);

/* 0..100 %, 0 before the first tenth of a second with frames. */
unsigned link_quality_percent(const struct link_quality *quality);
