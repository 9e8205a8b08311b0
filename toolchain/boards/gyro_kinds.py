"""The gyro chips that a board may carry, by the words of configurations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from neuroflight.toolchain.contract import GYROS_NOT_FLOWN, GyroChip

NOT_FLOWN = {chip.name: why for chip, why in GYROS_NOT_FLOWN.items()}
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


def check_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return names of chips, in capitals. Raises ValueError for one that the firmware does not know."""
    named = tuple(kind.upper() for kind in kinds)
    for kind in named:
        if kind not in GyroChip.__members__:
            raise ValueError(f"{kind[:60]!r}, expected one of {', '.join(GyroChip.__members__)}")
    return named
