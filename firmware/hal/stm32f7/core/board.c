/* Nothing, until toolchain/image/stamp.py writes what the build asks for. No code stands beside it: the compiler would take these
 * zeros for what it reads. */
#include "hal/stm32f7/core/board.h"

__attribute__((section(".board"), used)) const struct board board = { 0 };
