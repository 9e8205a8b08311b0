"""The shipped policy in torch, onnxruntime and compiled C, on observations of a flight and random ones."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray

from neuroflight.sim.control.observation import Observer
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.model import read_policy

Float32 = NDArray[np.float32]
TOLERANCE = 1e-6  # absolute
HALF = 5_000


def seen_in_flight(trace: Trace, observer: Observer) -> Float32:
    """Observations of a recorded flight, one a control step."""
    still, none = np.zeros((1, 4), np.float32), np.zeros(1, np.float32)
    rows = [
        observer.observe(slice(None), setpoint[None], gyro[None], still, none)
        for setpoint, gyro in zip(trace.setpoint, trace.gyro, strict=True)
    ]
    return np.concatenate(rows)


@pytest.fixture(scope="module")
def observations(reference_library: Path, shipped_policy: Path, flown: Callable[..., Trace]) -> Float32:
    """10,000 of them: half from a recorded flight, half random of unit scale."""
    policy = read_policy(shipped_policy)
    trace = flown(ReferencePort(reference_library, 1000), load_scenario("pulses", 31, count=2))
    flight = seen_in_flight(
        trace,
        Observer(
            policy.blocks,
            1,
            policy.action_count,
            policy.control_rate_hz,
            model=policy.model,
            idle=policy.idle,
        ),
    )
    assert np.abs(flight).max() > 1.0  # commands of some hundred deg/s were under way
    rng = np.random.default_rng(2)
    picked = flight[rng.choice(len(flight), HALF, replace=False)]
    return np.concatenate([picked, rng.normal(size=picked.shape).astype(np.float32)])


def through_torch(checkpoint: Path, observation: Float32) -> Float32:
    """The trained network itself, with the scaling and mapping that training put around it."""
    document = torch.load(checkpoint, weights_only=True)
    config, state = json.loads(document["config"]), document["state_dict"]
    activation = {"tanh": torch.nn.functional.tanh, "relu": torch.nn.functional.relu}[config["activation"]]
    x = torch.as_tensor(observation) * torch.tensor(config["observation_scale"], dtype=torch.float32)
    with torch.no_grad():
        for layer in range(len(config["hidden"])):
            name = f"mlp_extractor.policy_net.{2 * layer}"
            x = activation(torch.nn.functional.linear(x, state[f"{name}.weight"], state[f"{name}.bias"]))
        mean = torch.nn.functional.linear(x, state["action_net.weight"], state["action_net.bias"])
        if config["output"].get("squash"):
            mean = torch.nn.functional.tanh(mean)
    mapped: Float32 = (config["output"]["scale"] * mean + config["output"]["offset"]).clamp(0, 1).numpy()
    return mapped


def through_onnxruntime(policy: Path, observation: Float32) -> Float32:
    """The ONNX file in onnxruntime, one observation a call."""
    session = onnxruntime.InferenceSession(policy, providers=["CPUExecutionProvider"])
    return np.concatenate([session.run(["action"], {"observation": row[None]})[0] for row in observation])


def through_c(library: Path, observation: Float32, actions: int) -> Float32:
    """The policy inside the firmware's core."""
    core = ctypes.CDLL(str(library))
    state = (ctypes.c_uint64 * 8192)()  # struct policy, whatever its network needs
    core.policy_init(state, ctypes.byref(ctypes.c_float.in_dll(core, "policy_weights")))
    result = np.full((len(observation), actions), np.nan, np.float32)
    for row, out in zip(observation, result, strict=True):
        core.policy_step(state, ctypes.c_void_p(row.ctypes.data), ctypes.c_void_p(out.ctypes.data))
    return result


def test_torch_onnxruntime_and_c_agree_on_ten_thousand_observations(
    shipped_policy: Path, reference_library: Path, observations: Float32
) -> None:
    assert len(observations) == 2 * HALF
    trained = through_torch(shipped_policy.with_name("checkpoint.pt"), observations)
    runtime = through_onnxruntime(shipped_policy, observations)
    compiled = through_c(reference_library, observations, trained.shape[1])
    assert np.ptp(compiled, axis=0).min() > 0.5  # the observations do exercise every motor
    for name, peer in (("torch", trained), ("onnxruntime", runtime)):
        worst = float(np.abs(compiled - peer).max())
        print(f"compiled C against {name}: {worst:.2e}")
        assert worst <= TOLERANCE, name
    assert float(np.abs(trained - runtime).max()) <= TOLERANCE


def test_the_interpreter_is_the_c_to_the_bit_and_its_fast_form_within_the_tolerance(
    shipped_policy: Path, reference_library: Path, observations: Float32
) -> None:
    network, _ = optimize(read_policy(shipped_policy).network)
    compiled = through_c(reference_library, observations, 4)
    assert np.array_equal(evaluate(network, observations), compiled)
    assert np.abs(evaluate(network, observations, exact=False) - compiled).max() <= TOLERANCE
