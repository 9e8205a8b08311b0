"""Policies of every kernel and at every limit: each becomes an image that flies the host's bits."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from onnx import helper
from pytest import param

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import (
    ITCM,
    OBSERVATION_COUNT_MAX,
    POLICY_MEMORY_COUNT_MAX,
    POLICY_WEIGHT_COUNT_MAX,
)
from neuroflight.toolchain.image.elf import read_image
from neuroflight.toolchain.ir.network import OBSERVATION, Network
from neuroflight.toolchain.ir.onnx_export import to_model
from neuroflight.toolchain.ir.operations import (
    Add,
    Affine,
    Clip,
    Concat,
    Elu,
    Erf,
    LeakyRelu,
    Multiply,
    Relu,
    RmsNorm,
    Select,
    Sigmoid,
    Silu,
    Slice,
    Softmax,
    Softplus,
    Softsign,
    Tanh,
)
from neuroflight.toolchain.policy.model import parse_policy
from tests.conftest import ROOT, build_kept
from tests.random_networks import Maker, gru, lstm, norm

TEMPLATE = ROOT / "toolchain" / "rendering" / "templates" / "policy_kernels.c.j2"
ANY_FLIGHT = {"plausibility_detection": 0, "crash_detection": 0, "runaway_detection": 0}
MOVES = Scenario("moves", (Segment(0.06, (40.0, -30.0, 20.0), 0.4),))
SQUARE = (
    "rate_error",
    "rate",
    "rate_error_integral",
    "previous_motors",
    "rate@1",
)  # 16 values
WIDEST = (  # 64 values, of six motors
    *("rate_error", "rate", "rate_error_integral", "previous_motors", "throttle"),
    *(f"{name}@{age}" for age in range(1, 9) for name in ("rate_error", "rate")),
)
KERNELS = {
    *("linear8", "linear4", "look_up", "affine", "at_least", "at_most", "clip", "leaky", "softsign", "elu"),
    *("half", "half_sum", "sigmoid", "silu", "add", "multiply", "multiply_add", "blend", "cell"),
    *("layer_norm", "rms_norm", "below_largest", "shares", "look_up_even", "select", "copy"),
}


def tanh() -> Network:
    """What most policies are made of."""
    make = Maker(16, 1)
    for width in (24, 20):
        make.linear(width)
        make.add(Tanh())
    return make.clipped()


def linear_units() -> Network:
    """Activations that are a line or two."""
    make = Maker(16, 2)
    for width, operation in ((24, Relu()), (20, LeakyRelu(0.1)), (16, Clip(-1.0, 1.0)), (12, Softsign())):
        make.linear(width)
        make.add(operation)
    return make.clipped()


def exponential_units() -> Network:
    """SiLU, sigmoid and ELU, a layer norm between."""
    make = Maker(16, 3)
    make.linear(24)
    make.add(norm(make, 24))
    make.add(Silu())
    make.linear(20)
    make.add(Elu(0.7))
    make.linear(12)
    make.add(Sigmoid())
    return make.clipped()


def smooth_units() -> Network:
    """Build a network with GELU, Mish and SELU and an RMS norm between."""
    make = Maker(16, 10)
    seen = make.linear(24)
    wide = make.add(Affine(np.full(24, 0.5**0.5), np.zeros(24)), seen)
    make.add(Multiply(), seen, make.add(Affine(np.full(24, 0.5), np.full(24, 0.5)), make.add(Erf(), wide)))
    seen = make.add(RmsNorm(1e-5, 1 + 0.1 * make.weights(20), make.weights(20)), make.linear(20))
    make.add(Multiply(), seen, make.add(Tanh(), make.add(Softplus(), seen)))
    make.linear(12)
    make.add(Elu(1.6732632))
    make.add(Affine(np.full(12, 1.050701), np.zeros(12)))
    return make.clipped()


def gated() -> Network:
    """A GRU."""
    make = Maker(16, 4)
    make.add(gru(make, 16, 12))
    return make.clipped()


def remembering() -> Network:
    """An LSTM."""
    make = Maker(16, 5)
    make.add(lstm(make, 16, 12))
    return make.clipped()


def everything() -> Network:
    """Every kernel that there is."""
    make = Maker(16, 6)
    seen = make.linear(20, OBSERVATION)
    make.add(norm(make, 20))
    make.add(Silu())
    make.linear(16)
    make.add(Elu(0.7))
    make.linear(16)
    make.add(LeakyRelu(0.1))
    gated = make.add(Softsign(), make.linear(16))
    gate = make.add(Sigmoid(), make.linear(16, gated))
    product = make.add(Multiply(), gated, gate)
    make.add(Add(), product, gated)
    make.linear(12)
    make.add(RmsNorm(1e-5, np.linspace(0.5, 1.5, 12, dtype=np.float32), np.zeros(12, np.float32)))
    error, smooth = make.add(Erf()), make.add(Softplus())
    make.add(Select(), error, smooth, make.add(Softmax(), error))
    make.add(Relu())
    make.add(gru(make, 12, 8))
    cell = make.add(lstm(make, 8, 8))
    make.add(Concat(), cell, make.add(Slice(9, 5, -2), OBSERVATION), seen)
    make.linear(13)
    make.add(Tanh())
    for bounds in ((-1.0, 1.0), (None, 1.2)):
        scale, offset = make.weights(2, 13).astype(np.float64)
        make.add(Affine(1 + scale, offset))
        make.add(Clip(*bounds))
    return make.clipped()


def memory() -> Network:
    """As many floats to work on as there may be."""
    make = Maker(16, 7)
    make.add(Concat(), *(OBSERVATION for _ in range(39)))
    return make.clipped()


def observation() -> Network:
    """As many values observed and motors driven as there may be."""
    make = Maker(64, 8)
    make.linear(24)
    make.add(Tanh())
    return make.clipped(6)


def weights() -> Network:
    """As many weights as there may be."""
    make = Maker(64, 9)
    make.linear(104)
    make.add(Relu())
    make.linear(48)
    make.add(norm(make, 48))
    return make.clipped(6)


SETS = (tanh, linear_units, exponential_units, smooth_units, gated, remembering, everything)
LIMITS = (memory, observation, weights)
slow = pytest.mark.slow
FLOWN = (*SETS, *LIMITS)
CASES = [param(make, id=make.__name__, marks=() if make is everything else slow) for make in FLOWN]


def file_of(network: Network) -> bytes:
    """The network as a user's file."""
    model = to_model(network)
    document = {
        "version": "1",
        "observation": ",".join(SQUARE if network.inputs == 16 else WIDEST),
        "control_rate_hz": "1000",
        "filters": "[]",
        "aircraft": "nf1" if network.inputs == 16 else "hexa",
        "aircraft_sha256": "0" * 64,
        "training": "{}",
    }
    helper.set_model_props(model, {f"neuroflight.{key}": value for key, value in document.items()})
    return bytes(model.SerializeToString())


