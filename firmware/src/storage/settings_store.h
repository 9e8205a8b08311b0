/* Settings in flash: two sectors, written alternately, so that a loss of power at any moment leaves the old or the
 * new set, never a mix. */
#pragma once

#include "port/flash.h"
#include "storage/settings.h"

enum settings_loaded {
	SETTINGS_NONE,      /* there is no valid set */
	SETTINGS_AS_STORED,
	SETTINGS_MENDED, /* something was stored that this version does not take: what is flown is not what was set */
};

/* Reads the newest valid set. Settings missing in the set get their defaults. So do values beyond today's limits and
 * values that contradict each other: SETTINGS_MENDED. A mode range that is invalid today is treated as unused, so
 * that the default of its slot does not arm by a switch with another meaning; a range for a mode of a newer version
 * is kept as stored. */
enum settings_loaded settings_load(struct nf_settings *settings, const struct flash *flash);

/* Writes `settings` as the newest set, over the older one. Waits for the flash. NF_REFUSAL_CONFLICT: settings_conflict
 * finds a conflict. NF_REFUSAL_FLASH: flash did not take it, the set from before is still the newest. */
enum nf_refusal settings_save(const struct nf_settings *settings, const struct flash *flash);
