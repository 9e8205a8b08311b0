/* Motor test: turns motors slowly on the bench, without a pilot. The background opens the test and gives values. The
 * interrupt checks what forbids a test whenever safety is updated, and alone ends it. Each side writes only its own
 * part. */
#pragma once

#include "nf_contract.h"
#include "receiver/receiver.h"

struct motor_test {
	/* The background's. */
	volatile uint32_t wish;                  /* counts requests; odd: to open, even: to close */
	volatile uint32_t refreshed;             /* counts values given */
	volatile uint16_t given[NF_MOTOR_COUNT_MAX]; /* DShot values */
	float most;                              /* that one motor may be given, a fraction */
	/* The interrupt's. */
	volatile uint32_t wish_seen, refreshed_seen;
	volatile uint32_t left;                  /* control steps until it ends, 0: it is closed */
	volatile uint32_t settling;              /* control steps until it is forgotten; nothing arms before */
	enum receiver_link link;                 /* as it was when it opened */
	/* Nobody's. */
	uint32_t timeout;                        /* control steps */
	uint32_t motor_count;
};

/* Conditions of a test besides the request. */
struct motor_test_view {
	bool stopped;                            /* the flight state is NF_FLIGHT_DISARMED */
	bool switch_on;                          /* the arm switch, as a frame says it, whatever the link is worth */
	enum receiver_link link;
};

/* motor_count at most NF_MOTOR_COUNT_MAX. Starts closed. */
void motor_test_init(struct motor_test *test, unsigned control_rate_hz, unsigned motor_count);

/* From the background: NF_MOTOR_TEST_MAGIC opens, all motors at 0; NF_MOTOR_BENCH_MAGIC too, for one rotor on a
 * dynamometer; 0 closes; any other number closes too and is refused as PAYLOAD. `stopped` as in the view, as last
 * known: ARMED without it. */
enum nf_refusal motor_test_ask(struct motor_test *test, uint32_t magic, bool stopped);

/* From the background: motor fractions, 0 stops, of the first `count` motors; the others stop. To be given again within
 * NF_MOTOR_TEST_TIMEOUT_MS. All are taken or none: ORDER while the test is closed, INDEX for more motors than there
 * are, RANGE for one that is NaN or outside 0..most (NF_MOTOR_TEST_MAX; NF_MOTOR_BENCH_MAX where that magic opened the
 * test, NF_MOTOR_WIZARD_MAX where the app's wizard did), or a sum above NF_MOTOR_TEST_SUM_MAX. */
enum nf_refusal motor_test_give(struct motor_test *test, const float fractions[], size_t count);

/* From the background: an open test goes on for NF_MOTOR_TEST_TIMEOUT_MS, its values as they are. */
void motor_test_keep(struct motor_test *test);

/* From the background: returns whether values may still be given. Once it is closed, the motors stop at the next
 * control step. */
bool motor_test_open(const struct motor_test *test);

/* In the interrupt, for each receiver frame. A test ends when it is not `stopped`, the switch is on, or the link is
 * another than when it opened. */
void motor_test_update(struct motor_test *test, const struct motor_test_view *view);

/* In the interrupt, at each control step: updates, too. Returns whether the test is open; then it has written each
 * motor's DShot value. */
bool motor_test_step(struct motor_test *test, const struct motor_test_view *view, uint16_t dshot[]);

/* In the interrupt: ends a test, for instance because the gyro is silent. */
void motor_test_end(struct motor_test *test);

/* Does it forbid arming (NF_ARMING_REASON_MOTOR_TEST)? From the request that opens it until the motors have been
 * stopped for NF_MOTOR_TEST_TIMEOUT_MS: also at the update that ended it, so that the switch that ended it does not
 * arm. */
bool motor_test_forbids(const struct motor_test *test);
