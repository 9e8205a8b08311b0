/* When the chirp may run. In flash, not in the control path's fast memory: it costs time only while the mode is on. */
#pragma once

#include "control/chirp.h"
#include "control/control.h"
#include "receiver/receiver.h"
#include "safety/safety.h"

/* One control step of `chirp` after the sticks have given its setpoint [rad/s]: it runs only while the motors obey a pilot who
 * is heard. To be called while the mode CHIRP is on or the chirp is not idle. */
void chirp_interlock_step(struct chirp *chirp, const struct control *control, const struct receiver *receiver,
			  const struct safety *safety, float setpoint[3]);
