"""Finds recurrent cells whose state is an input and an output of the model.

    GRU    h' = (1 - z) n + z h,  z, r = sigmoid(W x + R h + b),  n = tanh(W x + b + r (R h + c))
    LSTM   c' = f c + i g,  h' = o tanh c',  i, o, f = sigmoid(W x + R h + b),  g = tanh(W x + R h + b)
    RNN    h' = tanh(W x + R h + b)

Exporters write these sums and products in many ways: one matrix or eight, gates side by side or each alone,
n + z (h - n) or (1 - z) n + z h. So the new state is expanded into a polynomial of gates and states, value by
value, and the sum before each gate is traced back through matrices, slices and sums to the state and to
the values that the cell reads. A cell that is found so is proven to compute the same in real arithmetic.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Node
from neuroflight.toolchain.reader.recurrent import GATE_OPEN, plain_cell

TERMS_MAX = 16  # of a polynomial; a cell's new state has three
STEPS_MAX = 400  # in one cell's search; each may be a level of recursion, an LSTM takes some 60
UNITS_MAX = 512  # of a cell: more have more weights than a board takes

Matrix = NDArray[np.float64]
Places = tuple[int, ...]  # of elements within a value
Atom = tuple[str, int, Places]  # kind ("state", "gate", "tanh", "row"), value, its elements
Polynomial = dict[tuple[Atom, ...], Matrix]  # product of atoms: factor of each element


class NoCellError(Exception):
    """A new state that no known cell computes; the message says why."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A cell that stands for the nodes that compute the value `result`."""

    operation: op.Recurrent
    takes: tuple[int, ...]  # the values that it takes, side by side
    result: int  # h'
    states: tuple[int, ...]  # numbers of the state inputs that it replaces


@dataclass
class _Sum:
    """W x + R h + b of one gate: W by the value that it multiplies, R by the input that holds the state."""

    given: dict[int, Matrix] = field(default_factory=dict)
    kept: dict[int, Matrix] = field(default_factory=dict)
    bias: Matrix = field(default_factory=lambda: np.zeros(1))


@dataclass(frozen=True)
class _Group:
    """State elements whose new values are exactly the elements of the value `after`, in its order."""

    state: int  # number of the input
    places: Places  # in the input
    after: int

    @property
    def atom(self) -> Atom:
        return "state", self.state, self.places


def find_cells(
    nodes: Sequence[Node], widths: Sequence[int], inputs: set[int], after: Mapping[int, int]
) -> tuple[list[Cell], dict[int, str]]:
    """Find the recurrent cells of a network, and for each state that belongs to none, the reason.

    inputs: numbers of the model's inputs; after: number of the new value of each input that is a state.
    """
    search = _Search(nodes, widths, inputs, set(after))
    groups, reasons, cells = list[_Group](), dict[int, str](), list[Cell]()
    for state, value in after.items():
        try:
            groups += search.groups(state, value)
        except NoCellError as error:
            reasons[state] = str(error)
    left = {group.after: group for group in groups}
    for group in sorted(groups, key=lambda group: group.after):
        try:
            cell, used = search.cell(group, left)
        except NoCellError as error:
            reasons[group.state] = str(error)
            continue
        cells.append(cell)
        search.results.add(cell.result)
        for done in used:
            del left[done.after]
    lost = reasons.keys() - {group.state for group in groups} | {group.state for group in left.values()}
    return cells, {state: reasons[state] for state in lost}


