/* Nothing, until toolchain/image/stamp.py writes what the user gave the build. No code stands beside it: the compiler would
 * take these zeros for what it reads. */
#include "hal/stm32f7/devices/gyro_kinds.h"

__attribute__((section(".gyro_file"), used)) const uint8_t gyro_file[NF_GYRO_FILE_BYTES] = { 0 };
