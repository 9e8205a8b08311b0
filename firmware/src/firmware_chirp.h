/* The chirp of the firmware. In flash, where the control path has no room: it costs time only while the mode is on. */
#ifndef NF_FIRMWARE_CHIRP_H
#define NF_FIRMWARE_CHIRP_H

#include "firmware.h"

/* One control step, after the sticks have given its setpoint; to be called while the mode CHIRP is on or the chirp is not
 * idle. */
void firmware_chirp(struct firmware *fw);

#endif
