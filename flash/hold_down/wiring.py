"""The rotor that each output turns, its direction and its push, from what the aircraft does by it.

A rotor in another corner, one that pushes down and one that turns the other way are told apart by which of
the explanations that fit is the most usual one: `_FAULTS`, from what pilots do when they build. Where two
that mean different things are about as usual, both are returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from neuroflight.flash.hold_down.reaction import Array, Reaction

SURE = 5.0  # standard deviations of a push, or of its distance to what another corner's would be
SAME = 0.95  # cosine between the turns of two corners that are not told apart by it: rotors on one arm
NOTHING = 0.15  # of the other motors' pushes: less is a motor that does nothing
# How seldom it is, in units of the mismatch 1 - cos between the axis about which the aircraft turns and the
# one about which it should: another corner of a square is 1 off, the opposite one 2.
_MOVED = 0.05
_FAULTS = {  # (pushes, turns the right way)
    (1, True): 0.0,
    (-1, False): 0.3,  # the motor turns the wrong way for its propeller
    (1, False): 0.5,  # motor and propeller are both of the other way
    (-1, True): 0.6,  # a propeller of the other way on a motor that turns right
}
_ALL_OTHER = 0.3  # all motors alike: props out instead of in
_ALL_WRONG = 0.4  # all motors turned around, the propellers not
_KEPT = 50  # explanations that are looked at
_APART = 0.15  # two explanations closer than that are both told, if other rotors push down in them


@dataclass(frozen=True, eq=False)
class Layout:
    """The motors of an aircraft, as its policy knows them, in motor order."""

    arms: Array  # (M, 2) [m] forward and left of the centre of mass
    spins: Array  # (M,): 1 counter-clockwise seen from above, -1 clockwise


@dataclass(frozen=True)
class Rotor:
    """The rotor that one motor's output turns."""

    place: int  # index of the motor whose corner it is in
    pushes: int  # 1 up, -1 down
    right_way: bool | None  # it turns as the motor of that place should; None: not known


@dataclass(frozen=True)
class Wiring:
    """The outcome of a check."""

    rotors: tuple[Rotor | None, ...]  # motor order; None: it does nothing, or too little to say
    unsure: tuple[str | None, ...]  # motor order: axes about which the push is too small to tell; None: sure
    nothing: tuple[bool, ...]  # motor order: it does nothing while others do
    instead: tuple[Rotor | None, ...] | None = None  # another explanation that is about as likely

    @property
    def right(self) -> bool:
        """True if every motor is in its place, pushes up and turns the right way."""
        return all(rotor == Rotor(i, 1, True) for i, rotor in enumerate(self.rotors))


def find_wiring(layout: Layout, reactions: Sequence[Reaction]) -> Wiring:
    """Explain the reactions of all motors, at most eight."""
    sure = np.array([each.sureness for each in reactions])
    size = np.array([np.hypot(*each.push[:2]) for each in reactions])
    seen = np.hypot(sure[:, 0], sure[:, 1]) > SURE
    nothing = ~seen & (size < NOTHING * np.median(size[seen])) if seen.any() else np.zeros(len(size), bool)
    expected, pushed = _directions(layout), _scaled(np.array([each.push[:2] for each in reactions]), seen)
    unsure = [_unsure(i, expected, pushed, reactions, bool(nothing[i])) for i in range(len(reactions))]
    told = [i for i in range(len(reactions)) if not nothing[i] and unsure[i] in (None, "yaw")]
    if not told:
        return Wiring((None,) * len(size), tuple(unsure), tuple(map(bool, nothing)))
    ways = [int(-np.sign(sure[i, 2])) if abs(sure[i, 2]) > SURE else 0 for i in range(len(reactions))]
    found = _explanations(layout, expected, pushed, ways, told)
    best = found[0][1]
    near = [
        rotors for cost, rotors in found[1:] if cost < found[0][0] + _APART and _down(rotors) != _down(best)
    ]
    return Wiring(best, tuple(unsure), tuple(map(bool, nothing)), near[0] if near else None)


