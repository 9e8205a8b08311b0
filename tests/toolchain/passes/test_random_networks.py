"""Random networks of every operation through all passes: proven after each, cheaper, the same at the end."""

from __future__ import annotations

from collections import Counter

import numpy as np
import onnxruntime
import pytest
from numpy.random import Generator
from numpy.typing import NDArray

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.float64_reference import reference
from neuroflight.toolchain.ir.interpreter import advance, clear_state, replay
from neuroflight.toolchain.ir.intervals import value_intervals
from neuroflight.toolchain.ir.network import Network, Node, output_width
from neuroflight.toolchain.ir.onnx_export import STATE, to_model
from neuroflight.toolchain.passes import PASSES, optimize, size
from neuroflight.toolchain.passes.equivalence import BOUND, check_equivalence

SEEDS, SEEDS_PROVEN = range(16), range(1000, 5000)
WIDEST = 8
WIDTHS_TOGETHER = 100  # no more Concats beyond it
CLEAN = (op.Tanh(), op.Sigmoid(), op.Silu(), op.Softsign(), op.Erf(), op.Softplus(), op.Relu())


def floats(rng: Generator, *shape: int, scale: float = 1.0) -> NDArray[np.float32]:
    return (scale * rng.normal(size=shape)).astype(np.float32)


def matrix(rng: Generator, outputs: int, inputs: int) -> op.Linear:
    """Some have columns of zeros, as pruning leaves them."""
    weight = floats(rng, outputs, inputs, scale=inputs**-0.5)
    if rng.random() < 0.3:
        weight[:, rng.random(inputs) < 0.4] = 0
    return op.Linear(weight, floats(rng, outputs))


def affine(rng: Generator, width: int) -> op.Affine:
    scale = np.ones(width) if rng.random() < 0.2 else floats(rng, width).astype(float)
    return op.Affine(scale, floats(rng, width).astype(float) * (rng.random() < 0.6))


def clip(rng: Generator) -> op.Clip:
    low, high = (float(bound) for bound in np.sort(floats(rng, 2, scale=2.0)))
    return op.Clip(None if rng.random() < 0.3 else low, None if rng.random() < 0.3 else high)