class _Search:
    """A network under examination."""

    def __init__(
        self, nodes: Sequence[Node], widths: Sequence[int], inputs: set[int], states: set[int]
    ) -> None:
        self.nodes, self.widths, self.inputs, self.states = nodes, widths, inputs, states
        self.results = set[int]()  # results of the cells found so far; no search goes past them
        self.steps = 0

    def _step(self) -> None:
        """Count one step of the search. Raises NoCellError after too many: paths may grow exponentially."""
        self.steps += 1
        if self.steps > STEPS_MAX:
            raise NoCellError("its new value has more branches than a cell's")

    def groups(self, state: int, value: int) -> list[_Group]:
        """Group the elements of `state` by the value that computes their new values."""
        found: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        for place in range(self.widths[state]):
            base, (where,) = self.source(value, (place,))
            found[base].append((where, place))
        groups = []
        for base, pairs in found.items():
            pairs.sort()
            if [where for where, _ in pairs] != list(range(self.widths[base])):
                raise NoCellError("its new value is a part of another value")
            groups.append(_Group(state, tuple(place for _, place in pairs), base))
        return groups

    def cell(self, group: _Group, left: Mapping[int, _Group]) -> tuple[Cell, list[_Group]]:
        """Return the cell whose new output is `group`, and the groups it carries. Raises NoCellError."""
        units, self.steps = len(group.places), 0
        if units > UNITS_MAX:
            raise NoCellError(f"it has {units} units, expected at most {UNITS_MAX}")
        after = self.polynomial(group.after, tuple(range(units)))
        kinds = sorted(tuple(sorted(kind for kind, *_ in atoms)) for atoms in after)
        if kinds == [("tanh",)]:
            return self._plain(group, after), [group]
        if kinds == [("gate", "state"), ("gate", "tanh"), ("tanh",)]:
            return self._gru(group, after, flipped=False), [group]
        if kinds == [("gate", "state"), ("gate", "tanh"), ("state",)]:
            return self._gru(group, after, flipped=True), [group]
        if kinds == [("gate", "tanh")]:
            return self._lstm(group, after, left)
        raise NoCellError("its new value is not that of a GRU, LSTM or tanh RNN")

    def _plain(self, group: _Group, after: Polynomial) -> Cell:
        ((new,),) = after
        _ones(after, {(new,): 1})
        total = self.sum(self._before(new))
        takes, state_weight = self._takes([total]), self._kept(total, group)
        if not state_weight.any():
            raise NoCellError("its new value does not depend on the state before")
        weight = _float32(_joined(total, takes, self.widths), state_weight, total.bias, 0 * total.bias)
        return Cell(plain_cell(*weight), takes, group.after, (group.state,))

    def _gru(self, group: _Group, after: Polynomial, *, flipped: bool) -> Cell:
        atoms = {atom[0]: atom for product in after for atom in product}
        h, z, n = group.atom, atoms["gate"], atoms["tanh"]
        stays, goes = (n, h) if flipped else (h, n)
        _ones(after, {_product(goes): 1, _product(goes, z): -1, _product(stays, z): 1})
        update = self.sum(self._before(z))
        inner = self._before(n)
        gates = {atom for product in inner for atom in product if atom[0] == "gate"}
        if len(gates) > 1:
            raise NoCellError("its new value has more than one reset gate")
        units = len(group.places)
        if gates:
            (r,) = gates
            reset = self.sum(self._before(r))
            bare = {product: factor for product, factor in inner.items() if r not in product}
            gated = {tuple(a for a in product if a != r): f for product, f in inner.items() if r in product}
            fresh, old = self.sum(bare), self.sum(gated)
        else:
            reset = _Sum(bias=np.full(units, GATE_OPEN))
            fresh = self.sum(inner)
            old = _Sum(kept=fresh.kept, bias=np.zeros(units))
            fresh = _Sum(given=fresh.given, bias=fresh.bias)
        if fresh.kept:
            raise NoCellError("a part of its state passes the reset gate by")
        if old.given:
            raise NoCellError("its reset gate multiplies what the cell takes, expected the state's part only")
        takes = self._takes([update, reset, fresh])
        sign = -1.0 if flipped else 1.0
        weight = [
            sign * _joined(update, takes, self.widths),
            *(_joined(s, takes, self.widths) for s in (reset, fresh)),
        ]
        kept = [sign * self._kept(update, group), self._kept(reset, group), self._kept(old, group)]
        bias = [sign * update.bias, reset.bias, fresh.bias]
        state_bias = [np.zeros(2 * units), old.bias]
        arrays = _float32(*(np.concatenate(parts) for parts in (weight, kept, bias, state_bias)))
        return Cell(op.Gru(*arrays), takes, group.after, (group.state,))

    def _lstm(
        self, group: _Group, after: Polynomial, left: Mapping[int, _Group]
    ) -> tuple[Cell, list[_Group]]:
        (product,) = after
        _ones(after, {product: 1})
        leave, squashed = product if product[0][0] == "gate" else product[::-1]
        units = len(group.places)
        inside, places = self.source(self.nodes[squashed[1] - 1].inputs[0], squashed[2])
        memory = left.get(inside)
        if memory is None or places != tuple(range(units)):
            raise NoCellError("its new value is an LSTM's, whose cell state is no output of the model")
        new = self.polynomial(inside, places)
        kinds = sorted(tuple(sorted(kind for kind, *_ in atoms)) for atoms in new)
        if kinds != [("gate", "state"), ("gate", "tanh")]:
            raise NoCellError("its cell state is not f c + i g")
        forget = next(a for p in new for a in p if a[0] == "gate" and any(b[0] == "state" for b in p))
        enter, gain = (
            next(a for p in new for a in p if a[0] == kind and a != forget) for kind in ("gate", "tanh")
        )
        _ones(new, {_product(forget, memory.atom): 1, _product(enter, gain): 1})
        sums = [self.sum(self._before(atom)) for atom in (enter, leave, forget, gain)]
        takes = self._takes(sums)
        weight = [_joined(total, takes, self.widths) for total in sums]
        kept = [self._kept(total, group) for total in sums]
        arrays = _float32(*(np.concatenate(p) for p in (weight, kept, [total.bias for total in sums])))
        return Cell(op.Lstm(*arrays), takes, group.after, (group.state, memory.state)), [group, memory]

    def _takes(self, sums: Sequence[_Sum]) -> tuple[int, ...]:
        """Return the values that a cell with these sums reads, in ascending order. Raises NoCellError."""
        takes = tuple(sorted({value for total in sums for value in total.given}))
        if not takes:
            raise NoCellError("its new value depends on no observation")
        return takes

    def _kept(self, total: _Sum, group: _Group) -> Matrix:
        """Return R of a sum, columns in `group`'s order. Raises NoCellError if it reads another state."""
        if total.kept.keys() - {group.state}:
            raise NoCellError("its gates take another state than its own output")
        units = len(group.places)
        matrix = total.kept.get(group.state, np.zeros((units, self.widths[group.state])))
        if np.delete(matrix, group.places, axis=1).any():
            raise NoCellError("its gates take another part of the state than its own output")
        return matrix[:, list(group.places)]

    def _before(self, atom: Atom) -> Polynomial:
        """Return the argument of the gate or tanh `atom`."""
        return self.polynomial(self.nodes[atom[1] - 1].inputs[0], atom[2])

    def source(self, value: int, places: Places) -> tuple[int, Places]:
        """Follow slices and concats back to the one value with these elements; return it and their places."""
        while value and value not in self.inputs:
            node = self.nodes[value - 1]
            match node.operation:
                case op.Slice(start, _, step):
                    value, places = node.inputs[0], tuple(start + step * place for place in places)
                case op.Concat():
                    part = self._part(node, places)
                    if part is None:
                        break
                    value, places = part
                case _:
                    break
        return value, places

    def _part(self, node: Node, places: Places) -> tuple[int, Places] | None:
        first = 0
        for value in node.inputs:
            if first <= min(places) and max(places) < first + self.widths[value]:
                return value, tuple(place - first for place in places)
            first += self.widths[value]
        return None

    def polynomial(self, value: int, places: Places) -> Polynomial:
        """Return these elements of `value` as sums of products of gates, states and other values."""
        self._step()
        value, places = self.source(value, places)
        one = np.ones(len(places))
        if value in self.states:
            return {(("state", value, places),): one}
        if value in self.inputs or value in self.results or not value:
            return {(("row", value, places),): one}
        node = self.nodes[value - 1]
        match node.operation:
            case op.Sigmoid():
                return {(("gate", value, places),): one}
            case op.Tanh():
                return {(("tanh", value, places),): one}
            case op.Affine(scale, offset):
                inner = self.polynomial(node.inputs[0], places)
                result = {product: factor * scale[list(places)] for product, factor in inner.items()}
                return _sum([result, {(): offset[list(places)]}])
            case op.Add():
                return _sum([self.polynomial(taken, places) for taken in node.inputs])
            case op.Multiply():
                first, second = (self.polynomial(taken, places) for taken in node.inputs)
                return _sum([{_product(*p, *q): a * b} for p, a in first.items() for q, b in second.items()])
        return {(("row", value, places),): one}

    def sum(self, polynomial: Polynomial) -> _Sum:
        """Return the matrices of a polynomial of degree 1. Raises NoCellError for a product."""
        total = _Sum(bias=np.zeros(len(next(iter(polynomial.values()), np.zeros(1)))))
        for product, factor in polynomial.items():
            match product:
                case ():
                    total.bias = total.bias + factor
                case ((_, value, places),):
                    matrix = np.zeros((len(places), self.widths[value]))
                    matrix[np.arange(len(places)), list(places)] = factor
                    self._flow(total, value, matrix, through=False)
                case _:
                    raise NoCellError("a gate of it takes a product")
        return total

    def _flow(self, total: _Sum, value: int, matrix: Matrix, *, through: bool) -> None:
        """Add matrix * value to `total`, traced back to states and to the values that the cell reads.

        through: True behind a matrix; a value before it that depends on no state is then read as it is.
        """
        self._step()
        if value in self.states:
            total.kept[value] = total.kept.get(value, 0.0) + matrix
            return
        stateless = not self._reaches_state(value)
        node = self.nodes[value - 1] if value else None
        if node is None or value in self.inputs or value in self.results or (through and stateless):
            total.given[value] = total.given.get(value, 0.0) + matrix
            return
        match node.operation:
            case op.Slice(start, count, step):
                wide = np.zeros((len(matrix), self.widths[node.inputs[0]]))
                wide[:, start + step * np.arange(count)] = matrix
                self._flow(total, node.inputs[0], wide, through=through)
            case op.Concat():
                ends = np.cumsum([self.widths[taken] for taken in node.inputs])[:-1]
                for taken, part in zip(node.inputs, np.split(matrix, ends, axis=1), strict=True):
                    if part.any():
                        self._flow(total, taken, part, through=through)
            case op.Affine(scale, offset):
                total.bias = total.bias + matrix @ offset
                self._flow(total, node.inputs[0], matrix * scale, through=through)
            case op.Add():
                for taken in node.inputs:
                    self._flow(total, taken, matrix, through=through)
            case op.Linear(weight, bias):
                total.bias = total.bias + matrix @ bias.astype(np.float64)
                self._flow(total, node.inputs[0], matrix @ weight.astype(np.float64), through=True)
            case _ if stateless:
                total.given[value] = total.given.get(value, 0.0) + matrix
            case op.Multiply() if through:
                raise NoCellError(
                    "its state is multiplied before its matrix, as by a GRU that resets before it "
                    "(linear_before_reset 0)"
                )
            case other:
                raise NoCellError(f"a {type(other).__name__} lies between its state and its gates")

    def _reaches_state(self, value: int) -> bool:
        waiting, seen = [value], set[int]()
        while waiting:
            number = waiting.pop()
            if number in seen or number in self.results or not number:
                continue
            seen.add(number)
            if number in self.states:
                return True
            if number not in self.inputs:
                waiting += self.nodes[number - 1].inputs
        return False


