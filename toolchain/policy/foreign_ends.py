"""The ends of another trainer's model: which inputs are the observation, which output is the action.

The remaining inputs are state, whose new values are outputs, as recurrent policies are exported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import onnx
from onnx import TensorProto

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.foreign_model import listed
from neuroflight.toolchain.reader.values import WIDTH_MAX, RowValue, Unread, Value, shown

ACTIONS = (  # names that exporters give the action beside a critic or a standard deviation
    "act",
    "action",
    "actions",
    "mu",
    "mean",
    "action_mean",
    "mean_action",
    "mean_actions",
    "motors",
    "output",
    "continuous_actions",
    "deterministic_action",
    "deterministic_actions",
    "deterministic_continuous_actions",
)
LISTED_MAX = 8  # outputs that a message lists
FLOATS = (TensorProto.FLOAT, TensorProto.DOUBLE)
Sizes = list[int | str]  # of an axis: its name where the exporter left it open


@dataclass(frozen=True)
class Ends:
    """The user's choice of inputs and outputs, and how many values they must have."""

    output: str | None  # the action's name
    input_order: tuple[str, ...] | None
    terms: tuple[tuple[str, int], ...] | None  # of the observation, with widths; None where not understood
    motors: int

    @property
    def observation_count(self) -> int | None:
        """Width of the observation."""
        return None if self.terms is None else sum(width for _, width in self.terms)


def input_shapes(model: onnx.ModelProto, ends: Ends) -> tuple[dict[str, tuple[int, ...]], list[str]]:
    """Return the shape that each float input has for one observation, and which sizes were changed for it.

    Open axes and batches become 1.
    """
    changes = list[str]()
    given = {tensor.name for tensor in model.graph.initializer}
    inputs = {v.name: _sizes(v) for v in model.graph.input if v.name not in given and _floats(v)}
    read = _read_inputs(model.graph)
    declared = [_sizes(value) for value in model.graph.output]
    observed = [s for name, s in inputs.items() if name in read and s not in declared]
    batched = _batches(observed, ends.observation_count)
    batches = {sizes[0] for name, sizes in inputs.items() if len(sizes) > 1 and name in read}
    fixed = dict[str, Sizes]()
    for name, sizes in inputs.items():
        fixed[name], last = list(sizes), len(sizes) - 1
        for axis, size in enumerate(sizes):
            if isinstance(size, str):
                batch = axis < last or name not in read or (last == 0 and len(inputs) > 1 and size in batches)
            else:  # a state's batch axis comes after its layers
                batch = size in batched and axis < last and (axis == 0 or sizes not in observed)
            if batch:
                changes.append(f"fixed axis {axis} of {shown(name)} to 1 (was {size})")
                fixed[name][axis] = 1
    open_ = [name for name, sizes in fixed.items() if any(isinstance(size, str) for size in sizes)]
    others = [fixed[n] for n in inputs if n in read and n not in open_ and inputs[n] not in declared]
    for name in open_:
        width = (ends.observation_count or 0) - sum(math.prod(map(int, sizes)) for sizes in others)
        if len(open_) > 1 or width < 1:
            text = ", ".join(map(str, inputs[name]))
            raise PolicyError(
                f"the input {shown(name)} has the dynamic shape [{text}], and its size cannot be told from "
                "--observation; export it with a fixed width, [1, n]"
            )
        changes.append(
            f"fixed axis {len(fixed[name]) - 1} of {shown(name)} to {width} (was {fixed[name][-1]})"
        )
        fixed[name][-1] = width
    shapes = {name: tuple(int(size) for size in sizes) for name, sizes in fixed.items()}
    for name, shape in shapes.items():
        if min(shape, default=1) < 1 or math.prod(shape) > WIDTH_MAX:
            raise PolicyError(
                f"the input {shown(name)} has the shape {list(shape)}, expected at most {WIDTH_MAX} values; "
                "export it for one observation, [1, n]"
            )
    if not shapes:
        names = listed([value.name for value in model.graph.input if value.name not in given])
        raise PolicyError(
            f"the model's inputs are {names}, expected an observation of floats, float32 [1, n]; export it so"
        )
    return shapes, changes


