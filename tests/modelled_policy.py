"""A policy that a model of its aircraft helps: observed rotors and rates, the gyro's mean, the centred mix.

Nobody trained it: it steers in proportion to the rate's error, and every other observation has a small say.
As it stands it computes and does not fly: what the others say leaves errors unanswered, and the firmware's
PID takes over (WRONG_WAY, at any control rate). Without them (spread 0) and with FLYING_GAIN it is a P
controller, which flies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.toolchain.contract import Mix, observation_blocks, observation_count
from neuroflight.toolchain.policy.freeze import to_onnx

OBSERVATION = (
    "rate_error,rate,rate_error_integral,rate~15Hz,rate~60Hz,previous_motors,rotor_estimate,throttle,"
    "rate_estimate,rate_estimate_error"
)
CONTROL_RATE_HZ = 1000
IDLE = 0.05
SCALES = {"rotor_estimate": 1e-3, "rate_error_integral": 2.0, "previous_motors": 1.0, "throttle": 1.0}
RATE_SCALE = 0.05  # of the blocks in rad/s
GAIN = 0.4  # motor fraction for 1 / RATE_SCALE rad/s of error
FLYING_GAIN = 4.0  # with which, and without `spread`, the NF1 follows its commands
SPREAD = 0.02  # standard deviation of all other weights and of biases


def modelled_policy(
    hidden: tuple[int, int] = (16, 16),
    *,
    seed: int = 1,
    mix: Mix = Mix.CENTRED,
    filters: tuple[tuple[str, ...], ...] = (("mean",),),
    observation: str = OBSERVATION,
    control_rate_hz: int = CONTROL_RATE_HZ,
    gain: float = GAIN,
    spread: float = SPREAD,
) -> bytes:
    """The bytes of such a policy.onnx for the NF1."""
    aircraft = load_aircraft("nf1")
    terms = observation_blocks(observation)
    motors = aircraft.motor_count
    scale = [SCALES.get(term.name, RATE_SCALE) for term in terms for _ in range(term.count(motors))]
    config = {
        "aircraft": {"name": aircraft.name, "sha256": "ab" * 32},
        "observation": observation,
        "observation_scale": scale,
        "control_rate_hz": control_rate_hz,
        "filters": [list(part) for part in filters],
        "mix": mix.text,
        "model": model_constants(aircraft, control_rate_hz).document(),
        "hidden": list(hidden),
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.5},
        "motors": motors,
        "idle": IDLE,
        "seed": seed,
    }
    rng = np.random.default_rng(seed)
    widths = (observation_count(terms, motors), *hidden)
    return to_onnx(config, _weights(aircraft, widths, gain, spread, rng))


def _weights(
    aircraft: Aircraft, widths: tuple[int, int, int], gain: float, spread: float, rng: np.random.Generator
) -> dict[str, NDArray[np.float32]]:
    inputs, first, second = widths
    layers = [rng.normal(0.0, spread, shape) for shape in ((first, inputs), (second, first), (4, second))]
    pid = pid_table(aircraft)
    assert pid is not None
    share = pid.mixer  # (M, 3)
    for axis in range(3):  # the rate's error goes straight through
        layers[0][axis, axis] = layers[1][axis, axis] = 1.0
    layers[2][:, :3] = gain * share / np.abs(share).max()
    names = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    return {
        f"{name}.{part}": value.astype(np.float32)
        for name, layer in zip(names, layers, strict=True)
        for part, value in (("weight", layer), ("bias", rng.normal(0.0, spread, len(layer))))
    }
