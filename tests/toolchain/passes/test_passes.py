"""Each pass alone: what it leaves, what it saves, that the values stay, and where it may not fire."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.ir.network import Network, Node, chain
from neuroflight.toolchain.passes import PASSES, Saving, optimize, size
from neuroflight.toolchain.passes.equivalence import check_equivalence

CLIP = op.Clip(0.0, 1.0)
RUN = {step.name: step.run for step in PASSES}


def array(*shape: int, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return (0.4 * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


def linear(outputs: int, inputs: int, seed: int = 0) -> op.Linear:
    return op.Linear(array(outputs, inputs, seed=seed), array(outputs, seed=seed + 1))


def affine(count: int, seed: int = 0) -> op.Affine:
    return op.Affine(array(count, seed=seed).astype(float), array(count, seed=seed + 1).astype(float))


def norm(count: int) -> op.LayerNorm:
    return op.LayerNorm(1e-5, array(count), array(count, seed=1))


def gru(units: int, inputs: int) -> op.Gru:
    weights = array(3 * units, inputs), array(3 * units, units, seed=1)
    return op.Gru(*weights, array(3 * units, seed=2), array(3 * units, seed=3))


def lstm(units: int, inputs: int) -> op.Lstm:
    return op.Lstm(array(4 * units, inputs), array(4 * units, units, seed=1), array(4 * units, seed=2))


def graph(*nodes: tuple[op.Operation, tuple[int, ...]], inputs: int = 6) -> Network:
    """A network of (operation, numbers of the values that it takes)."""
    return Network(inputs, tuple(Node(operation, taken) for operation, taken in nodes))


def line(*operations: op.Operation, inputs: int = 6) -> Network:
    return chain(inputs, operations)


def pruned(outputs: int, inputs: int, *columns: int) -> op.Linear:
    """A linear layer that does not read some of its inputs."""
    layer = linear(outputs, inputs)
    weight = layer.weight.copy()
    weight[:, list(columns)] = 0
    return op.Linear(weight, layer.bias)


def fixed(layer: op.Linear, *rows: int, bias: float = 0.5) -> op.Linear:
    """`layer` with some outputs that only their bias makes."""
    weight, biases = layer.weight.copy(), layer.bias.copy()
    weight[list(rows)], biases[list(rows)] = 0, bias
    return op.Linear(weight, biases)


def written(network: Network) -> str:
    """The network in a line: each operation with its width and what it takes."""
    nodes = zip(network.nodes, network.widths[1:], strict=True)
    return " ".join(f"{type(n.operation).__name__}{width}{list(n.inputs)}" for n, width in nodes)


SHARED = affine(6)  # one observation scaling that several branches take

# name of the pass, network before, network after, (nodes, operations, bytes) saved
FIRES: dict[str, tuple[str, Network, str, tuple[int, int, int]]] = {
    "units without weights": (
        "fold constants",
        line(fixed(linear(8, 6), 2, 5), op.Sigmoid(), linear(4, 8), CLIP),
        "Linear8[0] Sigmoid8[1] Linear4[2] Clip4[3]",
        (0, 0, 0),
    ),
    "constants before a cell": (
        "fold constants",
        line(fixed(linear(8, 6), 2), op.Tanh(), gru(3, 8), op.Tanh(), CLIP),
        "Linear8[0] Tanh8[1] Gru3[2] Tanh3[3] Clip3[4]",
        (0, 0, 0),
    ),
    "a node that nobody takes": (
        "drop unread",
        graph((linear(4, 6), (0,)), (linear(9, 6), (0,)), (op.Tanh(), (2,)), (CLIP, (1,))),
        "Linear4[0] Clip4[1]",
        (2, 9 * 6 + 9, 4 * 9 * 7),
    ),
    "a cell that nobody takes": (
        "drop unread",
        graph((gru(3, 6), (0,)), (linear(4, 6), (0,)), (CLIP, (2,))),
        "Linear4[0] Clip4[1]",
        (1, 9 * 9 + 36, 4 * 9 * 11),
    ),
    "rows behind a slice": (
        "drop unread",
        line(linear(9, 6), op.Tanh(), op.Slice(7, 4, -2), CLIP),
        "Linear4[0] Tanh4[1] Slice4[2] Clip4[3]",
        (0, 5 * 6 + 5, 4 * 5 * 7),
    ),
    "rows that only exact zeros meet": (
        "drop unread",
        line(linear(9, 6), op.Tanh(), affine(9), pruned(4, 9, 0, 5), CLIP),
        "Linear7[0] Tanh7[1] Affine7[2] Linear4[3] Clip4[4]",
        (0, 2 * 6 + 2 + 2 + 2 * 4, 4 * (2 * 7 + 2 * 2 + 2 * 4)),
    ),
    "what only unread rows read": (
        "drop unread",
        line(linear(9, 6), op.Tanh(), op.Linear(np.eye(9, dtype=np.float32), array(9)), op.Slice(2, 4), CLIP),
        "Linear4[0] Tanh4[1] Linear4[2] Slice4[3] Clip4[4]",
        (0, 5 * 6 + 5 + 81 - 16, 4 * (5 * 7 + 90 - 20)),
    ),
    "a branch that one of two readers needs": (
        "drop unread",
        graph(
            (linear(3, 6), (0,)),
            (linear(5, 6), (0,)),
            (op.Concat(), (1, 2)),
            (pruned(4, 8, 3, 4, 5, 6, 7), (3,)),
            (linear(4, 5), (2,)),
            (op.Add(), (4, 5)),
            (CLIP, (6,)),
        ),
        "Linear3[0] Linear5[0] Concat3[1] Linear4[3] Linear4[2] Add4[4, 5] Clip4[6]",
        (0, 5 * 4, 4 * 5 * 4),
    ),
    "one of two branches that is unread": (
        "drop unread",
        graph(
            (linear(3, 6), (0,)),
            (linear(5, 6), (0,)),
            (op.Concat(), (1, 2)),
            (pruned(4, 8, 3, 4, 5, 6, 7), (3,)),
            (CLIP, (4,)),
        ),
        "Linear3[0] Concat3[1] Linear4[2] Clip4[3]",
        (1, 5 * 6 + 5 * 4, 4 * (5 * 7 + 5 * 4)),
    ),
    "an affine map of ones and zeros": (
        "drop identities",
        line(op.Tanh(), op.Affine(np.ones(6), np.zeros(6)), CLIP),
        "Tanh6[0] Clip6[1]",
        (1, 6, 48),
    ),
    "a matrix of ones and zeros": (
        "drop identities",
        line(op.Tanh(), op.Linear(np.eye(6, dtype=np.float32), np.zeros(6, np.float32)), CLIP),
        "Tanh6[0] Clip6[1]",
        (1, 36, 4 * 42),
    ),
    "a slice of everything": ("drop identities", line(op.Slice(0, 6), CLIP), "Clip6[0]", (1, 0, 0)),
    "a leaky relu that does not bend": (
        "drop identities",
        line(op.LeakyRelu(1.0), CLIP),
        "Clip6[0]",
        (1, 12, 0),
    ),
    "equal layers on one value": (
        "share equal",
        graph(
            (linear(4, 6), (0,)), (linear(4, 6), (0,)), (op.Tanh(), (2,)), (op.Add(), (1, 3)), (CLIP, (4,))
        ),
        "Linear4[0] Tanh4[1] Add4[1, 2] Clip4[3]",
        (1, 24, 4 * 28),
    ),
    "equal cells on one value": (
        "share equal",
        graph((gru(2, 6), (0,)), (gru(2, 6), (0,)), (op.Multiply(), (1, 2)), (CLIP, (3,))),
        "Gru2[0] Multiply2[1, 1] Clip2[2]",
        (1, 6 * 8 + 24, 4 * 6 * 10),
    ),
    "sums of the same two values": (
        "share equal",
        graph(
            (linear(4, 6), (0,)),
            (op.Tanh(), (1,)),
            (op.Add(), (1, 2)),
            (op.Add(), (2, 1)),
            (op.Multiply(), (3, 4)),
            (CLIP, (5,)),
        ),
        "Linear4[0] Tanh4[1] Add4[1, 2] Multiply4[3, 3] Clip4[4]",
        (1, 4, 0),
    ),
    "a slice of a slice": (
        "simplify slices",
        line(op.Slice(5, 5, -1), op.Slice(0, 2, 3), CLIP),
        "Slice2[0] Clip2[1]",
        (1, 0, 0),
    ),
    "a slice of a concat": (
        "simplify slices",
        graph((op.Tanh(), (0,)), (op.Concat(), (0, 1)), (op.Slice(7, 3), (2,)), (CLIP, (3,))),
        "Tanh6[0] Slice3[1] Clip3[2]",
        (1, 0, 0),
    ),
    "a concat of neighbouring slices": (
        "simplify slices",
        graph((op.Slice(1, 2), (0,)), (op.Slice(3, 3), (0,)), (op.Concat(), (1, 2)), (CLIP, (3,))),
        "Slice5[0] Clip5[1]",
        (2, 0, 0),
    ),
    "a concat of a concat": (
        "simplify slices",
        graph((op.Tanh(), (0,)), (op.Concat(), (0, 1)), (op.Concat(), (2, 1)), (CLIP, (3,))),
        "Tanh6[0] Concat18[0, 1, 1] Clip18[2]",
        (1, 0, 0),
    ),
    "a clip that tanh cannot reach": (
        "drop bounds",
        line(linear(4, 6), op.Tanh(), op.Clip(-1.0, 1.5), affine(4), CLIP),
        "Linear4[0] Tanh4[1] Affine4[2] Clip4[3]",
        (1, 4, 0),
    ),
    "a clip that weights keep a value within": (
        "drop bounds",
        line(
            op.Softsign(),
            op.Linear(np.full((2, 6), 0.5, np.float32), np.ones(2, np.float32)),
            op.Clip(-2.0, 4.0),
            op.Tanh(),
            CLIP,
        ),
        "Softsign6[0] Linear2[1] Tanh2[2] Clip2[3]",
        (1, 2, 0),
    ),
    "a clip after a cell": (
        "drop bounds",
        line(lstm(2, 6), op.Clip(-1.0, 1.0), op.Tanh(), CLIP),
        "Lstm2[0] Tanh2[1] Clip2[2]",
        (1, 2, 0),
    ),
    "a relu after a sigmoid": (
        "drop bounds",
        line(op.Sigmoid(), op.Relu(), op.Tanh(), CLIP),
        "Sigmoid6[0] Tanh6[1] Clip6[2]",
        (1, 6, 0),
    ),
    "an elu after a relu": (
        "drop bounds",
        line(op.Relu(), op.Elu(1.0), op.Tanh(), CLIP),
        "Relu6[0] Tanh6[1] Clip6[2]",
        (1, 18, 0),
    ),
    "a relu before a clip": (
        "drop bounds",
        line(op.Relu(), op.Clip(-1.0, 0.5), op.Tanh(), CLIP),
        "Clip6[0] Tanh6[1] Clip6[2]",
        (1, 6, 0),
    ),
    "a relu before the last clip": (
        "drop bounds",
        line(linear(4, 6), op.Relu(), CLIP),
        "Linear4[0] Clip4[1]",
        (1, 4, 0),
    ),
    "a relu twice, taken by another too": (
        "drop bounds",
        graph(
            (op.Relu(), (0,)),
            (op.Relu(), (1,)),
            (op.Tanh(), (2,)),
            (op.Clip(None, 0.5), (1,)),
            (op.Add(), (3, 4)),
            (CLIP, (5,)),
        ),
        "Relu6[0] Tanh6[1] Clip6[1] Add6[2, 3] Clip6[4]",
        (1, 6, 0),
    ),
    "clips that do not meet": (
        "drop bounds",
        line(op.Clip(-2.0, -1.0), op.Clip(0.25, 3.0), op.Tanh(), CLIP),
        "Clip6[0] Tanh6[1] Clip6[2]",
        (1, 6, 0),
    ),
    "a sigmoid between matrices": (
        "lower sigmoid",
        line(linear(8, 6), op.Sigmoid(), linear(4, 8), CLIP),
        "Linear8[0] Affine8[1] Tanh8[2] Affine8[3] Linear4[4] Clip4[5]",
        (-2, 0, -4 * 4 * 8),
    ),
    "affine maps in a row": (
        "merge affine",
        line(op.Tanh(), affine(6), affine(6, 3), CLIP),
        "Tanh6[0] Affine6[1] Clip6[2]",
        (1, 6, 48),
    ),
    "an affine map before a matrix": (
        "fold affine",
        line(affine(6), linear(4, 6), CLIP),
        "Linear4[0] Clip4[1]",
        (1, 6, 48),
    ),
    "an affine map after a matrix": (
        "fold affine",
        line(linear(4, 6), affine(4), CLIP),
        "Linear4[0] Clip4[1]",
        (1, 4, 32),
    ),
    "an affine map after a layer norm": (
        "fold affine",
        line(norm(6), affine(6), CLIP),
        "LayerNorm6[0] Clip6[1]",
        (1, 6, 48),
    ),
    "an affine map before a gru": (
        "fold affine",
        line(affine(6), gru(3, 6), CLIP),
        "Gru3[0] Clip3[1]",
        (1, 6, 48),
    ),
    "an affine map before an lstm": (
        "fold affine",
        line(affine(6), lstm(3, 6), CLIP),
        "Lstm3[0] Clip3[1]",
        (1, 6, 48),
    ),
    "an affine map before two matrices": (
        "fold affine",
        graph(
            (SHARED, (0,)),
            (linear(4, 6), (1,)),
            (linear(4, 6, 5), (1,)),
            (op.Multiply(), (2, 3)),
            (CLIP, (4,)),
        ),
        "Linear4[0] Linear4[0] Multiply4[1, 2] Clip4[3]",
        (1, 6, 48),
    ),
    "affine maps below a concat": (
        "move affine",
        graph(
            (op.Tanh(), (0,)), (affine(6), (1,)), (op.Concat(), (2, 0)), (linear(4, 12), (3,)), (CLIP, (4,))
        ),
        "Tanh6[0] Concat12[1, 0] Affine12[2] Linear4[3] Clip4[4]",
        (0, -6, -48),
    ),
    "an affine map above a concat": (
        "move affine",
        graph((linear(3, 6), (0,)), (norm(6), (0,)), (op.Concat(), (1, 2)), (affine(9), (3,)), (CLIP, (4,))),
        "Linear3[0] LayerNorm6[0] Affine3[1] Affine6[2] Concat9[3, 4] Clip9[5]",
        (-1, 0, 0),
    ),
    "an affine map below a slice": (
        "move affine",
        line(op.Tanh(), affine(6), op.Slice(1, 2), CLIP),
        "Tanh6[0] Slice2[1] Affine2[2] Clip2[3]",
        (0, 4, 32),
    ),
    "matrices in a row": (
        "merge linear",
        line(linear(20, 6), linear(4, 20), CLIP),
        "Linear4[0] Clip4[1]",
        (1, 20 * 6 + 4 * 20 - 4 * 6, 4 * (20 * 7 + 4 * 21 - 4 * 7)),
    ),
    "matrices that only pay together": (
        "merge linear",
        line(linear(1, 30), linear(30, 1), linear(1, 30), CLIP, inputs=30),
        "Linear1[0] Clip1[1]",
        (2, 60, 4 * 91),
    ),
    "a matrix before a cell": (
        "merge linear",
        line(linear(20, 6), lstm(2, 20), CLIP),
        "Lstm2[0] Clip2[1]",
        (1, 20 * 6 + 8 * 20 - 8 * 6, 4 * (20 * 7 + 8 * 20 - 8 * 6)),
    ),
    "matrices that are added": (
        "merge linear",
        graph((linear(4, 6), (0,)), (linear(4, 6, 5), (0,)), (op.Add(), (1, 2)), (CLIP, (3,))),
        "Linear4[0] Clip4[1]",
        (2, 24 + 4, 4 * 28),
    ),
    "matrices beside each other": (
        "merge linear",
        graph(
            (linear(1, 6), (0,)),
            (linear(3, 6, 5), (0,)),
            (op.Tanh(), (0,)),
            (op.Concat(), (1, 2, 3)),
            (CLIP, (4,)),
        ),
        "Tanh6[0] Linear4[0] Concat10[2, 1] Clip10[3]",
        (1, 0, 0),
    ),
}

# name of the pass, network that it must leave alone
RESTS: dict[str, tuple[str, Network]] = {
    "a relu that hardly opens": (
        "fold constants",
        line(
            op.Tanh(),
            op.Linear(np.full((8, 6), 0.2, np.float32), np.full(8, -1, np.float32)),
            op.Relu(),
            linear(4, 8),
            CLIP,
        ),
    ),
    "constants that no matrix takes": (
        "fold constants",
        line(fixed(linear(4, 6), 1), op.Tanh(), affine(4), CLIP),
    ),
    "an observed value that only zeros meet": ("drop unread", line(pruned(4, 6, 2, 3), CLIP)),
    "a unit of a cell that only zeros meet": ("drop unread", line(gru(3, 6), pruned(4, 3, 1), CLIP)),
    "a value of a layer norm that only zeros meet": ("drop unread", line(norm(6), pruned(4, 6, 1), CLIP)),
    "a row that another branch reads": (
        "drop unread",
        graph(
            (linear(6, 6), (0,)),
            (pruned(4, 6, 1), (1,)),
            (op.Slice(1, 4), (1,)),
            (op.Add(), (2, 3)),
            (pruned(4, 6, 0, 5), (1,)),
            (op.Add(), (4, 5)),
            (CLIP, (6,)),
        ),
    ),
    "an affine map of nearly one": (
        "drop identities",
        line(op.Affine(np.full(6, 1 + 1e-9), np.zeros(6)), CLIP),
    ),
    "a matrix that exchanges values": (
        "drop identities",
        line(op.Linear(np.eye(6, dtype=np.float32)[::-1].copy(), np.zeros(6, np.float32)), CLIP),
    ),
    "an identity that is the output": ("drop identities", line(op.Tanh(), op.Slice(0, 6))),
    "a slice that turns": ("drop identities", line(op.Slice(5, 6, -1), CLIP)),
    "a matrix of ones and zeros with a bias": (
        "drop identities",
        line(op.Linear(np.eye(6, dtype=np.float32), array(6)), CLIP),
    ),
    "values that are joined in another order": (
        "share equal",
        graph(
            (op.Tanh(), (0,)),
            (op.Concat(), (0, 1)),
            (op.Concat(), (1, 0)),
            (op.Multiply(), (2, 3)),
            (CLIP, (4,)),
        ),
    ),
    "layers of other weights": (
        "share equal",
        graph((linear(4, 6), (0,)), (linear(4, 6, 1), (0,)), (op.Add(), (1, 2)), (CLIP, (3,))),
    ),
    "equal layers on other values": (
        "share equal",
        graph(
            (op.Tanh(), (0,)), (linear(4, 6), (0,)), (linear(4, 6), (1,)), (op.Add(), (2, 3)), (CLIP, (4,))
        ),
    ),
    "a slice across a concat's seam": (
        "simplify slices",
        graph((op.Tanh(), (0,)), (op.Concat(), (0, 1)), (op.Slice(4, 4), (2,)), (CLIP, (3,))),
    ),
    "slices that exchange places": (
        "simplify slices",
        graph((op.Slice(3, 3), (0,)), (op.Slice(0, 3), (0,)), (op.Concat(), (1, 2)), (CLIP, (3,))),
    ),
    "neighbouring slices of two values": (
        "simplify slices",
        graph(
            (op.Tanh(), (0,)),
            (op.Slice(0, 3), (0,)),
            (op.Slice(3, 3), (1,)),
            (op.Concat(), (2, 3)),
            (CLIP, (4,)),
        ),
    ),
    "a clip above what a silu falls to": (
        "drop bounds",
        line(op.Silu(), op.Clip(-0.2, None), op.Tanh(), CLIP),
    ),
    "a clip within what a bent line reaches": (
        "drop bounds",
        line(op.Tanh(), op.LeakyRelu(-1.0), op.Clip(0.5, None), op.Tanh(), CLIP),
    ),
    "a clip that binds": ("drop bounds", line(op.Tanh(), op.Clip(-0.9, 0.9), op.Softsign(), CLIP)),
    "a last clip that cannot bind": ("drop bounds", line(op.Sigmoid(), CLIP)),
    "a last clip whose lower bound would move": (
        "drop bounds",
        line(linear(4, 6), op.Clip(0.25, 0.75), CLIP),
    ),
    "a relu that another takes too": (
        "drop bounds",
        graph((op.Relu(), (0,)), (op.Clip(None, 0.5), (1,)), (op.Add(), (1, 2)), (CLIP, (3,))),
    ),
    "a relu whose input may be negative": (
        "drop bounds",
        line(op.LeakyRelu(0.1), op.Relu(), op.Tanh(), CLIP),
    ),
    "an elu that turns negative to positive": (
        "drop bounds",
        line(op.Elu(-1.0), op.Clip(None, 5.0), op.Tanh(), CLIP),
    ),
    "a sigmoid before the last clip": ("lower sigmoid", line(linear(4, 6), op.Sigmoid(), CLIP)),
    "a sigmoid of the observation": ("lower sigmoid", line(op.Sigmoid(), linear(4, 6), CLIP)),
    "a sigmoid that is multiplied": (
        "lower sigmoid",
        graph(
            (linear(6, 6), (0,)),
            (op.Sigmoid(), (1,)),
            (op.Multiply(), (0, 2)),
            (linear(4, 6), (2,)),
            (linear(4, 6), (3,)),
            (op.Add(), (4, 5)),
            (CLIP, (6,)),
        ),
    ),
    "an affine map that another takes too": (
        "merge affine",
        graph((SHARED, (0,)), (affine(6, 4), (1,)), (op.Add(), (1, 2)), (CLIP, (3,))),
    ),
    "an affine map before a matrix and a tanh": (
        "fold affine",
        graph((SHARED, (0,)), (linear(6, 6), (1,)), (op.Tanh(), (1,)), (op.Add(), (2, 3)), (CLIP, (4,))),
    ),
    "an affine map before a matrix and a concat that stays": (
        "fold affine",
        graph(
            (SHARED, (0,)),
            (linear(12, 6), (1,)),
            (op.Concat(), (0, 1)),
            (op.Multiply(), (2, 3)),
            (CLIP, (4,)),
        ),
    ),
    "an affine map after a matrix that another takes": (
        "fold affine",
        graph((linear(4, 6), (0,)), (affine(4), (1,)), (op.Add(), (1, 2)), (CLIP, (3,))),
    ),
    "an affine map after a cell": ("fold affine", line(gru(4, 6), affine(4), CLIP)),
    "an affine map before a layer norm": ("fold affine", line(op.Tanh(), affine(6), norm(6), CLIP)),
    "an affine map that stays after the concat": (
        "move affine",
        graph((op.Tanh(), (0,)), (affine(6), (1,)), (op.Concat(), (2, 0)), (CLIP, (3,))),
    ),
    "an affine map before a slice and a tanh": (
        "move affine",
        graph((SHARED, (0,)), (op.Slice(0, 6), (1,)), (op.Tanh(), (1,)), (op.Add(), (2, 3)), (CLIP, (4,))),
    ),
    "matrices whose product costs more": (
        "merge linear",
        line(linear(1, 30), linear(30, 1), CLIP, inputs=30),
    ),
    "matrices with an activation between": (
        "merge linear",
        line(linear(8, 6), op.Tanh(), linear(4, 8), CLIP),
    ),
    "a matrix that another takes too": (
        "merge linear",
        graph((linear(4, 6), (0,)), (linear(4, 4), (1,)), (op.Add(), (1, 2)), (CLIP, (3,))),
    ),
    "matrices of other values beside each other": (
        "merge linear",
        graph(
            (op.Tanh(), (0,)), (linear(4, 6), (0,)), (linear(4, 6), (1,)), (op.Concat(), (2, 3)), (CLIP, (4,))
        ),
    ),
    "matrices of other values that are added": (
        "merge linear",
        graph(
            (op.Tanh(), (0,)), (linear(4, 6), (0,)), (linear(4, 6), (1,)), (op.Add(), (2, 3)), (CLIP, (4,))
        ),
    ),
}


@pytest.mark.parametrize("name", FIRES)
def test_pass_saves_and_keeps_the_values_when_it_finds(name: str) -> None:
    step, before, expected, saved = FIRES[name]
    after = RUN[step](before)
    assert written(after) == expected
    less, now = astuple(size(before)), astuple(size(after))
    assert tuple(a - b for a, b in zip(less, now, strict=True)) == saved
    check_equivalence(before, after, step)
    observation = np.random.default_rng(9).normal(size=(60, before.inputs)).astype(np.float32)
    np.testing.assert_allclose(replay(after, observation), replay(before, observation), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", FIRES)
def test_pass_finds_nothing_more_when_it_runs_again(name: str) -> None:
    step, before, _, _ = FIRES[name]
    after = RUN[step](before)
    assert RUN[step](after) is after


@pytest.mark.parametrize("name", RESTS)
def test_pass_leaves_the_network_alone_when_it_meets(name: str) -> None:
    step, network = RESTS[name]
    assert RUN[step](network) is network


def test_units_are_dropped_when_they_cannot_vary() -> None:
    """Two have no weights, and a ReLU cannot open: 5 of 8 are left."""
    closed = fixed(linear(8, 6), 0, 7)
    closed.bias[3] = -1.1 * np.abs(closed.weight[3]).sum()
    network = line(op.Tanh(), closed, op.Relu(), linear(4, 8), CLIP)
    shorter, savings = optimize(network, prove=True)
    assert written(shorter) == "Tanh6[0] Linear5[1] Relu5[2] Linear4[3] Clip4[4]"
    assert [saving.rewrite for saving in savings] == ["drop unread", "fold constants"]


def test_savings_add_up_when_several_passes_run() -> None:
    network = line(affine(6), linear(8, 6), op.Sigmoid(), linear(20, 8), linear(4, 20), op.Relu(), CLIP)
    shorter, savings = optimize(network)
    assert written(shorter) == "Linear8[0] Tanh8[1] Linear4[2] Clip4[3]"
    assert [saving.rewrite for saving in savings] == [
        "drop bounds",
        "lower sigmoid",
        "fold affine",
        "merge linear",
    ]
    sums = (sum(s.nodes for s in savings), sum(s.operations for s in savings), sum(s.bytes for s in savings))
    assert sums == tuple(a - b for a, b in zip(astuple(size(network)), astuple(size(shorter)), strict=True))


def test_every_run_of_a_pass_is_proven_when_asked() -> None:
    network = line(affine(6), linear(8, 6), op.Sigmoid(), linear(4, 8), CLIP)
    shorter, savings = optimize(network, prove=True)
    proofs = {saving.rewrite: saving.proof for saving in savings}
    assert proofs.keys() == {"lower sigmoid", "fold affine"}
    assert all(
        proof is not None and proof.unit <= proof.bound and proof.observations > 0
        for proof in proofs.values()
    )
    assert written(optimize(network)[0]) == written(shorter)


def test_same_network_comes_out_when_it_is_optimized_twice() -> None:
    network = FIRES["an affine map before two matrices"][1]
    (one, _), (other, _) = optimize(network), optimize(network)
    for a, b in zip(one.nodes, other.nodes, strict=True):
        assert a.inputs == b.inputs
        if isinstance(a.operation, op.Linear) and isinstance(b.operation, op.Linear):
            np.testing.assert_array_equal(a.operation.weight, b.operation.weight)


def test_names_of_nodes_survive_when_they_are_folded() -> None:
    nodes = (Node(affine(6), (0,), "scale"), Node(linear(4, 6), (1,), "hidden"), Node(CLIP, (2,), "clip"))
    assert [node.name for node in optimize(Network(6, nodes))[0].nodes] == ["hidden", "clip"]


@pytest.mark.parametrize("after", [(linear(4, 6),), ()], ids=["into a matrix", "left alone"])
def test_policy_is_refused_when_folding_leaves_float32(after: tuple[op.Operation, ...]) -> None:
    large = op.Affine(np.full(6, 1e30), np.zeros(6))
    with pytest.raises(PolicyError, match="expected values of float32's range"):
        optimize(line(large, large, *after, CLIP))


def test_saving_is_told_when_a_pass_prepares_another() -> None:
    _, savings = optimize(line(linear(8, 6), op.Sigmoid(), linear(4, 8), CLIP))
    assert savings == (Saving("lower sigmoid", -2, 0, -128), Saving("fold affine", 2, 16, 128))
