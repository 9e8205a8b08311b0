"""What a later flight tells of an aircraft that changed, flown in the twin by its PID."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.known import How, Known
from neuroflight.sim.aircraft.model import Aircraft, TorqueResponse, load_aircraft, parse_aircraft
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import save_trace
from neuroflight.sim.identification.changes import Changes, find_changes
from neuroflight.sim.identification.fit.fit import fit
from neuroflight.sim.identification.fit.flight import Flight, Piece, read_flight
from neuroflight.sim.identification.fit.gyro_path import mean_path
from neuroflight.sim.identification.fit.result import Fit
from neuroflight.sim.identification.fit.write import fitted_text, start_text
from neuroflight.sim.identification.sag import find_sag
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")


def taps(count: int) -> Scenario:
    """Quick taps of all axes to both sides, in a random order."""
    rng = np.random.default_rng(7)
    segments = []
    for _ in range(count):
        axis, rate = rng.integers(3), rng.choice([-1, 1]) * rng.uniform(90.0, 200.0)
        segments += [
            Segment(0.12, tuple(rate * np.eye(3)[axis]), 0.4),
            Segment(rng.uniform(0.1, 0.25), (0.0, 0.0, 0.0), 0.4),
        ]
    return Scenario("taps", tuple(segments))


def flown(path: Path, aircraft: Aircraft, shares: tuple[float, ...] = (1.0,) * 4, count: int = 32) -> Path:
    """Save the trace of a flight of taps by the NF1's PID. shares: of each motor's thrust."""
    own = pid_settings(NF1)
    port = ControllerPort(
        aircraft_pid(NF1), 4, 4000, idle=own.idle, mix=own.mix, gyro_filters=own.gyro_filters
    )
    scenario = taps(count)
    twin = Twin(aircraft, rate_hz=4000, mount=scenario.mount, rng=np.random.default_rng(1))
    twin.weaken(np.array(shares))
    with closing(port), closing(twin):
        save_trace(path, fly(twin, port, scenario))
    return path


def fitted(trace: Path) -> Fit:
    return fit([read_flight(trace, NF1.motor_count)], NF1)


def heavier() -> Aircraft:
    """100 g more, 30 mm ahead of the origin, which nearly double the moments."""
    own = NF1.mass_properties
    mass = own.mass + 0.1
    centre = (own.mass * own.centre + 0.1 * np.array([0.03, 0.0, 0.05])) / mass
    return replace(
        NF1,
        mass_properties=replace(
            own, mass=mass, centre=centre, inertia=own.inertia + np.diag([5.2e-4, 4.2e-4, 6.0e-4])
        ),
    )


def slower(share: float) -> Aircraft:
    response = NF1.propulsion.response
    assert isinstance(response, TorqueResponse)
    kept = 1.0 / share
    less = replace(
        response,
        gain=kept * response.gain,
        torque_up=kept * response.torque_up,
        torque_down=kept * response.torque_down,
    )
    return replace(NF1, propulsion=replace(NF1.propulsion, response=less))


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """The fit of a flight of the file's own aircraft."""
    return fitted(flown(tmp_path_factory.mktemp("flown") / "same.npz", NF1))


def test_a_log_of_the_unchanged_aircraft_tells_nothing_new(unchanged: Fit) -> None:
    changes = find_changes(unchanged, NF1)
    assert not changes and changes.causes == () and changes.strengths == (1.0,) * 4


def weak(path: Path) -> Changes:
    return find_changes(fitted(flown(path, NF1, (1.0, 1.0, 0.88, 1.0), 40)), NF1)


def slow(path: Path) -> Changes:
    return find_changes(fitted(flown(path, slower(1.25), count=40)), NF1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "told"),
    [(weak, "motor 3 gives 1"), (slow, "the rotors take 2")],
)
def test_a_change_is_named_and_no_other(change: Callable[[Path], Changes], told: str, tmp_path: Path) -> None:
    (cause,) = change(tmp_path / "flight.npz").causes
    assert cause.startswith(told)


@cache
def of(key: str) -> tuple[str, ...]:
    """Keys of the fit that a change is made of."""
    return {
        "response": ("response.gain", "response.torque_up", "response.torque_down"),
        "gyro.noise": ("gyro.noise.roll", "gyro.noise.yaw"),
    }.get(key, (key,))


