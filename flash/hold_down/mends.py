"""The faults that a check found, in words, and the settings or the work that mend them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from neuroflight.flash.board.turn import BOARD_AXES, Axes
from neuroflight.flash.hold_down.nose import mended_turn
from neuroflight.flash.hold_down.reaction import Reaction
from neuroflight.flash.hold_down.wiring import Rotor, Wiring
from neuroflight.flash.motors.order import order_changes, outputs_of
from neuroflight.toolchain.errors import LinkError

LEVEL: Axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
TURNS = {1: "counter-clockwise", -1: "clockwise"}


@dataclass(frozen=True)
class Mend:
    """A fault in words, and the settings that mend it, or what else does."""

    fault: str
    settings: Mapping[str, float]
    do: str = ""  # where no setting mends it


def gyro_mends(seen: Axes, set_deg: Sequence[float]) -> list[Mend]:
    """Return what mends a gyro that is turned otherwise than set; nothing where it is right.

    seen: nose.seen_turn; set_deg: board_roll_deg and its like.
    """
    if [list(row) for row in seen] == LEVEL:
        return []
    mended = mended_turn(seen, set_deg)
    changes = {
        f"board_{axis}_deg": after
        for axis, before, after in zip(BOARD_AXES, set_deg, mended, strict=True)
        if before != after
    }
    said = ["nose", "left side", "top"]
    is_seen = [
        f"its {said[row]} is taken for its {_direction(seen[row])}"
        for row in range(3)
        if list(seen[row]) != LEVEL[row]
    ]
    return [Mend(f"the gyro sits in the aircraft otherwise than set: {', '.join(is_seen)}", changes)]


def motor_mends(
    wiring: Wiring, found: Sequence[Reaction], outputs: Sequence[int], where: Sequence[str], *, reversed: bool
) -> list[Mend]:
    """Return what mends the motors; nothing where each is right, or something is not sure.

    outputs: that the motors are set to, from 1; where: the place of each motor in words; reversed: the
    setting motors_reversed, by which `wiring` was found.
    """
    if any(wiring.unsure):  # one motor's place depends on all the others'
        return []
    mends: list[Mend] = []
    rotors = wiring.rotors
    for i, rotor in enumerate(rotors):
        if rotor is not None and rotor.place != i:
            turned = f"output {outputs[i]} turns the {where[rotor.place]} rotor"
            mends.append(Mend(f"motor {i + 1} should be {where[i]}: {turned}", {}))
    if mends:
        mends.append(_order(rotors, outputs))
    known = [rotor for rotor in rotors if rotor is not None]
    if known and len(known) == len(rotors) and all(r.right_way is False and r.pushes > 0 for r in known):
        mends.append(
            Mend(
                f"all motors turn the other way than set: propellers {'in' if reversed else 'out'}",
                {"motors_reversed": float(not reversed)},
            )
        )
    else:
        mends += [mend for rotor in known for mend in _rotor(rotor, where, rotors.index(rotor))]
    mends += [_nothing(i, found[i], where[i]) for i, dead in enumerate(wiring.nothing) if dead]
    return mends


def _order(rotors: Sequence[Rotor | None], outputs: Sequence[int]) -> Mend:
    """Return the settings that put all motors in their places."""
    if any(rotor is not None and rotor.pushes < 0 and rotor.right_way is not False for rotor in rotors):
        # One that pushes down does as the one in the opposite corner, which turns the same way.
        return Mend(
            "", {}, "mend the rotor that pushes down first, then check again: the order is not sure yet"
        )
    try:
        turned = [-1 if rotor is None else rotor.place for rotor in rotors]
        return Mend("", order_changes(outputs, outputs_of(outputs, turned)))
    except LinkError:
        return Mend("", {}, "mend the motors that do nothing first, then check again")


def _rotor(rotor: Rotor, where: Sequence[str], motor: int) -> list[Mend]:
    """Return what mends the direction of one rotor, or its propeller."""
    place = where[rotor.place]
    turn = (
        f"swap two of its motor's wires, or `neuroflight board motors direction {motor + 1} reversed --save` "
        "(normal where it is reversed now)"
    )
    if rotor.pushes < 0 and rotor.right_way is False:
        return [Mend(f"the {place} rotor turns the wrong way and pushes down", {}, turn)]
    if rotor.pushes < 0:
        return [
            Mend(
                f"the {place} rotor pushes down, its motor turns "
                f"{'the right way' if rotor.right_way else 'either way'}",
                {},
                "fit a propeller of the other direction",
            )
        ]
    if rotor.right_way is False:
        return [
            Mend(
                f"the {place} rotor turns the wrong way, with a propeller of that way",
                {},
                f"{turn}, and fit a propeller of the other direction",
            )
        ]
    return []


def _nothing(motor: int, found: Reaction, where: str) -> Mend:
    """Return what to look for where a motor does nothing."""
    if found.rpm:
        told = f"its ESC tells {found.rpm:.0f} rpm: is its propeller on and tight?"
    elif found.rpm is not None:
        told = "its ESC answers that it stands: look at the motor and its three wires"
    else:
        told = "look at its ESC, its wires and its propeller"
    return Mend(f"motor {motor + 1}, {where}, does nothing", {}, told)


def _direction(row: Sequence[float]) -> str:
    """Return the side of the firmware's aircraft that a row of axes points to."""
    names = (("nose", "tail"), ("left side", "right side"), ("top", "bottom"))
    axis = max(range(3), key=lambda i: abs(row[i]))
    return names[axis][row[axis] < 0]
