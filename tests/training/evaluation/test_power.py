"""Power of controllers whose motors are known, against the aircraft's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.compare.suites.power import drawn_document
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.training.evaluation.controllers import Conditions, ControllerSpec
from neuroflight.training.evaluation.evaluation import drawn as drawn_streams
from neuroflight.training.evaluation.power import Draw, disarmed, power
from neuroflight.training.evaluation.power_plot import draw_power
from neuroflight.training.tasks.task import PulseTask
from tests.conftest import ROOT
from tests.training.evaluation.constant import Constant

NF1 = load_aircraft("nf1")
NF1_FILE = ROOT / "sim" / "aircraft" / "nf1.toml"
SHORT = PulseTask(idle_s=0.01, command_s=0.02, rest_s=0.01)
CONDITIONS = Conditions(NF1, SHORT, 2, 7, charge=1.0)


def constant(level: float, idle: float) -> ControllerSpec:
    return ControllerSpec("constant", lambda n: Constant(n, level), 1000, idle, {"pid": f"{level}"})


def bar(_: str) -> Callable[[int, int], None]:
    return lambda done, total: None


def number(drawn: Draw, name: str) -> float:
    return float(getattr(drawn, name).value)


def test_a_disarmed_aircraft_draws_its_electronics_alone() -> None:
    assert NF1.battery is not None
    still = disarmed(NF1.battery, 1.0)
    volts, amps = number(still, "volts"), number(still, "amps")
    assert number(still, "watts") == pytest.approx(NF1.battery.electronics_power, rel=1e-5)
    assert volts == pytest.approx(NF1.battery.rest_voltage - NF1.battery.resistance * amps, abs=1e-4)
    assert number(disarmed(NF1.battery, 0.5), "amps") > amps  # the same power of a lower voltage


def test_an_idling_aircraft_draws_what_its_rotors_turn_with() -> None:
    idle = 0.2
    drawn = power(constant(0.0, idle), CONDITIONS, [], 0.2, bar)
    assert NF1.battery is not None and NF1.propulsion.supply_voltage is not None
    volts = number(drawn.idling, "volts")
    speed = target_speed(idle, NF1.propulsion) * volts / NF1.propulsion.supply_voltage
    _, torque = thrust_and_torque(speed, NF1.propulsion)
    shaft = 4 * float(abs(torque)) * float(speed)
    wanted = shaft / NF1.propulsion.efficiency + NF1.battery.electronics_power
    assert number(drawn.idling, "watts") == pytest.approx(wanted, rel=0.02)
    assert drawn.flown == ()


def test_in_flight_more_thrust_takes_more_current_and_the_error_is_told() -> None:
    drawn = power(constant(0.0, 0.05), CONDITIONS, [0.5, 1.0], 0.1, bar)
    less, more = drawn.flown
    assert number(drawn.idling, "amps") < number(less.rest, "amps") < number(more.rest, "amps")
    assert less.trim.reached and more.trim.reached
    # A controller that never answers is off by the command while it lasts: half of the time.
    commands, _ = drawn_streams(CONDITIONS.seed)
    wanted = np.rad2deg(np.abs(SHORT.episodes(2, commands, 1000))).mean()
    assert float(more.mae.value) == pytest.approx(wanted, rel=0.02)
    assert [flown["thrust"] for flown in drawn_document(drawn)["flights"]] == [0.5, 1.0]
    assert NF1.battery is not None
    still = disarmed(NF1.battery, 1.0)
    assert len(draw_power(still, [drawn], "title").axes) == 2
    assert len(draw_power(still, [replace(drawn, flown=())], "title").axes) == 1


def test_an_aircraft_without_a_battery_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = NF1_FILE.read_text()
    head, _, rest = text.partition("[battery]")
    file = tmp_path / "nf1.toml"
    file.write_text(head + "[body]" + rest.partition("[body]")[2])
    assert main(["compare", "--suite", "power", "pid", "--aircraft", str(file)]) == 1
    assert "no [battery] table" in capsys.readouterr().err