def _product(*atoms: Atom) -> tuple[Atom, ...]:
    return tuple(sorted(atoms))


def _sum(parts: Sequence[Polynomial]) -> Polynomial:
    """Add polynomials, without terms that cancel. Raises NoCellError for more terms than a cell has."""
    total: Polynomial = {}
    for part in parts:
        for product, factor in part.items():
            total[product] = total[product] + factor if product in total else factor
    if len(total) > TERMS_MAX:
        raise NoCellError("its new value is a longer sum than a cell's")
    return {product: factor for product, factor in total.items() if factor.any()}


def _ones(polynomial: Polynomial, expected: Mapping[tuple[Atom, ...], int]) -> None:
    """Raise NoCellError unless `polynomial` has these products with these factors in every element."""
    same = polynomial.keys() == expected.keys()
    if not same or not all((polynomial[product] == factor).all() for product, factor in expected.items()):
        raise NoCellError("its new value mixes the state otherwise than a GRU, LSTM or RNN")


def _joined(total: _Sum, takes: Sequence[int], widths: Sequence[int]) -> Matrix:
    """Return W of a sum, its columns over all values that the cell reads."""
    units = len(total.bias)
    return np.hstack([total.given.get(value, np.zeros((units, widths[value]))) for value in takes])


def _float32(*arrays: Matrix) -> list[NDArray[np.float32]]:
    with np.errstate(over="ignore"):
        rounded = [np.ascontiguousarray(array, np.float32) for array in arrays]
    if not all(np.isfinite(array).all() for array in rounded):
        raise NoCellError("its weights leave the range of float32")
    return rounded