@pytest.mark.parametrize(
    ("key", "times", "told"),
    [
        ("response", 1.25, "the rotors answer in 20 % less time"),
        ("response", 0.8, "the rotors take 25 % longer to answer"),
        (
            "authority.pitch",
            0.8,
            "pitch turns 20 % less for the same motors: something heavy (camera, battery)",
        ),
        ("authority.yaw", 1.3, "yaw turns 30 % more for the same motors: something heavy sits nearer"),
        ("delay_s", 2.0, "commands reach the rotors 2.0 ms later"),
        ("motor.2", 0.8, "motor 2 gives 20 % less thrust than the others"),
        ("motor.4", 1.2, "motor 4 gives 20 % more thrust than the others"),
        ("gyro.noise", 3.0, "the gyro is 3.0 times as noisy about roll and yaw"),
        ("authority.roll", 0.97, None),
        ("delay_s", 1.1, None),
        ("motor.2", 0.98, None),
        ("inflow", 9.0, None),
    ],
)
def test_a_number_that_is_another_one_is_told_in_a_pilot_s_words(
    key: str, times: float, told: str | None, unchanged: Fit
) -> None:
    parameters = dict(unchanged.parameters)
    for name in of(key):
        one = parameters[name]
        value = times * one.start
        half = min(0.02 * value, 3e-4) if key == "delay_s" else 0.02 * value
        parameters[name] = replace(one, value=value, low=value - half, high=value + half, told=True)
    causes = find_changes(replace(unchanged, parameters=parameters), NF1).causes
    assert (told is None and causes == ()) or [each.startswith(str(told)) for each in causes] == [True]
    untold = {name: replace(each, told=False) for name, each in parameters.items()}
    assert key == "inflow" or not find_changes(replace(unchanged, parameters=untold), NF1)


def test_a_change_within_what_the_file_s_own_mark_leaves_open_is_none(unchanged: Fit) -> None:
    one = unchanged.parameters["delay_s"]
    later = replace(one, value=0.0032, low=0.0029, high=0.0035)
    moved = replace(unchanged, parameters={**unchanged.parameters, "delay_s": later})
    assert find_changes(moved, NF1).causes
    unsure = replace(NF1, known={"propulsion.delay_s": Known(How.MEASURED, (0.001, 0.003), "a log")})
    assert not find_changes(moved, unsure)


def flights(aircraft: Aircraft, charge: float) -> list[Flight]:
    """A flight of 9 s with a battery, volts beside motors, at a throttle that goes up and down."""
    task = PulseTask(idle_s=0.5, command_s=3.0, rest_s=5.5)
    throttle = np.repeat([0.2, 0.55, 0.3, 0.7, 0.25, 0.5], 1500)[None].astype(np.float32)
    found = Conditions(aircraft, task, 1, 5, charge=charge).fly(load_controller("pid", NF1), throttle)
    assert found.volts is not None and found.motors is not None
    piece = Piece(
        0.0, found.step_s, found.motors[0].astype(float), found.rate[0].astype(float), None,
        found.volts[0].astype(float), None, np.ones(found.rate.shape[1], bool),
    )  # fmt: skip
    path = mean_path(found.step_s, found.step_s)
    return [
        Flight(
            name="log",
            pieces=(piece,),
            rate_hz=1000.0,
            control_s=found.step_s,
            twin_s=found.step_s,
            path=path,
            idle=None,
            current=None,
            notes=(),
        )
    ]


def test_another_battery_is_told_by_its_resistance_and_none_without_volts(unchanged: Fit) -> None:
    assert NF1.battery is not None
    (flight,) = flights(NF1, 0.9)
    old = find_sag([flight], NF1)
    assert old is not None and old.low < NF1.battery.resistance < old.high and old.cells is None
    assert not find_changes(unchanged, NF1, old)
    tired = replace(NF1, battery=replace(NF1.battery, resistance=0.045))
    sag = find_sag(flights(tired, 0.9), NF1)
    assert sag is not None and sag.resistance == pytest.approx(0.045, rel=0.1)
    (cause,) = find_changes(unchanged, NF1, sag).causes
    assert cause.startswith("the battery's resistance is 4") and "an old, cold or smaller pack" in cause
    bare = replace(flight, pieces=tuple(replace(piece, voltage=None) for piece in flight.pieces))
    assert find_sag([bare], NF1) is None


def test_a_motor_that_gave_less_when_the_file_was_fitted_is_no_change(unchanged: Fit) -> None:
    shares = (1.03, 0.91, 1.03, 1.03)
    parameters = dict(unchanged.parameters)
    for number, share in enumerate(shares, 1):
        one = parameters[f"motor.{number}"]
        parameters[one.key] = replace(one, value=share, low=share - 0.01, high=share + 0.01, told=True)
    fitted_again = replace(unchanged, parameters=parameters)
    assert "motor 2 gives" in find_changes(fitted_again, NF1).causes[0]
    logged = replace(NF1, motor_thrust=shares)
    assert not find_changes(fitted_again, logged)
    (cause,) = find_changes(unchanged, logged).causes
    assert cause.startswith("motor 2 gives") and "more thrust than in the file" in cause


def test_the_file_of_a_fit_holds_what_each_motor_gave(unchanged: Fit) -> None:
    aircraft = parse_aircraft(fitted_text(start_text("nf1"), NF1, unchanged).encode(), "mine.toml")
    found = [unchanged.parameters[f"motor.{number}"].value for number in range(1, 5)]
    assert aircraft.motor_thrust == pytest.approx(found, abs=1e-5)
