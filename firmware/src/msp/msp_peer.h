/* State of the peer of a port besides its partly read request; it ends with the peer. */
#ifndef NF_MSP_PEER_H
#define NF_MSP_PEER_H

#include <stdbool.h>
#include <stdint.h>

#include "msp/msp_stream.h"

struct msp_peer {
	struct msp_stream stream; /* what it gets unasked */
	bool locks;    /* it says that nothing may arm */
	uint32_t test; /* the motor test that it opened by ARMING_DISABLE: its wish (motor_test.h); 0: none */
	bool spoilt;   /* a change of its was refused since it last had the settings stored */
	uint64_t told; /* a bit for each configuration message that it has read: msp_configure.c */
};

#endif
