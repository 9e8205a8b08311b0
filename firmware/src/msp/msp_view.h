/* State that the configuration messages of MSP report and change. */
#ifndef NF_MSP_VIEW_H
#define NF_MSP_VIEW_H

#include "blackbox/blackbox.h"
#include "common/status.h"
#include "control/pid.h"
#include "nf_contract.h"

struct msp_view {
	const struct firmware_status *status;
	const struct pid_gains *pid; /* that is built in */
	const struct blackbox *blackbox; /* NULL: there is none */
	struct nf_settings *settings; /* as edited; for a SET a copy, which counts if the whole SET is taken */
};

#endif
