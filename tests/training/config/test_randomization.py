"""Domain randomization: what is drawn and when, and the errors of invalid ranges."""

from dataclasses import fields, replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.errors import AircraftError
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.envs.simulation import AttitudeSimulation
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
WIDE = Randomization(
    mass=(0.8, 1.2),
    inertia=(0.7, 1.3),
    thrust=(0.9, 1.1),
    torque=(0.5, 2.0),
    speed=(0.95, 1.05),
    lag=(0.5, 2.0),
    noise=(1.0, 3.0),
    motors=(0.9, 1.1),
    delay_s=(0.0, 0.006),
    charge=(0.2, 1.0),
    vibration_deg_s=(5.0, 40.0),
)


def of(drawn: Variation, name: str) -> Array:
    """Values that were drawn, in the unit of their range."""
    return np.rad2deg(drawn.vibration) if name == "vibration_deg_s" else getattr(drawn, name)


SHORT = PulseTask(idle_s=0.05, command_s=0.05, rest_s=0.05)


def simulation(randomization: Randomization, seed: int = 1, count: int = 4) -> AttitudeSimulation:
    config = TrainingConfig(task=SHORT, world=WorldConfig(randomization=randomization))
    return AttitudeSimulation(NF1, count, config=config, rng=np.random.default_rng(seed))


def test_draws_fill_their_ranges_and_stay_inside() -> None:
    drawn = WIDE.draw(4000, np.random.default_rng(0), 0.002)
    for field in fields(WIDE):
        low, high = getattr(WIDE, field.name)
        values = of(drawn, field.name)
        assert values.min() >= low
        assert values.max() <= high
        assert values.max() - values.min() > 0.98 * (high - low)
    # Half as long is as likely as twice as long.
    assert np.median(drawn.lag) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(drawn.mass, drawn.inertia)[0, 1] == pytest.approx(0.0, abs=0.06)


def test_most_aircraft_drawn_near_differ_little_and_all_at_once() -> None:
    drawn = replace(WIDE, charge=(0.2, 1.0)).draw_near(4000, np.random.default_rng(0), 0.002)
    low, high = WIDE.lag
    assert (drawn.lag > low).all() and (drawn.lag < high).all()
    # |log lag| over its end is the product of two uniform draws: below a half with 0.5 + 0.5 ln 2.
    far = np.abs(np.log(drawn.lag)) / np.log(high)
    assert (far < 0.5).mean() == pytest.approx(0.85, abs=0.03)
    others = np.abs(np.log(drawn.inertia)) / np.log(WIDE.inertia[1])
    assert np.corrcoef(far, others)[0, 1] > 0.2, "far from its file in one thing, an aircraft is so in others"
    assert np.rad2deg(drawn.vibration).mean() == pytest.approx(22.5, abs=0.5)
    assert np.mean(drawn.charge < 0.6) == pytest.approx(0.5, abs=0.03), "batteries are as empty as ever"


def test_what_is_not_randomized_stays_as_the_file_says() -> None:
    drawn = Randomization(lag=(0.5, 2.0)).draw(3, np.random.default_rng(0), 0.002)
    assert drawn.mass.tolist() == [1.0, 1.0, 1.0]
    assert drawn.delay_s.tolist() == [0.002, 0.002, 0.002]
    assert np.isnan(drawn.charge).all() and np.isnan(drawn.vibration).all()


def test_a_battery_is_rejected_where_the_aircraft_has_none() -> None:
    config = TrainingConfig(task=SHORT, world=WorldConfig(randomization=Randomization(charge=(0.5, 1.0))))
    with pytest.raises(AircraftError, match=r"no \[battery\] table"):
        AttitudeSimulation(replace(NF1, battery=None), 2, config=config, rng=np.random.default_rng(0))


def test_every_episode_draws_its_aircraft_and_leaves_the_others() -> None:
    simulated = simulation(WIDE)
    simulated.reset()
    before = simulated._twin.variation
    simulated.restart(np.array([1, 3]))
    after = simulated._twin.variation
    simulated.close()
    assert before is not None
    assert after is not None
    for field in fields(WIDE):
        changed = of(before, field.name) != of(after, field.name)
        if changed.ndim == 2:
            assert (changed == changed[:, :1]).all()
            changed = changed[:, 0]
        assert changed.tolist() == [False, True, False, True], field.name


def test_the_same_seed_draws_the_same_aircraft() -> None:
    rates = []
    for seed in (1, 1, 2):
        simulated = simulation(WIDE, seed)
        simulated.reset()
        for _ in range(30):
            simulated.step(np.full((4, 4), 0.5, np.float32) * np.array([1.0, 1.0, 0.8, 1.0], np.float32))
        rates.append(simulated.rate.copy())
        simulated.close()
    assert np.array_equal(rates[0], rates[1])
    assert not np.array_equal(rates[0], rates[2])
    assert len({tuple(row) for row in rates[0].tolist()}) == 4


def test_nothing_is_drawn_when_nothing_is_randomized() -> None:
    simulated = simulation(Randomization())
    simulated.reset()
    known = simulated._twin.variation
    simulated.close()
    assert known is None