def _batches(observed: Sequence[Sizes], count: int | None) -> set[int]:
    """Return the batch sizes that the exporter fixed: first axes above 1.

    Where the inputs have as many values as the observation, such an axis is a history, [steps, n].
    """
    values = sum(math.prod(size for size in sizes if isinstance(size, int)) for sizes in observed)
    firsts = {sizes[0] for sizes in observed if len(sizes) > 1}
    return set() if values == count else {size for size in firsts if isinstance(size, int) and size > 1}


def _read_inputs(graph: onnx.GraphProto) -> set[str]:
    """Return the inputs that some node other than Identity reads, directly or through an Identity."""
    source = {value.name: value.name for value in graph.input}
    read = set[str]()
    for node in graph.node:
        taken = {source[name] for name in node.input if name in source}
        if node.op_type == "Identity" and taken:
            source[node.output[0]] = taken.pop()
        read |= taken
    return read


def _sizes(value: onnx.ValueInfoProto) -> Sizes:
    """Return the sizes of a value's axes; exporters also write 0 and -1 for an open one."""
    dims = value.type.tensor_type.shape.dim
    return [dim.dim_value if dim.dim_value > 0 else dim.dim_param or "?" for dim in dims]


def _floats(value: onnx.ValueInfoProto) -> bool:
    return value.type.HasField("tensor_type") and value.type.tensor_type.elem_type in FLOATS


def find_action(model: onnx.ModelProto, values: Mapping[str, Value], ends: Ends) -> str:
    """Return the name of the action: that of --output, the only output, or the only one that can be it."""
    names: list[str] = [value.name for value in model.graph.output]
    if ends.output is not None:
        if ends.output not in names:
            raise PolicyError(f"the model has no output {ends.output!r}, its outputs are {listed(names)}")
        return ends.output
    if len(names) == 1:
        return names[0]
    declared = {value.name: _sizes(value) for value in model.graph.output}
    fitting = [name for name in names if _fits(values.get(name), declared[name], ends.motors)]
    named = [name for name in fitting if name.lower() in ACTIONS]
    for choice in (fitting, named):
        if len(choice) == 1:
            return choice[0]
    shown_ = [f"{shown(name)} ({_width(values, name) or 'no'} values)" for name in names[:LISTED_MAX]]
    raise PolicyError(
        f"the model's outputs are {', '.join(shown_)}, expected one of {ends.motors} values, one a motor; "
        "choose one with --output"
    )


def _fits(value: Value | None, declared: Sizes, motors: int) -> bool:
    """Return True if an output may be the action; an unreadable one may unless its shape rules it out."""
    if isinstance(value, Unread):
        shape = declared if value.shape is None else list(value.shape)
        return not shape or isinstance(shape[-1], str) or shape[-1] == motors
    return isinstance(value, RowValue) and value.width == motors


def _width(values: Mapping[str, Value], name: str) -> int | None:
    value = values.get(name)
    return value.width if isinstance(value, RowValue) else None


def computed(values: Mapping[str, Value], name: str) -> RowValue:
    """Return the output `name` as a value. Raises PolicyError where it is none or could not be read."""
    value = values.get(name)
    if isinstance(value, RowValue):
        return value
    if isinstance(value, Unread):
        raise value.error or PolicyError(f"the output {shown(name)} is {value.label}, which is not supported")
    raise PolicyError(f"the output {shown(name)} is no function of the observation; is the export right?")


def find_states(
    model: onnx.ModelProto, values: Mapping[str, Value], inputs: Mapping[str, RowValue], action: str
) -> dict[str, str]:
    """Pair inputs that may be state with outputs that may be its new value: equally wide, in order."""
    found = dict[str, str]()
    others = [value.name for value in model.graph.output if value.name != action]
    for width in dict.fromkeys(_width(values, name) for name in others):
        outputs = [name for name in others if _width(values, name) == width]
        takers = [name for name, row in inputs.items() if row.width == width]
        count = min(len(takers), len(outputs))
        if width is not None and count:
            found |= dict(zip(takers[-count:], outputs[:count], strict=True))
    return found
