/* Changes to settings as a user writes them: NAME=VALUE. */
#pragma once

#include <stdbool.h>

#include "storage/settings.h"

/* Reads `text`, its value as settings_text.h does. Returns false, `change` unset, if the name is no setting's or the
 * value is none of it or beyond its limits. Mode ranges are also taken as the number that SETTING_GET tells. */
bool change_parse(const char *text, struct setting_change *change);
