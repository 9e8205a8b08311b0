"""Walks a network and turns each operation into calls of kernels and parts of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from neuroflight.toolchain.codegen.kernel_calls import BLOCK, BufferPlace, Call
from neuroflight.toolchain.codegen.scratch_allocation import PendingCall
from neuroflight.toolchain.codegen.weight_table import block_part, lanes_part, padded_gates
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.activation_tables import ERF, EXPM1, SOFTPLUS, TANH, ActivationTable
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.lanes import LANES, padded
from neuroflight.toolchain.ir.network import Network, Node

TABLES = (  # tables of functions, and the operations that look them up
    (TANH, (op.Tanh, op.Sigmoid, op.Silu, op.Gru, op.Lstm)),
    (EXPM1, (op.Elu, op.Softmax)),
    (ERF, (op.Erf,)),
    (SOFTPLUS, (op.Softplus,)),
)


@dataclass(frozen=True)
class _Value:
    """A value under lowering: part of a buffer (scratch, numbered) or of the state."""

    place: BufferPlace  # in scratch, `offset` counts from the begin of buffer `buffer`
    count: int
    buffer: int | None  # None: in the state
    whole: bool  # its padding may be read and written


class Lowering:
    """The lowering of a network, done once; its results are the public attributes."""

    def __init__(self, network: Network) -> None:
        self.calls: list[PendingCall] = []
        self.table: list[Float32] = []
        self.functions: list[ActivationTable] = []
        self.state = 0
        self._size = 0
        self._buffers = 0
        self._tables: dict[str, int] = {}
        for function, users in TABLES:
            if any(isinstance(node.operation, users) for node in network.nodes):
                self.functions.append(function)
                self._tables[function.name] = self._store(function.rows.ravel())
        entrance = self._new(network.inputs)
        self._emit("enter", entrance, (), network.inputs)
        values = [entrance]
        for node in network.nodes[:-1]:
            values.append(self._lower(node, [values[number] for number in node.inputs]))
        last = network.nodes[-1]
        assert isinstance(last.operation, op.Clip), "a policy's last node is its Clip"
        (value,) = (values[number] for number in last.inputs)
        if not self.table:
            self._store(np.zeros(LANES, np.float32))  # C has no empty array
        call = Call("leave", None, (value.place,), value.count, constants=_bounds(last.operation))
        self.calls.append(PendingCall(call, None, (value.buffer,)))

    def _lower(self, node: Node, inputs: list[_Value]) -> _Value:
        x = inputs[0]
        match node.operation:
            case op.Linear(weight, bias):
                return self._linear(weight, bias, x)
            case op.Affine(scale, offset):
                table = self._store(lanes_part(scale), lanes_part(offset))
                return self._map("affine", [x], table=table)
            case op.Tanh():
                return self._look_up(TANH, x)
            case op.Sigmoid():
                return self._sigmoid(self._map("half", [x]))
            case op.Silu():
                return self._map("silu", [x, self._look_up(TANH, self._map("half", [x]))])
            case op.Softsign():
                return self._map("softsign", [x])
            case op.Erf():
                return self._look_up(ERF, x)
            case op.Softplus():
                return self._map("elu", [x, self._look_up(SOFTPLUS, x)], constants=(1.0,))
            case op.Relu():
                return self._map("at_least", [x], constants=(0.0,))
            case op.LeakyRelu(slope):
                return self._map("leaky", [x], constants=(slope,))
            case op.Elu(alpha):
                return self._map("elu", [x, self._look_up(EXPM1, x)], constants=(alpha,))
            case op.Clip(low, high):
                kernel = "clip" if None not in (low, high) else "at_most" if low is None else "at_least"
                bounds = _bounds(node.operation)
                return self._map(kernel, [x], constants=bounds) if bounds else x
            case op.LayerNorm():
                return self._norm("layer_norm", node.operation, x)
            case op.RmsNorm():
                return self._norm("rms_norm", node.operation, x)
            case op.Softmax():
                return self._reduce("shares", self._look_up(EXPM1, self._reduce("below_largest", x)))
            case op.Add():
                return self._map("add", inputs)
            case op.Multiply():
                return self._map("multiply", inputs)
            case op.Select():
                return self._map("select", inputs)
            case op.Concat():
                return self._concat(inputs)
            case op.Slice(start, count, step):
                return self._slice(x, start, count, step)
            case op.Gru():
                return self._gru(node.operation, x)
            case op.Lstm():
                return self._lstm(node.operation, x)
            case never:
                assert_never(never)

    # --- kernels -----------------------------------------------------------------------------------

    def _linear(self, weight: Float32, bias: Float32, x: _Value) -> _Value:
        outputs, inputs = weight.shape
        target = self._new(outputs)
        rest = outputs % BLOCK
        eights = outputs // BLOCK + (rest > LANES)
        if eights:
            table = self._store(*(block_part(weight, bias, BLOCK * index, BLOCK) for index in range(eights)))
            self._emit("linear8", target, (x,), eights, table=table, inputs=inputs, size=BLOCK * eights)
        if 0 < rest <= LANES:
            table = self._store(block_part(weight, bias, BLOCK * eights, LANES))
            part = replace(target, place=replace(target.place, offset=BLOCK * eights))
            self._emit("linear4", part, (x,), 1, table=table, inputs=inputs, size=BLOCK * eights + LANES)
        return target

    def _look_up(self, function: ActivationTable, x: _Value) -> _Value:
        """Append a call that looks `x` up in a function's table.

        The bounds that keep addresses inside the table are constants of the call: no weight can change them.
        """
        limits = (function.low, function.high, function.magic)
        kernel = "look_up_even" if function.even else "look_up"
        return self._map(kernel, [x], table=self._tables[function.name], constants=limits)

    def _sigmoid(self, half: _Value) -> _Value:
        return self._map("sigmoid", [self._look_up(TANH, half)])

    def _norm(self, kernel: str, norm: op.Norm, x: _Value) -> _Value:
        table = self._store(lanes_part(norm.scale), lanes_part(norm.offset))
        return self._reduce(kernel, x, table=table, constants=(1 / x.count, norm.epsilon))

    def _reduce(
        self, kernel: str, x: _Value, *, table: int | None = None, constants: tuple[float, ...] = ()
    ) -> _Value:
        """Call a kernel that first reads all values of `x` together, without the padding behind them."""
        target = self._new(x.count)
        self._emit(kernel, target, (x,), x.count, table=table, constants=constants)
        return target

    def _map(
        self,
        kernel: str,
        sources: Sequence[_Value],
        *,
        table: int | None = None,
        constants: tuple[float, ...] = (),
        target: _Value | None = None,
    ) -> _Value:
        """Append a call of a kernel that goes over its sources value by value, LANES at a time."""
        sources = [self._whole(source) for source in sources]
        target = target or self._new(sources[0].count)
        count = padded(target.count)
        self._emit(kernel, target, tuple(sources), count, table=table, constants=constants)
        return target

    def _whole(self, value: _Value) -> _Value:
        """Return `value`, or a copy of it, whose padding may be read."""
        if value.whole:
            return value
        target = self._new(value.count)
        self._emit("copy", target, (value,), value.count, inputs=1)
        return target

    def _concat(self, parts: Sequence[_Value]) -> _Value:
        target, offset = self._new(sum(part.count for part in parts)), 0
        for part in parts:
            place = replace(target.place, offset=offset)
            offset += part.count
            self._emit("copy", replace(target, place=place), (part,), part.count, inputs=1, size=offset)
        return target

    def _slice(self, x: _Value, start: int, count: int, step: int) -> _Value:
        part = replace(x, place=replace(x.place, offset=x.place.offset + start), count=count, whole=False)
        if step == 1 or count == 1:
            return part
        target = self._new(count)
        self._emit("copy", target, (part,), count, inputs=step)
        return target

    def _gru(self, cell: op.Gru, x: _Value) -> _Value:
        units, room = cell.units, padded(cell.units)
        h = self._state(units)
        weights = [padded_gates(array, units) for array in (cell.input_weight, cell.state_weight)]
        biases = [padded_gates(array, units) for array in (cell.input_bias, cell.state_bias)]
        from_input = self._linear(weights[0], biases[0], x)
        from_state = self._linear(weights[1], biases[1], h)
        sums = [_part(value, 0, 2 * room) for value in (from_input, from_state)]
        gates = self._sigmoid(self._map("half_sum", sums))
        update, reset = _part(gates, 0, room), _part(gates, room, room)
        last = [_part(value, 2 * room, room) for value in (from_state, from_input)]
        candidate = self._look_up(TANH, self._map("multiply_add", [reset, *last]))
        self._map("blend", [update, h, candidate], target=h)
        return h

    def _lstm(self, cell: op.Lstm, x: _Value) -> _Value:
        units, room = cell.units, padded(cell.units)
        h, c = self._state(units), self._state(units)
        none = np.zeros_like(cell.bias)
        from_input = self._linear(padded_gates(cell.input_weight, units), padded_gates(cell.bias, units), x)
        from_state = self._linear(padded_gates(cell.state_weight, units), padded_gates(none, units), h)
        sums = [_part(value, 0, 3 * room) for value in (from_input, from_state)]
        gates = self._sigmoid(self._map("half_sum", sums))
        write, output, forget = (_part(gates, index * room, room) for index in range(3))
        last = [_part(value, 3 * room, room) for value in (from_input, from_state)]
        candidate = self._look_up(TANH, self._map("add", last))
        self._map("cell", [forget, c, write, candidate], target=c)
        self._map("multiply", [output, self._look_up(TANH, c)], target=h)
        return h

    # --- bookkeeping -------------------------------------------------------------------------------

    def _store(self, *parts: Float32) -> int:
        """Append `parts`, each a multiple of LANES floats, to the table. Returns where they begin."""
        begin = self._size
        for part in parts:
            self.table.append(part)
            self._size += part.size
        return begin

    def _new(self, count: int) -> _Value:
        self._buffers += 1
        return _Value(BufferPlace("scratch", 0), count, self._buffers - 1, whole=True)

    def _state(self, units: int) -> _Value:
        value = _Value(BufferPlace("state", self.state), units, None, whole=True)
        self.state += padded(units)
        return value

    def _emit(
        self,
        kernel: str,
        target: _Value,
        sources: tuple[_Value, ...],
        count: int,
        *,
        table: int | None = None,
        inputs: int = 0,
        constants: tuple[float, ...] = (),
        size: int = 0,
    ) -> None:
        places = tuple(source.place for source in sources)
        call = Call(kernel, target.place, places, count, table, inputs, constants)
        buffers = tuple(source.buffer for source in sources)
        self.calls.append(PendingCall(call, target.buffer, buffers, padded(size or target.count)))


def _part(value: _Value, start: int, count: int) -> _Value:
    """Return whole lanes of a value, without a copy."""
    return replace(value, place=replace(value.place, offset=value.place.offset + start), count=count)


def _bounds(clip: op.Clip) -> tuple[float, ...]:
    return tuple(bound + 0.0 for bound in (clip.low, clip.high) if bound is not None)  # never -0
