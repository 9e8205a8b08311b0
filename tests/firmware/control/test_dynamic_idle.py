"""dynamic_idle.c: how far the idle is raised, and that a twin's slowest rotor keeps its speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.rotor import target_speed
from neuroflight.toolchain.contract import DYNAMIC_IDLE_MAX

RATE_HZ = 1000
RPM = np.pi / 30


class Idle:
    """A dynamic idle of four motors."""

    def __init__(self, core: Any, rpm: int = 3000, telemetry: int = 1) -> None:
        self._core, self.struct = core, core.new("struct dynamic_idle *")
        settings = core.new("struct nf_settings *")
        core.lib.settings_default(settings)
        settings.dynamic_idle_rpm, settings.motor_telemetry = rpm, telemetry
        core.lib.dynamic_idle_init(self.struct, settings, RATE_HZ)

    def step(self, *speeds: float, silent: int = 0) -> float:
        return float(self._core.lib.dynamic_idle_step(self.struct, list(speeds), silent))


@pytest.mark.parametrize(("rpm", "telemetry"), [(0, 1), (3000, 0)])
def test_nothing_is_raised_when_it_is_off(scripted: Any, rpm: int, telemetry: int) -> None:
    idle = Idle(scripted, rpm, telemetry)
    assert [idle.step(0.0, 0.0, 0.0, 0.0) for _ in range(100)] == [0.0] * 100


@pytest.mark.parametrize("name", ["nf1", "iris"])
def test_the_slowest_rotor_keeps_its_speed(scripted: Any, name: str) -> None:
    propulsion = load_aircraft(name).propulsion
    wanted = 0.14 * propulsion.speed_max
    idle, speed, raised = Idle(scripted, round(wanted / RPM)), 0.4 * propulsion.speed_max, []
    for _ in range(3000):
        raised.append(idle.step(speed, 2 * speed, 2 * speed, 2 * speed))
        speed += 0.04 * (float(target_speed(np.array([0.055 + raised[-1]]), propulsion)[0]) - speed)
    assert raised[0] == 0.0
    assert speed == pytest.approx(wanted, rel=0.02)
    assert max(raised) <= DYNAMIC_IDLE_MAX


def test_the_idle_comes_down_when_rotors_are_fast_or_an_esc_is_silent(scripted: Any) -> None:
    for speeds, silent in (((900.0,) * 4, 0), ((0.0,) * 4, 4)):
        idle = Idle(scripted)
        for _ in range(2000):
            most = idle.step(0.0, 900.0, 900.0, 900.0)
        assert most == pytest.approx(DYNAMIC_IDLE_MAX)
        assert idle.step(*speeds, silent=silent) <= most
        for _ in range(400):
            least = idle.step(*speeds, silent=silent)
        assert least == 0.0


def test_the_outputs_of_all_motors_are_raised_up_to_the_limit(scripted: Any) -> None:
    core, mixer = scripted, scripted.new("struct mixer *")
    settings = core.new("struct nf_settings *")
    core.lib.settings_default(settings)
    settings.motor_limit = 0.8
    assert core.lib.mixer_init(mixer, settings, 0.1, 1) == 0
    core.lib.mixer_raise_idle(mixer, 0.05)
    out = core.new("float[4]")
    core.lib.mixer_raise(mixer, [0.0, 0.5, 1.0, 0.25], out)
    assert list(out) == pytest.approx([0.15, 0.475, 0.8, 0.3125])
    assert core.lib.mixer_rest(mixer, 0.5) == pytest.approx(0.475)
