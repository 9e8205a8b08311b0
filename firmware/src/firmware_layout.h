/* A number that changes with the layout of struct firmware. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "firmware.h"

/* Multiplied by an odd number of its own (Knuth, "The Art of Computer Programming" 3, 6.4: 2^32 over the golden ratio). */
#define LAYOUT_OF(row, member)                                                                            \
	((uint32_t)(offsetof(struct firmware, member) * 65536u + sizeof((struct firmware){ 0 }.member)) * \
	 (2654435761u * (2u * (row) + 1u)))

/* Programs with the same number have the same layout of struct firmware. */
#define FIRMWARE_LAYOUT                                                                                                \
	((uint32_t)sizeof(struct firmware) + LAYOUT_OF(1u, gyro) + LAYOUT_OF(2u, filters) + LAYOUT_OF(3u, attitude) +  \
	 LAYOUT_OF(4u, receiver) + LAYOUT_OF(5u, rates) + LAYOUT_OF(6u, safety) + LAYOUT_OF(7u, turning) +             \
	 LAYOUT_OF(8u, plausibility) + LAYOUT_OF(9u, crash) + LAYOUT_OF(10u, control) + LAYOUT_OF(11u, chirp) +        \
	 LAYOUT_OF(12u, motor_test) + LAYOUT_OF(13u, dshot_command) + LAYOUT_OF(14u, outputs) +                        \
	 LAYOUT_OF(15u, rewired) + LAYOUT_OF(16u, gyro_chip) + LAYOUT_OF(17u, gyro_rate_hz) +                          \
	 LAYOUT_OF(18u, control_divider) + LAYOUT_OF(19u, until_control) + LAYOUT_OF(20u, overdue) +                   \
	 LAYOUT_OF(21u, control_steps) + LAYOUT_OF(22u, grace_left) + LAYOUT_OF(23u, level_cosine) +                   \
	 LAYOUT_OF(24u, failsafe_throttle) + LAYOUT_OF(25u, rested) + LAYOUT_OF(26u, doubts) + LAYOUT_OF(27u, trial) + \
	 LAYOUT_OF(28u, pid_wanted) + LAYOUT_OF(29u, health) + LAYOUT_OF(30u, forbidden) +                             \
	 LAYOUT_OF(31u, voltage_gain) + LAYOUT_OF(32u, posted_us) + LAYOUT_OF(33u, handed) + LAYOUT_OF(34u, begun) +   \
	 LAYOUT_OF(35u, heard) + LAYOUT_OF(36u, edges) + LAYOUT_OF(37u, silences) + LAYOUT_OF(38u, status) +           \
	 LAYOUT_OF(39u, published) + LAYOUT_OF(40u, window) + LAYOUT_OF(41u, samples) + LAYOUT_OF(42u, gyro.last) +    \
	 LAYOUT_OF(43u, gyro.bias) + LAYOUT_OF(44u, gyro.same) + LAYOUT_OF(45u, gyro.turn) +                           \
	 LAYOUT_OF(46u, filters.count) + LAYOUT_OF(47u, filters.dynamic) + LAYOUT_OF(48u, attitude.bias) +             \
	 LAYOUT_OF(49u, receiver.channels_us) + LAYOUT_OF(50u, receiver.quality) + LAYOUT_OF(51u, safety.state) +      \
	 LAYOUT_OF(52u, control.policy) + LAYOUT_OF(53u, control.observation) +                                        \
	 LAYOUT_OF(54u, control.observation.memory) + LAYOUT_OF(55u, control.pid) +                                    \
	 LAYOUT_OF(56u, control.pid.integral) + LAYOUT_OF(57u, control.mixers) + LAYOUT_OF(58u, control.good) +        \
	 LAYOUT_OF(59u, control.refused) + LAYOUT_OF(60u, control.flying) + LAYOUT_OF(61u, control.seen) +             \
	 LAYOUT_OF(62u, control.action) + LAYOUT_OF(63u, control.output) + LAYOUT_OF(64u, control.offset) +            \
	 LAYOUT_OF(65u, control.handover_left) + LAYOUT_OF(66u, status.trace) + LAYOUT_OF(67u, status.channels_us) +   \
	 LAYOUT_OF(68u, mean) + LAYOUT_OF(69u, control.estimator) + LAYOUT_OF(70u, control.estimator.speed) +          \
	 LAYOUT_OF(71u, control.motors) + LAYOUT_OF(72u, takeoff) + LAYOUT_OF(73u, gyro.rests) +                       \
	 LAYOUT_OF(74u, control.pid.standing) + LAYOUT_OF(75u, rotors) + LAYOUT_OF(76u, rotors.speed) +                \
	 LAYOUT_OF(77u, control.sees_rotors) + LAYOUT_OF(78u, rpm) + LAYOUT_OF(79u, control.estimator.measures) +      \
	 LAYOUT_OF(80u, weak_motor) + LAYOUT_OF(81u, control.dynamic_idle))

/* Offsets of its pointers (held.h), 8 bytes each, which are valid only in the program that wrote them. */
#define FIRMWARE_HELD                                                                                                 \
	{ offsetof(struct firmware, control.policy.weights),   offsetof(struct firmware, control.weights),            \
	  offsetof(struct firmware, control.pid.gains),        offsetof(struct firmware, control.observation.blocks), \
	  offsetof(struct firmware, control.observation.ages), offsetof(struct firmware, control.observation.gains),  \
	  offsetof(struct firmware, dshot_command.outputs) }
