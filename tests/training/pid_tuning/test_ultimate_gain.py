"""Ultimate gains against flights at gains beside the one found."""

import dataclasses

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import PidSettings, load_aircraft
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.evaluation.evaluation import record
from neuroflight.training.pid_tuning.ultimate_gain import UltimateGain, ultimate_gains
from neuroflight.training.tasks.task import EpisodicTask, GivenCommands

NF1 = load_aircraft("nf1")
IDLE = 0.1


@pytest.fixture(scope="module")
def found() -> tuple[UltimateGain, UltimateGain, UltimateGain]:
    return ultimate_gains(NF1, IDLE, 1000)


@pytest.mark.parametrize("axis", range(3))
def test_oscillation_dies_below_the_ultimate_gain_and_lasts_above(
    found: tuple[UltimateGain, UltimateGain, UltimateGain], axis: int
) -> None:
    nothing = (0.0, 0.0, 0.0)
    settings = []
    for part in (0.8, 1.2):
        gains = [nothing, nothing, nothing]
        gains[axis] = (part * found[axis].gain, 0.0, 0.0)
        settings.append(PidSettings((gains[0], gains[1], gains[2]), None, IDLE))
    command = np.zeros((2, 3))
    command[:, axis] = np.deg2rad(20)
    flown = record(
        Pid(mixer(NF1), settings, 2, 1000),
        NF1,
        GivenCommands(EpisodicTask(hold_s=2.0), command),
        episodes=2,
        seed=0,
        control_rate_hz=1000,
        noise=False,
        idle=IDLE,
    )
    rate = np.rad2deg(flown.rate[:, :, axis])
    early, late = rate[:, 200:700].std(axis=1), rate[:, 1500:].std(axis=1)
    assert late[0] < 0.1 * late[1]
    assert late[1] > 0.8 * early[1]
    assert late[1] > 1.0


def test_period_is_that_of_lag_and_delay(found: tuple[UltimateGain, UltimateGain, UltimateGain]) -> None:
    # Rate from thrust is an integrator behind the rotors' lag (42 ms) and about 3 ms of delay: the phase
    # reaches half a turn where w^2 = 1 / (42 ms x 3 ms), 70 ms a cycle. Yaw's reaction skips the lag.
    assert found[0].period == pytest.approx(0.065, abs=0.01)
    assert found[1].period == pytest.approx(0.065, abs=0.01)
    assert found[2].period < 0.02


def test_rules_are_ziegler_and_nichols() -> None:
    assert UltimateGain(10.0, 0.1).gains("Ziegler-Nichols") == pytest.approx((6.0, 120.0, 0.075))


def test_an_aircraft_is_rejected_when_no_gain_makes_it_oscillate() -> None:
    heavy = dataclasses.replace(NF1.mass_properties, inertia=1e5 * NF1.mass_properties.inertia)
    with pytest.raises(TrainingError, match="roll does not oscillate by itself at any proportional gain"):
        ultimate_gains(dataclasses.replace(NF1, mass_properties=heavy), IDLE, 1000)
