"""Thrust at rest and equal thrust of controllers whose thrust is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.cli.compare.thrust import documents, rest_documents
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY, Mix
from neuroflight.training.evaluation import comparison
from neuroflight.training.evaluation import equal_thrust as module
from neuroflight.training.evaluation.comparison import Entry
from neuroflight.training.evaluation.comparison_plot import draw_comparison
from neuroflight.training.evaluation.controllers import AnyController, Conditions, ControllerSpec
from neuroflight.training.evaluation.equal_thrust import equal_thrust, over_levels
from neuroflight.training.evaluation.thrust import THROTTLES, Progress, at_rest, transparency, trims
from neuroflight.training.tasks.task import PulseTask
from tests.training.evaluation.constant import Constant

NF1 = load_aircraft("nf1")
SHORT = PulseTask(idle_s=0.01, command_s=0.02, rest_s=0.01)
CONDITIONS = Conditions(NF1, SHORT, 3, 7)
WEIGHT = NF1.mass_properties.mass * GRAVITY  # [N]


def constant(level: float, idle: float, mix: Mix = Mix.ATTITUDE_FIRST) -> ControllerSpec:
    return ControllerSpec("constant", lambda n: Constant(n, level), 1000, idle, {"pid": f"{level}"}, mix)


def thrust_of(fraction: float) -> float:
    """Thrust of four rotors at a motor fraction, of the weight, from the aircraft's file."""
    thrust, _ = thrust_and_torque(target_speed(fraction, NF1.propulsion), NF1.propulsion)
    return 4 * float(thrust) / WEIGHT


def test_thrust_at_rest_is_the_rotors_when_the_motors_stand_at_a_fraction() -> None:
    (rest,) = at_rest(constant(0.0, 0.1), CONDITIONS, [0.25])
    fraction = 0.1 + 0.9 * 0.25
    assert rest.motor == pytest.approx(fraction, abs=3e-4)  # a step of DShot
    assert float(rest.thrust.value) == pytest.approx(thrust_of(fraction), rel=2e-3)
    assert rest.deviation == pytest.approx(0.0, abs=1e-9)


def test_the_deviation_at_rest_is_the_motors_when_they_swing() -> None:
    class Swinging(Constant):
        """Motors in pairs swing against each other, by 0.02 to either side of 0.5, at 50 Hz."""

        step_number = 0

        def step(
            self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
        ) -> NDArray[np.float32]:
            self.step_number += 1
            swing = 0.02 * np.sin(2 * np.pi * 50 * self.step_number / 1000)
            return self.action + np.array([swing, swing, -swing, -swing], np.float32)

    swinging = replace(constant(0.5, 0.1, Mix.CENTRED), build=lambda n: Swinging(n, 0.5))
    (rest,) = at_rest(swinging, CONDITIONS, [0.5])
    assert rest.deviation == pytest.approx(0.9 * 0.02 / np.sqrt(2), rel=0.03)  # the idle leaves 0.9


def test_a_transparent_controller_does_not_deviate_and_another_shows_what_it_adds() -> None:
    plain = transparency(constant(0.5, 0.1, Mix.CENTRED), CONDITIONS)
    assert [rest.throttle for rest in plain.rests] == list(THROTTLES)
    assert abs(plain.deviation.motor - plain.ideal(plain.deviation.throttle)) < 5e-4
    assert plain.falls is None
    greedy = transparency(constant(0.5, 0.1), CONDITIONS)  # u = T / 2 + 1 / 2
    assert greedy.deviation.throttle == 0.15
    assert greedy.deviation.motor - greedy.ideal(0.15) == pytest.approx(0.9 * 0.5 * 0.85, abs=5e-4)
    full = transparency(constant(1.0, 0.1), CONDITIONS)  # the throttle changes nothing
    assert full.falls == (THROTTLES[0], THROTTLES[1])
    told: Any = rest_documents([greedy])
    document = told["transparency"][0]
    assert document["falls"] is None
    assert document["motor"] == pytest.approx([0.55 + 0.45 * throttle for throttle in THROTTLES], abs=5e-4)


