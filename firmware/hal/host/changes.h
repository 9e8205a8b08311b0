/* Changes to settings as a user writes them: NAME=VALUE. */
#ifndef NF_HOST_CHANGES_H
#define NF_HOST_CHANGES_H

#include <stdbool.h>

#include "storage/settings.h"

/* Reads `text`. Returns false, `change` unset, if the name is no setting's or the value is no number within its
 * limits. Settings with named choices take their numbers. */
bool change_parse(const char *text, struct setting_change *change);

#endif
