/* Flash for the boot part: reading, and programming of the marks that it leaves. */
#pragma once

#include "port/flash.h"

/* Erases nothing. Programming stalls the code, which lies in flash too: interrupts are off all along. */
extern const struct flash boot_flash;
