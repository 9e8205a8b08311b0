"""Compares what was read of a foreign model with the model itself, as onnxruntime or onnx computes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Clip
from neuroflight.toolchain.policy.foreign_model import inline_functions, keep_outputs
from neuroflight.toolchain.policy.foreign_network import Adopted
from neuroflight.toolchain.policy.model import parse_model
from neuroflight.toolchain.verification.machines import first_line

STEPS = 300  # with a random observation of unit size each
APART_MAX = 1e-4  # relative to the largest action, at least 1: a hundred times the effect of rounding
JUMPS_MAX = 0.05  # part of the steps that may differ more: rounding can flip a comparison in the model
NOT_COMPARED = "not compared with the model itself"
UNBOUNDED = Clip(float(np.finfo(np.float32).min), float(np.finfo(np.float32).max))

Run = Callable[[list[str], dict[str, NDArray[Any]]], list[NDArray[Any]]]  # outputs by name of inputs by name


def compare(data: bytes, adopted: Adopted) -> str:
    """Return in a line how far `adopted` is from the model in `data`. Raises PolicyError if too far."""
    model = parse_model(data)
    inline_functions(model)  # so that the operators are those that were read
    keep_outputs(model.graph, {adopted.action, *adopted.states.values()})
    taken = {name for node in model.graph.node for name in node.input}
    for value in [value for value in model.graph.input if value.name not in taken]:
        model.graph.input.remove(value)
    observation = np.random.default_rng(0).standard_normal((STEPS, adopted.network.inputs), np.float32)
    reason = ""
    for machine, make in _machines():
        try:
            expected = _actions(make(model), model, adopted, observation)
        except Exception as error:  # neither has a common class of its errors
            reason = reason or f"{machine} does not run it: {first_line(str(error))}"
            continue
        return _compared(machine, adopted, expected, observation)
    return f"{NOT_COMPARED}: {reason}"


def _compared(machine: str, adopted: Adopted, expected: NDArray[np.float64], observation: Float32) -> str:
    found = _adopted_actions(adopted, observation)
    usable = np.isfinite(found).all(axis=1)  # a policy whose sums overflow gives NaN by design
    if not usable.any():
        return f"{NOT_COMPARED}: its sums leave float32 in all of {STEPS} random steps"
    apart = np.abs(found[usable] - expected[usable]).max(axis=1)
    allowed = APART_MAX * max(1.0, float(np.abs(found[usable]).max()))
    if not (apart <= allowed).mean() >= 1 - JUMPS_MAX:
        raise PolicyError(
            f"what was read of the model is up to {apart.max():.2g} away from what {machine} computes with "
            f"it, expected at most {allowed:.2g}; please report this with the file"
        )
    carried = ", its state carried" if adopted.states and not adopted.forgetful else ""
    far = f"at most {apart.max():.1e} apart"
    return f"compared with {machine} on the model itself, {STEPS} steps{carried}: {far}"


def _machines() -> Iterator[tuple[str, Callable[[onnx.ModelProto], Run]]]:
    """Yield the programs that can run models, the most independent one first."""
    from onnx.reference import ReferenceEvaluator

    try:
        import onnxruntime
    except ImportError:
        pass
    else:

        def session(model: onnx.ModelProto) -> Run:
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads, options.log_severity_level = 1, 4
            run: Run = onnxruntime.InferenceSession(
                model.SerializeToString(), options, providers=["CPUExecutionProvider"]
            ).run
            return run

        yield "onnxruntime", session

    def evaluator(model: onnx.ModelProto) -> Run:
        reference = ReferenceEvaluator(model)
        return lambda names, given: list(reference.run(names, given))

    yield "onnx's reference", evaluator


def _actions(run: Run, model: onnx.ModelProto, adopted: Adopted, observation: Float32) -> NDArray[np.float64]:
    """Run the model itself; states start from zero, at every step if a cell inside it does."""
    sizes, kinds = dict[str, list[int]](), dict[str, type]()
    for value in model.graph.input:
        tensor = value.type.tensor_type
        shape = adopted.inputs.get(value.name, (1,) * len(tensor.shape.dim))
        axes = tensor.shape.dim if tensor.HasField("shape") else [None] * len(shape)
        sizes[value.name] = [
            axis.dim_value if axis is not None and axis.dim_value > 0 else one
            for axis, one in zip(axes, shape, strict=True)
        ]
        kinds[value.name] = np.float64 if tensor.elem_type == TensorProto.DOUBLE else np.float32
    names, rows = [adopted.action, *adopted.states.values()], []
    clear: dict[str, NDArray[Any]] = {name: np.zeros(sizes[name], kinds[name]) for name in adopted.states}
    ends = np.cumsum([np.prod(shape, dtype=int) for shape in adopted.inputs.values()])
    state = clear
    for row in observation:
        parts = zip(adopted.inputs.items(), np.split(row, ends[:-1]), strict=True)
        given: dict[str, NDArray[Any]] = {
            name: np.ascontiguousarray(np.broadcast_to(part.reshape(shape), sizes[name]).astype(kinds[name]))
            for (name, shape), part in parts
        }
        action, *after = run(names, given | state)
        rows.append(np.asarray(action).reshape(-1, adopted.network.outputs)[0])
        fresh = {n: v.reshape(sizes[n]) for n, v in zip(adopted.states, after, strict=True)}
        state = clear if adopted.forgetful else fresh
    return np.array(rows, np.float64)


def _adopted_actions(adopted: Adopted, observation: Float32) -> Float32:
    network = adopted.network
    network = Network(network.inputs, (*network.nodes, Node(UNBOUNDED, (len(network.nodes),))))
    clear, rows = clear_state(network, 1), []
    state = clear
    for row in observation:
        action, after = advance(network, row[None], state, exact=False)
        state = clear if adopted.forgetful else after
        rows.append(action[0])
    return np.array(rows)
