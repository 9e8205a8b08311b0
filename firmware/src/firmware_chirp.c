#include "firmware_chirp.h"

#include "control/chirp.h"

/* The last good frame's switch counts, whatever the link's state: a mode that was on before a silence must go off before
 * the chirp begins again. */
void firmware_chirp(struct firmware *fw)
{
	const struct chirp_input input = {
		.on = (fw->receiver.on & MODE_BIT(CHIRP)) != 0,
		.allowed = safety_motors(&fw->safety) && !safety_descending(&fw->safety) &&
			   receiver_link(&fw->receiver) == RECEIVER_GOOD,
		.controller = (uint8_t)fw->control.flying,
	};

	chirp_step(&fw->chirp, &input, fw->status.trace.setpoint);
}
