/* Settings in flash: two sectors, written alternately, so that a loss of power at any moment leaves the old or the
 * new set, never a mix. */
#ifndef NF_SETTINGS_STORE_H
#define NF_SETTINGS_STORE_H

#include <stdbool.h>

#include "storage/flash.h"
#include "storage/settings.h"

/* Reads the newest valid set. A setting that the set does not have, or whose value is beyond today's limits, gets its
 * default; so do those that contradict each other. Returns false, all at their defaults, if there is no valid set. */
bool settings_load(struct nf_settings *settings, const struct flash *flash);

/* Writes `settings` as the newest set, over the older one. Waits for the flash. NF_REFUSAL_CONFLICT: settings_conflict
 * finds a conflict. NF_REFUSAL_FLASH: flash did not take it, the set from before is still the newest. */
enum nf_refusal settings_save(const struct nf_settings *settings, const struct flash *flash);

#endif