def test_the_throttle_is_found_or_the_nearest_where_there_is_none() -> None:
    known = transparency(constant(0.0, 0.23), CONDITIONS)
    closed, least, hover, four, most = trims(known, CONDITIONS, [0.0, 0.2, 1.0, 4.0, 19.0])
    assert closed.rest.throttle == least.rest.throttle == 0.0
    assert not least.reached
    assert most.rest.throttle == 1.0
    assert not most.reached
    for trim in (hover, four):
        assert trim.reached
        assert float(trim.rest.thrust.value) == pytest.approx(trim.wanted, rel=4e-3)
        assert thrust_of(0.23 + 0.77 * trim.rest.throttle) == pytest.approx(trim.wanted, rel=6e-3)


def test_a_throttle_that_stands_for_two_thrusts_is_flown_once(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[float | None] = []

    def counted(
        controller: AnyController, conditions: Conditions, throttle: float | None, show: Progress | None
    ) -> Entry:
        flown.append(throttle)
        return comparison.enter(controller, conditions, throttle, show)

    monkeypatch.setattr(module, "enter", counted)
    controllers = [constant(0.0, 0.23), constant(0.25, 0.1)]
    bars: list[str] = []

    def bar(label: str) -> Progress:
        bars.append(label)
        return lambda done, total: None

    found = equal_thrust(controllers, CONDITIONS, [0.0, 0.1, 2.0, 4.0], bar)
    assert len(flown) == 2 * 3  # closed and 0.1 are one throttle
    assert len(bars) == 2 * (2 + 3)
    assert [level.wanted for level in found.levels] == [0.0, 0.1, 2.0, 4.0]
    document: Any = documents(found)["equal_thrust"]
    first, second = document[2]["controllers"]
    assert first["thrust_at_rest"]["value"] == pytest.approx(2.0, rel=4e-3)
    assert first["throttle"] == found.levels[2].trims[0].rest.throttle
    assert "difference" not in first
    assert "motor_change" in second["difference"]
    mean, less = over_levels(found.levels[2:], 1, "mae")
    base, none = over_levels(found.levels[2:], 0, "mae")
    assert none is None
    assert less is not None
    assert float(less.value) == pytest.approx(float(mean.value - base.value), abs=1e-9)
    figure = draw_comparison(found.levels[3].entries, "", found.transparency)
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert "thrust at rest, of the weight" in titles


def test_motors_change_as_the_outputs_above_idle_where_the_throttle_stands_still() -> None:
    class Stairs(Constant):
        def step(
            self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
        ) -> NDArray[np.float32]:
            self.action = np.where(self.action > 0.2, np.float32(0.1), np.float32(0.3))
            return self.action

    spec = ControllerSpec("stairs", lambda count: Stairs(count, 0.1), 1000, 0.5, {})
    flights = CONDITIONS.fly(spec, 0.0)
    assert flights.motors is not None
    assert flights.motors.shape == flights.output.shape
    changes = np.abs(np.diff(flights.motors, axis=1))
    assert changes == pytest.approx(np.full(changes.shape, 0.1), abs=6e-4)


def test_a_faster_gyro_steps_the_twin_between_control_steps() -> None:
    slow, fast = (
        Conditions(NF1, SHORT, 3, 7, gyro_rate_hz=rate).fly(constant(0.2, 0.1), 0.3) for rate in (None, 4000)
    )
    assert slow.rate.shape == fast.rate.shape
    assert np.array_equal(slow.setpoint, fast.setpoint)
    assert slow.lift is not None
    assert fast.lift is not None
    assert fast.lift[:, -1] == pytest.approx(slow.lift[:, -1], rel=0.03)  # the same rotors, in finer steps


def test_commands_are_whole_steps_of_the_sticks_and_near_those_of_the_task() -> None:
    free, said = (
        np.rad2deg(Conditions(NF1, SHORT, 3, 7, sticks=sticks).fly(constant(0.2, 0.1), 0.3).setpoint)
        for sticks in (False, True)
    )
    assert said / 2 == pytest.approx(np.rint(said / 2), abs=1e-4)
    assert np.abs(said - free).max() <= 1.0 + 1e-4
    assert not np.array_equal(said, free)
