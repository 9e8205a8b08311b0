"""The gyro chips that a board may carry, by the words of configurations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from neuroflight.toolchain.contract import GYRO_FILES, GyroChip

FILES = {chip.name: file for chip, file in GYRO_FILES.items()}  # that some measure only with
# Drivers of Betaflight's, which a configuration names, and what makers fit because these take it as well.
_KIN = {
    "MPU6500": {"MPU9250", "ICM20601", "ICM20602", "ICM20608G"},
    "ICM42688P": {"ICM42605"},
}


def with_kin(told: Iterable[str]) -> tuple[str, ...]:
    """Return the chips that boards may carry whose configuration tells these, in the firmware's order.

    A configuration that names any of a driver's chips beside it names all that there are.
    """
    named = set(told)
    for driver, kin in _KIN.items():
        if driver in named and named.isdisjoint(kin):
            named |= kin
    return tuple(chip.name for chip in GyroChip if chip.name in named)


def with_known_turn(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return those of a board's chips for which the turn that its configuration tells is theirs.

    A BMI270's axes lie a quarter turn from its neighbours' on the same pads, and configurations with both
    tell one turn: whose it is, nobody says (Betaflight turns the BMI270 of some boards by itself).
    """
    return tuple(kind for kind in kinds if kind != GyroChip.BMI270.name or len(kinds) == 1)


def check_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return names of chips, in capitals. Raises ValueError for one that the firmware does not know."""
    named = tuple(kind.upper() for kind in kinds)
    for kind in named:
        if kind not in GyroChip.__members__:
            raise ValueError(f"{kind[:60]!r}, expected one of {', '.join(GyroChip.__members__)}")
    return named
