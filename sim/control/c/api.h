/* What Python calls of the PIDs (control/pid.py) and of the notches on rotors' turns (control/gyro_filter.py). Python reads this file as it stands: plain declarations only; it skips the lines that begin with #.
 * struct pid_gains it reads from the firmware's pid.h. */
#ifndef PIDS_API_H
#define PIDS_API_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

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

struct rpm_filters;

/* Bytes of so many filters. */
size_t rpm_filters_size(size_t count);

/* Of the settings rpm_filter_*. `rpm_filters_reset` all of them before the first step. */
void rpm_filters_init(struct rpm_filters *filters, unsigned harmonics, float min_hz, float q, unsigned gyro_rate_hz);

/* The next sample of the filters of `which` (count) is their first. */
void rpm_filters_reset(struct rpm_filters *filters, size_t count, const int64_t which[]);

/* A gyro sample of the filters of `which`, in place. speed: (count, motors) [rad/s], as ESCs tell it; rate: (count, 3)
 * [rad/s]. */
void rpm_filters_step(struct rpm_filters *filters, size_t count, const int64_t which[], const float speed[],
		      float rate[]);

#endif
