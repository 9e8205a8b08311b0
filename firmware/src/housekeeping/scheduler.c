#include "housekeeping/scheduler.h"

#include "common/fence.h"

void task_stats_init(struct task_stats *stats, uint32_t rate_hz)
{
	*stats = (struct task_stats){ .rate_hz = rate_hz };
}

void task_stats_add(struct task_stats *stats, uint32_t cycles, bool missed)
{
	stats->last = cycles;
	if (cycles > stats->recent)
		stats->recent = cycles;
	if (cycles > stats->worst)
		stats->worst = cycles;
	/* Less 1, the 0 of no run so far is above all: one comparison and no jump, so that a sample takes as many
	 * instructions whatever its time was. */
	if (cycles - 1u < stats->best - 1u)
		stats->best = cycles;
	stats->sum += cycles;
	++stats->runs;
	stats->misses += missed;
}

/* Reads how many runs there were, and their sum: of the same moment. A run that the interrupt adds between the reads, or between
 * the halves of the sum, shows in the number of runs. */
static uint32_t task_stats_read(const struct task_stats *stats, uint64_t *sum)
{
	const volatile uint32_t *const now = &stats->runs;
	uint32_t runs;

	do {
		runs = *now;
		fence();
		*sum = stats->sum;
		fence();
	} while (runs != *now);
	return runs;
}

/* Long division, bit by bit: the compiler's of 64 bits takes 0.7 KB of flash. A mean of 32 bits is one of 32 bits. */
uint32_t task_stats_mean(const struct task_stats *stats)
{
	uint64_t rest;
	const uint32_t runs = task_stats_read(stats, &rest);
	uint32_t mean = 0;

	for (uint32_t bit = UINT32_C(1) << 31; bit != 0 && runs != 0; bit >>= 1) {
		const uint64_t part = (uint64_t)runs * bit;
		if (rest < part)
			continue;
		rest -= part;
		mean |= bit;
	}
	return mean;
}

void scheduler_init(struct scheduler *scheduler, const struct task *tasks, size_t count,
		    struct task_stats stats[TASK_COUNT], uint32_t gyro_rate_hz, uint32_t (*cycles)(void *clock),
		    void *clock)
{
	*scheduler = (struct scheduler){
		.tasks = tasks,
		.count = count,
		.gyro_rate_hz = gyro_rate_hz,
		.cycles = cycles,
		.clock = clock,
		.stats = stats,
	};
	for (size_t i = 0; i < count; ++i)
		task_stats_init(&stats[tasks[i].id], tasks[i].rate_hz);
}

bool scheduler_step(struct scheduler *scheduler, uint32_t now, void *context)
{
	for (size_t i = 0; i < scheduler->count; ++i) {
		const struct task *task = &scheduler->tasks[i];
		const uint32_t period = scheduler->gyro_rate_hz / task->rate_hz;
		const uint32_t late = now - scheduler->due[i];

		/* The index wraps: a difference above half its range means not due yet. */
		if (late > UINT32_MAX / 2)
			continue;
		const bool missed = late >= period;
		scheduler->due[i] = missed ? now + period : scheduler->due[i] + period;
		const uint32_t start = scheduler->cycles(scheduler->clock);
		task->run(context);
		task_stats_add(&scheduler->stats[task->id], scheduler->cycles(scheduler->clock) - start, missed);
		return true;
	}
	return false;
}
