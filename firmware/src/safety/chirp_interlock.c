#include "safety/chirp_interlock.h"

/* The last good frame's switch counts, whatever the link's state: a mode that was on before a silence must go off before
 * the chirp begins again. */
void chirp_interlock_step(struct chirp *chirp, const struct control *control, const struct receiver *receiver,
			  const struct safety *safety, float setpoint[3])
{
	const struct chirp_input input = {
		.on = (receiver->on & MODE_BIT(CHIRP)) != 0,
		.allowed = safety_motors(safety) && !safety_descending(safety) &&
			   receiver_link(receiver) == RECEIVER_GOOD,
		.controller = (uint8_t)control->flying,
	};

	chirp_step(chirp, &input, setpoint);
}
