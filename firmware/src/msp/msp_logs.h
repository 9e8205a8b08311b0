/* MSP about logs: what the blackbox does, and the logs that its device keeps. */
#ifndef NF_MSP_LOGS_H
#define NF_MSP_LOGS_H

#include "blackbox/blackbox.h"
#include "msp/msp_payload.h"
#include "nf_contract.h"

/* Each function answers the message of its name. *detail is an enum nf_log_error for NF_REFUSAL_LOG. */
enum nf_refusal msp_log_info(struct blackbox *blackbox, struct msp_reader *payload, struct msp_writer *reply,
			     int *detail);
enum nf_refusal msp_log_entry(struct blackbox *blackbox, struct msp_reader *payload, struct msp_writer *reply,
			      int *detail);
enum nf_refusal msp_log_read(struct blackbox *blackbox, struct msp_reader *payload, struct msp_writer *reply,
			     int *detail);
enum nf_refusal msp_log_erase(struct blackbox *blackbox, struct msp_reader *payload, struct msp_writer *reply,
			      int *detail);

/* What the ecosystem's summary of a card has: part 0 state, 1 error, 2 free, 3 total [KB]. NULL: there is none. */
uint32_t msp_log_card(const struct blackbox *blackbox, unsigned part);

#endif