def cut(rng: Generator, width: int) -> op.Slice:
    step = int(rng.choice([1, 1, 2, -1, -2]))
    count = int(rng.integers(1, -(-width // abs(step)) + 1))
    reach = (count - 1) * step
    return op.Slice(int(rng.integers(max(0, -reach), width - max(0, reach))), count, step)


def cell(rng: Generator, inputs: int) -> op.Operation:
    units = int(rng.integers(1, 5))
    gates = (3 if rng.random() < 0.5 else 4) * units
    weights = floats(rng, gates, inputs, scale=0.5), floats(rng, gates, units, scale=0.5), floats(rng, gates)
    return op.Gru(*weights, floats(rng, gates)) if gates == 3 * units else op.Lstm(*weights)


def one_value(rng: Generator, width: int) -> op.Operation:
    """An operation of one value."""
    match rng.integers(16):
        case 0 | 1 | 2:
            return matrix(rng, int(rng.integers(1, WIDEST + 1)), width)
        case 3 | 4:
            return affine(rng, width)
        case 5 | 6 | 7:
            return CLEAN[rng.integers(len(CLEAN))]
        case 8:
            return op.LeakyRelu(float(rng.choice([0.125, -0.25, 1.0, 0.0])))
        case 9:
            return op.Elu(float(rng.choice([1.0, 0.5, -0.25])))
        case 10:
            return clip(rng)
        case 11:
            return op.LayerNorm(1e-5, floats(rng, width), floats(rng, width))
        case 12:
            return cut(rng, width)
        case 13:
            return op.RmsNorm(1e-5, floats(rng, width), floats(rng, width))
        case 14:
            return op.Softmax()
        case _:
            return cell(rng, width)


def random_network(rng: Generator) -> Network:
    """A network of a few nodes, mostly in a row, with branches, copies and nodes that nobody takes."""
    inputs = int(rng.integers(2, WIDEST + 1))
    nodes, widths = list[Node](), [inputs]

    def add(operation: op.Operation, *taken: int) -> int:
        nodes.append(Node(operation, taken))
        widths.append(output_width(operation, [widths[value] for value in taken]))
        return len(nodes)

    for _ in range(int(rng.integers(3, 20))):
        value = int(rng.integers(max(0, len(nodes) - 2) if rng.random() < 0.8 else 0, len(widths)))
        width, kind = widths[value], rng.random()
        if kind < 0.08 and nodes:
            copied = nodes[rng.integers(len(nodes))]
            add(copied.operation, *copied.inputs)
        elif kind < 0.18:
            gate = add(op.Sigmoid(), add(matrix(rng, int(rng.integers(1, WIDEST + 1)), width), value))
            joined = add(op.Concat(), gate, value) if rng.random() < 0.4 else gate
            add(matrix(rng, int(rng.integers(1, WIDEST + 1)), widths[joined]), joined)
        elif kind < 0.3:
            other = rng.choice([number for number, same in enumerate(widths) if same == width])
            match rng.integers(5):
                case 0:  # the larger of two: no jump where a rewritten comparison rounds otherwise
                    less = add(op.Affine(np.full(width, -1.0), np.zeros(width)), int(other))
                    add(op.Select(), add(op.Add(), value, less), value, int(other))
                case 1 | 2:
                    add(op.Multiply(), value, int(other))
                case _:
                    add(op.Add(), value, int(other))
        elif kind < 0.4 and sum(widths) < WIDTHS_TOGETHER:
            add(op.Concat(), *(int(v) for v in rng.integers(0, len(widths), int(rng.integers(1, 4)))))
        else:
            add(one_value(rng, width), value)
    motors = int(rng.integers(1, 5))
    last = op.Linear(
        floats(rng, motors, widths[-1], scale=0.3), floats(rng, motors, scale=0.3) + np.float32(0.5)
    )
    add(op.Clip(0.0, 1.0), add(last, len(nodes)))
    return Network(inputs, tuple(nodes))


def check(seed: int) -> set[str]:
    """Hold one network against what the passes leave of it. Returns the passes that fired."""
    network = random_network(np.random.default_rng(seed))
    shorter, savings = optimize(network, prove=True)
    assert optimize(shorter)[0] is shorter
    assert isinstance(shorter.nodes[-1].operation, op.Clip)
    assert size(shorter).operations <= size(network).operations
    assert size(shorter).bytes <= size(network).bytes
    together = check_equivalence(network, shorter, "all passes")
    observation = np.random.default_rng(seed).normal(size=(12, network.inputs)).astype(np.float32)
    difference = np.abs(replay(shorter, observation) - replay(network, observation)).max()
    assert difference <= max(BOUND * np.abs(observation).max(), 16 * together.unit)
    return {saving.rewrite for saving in savings}


def check_intervals(seed: int) -> None:
    """Check that every value onnxruntime computes is in its interval, and that its actions equal ours."""
    rng = np.random.default_rng(seed)
    network = random_network(rng)
    model = to_model(network, rows="rows", state=True, values=True)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    run = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    rows = np.concatenate([rng.normal(size=(40, network.inputs)), 30 * rng.normal(size=(40, network.inputs))])
    rows = rows.astype(np.float32)
    states = clear_state(network, len(rows))
    given = {f"{STATE}{index}": state for index, state in enumerate(states)}
    names = [value.name for value in run.get_outputs()]
    values = dict(zip(names, run.run(names, {"observation": rows, **given}), strict=True))
    numbered = [values.get(f"value{number}") for number in range(1, len(network.nodes))]
    for value, (low, high) in zip([*numbered, values["action"]], value_intervals(network)[1:], strict=True):
        assert value is not None
        finite = np.isfinite(value).all(axis=1)
        slack = 1e-5 * np.maximum(1, np.abs(value[finite]))
        assert (value[finite] >= low - slack).all()
        assert (value[finite] <= high + slack).all()
    exact = reference(network, rows[:, None])[:, 0]
    noise = np.abs(values["action"] - exact)
    ours = advance(network, rows, states)[0]
    compared = np.isfinite(ours).all(axis=1)
    allowed = np.maximum(
        1e-6 * np.maximum(1, np.abs(rows).max(axis=1, keepdims=True)), 16 * noise.max(axis=0)
    )
    assert (np.abs(ours - exact)[compared] <= allowed[compared]).all()


def test_values_lie_within_their_intervals_when_networks_are_random() -> None:
    for seed in SEEDS:
        check_intervals(seed)


@pytest.mark.slow
def test_values_lie_within_their_intervals_when_a_thousand_networks_are_random() -> None:
    for seed in range(5000, 6000):
        check_intervals(seed)


def test_random_networks_keep_their_values_when_all_passes_run() -> None:
    fired = Counter(name for seed in SEEDS for name in check(seed))
    assert set(fired) == {step.name for step in PASSES}, "a pass that never fired was never tested"


@pytest.mark.slow
def test_thousands_of_random_networks_keep_their_values_when_all_passes_run() -> None:
    for seed in SEEDS_PROVEN:
        check(seed)
