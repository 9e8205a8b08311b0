#include "motors/motor_test.h"

#include "common/fence.h"
#include "motors/dshot.h"

void motor_test_init(struct motor_test *test, unsigned control_rate_hz, unsigned motor_count)
{
	*test = (struct motor_test){
		.timeout = control_rate_hz * NF_MOTOR_TEST_TIMEOUT_MS / 1000u,
		.motor_count = motor_count,
	};
}

/* --- The background's side ------------------------------------------------------------------------------- */
static bool motor_test_wished(const struct motor_test *test)
{
	return test->wish & 1u;
}

/* A test that the interrupt has not seen yet counts as open: values may follow at once. */
bool motor_test_open(const struct motor_test *test)
{
	return motor_test_wished(test) && (test->wish != test->wish_seen || test->left > 0);
}

enum nf_refusal motor_test_ask(struct motor_test *test, uint32_t magic, bool stopped)
{
	const bool bench = magic == NF_MOTOR_BENCH_MAGIC;
	const bool opens = bench || magic == NF_MOTOR_TEST_MAGIC;

	if (opens && !stopped)
		return NF_REFUSAL_ARMED;
	for (unsigned i = 0; i < NF_MOTOR_COUNT_MAX; ++i)
		test->given[i] = NF_DSHOT_STOP;
	test->most = bench ? NF_MOTOR_BENCH_MAX : NF_MOTOR_TEST_MAX;
	fence();
	test->wish += motor_test_wished(test) == opens ? 2u : 1u;
	return opens || magic == 0 ? NF_REFUSAL_NONE : NF_REFUSAL_PAYLOAD;
}

static bool motor_test_within_range(float most, const float fractions[], size_t count)
{
	float sum = 0.0f;

	for (size_t i = 0; i < count; ++i) {
		if (!(fractions[i] >= 0.0f && fractions[i] <= most))
			return false;
		sum += fractions[i];
	}
	return sum <= NF_MOTOR_TEST_SUM_MAX;
}

enum nf_refusal motor_test_give(struct motor_test *test, const float fractions[], size_t count)
{
	if (!motor_test_open(test))
		return NF_REFUSAL_ORDER;
	if (count > test->motor_count)
		return NF_REFUSAL_INDEX;
	if (!motor_test_within_range(test->most, fractions, count))
		return NF_REFUSAL_RANGE;
	for (size_t i = 0; i < test->motor_count; ++i)
		test->given[i] = i < count && fractions[i] > 0.0f ? dshot_value(fractions[i]) : NF_DSHOT_STOP;
	fence();
	++test->refreshed;
	return NF_REFUSAL_NONE;
}

void motor_test_keep(struct motor_test *test)
{
	if (motor_test_open(test))
		++test->refreshed;
}

/* --- The interrupt's side -------------------------------------------------------------------------------- */
void motor_test_end(struct motor_test *test)
{
	if (test->left > 0)
		test->settling = test->timeout;
	test->left = 0;
	test->wish_seen = test->wish;
}

static bool motor_test_allowed(const struct motor_test_view *view)
{
	return view->stopped && !view->switch_on;
}

void motor_test_update(struct motor_test *test, const struct motor_test_view *view)
{
	if (!motor_test_allowed(view) || (test->left > 0 && view->link != test->link))
		motor_test_end(test);
}

/* Carries out a wish of the background. */
static void motor_test_carry_out(struct motor_test *test, const struct motor_test_view *view)
{
	motor_test_end(test);
	if (!motor_test_wished(test))
		return;
	test->left = test->timeout;
	test->link = view->link;
}

/* Counts down the time that is left; new values restart it. */
static void motor_test_count_down(struct motor_test *test)
{
	if (test->refreshed != test->refreshed_seen) {
		test->refreshed_seen = test->refreshed;
		test->left = test->timeout;
	} else if (--test->left == 0) {
		test->settling = test->timeout;
	}
}

/* Updates a test that is requested, open or settling; never called in flight. */
static __attribute__((noinline)) bool motor_test_run(struct motor_test *test, const struct motor_test_view *view,
						     uint16_t dshot[])
{
	if (test->wish != test->wish_seen)
		motor_test_carry_out(test, view);
	if (test->left > 0)
		motor_test_count_down(test);
	else if (test->settling > 0)
		--test->settling;
	if (test->left == 0)
		return false;
	for (unsigned i = 0; i < test->motor_count; ++i)
		dshot[i] = test->given[i];
	return true;
}

bool motor_test_step(struct motor_test *test, const struct motor_test_view *view, uint16_t dshot[])
{
	motor_test_update(test, view);
	return (test->wish != test->wish_seen || test->left > 0 || test->settling > 0) &&
	       motor_test_run(test, view, dshot);
}

bool motor_test_forbids(const struct motor_test *test)
{
	return motor_test_open(test) || test->left > 0 || test->settling > 0;
}
