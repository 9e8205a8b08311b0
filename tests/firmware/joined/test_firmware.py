"""firmware.c: the joined core, flown sample by sample around a scripted policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_ROLL,
    CHANNEL_YAW,
    GYRO_BAD_MS,
    RECEIVER_LOST_MS,
    Alignment,
    ArmingReason,
    DshotCommand,
    FlightState,
    GyroHealth,
)

Make = Callable[..., Any]


@pytest.mark.parametrize("gyro_hz", [1000, 2000, 4000, 8000])
def test_control_steps_come_at_the_policys_rate_when_the_gyro_is_faster(bench: Make, gyro_hz: int) -> None:
    b = bench(gyro_hz)
    due = []
    for _ in range(4 * gyro_hz // 1000):
        due.append(b.core.lib.firmware_control_due(b.fw))
        b.sample()
    assert due == ([True] + [False] * (gyro_hz // 1000 - 1)) * 4
    assert b.trace.step == 3


@pytest.mark.parametrize("gyro_hz", [0, 1, 500, 1500, 3000, 16000])
def test_init_refuses_when_the_gyro_rate_is_unknown(bench: Make, scripted: Any, gyro_hz: int) -> None:
    bench(gyro_hz, expect=scripted.lib.NF_ERR_GYRO_RATE)


def test_init_refuses_when_the_alignment_is_wrong(bench: Make, scripted: Any) -> None:
    bench(1000, alignment=len(Alignment), expect=scripted.lib.NF_ERR_ALIGNMENT)


def test_outputs_follow_mixer_and_dshot_when_armed(bench: Make, scripted: Any) -> None:
    b = bench(4000)
    mixer = scripted.ffi.addressof(b.fw.control.mixers[scripted.lib.CONTROLLER_POLICY])
    assert scripted.lib.mixer_set_idle(mixer, 0.05) == 0
    b.arm()
    scripted.lib.scripted_action = [0.0, 0.25, 0.5, 0.125]
    values = b.run(20, arm=2000, throttle=1400)
    u = 0.05 + 0.95 * (0.4 * (1 - 0.5) + np.array([0.0, 0.25, 0.5, 0.125]))
    np.testing.assert_allclose(values, 48 + 1999 * u, atol=0.51)
    assert list(b.trace.dshot)[:4] == values


def test_outputs_are_held_when_the_sample_is_no_control_step(bench: Make, scripted: Any) -> None:
    b = bench(4000)
    b.arm()
    while not b.core.lib.firmware_control_due(b.fw):
        b.sample()
    scripted.lib.scripted_action = [0.5] * 4
    held = b.sample()
    scripted.lib.scripted_action = [0.9] * 4
    assert [b.sample() for _ in range(3)] == [held] * 3
    assert b.sample() != held


def test_observation_holds_what_was_flown_when_all_blocks_are_asked_for(bench: Make, scripted: Any) -> None:
    b = bench(1000, ground_detection=0)
    b.arm()
    scripted.lib.scripted_action = [0.1, 0.2, 0.3, 0.4]
    b.sample()  # remembered as the previous action below
    b.counts = (1000, -2000, 3000)
    b.stick(arm=2000, throttle=1250, c0=1600, c1=1450, c3=1510)
    b.sample()
    rate = np.radians(np.array(b.counts) * 2000 / 32768)
    error = np.radians([200, -100, -20]) - rate
    seen = np.array(list(scripted.lib.scripted_observation))
    np.testing.assert_allclose(seen[0:3], rate, rtol=1e-6)
    np.testing.assert_allclose(seen[3:6], error, rtol=1e-6)
    np.testing.assert_allclose(seen[6:9], error, rtol=1e-6)  # the error was 0 before
    np.testing.assert_allclose(seen[9:12], error / 1000, rtol=1e-6)
    np.testing.assert_allclose(seen[12:16], [0.1, 0.2, 0.3, 0.4], rtol=1e-6)
    assert seen[16] == pytest.approx(0.25)
    np.testing.assert_allclose(list(b.trace.gyro), rate, rtol=1e-6)
    np.testing.assert_allclose(list(b.trace.setpoint), np.radians([200, -100, -20]), rtol=1e-6)


def test_the_controller_remembers_nothing_when_it_is_armed_again(bench: Make, scripted: Any) -> None:
    b = bench(1000, level_limit_deg=0, ground_detection=0)  # it is tilted when it is armed again
    b.arm()
    scripted.lib.scripted_action = [0.3] * 4
    b.counts = (5000, 5000, 5000)
    b.run(100, arm=2000, c0=1900)
    assert any(list(scripted.lib.scripted_observation)[9:12])
    inits = scripted.lib.scripted_inits
    b.run(50)
    assert scripted.lib.scripted_inits == inits + 1  # at once, so that arming takes no longer than flying
    b.stick(arm=2000, c0=1700)
    b.sample()
    assert b.armed
    assert scripted.lib.scripted_inits == inits + 1
    seen = np.array(list(scripted.lib.scripted_observation))
    assert seen[6:9].tolist() == [0, 0, 0]
    np.testing.assert_allclose(seen[9:12], seen[3:6] / 1000, rtol=1e-6)
    assert seen[12:16].tolist() == [0, 0, 0, 0]


def test_the_policy_does_not_run_when_disarmed(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    steps = scripted.lib.scripted_steps
    scripted.lib.scripted_action = [0.5] * 4
    assert b.run(1500, throttle=1000) == [0, 0, 0, 0]
    assert scripted.lib.scripted_steps == steps


def test_status_is_that_of_the_last_control_step_when_asked(bench: Make) -> None:
    b = bench(2000)
    b.run(230, c0=1234, throttle=1500)
    status = b.status
    assert status.trace.step == b.trace.step == 229
    assert status.channels_us[CHANNEL_ROLL] == 1234
    assert status.channels_us[CHANNEL_YAW] == 1500
    assert (status.receiver_good, status.policy_good) == (True, True)
    assert status.gyro_rate_hz == 2000
    b.run(500, every_ms=None)
    assert not b.status.receiver_good


def test_receiver_frames_are_whole_when_their_bytes_come_over_several_steps(
    bench: Make, sbus: Callable[..., bytes]
) -> None:
    b = bench(1000)
    b.run(200)
    frame = sbus([992] * 4 + [172] * 12)
    for first in range(0, 25, 8):  # 8 bytes a millisecond at 100 kbaud
        assert not b.status.receiver_good
        b.send(frame[first : first + 8])
        b.sample()
    assert b.status.receiver_good


def test_half_a_frame_is_forgotten_when_the_line_falls_silent(
    bench: Make, sbus: Callable[..., bytes]
) -> None:
    b = bench(1000)
    b.run(200)
    frame = sbus([992] * 16)
    b.send(frame[:10])
    b.sample()
    for _ in range(3):
        b.send(b"")
        b.sample()
    b.send(frame[10:])
    b.sample()
    assert not b.status.receiver_good
    b.run(3, every_ms=None)
    b.send(frame)
    b.sample()
    assert b.status.receiver_good


def test_any_receiver_bytes_are_survived_when_they_are_random(bench: Make) -> None:
    b = bench(1000)
    rng = np.random.default_rng(9)
    for _ in range(3000):
        b.send(rng.integers(0, 256, rng.integers(0, 60), np.uint8).tobytes())
        assert b.sample() == [0, 0, 0, 0]


def test_a_dshot_command_reaches_the_motors_and_nothing_arms_when_one_is_asked_for(
    bench: Make, scripted: Any
) -> None:
    b = bench(1000)
    b.run(1100)
    command = scripted.ffi.addressof(b.fw, "dshot_command")
    assert scripted.lib.dshot_command_ask(command, DshotCommand.DIRECTION_2, 1, True) == 0
    rows = [b.sample() for _ in range(100)]
    assert [0, 8, 0, 0] in rows
    assert {tuple(row) for row in rows} <= {(0, 0, 0, 0), (0, 8, 0, 0)}
    assert scripted.lib.dshot_command_ask(command, DshotCommand.BEACON_1, 0, True) == 0
    b.run(20, arm=2000)
    assert not b.armed
    assert b.reasons & 1 << ArmingReason.MOTOR_TEST


def test_motors_stop_and_everything_waits_on_when_the_gyro_is_silent(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    b.arm()
    scripted.lib.scripted_action = [0.5] * 4
    assert min(b.run(20, arm=2000)) > 48
    values = scripted.new("uint16_t[4]", [9] * 4)
    before = scripted.lib.firmware_samples(b.fw)
    scripted.lib.firmware_gyro_silent(b.fw, values)
    assert list(values) == [0] * 4
    assert scripted.lib.firmware_samples(b.fw) == before + GYRO_BAD_MS
    assert (b.status.state, b.status.gyro_health) == (FlightState.FAULT, GyroHealth.SILENT)
    assert b.run(100, arm=2000) == [0] * 4
    assert b.status.gyro_health == GyroHealth.GOOD


def test_a_silent_gyro_lets_the_receiver_age_when_nothing_flies(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    b.run(1100)
    values = scripted.new("uint16_t[4]")
    for _ in range(RECEIVER_LOST_MS // GYRO_BAD_MS):
        scripted.lib.firmware_gyro_silent(b.fw, values)
    assert b.reasons & 1 << ArmingReason.RECEIVER_LOST
    assert b.reasons & 1 << ArmingReason.GYRO_BAD
    assert b.status.state == FlightState.DISARMED


@pytest.mark.parametrize(
    ("tilt_deg", "level"), [(0, True), (24, True), (26, False), (90, False), (180, False)]
)
def test_it_arms_only_within_the_tilt_that_is_set_when_it_stands_still(
    bench: Make, tilt_deg: float, level: bool
) -> None:
    b = bench(1000)
    angle = np.radians(tilt_deg)
    b.accel = (0, round(2048 * np.sin(angle)), round(2048 * np.cos(angle)))
    b.run(1100)
    assert b.reasons == (0 if level else 1 << ArmingReason.NOT_LEVEL)
    b.run(20, arm=2000)
    assert b.armed is level


def test_motors_stand_with_the_throttle_low_when_motor_stop_is_set(bench: Make) -> None:
    b = bench(1000, motor_stop=1)
    b.arm()
    assert b.run(20, arm=2000) == [0] * 4
    assert b.armed
    assert min(b.run(20, arm=2000, throttle=1300)) > 48


def test_reasons_of_the_background_forbid_arming_when_they_hold(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    b.run(1100)
    for reason in (ArmingReason.BATTERY_UNKNOWN, ArmingReason.FAULT, ArmingReason.STORING):
        scripted.lib.firmware_forbid(b.fw, reason, True)
        b.run(20, arm=2000)
        assert not b.armed
        assert b.reasons & 1 << reason
        scripted.lib.firmware_forbid(b.fw, reason, False)
        b.run(20)
        assert b.reasons == 0


# --- Samples that nobody took --------------------------------------------------------------------
@pytest.mark.parametrize("gyro_hz", [1000, 2000, 4000, 8000])
def test_time_goes_on_and_control_steps_keep_their_times_when_samples_are_lost(
    bench: Make, gyro_hz: int
) -> None:
    b, rng, divider = bench(gyro_hz), np.random.default_rng(gyro_hz), gyro_hz // 1000
    at, due = 0, 0  # sample that comes, and that of the next control step
    for _ in range(4000):
        lost = int(rng.integers(0, 3 * divider)) if rng.random() < 0.1 else 0
        b.core.lib.firmware_lost(b.fw, lost)
        at += lost
        while due + divider <= at:  # more than a control period late: that step is lost
            due += divider
        assert bool(b.core.lib.firmware_control_due(b.fw)) is (at >= due)
        b.sample()
        if at >= due:
            assert b.trace.step == due // divider
            due += divider
        at += 1
        assert b.fw.samples == at
        assert (b.fw.grace_left > 0) is (at < gyro_hz)


def test_a_silent_receiver_is_lost_in_its_time_when_samples_are_lost(bench: Make) -> None:
    b = bench(4000)
    b.arm()
    for _ in range(RECEIVER_LOST_MS - 1):
        b.core.lib.firmware_lost(b.fw, 2)
        b.run(0.5, every_ms=None)
        assert b.armed
    b.core.lib.firmware_lost(b.fw, 6)
    b.run(1, every_ms=None)
    assert not b.armed
