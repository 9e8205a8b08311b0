"""The battery against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Battery
from neuroflight.sim.physics.battery import BatteryState, loaded_voltage, open_circuit_voltage
from tests.sim.physics.flying import repeat

PACK = Battery(cells=4, capacity=3600 * 1.5, rest_voltage=16.78, resistance=0.05, electronics_power=6.21)
DT = 1e-3


def state(battery: Battery = PACK, charge: float = 1.0, count: int = 2) -> BatteryState:
    packs = BatteryState(battery, count)
    packs.reset(np.arange(count), charge)
    return packs


def test_open_circuit_gives_the_rest_voltage_when_full() -> None:
    assert open_circuit_voltage(PACK, np.array(1.0)) == pytest.approx(16.78, rel=1e-12)


def test_open_circuit_falls_all_the_way_when_discharged() -> None:
    charge = np.linspace(0.0, 1.0, 101)
    assert (np.diff(open_circuit_voltage(PACK, charge)) > 0).all()
    # A rested cell of a typical LiPo: 3.84 V at half charge, 3.27 V empty.
    assert open_circuit_voltage(PACK, np.array([0.5, 0.0])) / 16.78 == pytest.approx([3.84 / 4.2, 3.27 / 4.2])


def test_power_is_voltage_times_current_when_under_load() -> None:
    packs = state()
    power = np.array([100.0, 900.0])
    packs.step(power, DT)
    assert packs.voltage[:, 0] * packs.current == pytest.approx(power, rel=1e-12)
    assert packs.voltage[:, 0] == pytest.approx(16.78 - 0.05 * packs.current, rel=1e-12)
    assert (packs.voltage > 16.78 / 2).all()


def test_power_is_limited_when_more_than_the_pack_can_give() -> None:
    packs = state()
    most = 16.78**2 / (4 * 0.05)
    packs.step(np.array([most, 3 * most]), DT)
    assert packs.voltage[:, 0] == pytest.approx([8.39, 8.39], rel=1e-6)
    assert packs.current == pytest.approx([16.78 / 0.1] * 2, rel=1e-6)


def test_voltage_is_the_open_circuit_when_there_is_no_load() -> None:
    packs = state(charge=0.7)
    packs.step(np.zeros(2), DT)
    expected = 16.78 * 3.95 / 4.20
    assert packs.voltage.shape == (2, 1)
    assert packs.voltage[:, 0] == pytest.approx([expected] * 2)
    assert packs.current.tolist() == [0.0, 0.0]


def test_discharge_follows_the_closed_form_when_current_is_constant() -> None:
    """Between two points of the curve the voltage falls in a straight line under a constant current."""
    packs, amperes = state(charge=0.7), 31.0
    slope = 16.78 / 4.20 * (3.95 - 3.87) / 0.1 / PACK.capacity  # [V] an ampere second
    start = 16.78 / 4.20 * 3.95
    dt, steps = 0.01, 1500  # 465 A s of 5580: from 0.7 to 0.617
    for step in range(steps):
        open_circuit = start - slope * amperes * step * dt
        packs.step(np.full(2, amperes * (open_circuit - 0.05 * amperes)), dt)
    assert packs.current == pytest.approx([amperes] * 2, rel=1e-9)
    assert packs.charge == pytest.approx([0.3 * PACK.capacity + amperes * dt * steps] * 2, rel=1e-9)


def test_discharge_follows_the_closed_form_when_power_is_constant() -> None:
    """Without resistance P = V dq/dt, so P t is the integral of V over q: exact between two points."""
    packs = state(replace(PACK, resistance=0.0), charge=0.9)
    high, low = 16.78 / 4.20 * 4.11, 16.78 / 4.20 * 4.02
    charge = 0.1 * PACK.capacity
    seconds = 0.5 * (high + low) * charge / 500.0
    steps = 10_000
    repeat(steps, packs.step, np.full(2, 500.0), seconds / steps)
    # The step of an explicit rule sees the voltage at its start: at most the curve's fall over one step.
    assert packs.state_of_charge == pytest.approx([0.8] * 2, abs=0.1 * (high / low - 1) / steps)


def test_energy_balances_when_flown_from_full_to_empty() -> None:
    rng, dt = np.random.default_rng(1), 0.2
    packs = state(count=1)
    drawn = lost = most = 0.0
    while packs.state_of_charge[0] > 0.0:
        packs.step(rng.uniform(0, 600, 1), dt)
        drawn += float(packs.voltage[0, 0] * packs.current[0]) * dt
        lost += float(PACK.resistance * packs.current[0] ** 2) * dt
        most = max(most, float(packs.current[0]) * dt)
    left = np.linspace(float(packs.state_of_charge[0]), 1.0, 200_001)
    open_circuit = open_circuit_voltage(PACK, left)
    stored = np.trapezoid(open_circuit, left) * PACK.capacity
    # Each step takes its charge at the voltage of its start: too high by at most what the step lets it fall.
    excess = drawn + lost - stored
    assert 0.0 < excess < most * (open_circuit[-1] - open_circuit[0])
    assert stored > 80e3  # [J], of a pack of 1.5 Ah


def test_nothing_is_left_when_drawn_beyond_empty() -> None:
    packs = state(charge=0.0)
    repeat(400, packs.step, np.full(2, 300.0), 0.1)
    assert packs.voltage[:, 0] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert packs.current == pytest.approx([0.0, 0.0], abs=1e-6)
    assert packs.charge == pytest.approx([1.02 * PACK.capacity] * 2)


def test_nothing_breaks_when_an_ideal_pack_is_drawn_beyond_empty() -> None:
    packs = state(replace(PACK, resistance=0.0), charge=0.0)
    repeat(400, packs.step, np.full(2, 300.0), 0.1)
    assert np.isfinite(packs.charge).all()
    assert packs.voltage[:, 0].tolist() == [0.0, 0.0]


def test_reset_refills_only_those_named_when_given_an_index() -> None:
    packs = state(count=3)
    packs.step(np.full(3, 300.0), 1.0)
    used = packs.charge[0]
    packs.reset(np.array([1]), 0.5)
    assert packs.charge.tolist() == pytest.approx([used, 0.5 * PACK.capacity, used])
    assert packs.voltage[1, 0] == pytest.approx(16.78 * 3.84 / 4.20)
    assert packs.current[1] == 0.0
    assert packs.voltage[0, 0] < 16.78


@pytest.mark.parametrize("charge", [-0.1, 1.1, math.nan])
def test_reset_refuses_when_charge_is_no_fraction(charge: float) -> None:
    with pytest.raises(ValueError, match="expected 0 to 1"):
        BatteryState(PACK, 1).reset(np.arange(1), charge)


def test_loaded_voltage_is_the_upper_root_when_both_are_physical() -> None:
    # 10 V, 1 ohm, 9 W: V^2 - 10 V + 9 = 0, so 9 V at 1 A or 1 V at 9 A.
    assert loaded_voltage(np.array([10.0]), np.array([9.0]), 1.0).tolist() == pytest.approx([9.0])
