"""The lockstep loop with a port that records what it gets."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control import sticks
from neuroflight.sim.flight import loop
from neuroflight.sim.flight.loop import fly, stand
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import CHANNEL_ARM, CHANNEL_THROTTLE, SWITCH_ON_US, THROTTLE_LOW_US
from neuroflight.toolchain.errors import LinkError

UNHEARD = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False).tolist()
HOLD = Scenario("hold", (Segment(0.02), Segment(0.03, (100.0, -50.0, 20.0), 0.4), Segment(0.05)))


class Recorder:
    """Arms with the switch after a second; answers a DShot value that tells control step and motor."""

    disarms = True

    def __init__(self, gyro_rate_hz: int = 4000, motors: int = 4, arms: bool = True) -> None:
        self.motor_count, self.gyro_rate_hz, self.control_rate_hz = motors, gyro_rate_hz, 1000
        self.samples: list[Sample] = []
        self.frames: list[tuple[int, list[int]]] = []  # (sample number, channels)
        self.replies: list[Reply] = []
        self._arms = arms

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        number = len(self.samples)
        self.samples.append(sample.copy())
        if channels_us is not None:
            self.frames.append((number, list(channels_us)))
        channels = self.frames[-1][1] if self.frames else UNHEARD
        step = number // (self.gyro_rate_hz // 1000)
        stays = not self.disarms and step > 0 and self.replies[-1].armed
        armed = self._arms and step >= 1000 and (channels[CHANNEL_ARM] >= SWITCH_ON_US or stays)
        dshot = np.array([48 + 10 * (step % 100) + motor for motor in range(self.motor_count)]) * armed
        reply = Reply(
            dshot.astype(np.uint16),
            step,
            sticks.setpoint(channels),
            sample.gyro.astype(np.float32),
            float(sticks.throttle(channels)),
            armed,
        )
        self.replies.append(reply)
        return reply

    def arming_reasons(self) -> tuple[str, ...]:
        return ("POLICY_BAD", "THROTTLE_HIGH")

    def close(self) -> None:
        pass


class Watched(Twin):
    """A twin that writes down the commands it gets."""

    def __init__(self, rate_hz: int = 4000, count: int = 1) -> None:
        super().__init__(load_aircraft("nf1"), count, rate_hz=rate_hz, rng=np.random.default_rng(1))
        self.given: list[list[float]] = []
        self.rates = [self.rate[0].copy()]

    def step(self, motors: np.ndarray, samples: int = 1) -> np.ndarray:
        self.given.append(motors[0].tolist())
        read = super().step(motors, samples)
        self.rates.append(self.rate[0].copy())
        return read


@functools.cache
def held() -> tuple[Recorder, Watched, Trace, int]:
    """The port, and what was `flown` with it."""
    port = Recorder()
    return port, *flown(port)


def flown(port: Recorder, scenario: Scenario = HOLD) -> tuple[Watched, Trace, int]:
    """The twin, the trace, and the number of the first armed sample."""
    twin = Watched(port.gyro_rate_hz)
    trace = fly(twin, port, scenario)
    return twin, trace, next(k for k, reply in enumerate(port.replies) if reply.armed)


def test_every_sample_is_answered_and_flown_once_when_in_lockstep() -> None:
    port, twin, trace, start = held()
    assert len(port.samples) == start + 4 * 101  # the last step is disarmed
    assert len(twin.given) == 4 * 101  # held until armed
    assert [sample.time_s for sample in port.samples[:3]] == [0.0, 0.00025, 0.0005]
    for reply, given in zip(port.replies[start:-4], twin.given[:-4], strict=True):
        assert given == [(int(value) - 48) / 1999 for value in reply.dshot]
    assert trace.t.tolist() == [k / 1000 for k in range(100)]


def test_rows_begin_at_the_first_armed_control_step_when_traced() -> None:
    port, twin, trace, start = held()
    assert start % 4 == 0
    controls = port.replies[start:-4:4]
    assert trace.dshot.tolist() == [reply.dshot.tolist() for reply in controls]
    assert trace.setpoint.tolist() == [reply.setpoint.tolist() for reply in controls]
    assert trace.rate.tolist() == [rate.tolist() for rate in twin.rates[:-5:4]]
    assert trace.gyro.tolist() == [reply.gyro.tolist() for reply in controls]
    assert trace.motors.tolist() == twin.given[:-4:4]


def test_setpoints_follow_the_scenario_to_the_step_when_flown() -> None:
    _, _, trace, _ = held()
    expected = np.zeros((100, 3))
    expected[20:50] = (100, -50, 20)
    assert np.rad2deg(trace.setpoint) == pytest.approx(expected, abs=1e-3)
    assert trace.throttle == pytest.approx(np.where(expected[:, 0] > 0, 0.4, 0.0))


def test_the_first_row_has_the_scenarios_rates_and_a_low_throttle_when_it_begins_in_motion() -> None:
    _, trace, _ = flown(Recorder(), Scenario("moving", (Segment(0.01, (200.0, 0.0, 0.0), 0.5),)))
    assert np.rad2deg(trace.setpoint[:, 0]) == pytest.approx(np.full(10, 200.0))
    assert trace.throttle[0] == 0
    # The throttle rises with the next frame that SBUS can carry, 4 ms later.
    assert trace.throttle[1:] == pytest.approx([0] * 3 + [0.5] * 6)


def test_frames_come_at_control_steps_as_a_receiver_sends_them_when_flown() -> None:
    port, _, _, start = held()
    assert port.frames[0][0] == 4 * 4  # no receiver is heard sooner: its frame takes so long
    times = np.array([number for number, _ in port.frames])
    assert (times % 4 == 0).all()
    gaps = np.diff(times) // 4
    assert gaps.min() >= 4
    assert gaps.max() == 10
    changed = [number for number, frame in port.frames if number >= start and frame[0] == 1550]
    assert changed[0] == start + 4 * 20


@pytest.mark.parametrize(("gyro_rate_hz", "first_ms"), [(8000, 4), (2000, 4), (1000, 5)])
def test_the_first_frame_arrives_when_a_serial_line_can_carry_it(gyro_rate_hz: int, first_ms: int) -> None:
    port = Recorder(gyro_rate_hz)
    flown(port, Scenario("short", (Segment(0.01),)))
    assert port.frames[0][0] == first_ms * gyro_rate_hz // 1000


def test_nobody_switches_on_and_frames_go_on_when_it_stands() -> None:
    port, twin = Recorder(1000), Watched(1000)
    stand(twin, port, 1500)  # the port would arm after 1000
    assert len(port.samples) == 1500
    assert len(port.frames) == pytest.approx(150, abs=2)  # one every 10 ms
    assert all(frame == UNHEARD for _, frame in port.frames)
    assert not any(reply.armed for reply in port.replies) and not twin.given


def test_boot_keeps_switch_and_throttle_low_when_not_yet_armed() -> None:
    port, _, _, start = held()
    boot = [frame for number, frame in port.frames if number < start]
    assert all(frame[CHANNEL_ARM] < SWITCH_ON_US for frame in boot)
    assert all(frame[CHANNEL_THROTTLE] <= THROTTLE_LOW_US for frame in boot)
    assert 1000 <= start // 4 <= 1200


def test_the_aircraft_stands_still_with_a_live_gyro_until_it_is_armed() -> None:
    port = Recorder(1000)
    twin = Twin(load_aircraft("nf1"), mount=Mount.FREE, rng=np.random.default_rng(1))
    fly(twin, port, HOLD)
    start = next(k for k, reply in enumerate(port.replies) if reply.armed)
    assert not np.any([sample.position for sample in port.samples[: start + 1]])
    noise = np.array([sample.gyro for sample in port.samples[:start]])
    assert (noise.std(axis=0) > 0.01).all()
    assert port.samples[-1].position[2] < 0  # and falls once it may move


def test_stops_when_the_firmware_turns_motors_while_disarmed() -> None:
    class Runaway(Recorder):
        def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
            reply = super().exchange(sample, channels_us)
            return replace(reply, dshot=np.full(4, 100, np.uint16), armed=False)

    with pytest.raises(LinkError, match="turns motors while it is disarmed"):
        flown(Runaway(1000))


def test_the_pilot_switches_off_and_the_motors_stop_when_the_scenario_is_over() -> None:
    port = Recorder(1000)
    twin, trace, start = flown(port, Scenario("short", (Segment(0.05, (100.0, 0.0, 0.0), 0.4),)))
    number, last = port.frames[-1]
    assert (last[CHANNEL_ARM], last[CHANNEL_THROTTLE]) == (1000, 1000)
    assert number == start + 50  # not before the last row
    assert not port.replies[-1].dshot.any()
    assert (len(trace.t), twin.given[-1]) == (50, [0.0] * 4)


def test_it_says_so_when_the_firmware_does_not_disarm() -> None:
    class Stubborn(Recorder):
        disarms = False

    class Spinning(Recorder):
        def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
            reply = super().exchange(sample, channels_us)
            return reply if reply.armed or not self.frames[-1:] else replace(reply, dshot=self._spin(reply))

        def _spin(self, reply: Reply) -> np.ndarray:
            flew = any(reply.armed for reply in self.replies)
            return np.full(4, 48 if flew else 0, np.uint16)

    for port, state in ((Stubborn(1000), "it is armed"), (Spinning(1000), "it is disarmed, DShot .48, 48")):
        with pytest.raises(LinkError, match=rf"did not disarm within 1 s.*{state}"):
            flown(port)


def test_no_frames_come_when_the_transmitter_is_silent() -> None:
    port = Recorder(1000)
    _, _, start = flown(port, Scenario("lost", (Segment(0.05), Segment(0.2, receiver=False), Segment(0.05))))
    heard = [number - start for number, _ in port.frames if number > start]
    assert not [step for step in heard if 50 <= step < 250]
    assert 250 in heard


def test_motors_are_crossed_when_an_order_is_given() -> None:
    port, twin = Recorder(1000), Watched(1000)
    fly(twin, port, HOLD, motor_order=(0, 2, 1, 3))
    last = port.replies[-2].dshot.tolist()
    assert twin.given[-2] == [(last[i] - 48) / 1999 for i in (0, 2, 1, 3)]


def test_progress_rises_to_the_end_when_asked_for() -> None:
    seen: list[float] = []
    twin = Watched(1000)
    fly(twin, Recorder(1000), Scenario("long", (Segment(1.0),)), progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) == 9
    assert 0.0 < seen[0] < seen[-1] < 1.0


def test_the_flight_repeats_when_the_seed_repeats() -> None:
    assert flown(Recorder())[1].same(held()[2])


@pytest.mark.parametrize(
    ("reasons", "said"),
    [
        (("POLICY_BAD", "THROTTLE_HIGH"), "POLICY_BAD, THROTTLE_HIGH"),
        ((), "names no reason; the pilot's arm switch is AUX 1"),
    ],
)
def test_it_gives_up_with_the_reasons_when_the_firmware_does_not_arm(
    reasons: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "ARM_LIMIT_S", 3.0)
    port = Recorder(1000, arms=False)
    port.arming_reasons = lambda: reasons  # type: ignore[method-assign]
    with pytest.raises(LinkError, match=f"did not arm within 3 s.*{said}"):
        fly(Watched(1000), port, HOLD)


def test_it_refuses_when_the_firmware_is_armed_from_an_earlier_flight() -> None:
    port, twin = Recorder(1000), Watched(1000)
    fly(twin, port, HOLD)
    port.exchange = lambda sample, channels_us: port.replies[-2]  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="armed with the switch off"):
        fly(twin, port, HOLD)


@pytest.mark.parametrize(
    ("port", "message"),
    [
        (Recorder(4000, motors=6), "drives 6 motors, aircraft nf1 has 4"),
        (Recorder(2000), "gyro runs at 2000 Hz"),
    ],
)
def test_it_refuses_when_firmware_and_twin_do_not_fit(port: Recorder, message: str) -> None:
    twin = Watched(4000)
    with pytest.raises(LinkError, match=message):
        fly(twin, port, HOLD)


def test_it_raises_a_value_error_when_the_motor_order_or_the_count_is_wrong() -> None:
    twin, pair = Watched(4000), Watched(4000, count=2)
    with pytest.raises(ValueError, match="no permutation"):
        fly(twin, Recorder(), HOLD, motor_order=(0, 1, 1, 3))
    with pytest.raises(ValueError, match="flies one aircraft"):
        fly(pair, Recorder(), HOLD)
