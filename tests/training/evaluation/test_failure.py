"""Changes in flight: what the twin does, and what is read from a flight."""

import math
from contextlib import closing

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.aircraft.payload import Payload, loaded, parse_payload
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.errors import AircraftError
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.evaluation.failure import case_result, nothing_happens

NF1 = load_aircraft("nf1")
STEPS, AT = 2000, 1000


def twin(mount: Mount = Mount.CENTRE) -> Twin:
    return Twin(NF1, 1, mount=mount, noise=False, rng=np.random.default_rng(0))


def turned(flown: Twin, steps: int) -> np.ndarray:
    for _ in range(steps):
        flown.step(np.full((1, 4), 0.5))
    rate: np.ndarray = flown.rate[0]
    return rate


def test_aircraft_turns_to_the_dead_motor_and_it_runs_down_when_it_fails() -> None:
    with closing(twin()) as flown:
        level = turned(flown, 500)
        flown.weaken(np.array([0.0, 1.0, 1.0, 1.0]))
        after = turned(flown, 100)
        assert np.abs(level).max() < math.radians(1)
        assert after[0] > math.radians(100)  # rear right sinks: roll right, nose up
        assert after[1] < -math.radians(100)
        turned(flown, 500)
        assert flown.rotor_speed[0, 0] < 1.0 < flown.rotor_speed[0, 1]


def test_half_the_thrust_is_lost_when_a_motor_loses_half() -> None:
    with closing(twin()) as flown:
        flown.weaken(np.array([0.5, 1.0, 1.0, 1.0]))
        turned(flown, 1000)
        weak, strong = flown.rotor_speed[0, :2]
        assert (weak / strong) ** 2 == pytest.approx(0.5, rel=1e-3)


def test_rate_goes_on_and_thrust_tilts_when_a_payload_comes_on() -> None:
    payload = Payload(0.05, (0.04, 0.0, 0.02))
    carrying, before = twin(), twin()
    try:
        for each in (carrying, before):
            turned(each, 300)
        carrying.load(loaded(NF1, payload))
        assert carrying.rate == pytest.approx(before.rate, abs=1e-12)
        # The thrust acts behind the new centre of mass: nose down, at thrust x offset / inertia.
        changed = loaded(NF1, payload).mass_properties
        offset = changed.centre[0] - NF1.mass_properties.centre[0]
        thrust = 9.37e-7 * float((carrying.rotor_speed**2).sum())
        gained = turned(carrying, 20) - turned(before, 20)
        assert gained[1] == pytest.approx(0.02 * thrust * offset / changed.inertia[1, 1], rel=0.05)
    finally:
        carrying.close()
        before.close()


def test_twin_is_not_loaded_when_it_is_free() -> None:
    with closing(twin(Mount.FREE)) as flown:
        with pytest.raises(ValueError, match="held at its centre"):
            flown.load(NF1)
        with pytest.raises(ValueError, match="expected 4 of 0 to 1"):
            flown.weaken(np.array([2.0, 1.0, 1.0, 1.0]))


def test_recovery_is_timed_from_the_change_to_the_last_step_outside_the_band() -> None:
    rate = np.zeros((2, STEPS, 3), np.float32)
    rate[:, AT : AT + 200, 0] = math.radians(50)  # roll is off for 200 ms, in both episodes
    rate[1, AT:, 1] = math.radians(50)  # pitch is lost in one
    flights = Flights(np.zeros_like(rate), rate, np.zeros((2, STEPS, 4), np.float32), 1e-3)
    found = case_result(nothing_happens(NF1), flights, AT * 1e-3)
    assert found.recovery_s[0] == pytest.approx(0.2 + 0.018, abs=0.002)  # the average of 20 ms follows
    assert found.recovered.tolist() == [1.0, 0.5, 1.0]
    assert found.before.tolist() == [0.0, 0.0, 0.0]
    assert found.settled == pytest.approx([0.0, 25.0, 0.0], abs=1e-4)
    assert found.lost == () and found.diverged == 0.0


@pytest.mark.parametrize("text", ["50", "50@1,2", "-5@0,0,0", "nan@0,0,0", "50@0,0,inf", "50@0,0,9"])
def test_payload_is_refused_when_it_is_none(text: str) -> None:
    with pytest.raises(AircraftError, match="expected GRAMS@X,Y,Z"):
        parse_payload(text)
