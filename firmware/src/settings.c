#include "settings.h"

#define DEFAULT(name, kind, low, high, preset, unit) settings->name = (kind)(preset);

void settings_default(struct nf_settings *settings)
{
	NF_SETTINGS(DEFAULT)
}
