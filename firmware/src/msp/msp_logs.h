/* MSP about logs: what the blackbox does, and the logs that its device keeps. */
#pragma once

#include "blackbox/blackbox.h"
#include "msp/msp_request.h"
#include "nf_contract.h"

/* Each function answers the message of its name. */
enum nf_refusal command_log_info(struct msp_request *q);
enum nf_refusal command_log_entry(struct msp_request *q);
enum nf_refusal command_log_read(struct msp_request *q);
enum nf_refusal command_log_erase(struct msp_request *q);

/* What the ecosystem's summary of a card has: part 0 state, 1 error, 2 free, 3 total [KB]. */
uint32_t msp_log_card(const struct blackbox *blackbox, unsigned part);
