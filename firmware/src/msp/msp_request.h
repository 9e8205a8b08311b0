/* A request of MSP, and the state of the peer that makes it. */
#pragma once

#include "command_line/services.h"
#include "common/status.h"
#include "msp/msp_payload.h"
#include "msp/msp_stream.h"
#include "nf_contract.h"

/* State of the peer of a port besides its partly read request; it ends with the peer. */
struct msp_peer {
	struct msp_stream stream; /* what it gets unasked */
	bool locks;    /* it says that nothing may arm */
	uint32_t test; /* the motor test that it opened by ARMING_DISABLE: its wish (motor_test.h); 0: none */
	uint32_t opened; /* likewise by MOTOR_TEST */
	bool spoilt;   /* a change of its was refused since it last had the settings stored */
	uint64_t told; /* a bit for each configuration message that it has read: msp_configure.c */
};

struct msp_request {
	const struct services *services;
	struct msp_peer *peer;
	const struct firmware_status *status;
	struct nf_settings *settings; /* as edited; for a SET a copy, which counts if the whole SET is taken */
	uint16_t command;
	struct msp_reader payload;    /* aligned to 4 */
	struct msp_writer *reply;
	enum nf_refusal refusal;      /* NF_REFUSAL_NONE: carried out */
	int detail; /* of BLOB and IMAGE the enum nf_err, of LOG the enum nf_log_error, of CONFLICT the
					 index of a setting, else 0 */
};

/* Each carries out the request, and writes its reply, if its command is one of its own; returns false if it is none.
 *
 * msp_replies.c: commands that only read, and read no settings to be changed (toolchain/contract/msp_messages.py). */
bool msp_reply(struct msp_request *q);

/* msp_configure.c: configuration, the messages of msp_fields.c and msp_lists.c.
 *
 * A SET changes the settings whose fields differ from what its GET tells. A refused field leaves its setting as it was,
 * and so do settings that would conflict; the other fields are taken, and the reply is an error that names a refusal.
 * Nothing is taken while armed, or where the GET is refused. A peer that has not sent the GET may send zeros for fields
 * that it does not know: from it a SET is taken whole or not at all, and not at all where zeros are valid values. After
 * a refusal the peer's next EEPROM_WRITE stores what was taken, and is answered with NF_REFUSAL_SPOILT: stored, but not
 * all. */
bool msp_configure(struct msp_request *q);

/* msp_commands.c: commands that take a payload, change something, or report what only the background has. */
bool msp_command(struct msp_request *q);