def test_every_kernel_is_in_one_of_the_sets_and_each_limit_is_reached() -> None:
    plans = {make: compile_policy(parse_policy(file_of(make()))).plan for make in SETS + LIMITS}
    assert {call.kernel for plan in plans.values() for call in plan.calls} == KERNELS | {"enter", "leave"}
    assert set(re.findall(r'if "(\w+)" in kernels', TEMPLATE.read_text())) == KERNELS
    assert plans[weights].table.size == POLICY_WEIGHT_COUNT_MAX
    assert plans[memory].memory == POLICY_MEMORY_COUNT_MAX
    widest = parse_policy(file_of(observation()))
    assert (widest.observation_count, widest.action_count) == (
        OBSERVATION_COUNT_MAX,
        6,  # motors of the largest aircraft that ships
    )


@pytest.mark.parametrize("make", CASES)
def test_a_policy_flies_the_same_bits_on_board_and_host_when_it_is_of_these_kernels(
    make: Callable[[], Network], flown: Callable[..., Trace]
) -> None:
    data = file_of(make())
    policy = parse_policy(data)
    aircraft = policy.aircraft
    pid = pid_table(load_aircraft(aircraft))
    folders = {target: build_kept(target, data, make.__name__, pid) for target in ("HOST", "MATEKF722")}
    ports = (
        ReferencePort(folders["HOST"] / "libneuroflight.so", settings=ANY_FLIGHT),
        EmulatedPort(folders["MATEKF722"] / "neuroflight.bin", settings=ANY_FLIGHT),
    )
    host, board = (flown(port, MOVES, aircraft=aircraft) for port in ports)
    assert host.dshot.shape[1] == policy.action_count
    assert np.ptp(host.dshot[1:].astype(int), axis=0).min() > 0  # each motor is steered
    assert host.same(board)
    symbols = read_image(folders["MATEKF722"] / "neuroflight.elf").symbols
    assert (symbols["policy_step"] < ITCM.size) == (make is not everything)
