/* Flash for the boot part: reading, and programming of the marks that it leaves. */
#ifndef STM32F7_BOOT_FLASH_H
#define STM32F7_BOOT_FLASH_H

#include "port/flash.h"

/* Erases nothing. Programming stalls the code, which lies in flash too: interrupts are off all along. */
extern const struct flash boot_flash;

#endif
