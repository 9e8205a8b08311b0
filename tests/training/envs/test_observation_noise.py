"""The deviation of each observation under gyro noise, compared with that of an observer."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.observation import Observer
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.ppo import observation_noise

TERMS = "rate,rate_error~15Hz,rate_error_delta,rate_error_delta~40Hz@2,rate~200Hz@1,throttle,previous_action"
COUNT, STEPS = 400, 300


def test_noise_of_a_term_is_that_of_an_observer_when_nothing_else_moves() -> None:
    config = TrainingConfig(observation=TERMS)
    aircraft = load_aircraft("nf1")
    observer = Observer(config.blocks(), COUNT, 4, config.control_rate_hz)
    rng = np.random.default_rng(3)
    still, none = np.zeros((COUNT, 3), np.float32), np.zeros(COUNT, np.float32)
    for _ in range(STEPS):  # until the slowest low-pass has forgotten its start
        gyro = (rng.standard_normal((COUNT, 3)) * aircraft.gyro.noise).astype(np.float32)
        seen = observer.observe(slice(None), still, gyro, np.zeros((COUNT, 4), np.float32), none)
    measured = (seen * np.array(config.observation_scale(4), np.float32)).std(axis=0)
    told = observation_noise(aircraft, config)
    assert (told[:15] > 0).all()
    # 400 samples tell a standard deviation to within 3.5 %, one time in three.
    np.testing.assert_allclose(measured, told, rtol=0.14, atol=1e-12)
