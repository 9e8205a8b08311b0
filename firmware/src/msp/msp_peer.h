/* What belongs to the peer of a port beside its half-read request, and ends with it. */
#ifndef NF_MSP_PEER_H
#define NF_MSP_PEER_H

#include "msp/msp_stream.h"

struct msp_peer {
	struct msp_stream stream; /* what it gets unasked */
};

#endif
