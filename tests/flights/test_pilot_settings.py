"""Settings of how the aircraft is built and wired: set as it is, it flies as the one of its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment, pulses
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.contract import AXES, GRAVITY, FlightState, Msp, StopCause
from tests.flights.wiring import on_turned_board, reversed_aircraft
from tests.sampling import sampled

GYRO_RATE_HZ = 4000
Flown = Callable[..., Trace]
TURNS = Scenario(
    "turns",
    (
        Segment(0.3, (100.0, 0.0, 0.0), 0.3),
        Segment(0.3, (0.0, -80.0, 60.0), 0.5),
        Segment(0.3, (-50.0, 40.0, -90.0), 0.4, pid=True),
    ),
)


def motor_order(outputs: Sequence[int]) -> dict[str, float]:
    """The settings of an aircraft whose motor i is wired to output outputs[i], both from 1."""
    return {f"motor{motor}_output": output for motor, output in enumerate(outputs, start=1)}


@pytest.mark.parametrize("outputs", sampled([(2, 1, 3, 4), (4, 2, 1, 3), (2, 3, 4, 1)], (4, 2, 1, 3)))
def test_an_aircraft_flies_the_same_bits_when_its_motors_are_wired_as_set(
    reference_library: Path, flown: Flown, outputs: tuple[int, ...]
) -> None:
    straight = flown(ReferencePort(reference_library, GYRO_RATE_HZ), TURNS)
    port = ReferencePort(reference_library, GYRO_RATE_HZ, motor_order(outputs))
    motor_of = tuple(np.argsort(outputs).tolist())
    crossed = flown(port, TURNS, motor_order=motor_of)
    np.testing.assert_array_equal(crossed.dshot, straight.dshot[:, motor_of])
    np.testing.assert_array_equal(crossed.rate, straight.rate)
    np.testing.assert_array_equal(crossed.gyro, straight.gyro)


# --- Motors that turn the other way ---------------------------------------------------------------
Built = Callable[..., tuple[Trace, records.Safety]]


@pytest.fixture
def built(reference_library: Path) -> Built:
    """Flies an aircraft under these settings; returns the trace, and what the firmware says of its safety."""

    def run(
        aircraft: Aircraft,
        scenario: Scenario,
        settings: Mapping[str, float],
        *,
        noise: bool = True,
        ground: bool = False,
    ) -> tuple[Trace, records.Safety]:
        port = ReferencePort(reference_library, GYRO_RATE_HZ, {"ground_detection": int(ground), **settings})
        rng = np.random.default_rng((1, 1))
        twin = Twin(aircraft, rate_hz=GYRO_RATE_HZ, mount=scenario.mount, noise=noise, ground=ground, rng=rng)
        with closing(port), closing(twin):
            trace = fly(twin, port, scenario)
            return trace, records.safety(Client(port.reference).request(Msp.SAFETY))

    return run


def mae_deg_s(trace: Trace) -> NDArray[np.float64]:
    """Mean error of each axis."""
    error: NDArray[np.float64] = np.rad2deg(np.abs(trace.setpoint - trace.rate)).mean(axis=0)
    return error


@pytest.mark.parametrize("pid", sampled([False, True], False), ids=["policy", "pid"])
def test_an_aircraft_of_reversed_motors_flies_when_set_so(built: Built, tmp_path: Path, pid: bool) -> None:
    """As the usual one whose yaw is commanded the other way, under the PID.

    A network has learnt to answer the body's own coupling of the axes, which reversed rotors leave as it is:
    its errors are up to two and a half times as large, as docs/reference/settings.md says.
    """
    scenario = pulses(7, 2)
    scenario = scenario.under_pid() if pid else scenario
    mirrored = tuple(
        replace(
            part, setpoint_deg_s=(part.setpoint_deg_s[0], part.setpoint_deg_s[1], -part.setpoint_deg_s[2])
        )
        for part in scenario.segments
    )
    usual, _ = built(load_aircraft("nf1"), replace(scenario, segments=mirrored), {})
    other, safety = built(reversed_aircraft("nf1", tmp_path), scenario, {"motors_reversed": 1})
    assert safety.stop_cause == StopCause.SWITCH
    assert (other.dshot > 0).all()
    if pid:
        assert np.abs(mae_deg_s(other) - mae_deg_s(usual)).max() < 0.2
    else:
        assert (mae_deg_s(other) < 2.5 * mae_deg_s(usual)).all()


@pytest.mark.parametrize("pid", [False, True], ids=["policy", "pid"])
def test_the_flight_is_the_mirror_image_when_yaw_is_commanded_the_other_way(
    built: Built, tmp_path: Path, pid: bool
) -> None:
    """Without noise. What is left is how a turning body and its rotors couple the axes: it has no image."""

    def commands(sign: float) -> Scenario:
        rest = Segment(0.4, throttle=0.3, pid=pid)
        yaw = replace(rest, setpoint_deg_s=(0.0, 0.0, 90.0 * sign))
        roll = replace(rest, setpoint_deg_s=(100.0, 0.0, 0.0))
        return Scenario("mirrored", (rest, yaw, rest, roll))

    still = {"gyro_stuck_ms": 0}  # without noise it measures the same at rest
    usual, _ = built(load_aircraft("nf1"), commands(1.0), still, noise=False)
    aircraft = reversed_aircraft("nf1", tmp_path)
    other, _ = built(aircraft, commands(-1.0), still | {"motors_reversed": 1}, noise=False)
    apart = np.rad2deg(np.abs(usual.rate - other.rate * (1.0, 1.0, -1.0))).max(axis=0)
    print(apart, np.abs(usual.dshot.astype(int) - other.dshot).max())
    assert np.rad2deg(np.abs(usual.rate)).max(axis=0)[[0, 2]].min() > 80
    assert apart.max() < 0.5


@pytest.mark.parametrize("pid", [False, True], ids=["policy", "pid"])
@pytest.mark.parametrize("throttle", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("turned", [False, True], ids=["usual motors", "reversed motors"])
def test_the_motors_stop_at_once_when_their_direction_is_set_wrongly(
    built: Built, tmp_path: Path, pid: bool, throttle: float, turned: bool
) -> None:
    """Yaw runs away under either controller: neither can help."""
    aircraft = reversed_aircraft("nf1", tmp_path) if turned else load_aircraft("nf1")
    scenario = Scenario("wrong", (Segment(1.0, throttle=throttle, pid=pid),))
    trace, safety = built(aircraft, scenario, {"motors_reversed": 0 if turned else 1})
    stopped = trace.t[(trace.dshot == 0).all(axis=1)]
    assert (safety.state, safety.stop_cause) == (FlightState.CRASHED, StopCause.RUNAWAY)
    assert stopped[0] < 0.6
    assert np.rad2deg(np.abs(trace.rate)).max() < 800


@pytest.mark.parametrize("pid", [False, True], ids=["policy", "pid"])
def test_the_motors_stop_before_it_flies_when_it_takes_off_with_their_direction_set_wrongly(
    built: Built, tmp_path: Path, pid: bool
) -> None:
    lift = Scenario("lift", (Segment(1.0, pid=pid), Segment(2.0, throttle=0.3, pid=pid)), mount=Mount.FREE)
    _, safety = built(load_aircraft("nf1"), lift, {}, ground=True)
    assert safety.stop_cause == StopCause.SWITCH
    trace, safety = built(reversed_aircraft("nf1", tmp_path), lift, {}, ground=True)
    stopped = trace.t[(trace.dshot == 0).all(axis=1)]
    assert safety.stop_cause == StopCause.RUNAWAY
    assert stopped[0] < 1.5, "within half a second of the throttle's rise, as docs/reference/settings.md says"


# --- A board that is turned ------------------------------------------------------------------------
Angles = tuple[float, float, float]
MOUNTED = [(0.0, 0.0, 45.0), (180.0, 0.0, 0.0), (-37.0, 61.0, 142.0)]


def board_angles(angles: Angles) -> dict[str, float]:
    """The settings of a board that is so turned."""
    return {f"board_{axis}_deg": angle for axis, angle in zip(AXES, angles, strict=True)}


@pytest.mark.parametrize("pid", sampled([False, True], False), ids=["policy", "pid"])
@pytest.mark.parametrize("angles", sampled(MOUNTED, MOUNTED[2]), ids=str)
def test_an_aircraft_flies_as_well_when_its_board_is_turned_as_set(
    reference_library: Path, flown: Flown, angles: Angles, pid: bool
) -> None:
    scenario = pulses(7, 2)
    scenario = scenario.under_pid() if pid else scenario
    straight = flown(ReferencePort(reference_library, GYRO_RATE_HZ), scenario)
    port = ReferencePort(reference_library, GYRO_RATE_HZ, board_angles(angles))
    turned = flown(on_turned_board(port, angles), scenario)
    print(mae_deg_s(straight), mae_deg_s(turned))
    assert np.abs(mae_deg_s(turned) - mae_deg_s(straight)).max() < 0.1
    seen = np.rad2deg(np.abs(turned.gyro - turned.rate)).mean(axis=0)
    assert seen.max() < 2.0, "the gyro tells body rates"


def told(port: ReferencePort, roll_deg: float, pitch_deg: float) -> tuple[messages.Attitude, tuple[str, ...]]:
    """What the firmware makes of an aircraft that stands so for two seconds."""
    roll, pitch = np.radians((roll_deg, pitch_deg))
    level = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    nose = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    up = (nose @ level).T @ (0.0, 0.0, GRAVITY)
    rng = np.random.default_rng(1)
    sample = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), up)
    for _ in range(2 * GYRO_RATE_HZ):
        sample.gyro[:] = rng.normal(0.0, 0.01, 3)
        port.exchange(sample, None)
    attitude = messages.attitude(Client(port.reference).request(Msp.ATTITUDE))
    return attitude, port.arming_reasons()


@pytest.mark.parametrize(
    "stands", sampled([(0.0, 0.0), (20.0, -15.0), (60.0, 10.0)], (20.0, -15.0), (60.0, 10.0)), ids=str
)
@pytest.mark.parametrize("angles", sampled(MOUNTED, MOUNTED[2]), ids=str)
def test_attitude_and_level_check_are_the_aircrafts_when_its_board_is_turned_as_set(
    reference_library: Path, angles: Angles, stands: tuple[float, float]
) -> None:
    straight, reasons = told(ReferencePort(reference_library, GYRO_RATE_HZ), *stands)
    assert ("NOT_LEVEL" in reasons) == (stands[0] > 25)
    port = ReferencePort(reference_library, GYRO_RATE_HZ, board_angles(angles))
    turned = told(on_turned_board(port, angles), *stands)
    assert turned[0].roll_deg == pytest.approx(straight.roll_deg, abs=0.2)
    assert turned[0].pitch_deg == pytest.approx(straight.pitch_deg, abs=0.2)
    assert abs(straight.roll_deg) == pytest.approx(stands[0], abs=0.2)
    assert turned[1] == reasons


def test_a_board_that_hangs_upside_down_does_not_arm_when_nobody_set_it(reference_library: Path) -> None:
    hanging = on_turned_board(ReferencePort(reference_library, GYRO_RATE_HZ), (180.0, 0.0, 0.0))
    assert "NOT_LEVEL" in told(hanging, 0.0, 0.0)[1]


# --- All of it -------------------------------------------------------------------------------------
def test_library_host_and_board_fly_the_same_bits_when_all_is_set(
    reference_library: Path, host_program: Path, board_image: Path, tmp_path: Path
) -> None:
    outputs, angles = (3, 1, 4, 2), (-37.0, 61.0, 142.0)
    factors = {"pid_roll_p": 1.2, "pid_pitch_d": 0.8, "pid_yaw_i": 1.5}
    settings = {"motors_reversed": 1, **motor_order(outputs), **board_angles(angles), **factors}
    aircraft = reversed_aircraft("nf1", tmp_path)
    ports = (
        ReferencePort(reference_library, settings=settings),
        HostPort(host_program, settings=settings),
        EmulatedPort(board_image.with_suffix(".bin"), settings=settings),
    )
    traces = []
    for port in ports:
        rng = np.random.default_rng(2)
        twin = Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=TURNS.mount, rng=rng)
        with closing(port), closing(twin):
            order = np.argsort(outputs).tolist()
            traces.append(fly(twin, on_turned_board(port, angles), TURNS, motor_order=order))
    library, *others = traces
    assert np.ptp(library.dshot.astype(int), axis=0).min() > 100, "every motor has something to do"
    assert np.rad2deg(np.abs(library.setpoint - library.rate))[[500, 899]].max() < 10
    for other in others:
        assert other.same(library)
