/* Scheduler: background tasks, one at a time, and the run-time statistics of every task.
 *
 * Time is the gyro sample index; cycles are only measured. */
#pragma once

#include "nf_contract.h"

#define TASK_COUNT (NF_TASK_MSP + 1)

/* Processor time of a task since boot. */
struct task_stats {
	uint32_t rate_hz;    /* that it is meant to run at; 0: whenever there is something to do */
	uint32_t runs;
	uint32_t misses;     /* runs that began a whole period late; of control steps: ended late */
	uint32_t worst;      /* cycles */
	uint32_t best;       /* cycles; 0 before the first run */
	uint64_t sum;        /* cycles of all runs */
	uint32_t recent;     /* cycles: the longest since its reader set it to 0 */
	uint32_t last;       /* cycles of the last run */
};

/* Starts a measure. */
void task_stats_init(struct task_stats *stats, uint32_t rate_hz);

/* One run took `cycles`. */
void task_stats_add(struct task_stats *stats, uint32_t cycles, bool missed);

/* Cycles of a mean run, 0 before the first. An interrupt may add runs meanwhile. */
uint32_t task_stats_mean(const struct task_stats *stats);

/* A task of the background. */
struct task {
	enum nf_task id;
	uint32_t rate_hz;           /* at most the gyro rate */
	void (*run)(void *context);
};

struct scheduler {
	const struct task *tasks;
	size_t count;               /* at most TASK_COUNT */
	uint32_t gyro_rate_hz;
	uint32_t (*cycles)(void *clock); /* a free-running counter */
	void *clock;
	uint32_t due[TASK_COUNT];   /* sample at which the task of that row is to run */
	struct task_stats *stats;   /* [TASK_COUNT], by enum nf_task */
};

/* `tasks` and `stats` must outlive the scheduler; all tasks are due at sample 0. */
void scheduler_init(struct scheduler *scheduler, const struct task *tasks, size_t count,
		    struct task_stats stats[TASK_COUNT], uint32_t gyro_rate_hz, uint32_t (*cycles)(void *clock),
		    void *clock);

/* Runs the first task of the table that is due at gyro sample `now`, if one is. Returns whether one ran. A task
 * that comes a whole period late is not run twice: it counts as missed. */
bool scheduler_step(struct scheduler *scheduler, uint32_t now, void *context);
