/* What Python calls of the PIDs (control/pid.py). Python reads this file as it stands: plain declarations only; it skips the lines that begin with #.
 * struct pid_gains it reads from the firmware's pid.h. */
#ifndef PIDS_API_H
#define PIDS_API_H

#include <stdbool.h>
#include <stddef.h>

struct pid_gains;
struct pids;

/* Bytes of so many PIDs. */
size_t pids_size(size_t count);

/* `count` PIDs with the pilot's factors at 1. gains: one for all or one for each, `gains_count` of them, which must outlive
 * the PIDs; standing: they are on the ground all the time. */
void pids_init(struct pids *pids, size_t count, const struct pid_gains *gains, size_t gains_count, bool standing);

/* Clears what they remember; the voltages stay. */
void pids_reset(struct pids *pids);

/* volts: (count,), of the packs, filtered; 0 or NaN where one is not known. */
void pids_compensate(struct pids *pids, const float volts[]);

/* A control step of each. setpoint, rate: (count, 3) [rad/s]; throttle: (count,), 0..1; action: (count, motors). */
void pids_step(struct pids *pids, const float setpoint[], const float rate[], const float throttle[], float action[]);

#endif
