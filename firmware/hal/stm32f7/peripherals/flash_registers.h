/* Values of the flash interface's registers (RM0431 chapter 3), for image and boot part. */
#pragma once

#include "hal/stm32f7/core/registers.h"

/* FLASH_KEYR, one after the other (RM0431 3.3.5). */
#define FLASH_KEY_1 0x45670123u
#define FLASH_KEY_2 0xCDEF89ABu

enum { FLASH_PARALLEL_32 = 2 }; /* FLASH_CR PSIZE: words, at 2.7 to 3.6 V */
#define FLASH_ERRORS (FLASH_SR_OPERR | FLASH_SR_WRPERR | FLASH_SR_PGAERR | FLASH_SR_PGPERR | FLASH_SR_ERSERR)
