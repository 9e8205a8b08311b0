"""A policy that a model of its aircraft helps: observed rotors and rates, the gyro's mean, the centred mix.

Nobody trained it: it steers in proportion to the rate's error, and every other observation has a small say.
"""

from __future__ import annotations

import numpy as np

from sim.aircraft.model import Aircraft, load_aircraft
from sim.control.estimator import model_constants
from sim.control.pid_table import pid_table
from toolchain.contract import Mix, observation_blocks, observation_count
from toolchain.policy.freeze import to_onnx

OBSERVATION = (
    "rate_error,rate,rate_error_integral,rate~15Hz,rate~60Hz,previous_motors,rotor_estimate,throttle,"
    "rate_estimate,rate_estimate_error"
)
CONTROL_RATE_HZ = 1000
IDLE = 0.05
SCALES = {"rotor_estimate": 1e-3, "rate_error_integral": 2.0, "previous_motors": 1.0, "throttle": 1.0}
RATE_SCALE = 0.05  # of the blocks in rad/s
GAIN = 0.4  # motor fraction for 1 / RATE_SCALE rad/s of error


def modelled_policy(
    hidden: tuple[int, int] = (16, 16),
    *,
    seed: int = 1,
    mix: Mix = Mix.CENTRED,
    filters: tuple[tuple[str, ...], ...] = (("mean",),),
    observation: str = OBSERVATION,
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
        "control_rate_hz": CONTROL_RATE_HZ,
        "filters": [list(part) for part in filters],
        "mix": mix.text,
        "model": model_constants(aircraft, CONTROL_RATE_HZ).document(),
        "hidden": list(hidden),
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.5},
        "motors": motors,
        "idle": IDLE,
        "seed": seed,
    }
    return to_onnx(config, _weights(aircraft, observation_count(terms, motors), hidden, seed))


def _weights(aircraft: Aircraft, inputs: int, hidden: tuple[int, int], seed: int) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    rng = np.random.default_rng(seed)
    first, second = hidden
    layers = [rng.normal(0.0, 0.02, shape) for shape in ((first, inputs), (second, first), (4, second))]
    pid = pid_table(aircraft)
    assert pid is not None
    share = pid.mixer  # (M, 3)
    for axis in range(3):  # the rate's error goes straight through
        layers[0][axis, axis] = layers[1][axis, axis] = 1.0
    layers[2][:, :3] = GAIN * share / np.abs(share).max()
    names = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    return {
        f"{name}.{part}": value.astype(np.float32)
        for name, layer in zip(names, layers, strict=True)
        for part, value in (("weight", layer), ("bias", rng.normal(0.0, 0.02, len(layer))))
    }
