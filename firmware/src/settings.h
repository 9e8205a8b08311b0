/* Settings: the pilot's numbers (contract: SETTINGS), their limits and defaults. */
#ifndef NF_SETTINGS_H
#define NF_SETTINGS_H

#include "nf_contract.h"

/* Every setting at its default. */
void settings_default(struct nf_settings *settings);

#endif
