"""The wiring of motors to outputs, from the motors that turned, as settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from neuroflight.toolchain.errors import LinkError


def outputs_of(outputs: Sequence[int], turned: Sequence[int]) -> tuple[int, ...]:
    """Return the output of each motor, motor order, from 1.

    outputs: the assumed output of each motor; turned[i]: index of the motor that turned when motor i was to
    turn. \\ Raises LinkError if `turned` is no permutation: two answers name the same motor.
    """
    if sorted(turned) != list(range(len(outputs))):
        told = ", ".join(str(motor + 1) for motor in turned)
        raise LinkError(
            f"motors that turned: got {told}, expected each of 1 to {len(outputs)} once; nothing is set; "
            "look again, and check that no two ESCs share a signal wire"
        )
    found = [0] * len(outputs)
    for believed, motor in enumerate(turned):
        found[motor] = outputs[believed]
    return tuple(found)


def order_changes(before: Sequence[int], after: Sequence[int]) -> Mapping[str, float]:
    """Return the settings to change, by name."""
    pairs = enumerate(zip(before, after, strict=True), 1)
    return {f"motor{number}_output": float(new) for number, (old, new) in pairs if old != new}