def _down(rotors: Sequence[Rotor | None]) -> set[int]:
    """Return the places of the rotors that push down."""
    return {rotor.place for rotor in rotors if rotor is not None and rotor.pushes < 0}


def _directions(layout: Layout) -> Array:
    """Return the push about roll and pitch by each motor, of mean square 1 about each axis, (M, 2)."""
    forward, left = layout.arms.T
    pushes = np.stack([left, -forward], axis=1)
    return np.asarray(pushes / np.maximum(np.sqrt((pushes**2).mean(axis=0)), 1e-9))


def _scaled(pushed: Array, seen: Array) -> Array:
    """Return the same with mean square 1 about each axis: a mount may be stiffer about one of them."""
    counted = pushed[seen] if seen.any() else pushed
    return np.asarray(pushed / np.maximum(np.sqrt((counted**2).mean(axis=0)), 1e-12))


def _cosine(one: Array, other: Array) -> float:
    return float(one @ other) / max(float(np.linalg.norm(one)) * float(np.linalg.norm(other)), 1e-12)


def _unsure(
    motor: int, expected: Array, pushed: Array, reactions: Sequence[Reaction], nothing: bool
) -> str | None:
    """Return the axes about which a motor's push cannot be told; None: there are none."""
    if nothing:
        return None
    reaction = reactions[motor]
    scale = np.abs(pushed[motor]) / np.maximum(np.abs(reaction.push[:2]), 1e-15)
    spread = float(np.linalg.norm(reaction.error[:2] * scale)) / np.sqrt(2.0)
    units = [sign * each / np.linalg.norm(each) for each in expected for sign in (1, -1)]
    best = max(units, key=lambda unit: float(pushed[motor] @ unit))
    others = [unit for unit in units if _cosine(unit, best) < SAME]
    distances = [float(pushed[motor] @ (best - unit)) / float(np.linalg.norm(best - unit)) for unit in others]
    told = [] if min(distances) > SURE * spread else ["roll and pitch"]
    return " and ".join(told + ([] if abs(reaction.sureness[2]) > SURE else ["yaw"])) or None


def _explanations(
    layout: Layout, expected: Array, pushed: Array, ways: Sequence[int], told: Sequence[int]
) -> list[tuple[float, tuple[Rotor | None, ...]]]:
    """Return (cost, rotors) of the likeliest explanations of what the motors of `told` do, by their cost."""
    count = len(pushed)
    fit = np.array([[_cosine(pushed[i], expected[p]) for p in range(count)] for i in range(count)])
    wrong = np.array([[ways[i] == -layout.spins[p] for p in range(count)] for i in range(count)])
    fault = {push: np.where(wrong, _FAULTS[push, False], _FAULTS[push, True]) for push in (1, -1)}
    up, down = 1.0 - fit + fault[1], 1.0 + fit + fault[-1]
    kinds = [  # cost of each motor in each place, whether it pushes up there, cost of them all
        (np.minimum(up, down), up <= down, 0.0),
        (np.where(wrong, 1.0 - fit, np.inf), np.full_like(wrong, True), _ALL_OTHER),
        (np.where(wrong, 1.0 + fit, np.inf), np.full_like(wrong, False), _ALL_WRONG),
    ]
    orders = np.array(list(permutations(range(count))))
    found = []
    for costs, ups, all_of_them in kinds:
        whole = _MOVED * (orders != np.arange(count))[:, told].sum(axis=1) + all_of_them
        whole = whole + sum(costs[i, orders[:, i]] for i in told)
        for order in np.argsort(whole, kind="stable")[:_KEPT]:
            rotors: list[Rotor | None] = [None] * count
            for i in told:
                place = int(orders[order, i])
                right = None if ways[i] == 0 else not wrong[i, place]
                rotors[i] = Rotor(place, 1 if ups[i, place] else -1, right)
            found.append((float(whole[order]), tuple(rotors)))
    return sorted(found, key=lambda each: each[0])
