"""The output that each motor of a Betaflight quadcopter is wired to, by the pins of the board's outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

MOTORS = (
    4  # of Betaflight's QUADX, whose order is this project's: rear right, front right, rear left, front left
)
NO_PIN = "NONE"


def motor_outputs(own: Sequence[str], pins: Mapping[int, str], order: Sequence[int]) -> list[int]:
    """Return the output of each motor. Raises ValueError, one line, unless they are the first four.

    own: pins of the board's outputs 1, 2, ..., as C06. pins: from the `resource MOTOR` lines, by motor from
    1. order: Betaflight's motor_output_reordering.
    """
    wired = [pins.get(motor, own[motor - 1]) for motor in range(1, MOTORS + 1)]
    if sorted(order[:MOTORS]) != list(range(MOTORS)):
        raise ValueError(f"motor_output_reordering names others than the first {MOTORS} motors")
    used = [wired[place] for place in order[:MOTORS]]
    outputs = [own.index(pin) + 1 if pin in own else 0 for pin in used]
    if sorted(outputs) != list(range(1, MOTORS + 1)):
        firsts = ", ".join(own[:MOTORS])
        raise ValueError(
            f"the motors are on {', '.join(used)}, and four motors here are on the outputs 1 to 4, {firsts}; "
            "rewire them, then `neuroflight board motors order`"
        )
    return outputs


def read_pin(word: str) -> str:
    """Return a pin as Betaflight writes it: C09, also if given as PC9."""
    word = word.upper()
    if word == NO_PIN:
        return word
    word = word.removeprefix("P") if len(word) > 2 and word[1].isalpha() else word
    return f"{word[0]}{word[1:].zfill(2)}"
