/* Order between the background and the gyro interrupt, which run on the same core. */
#pragma once

/* Keeps the compiler from moving memory accesses across. */
static inline __attribute__((always_inline)) void fence(void)
{
	__atomic_signal_fence(__ATOMIC_SEQ_CST);
}
