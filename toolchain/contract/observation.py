"""The observation of a policy: blocks, low-passed and delayed terms of them, and their limits."""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from enum import IntEnum


class Width(IntEnum):
    """The width of a block: a fixed count, or one value a motor."""

    SCALAR = 1
    AXES = 3
    MOTORS = 0


@dataclass(frozen=True)
class ObservationBlock:
    """A named quantity known in a control step."""

    name: str
    code: int
    width: Width
    unit: str
    meaning: str
    in_firmware: bool = True  # the firmware has a source for it

    def count(self, motors: int) -> int:
        """Return the number of float32 values of this block on an aircraft with `motors` motors."""
        return motors if self.width is Width.MOTORS else int(self.width)


OBSERVATION_BLOCKS = (
    ObservationBlock("rate", 1, Width.AXES, "rad/s", "gyro, body axes"),
    ObservationBlock("rate_error", 2, Width.AXES, "rad/s", "setpoint - gyro"),
    ObservationBlock("rate_error_delta", 3, Width.AXES, "rad/s", "rate_error - that of the step before"),
    ObservationBlock("rate_error_integral", 4, Width.AXES, "rad", "sum of rate_error dt, clamped"),
    ObservationBlock("previous_action", 5, Width.MOTORS, "1", "the policy's last output"),
    ObservationBlock("throttle", 6, Width.SCALAR, "1", "the pilot's thrust, 0..1"),
    ObservationBlock("rotor_speed", 7, Width.MOTORS, "rad/s", "as the motors' ESCs tell it"),
    ObservationBlock("gravity", 8, Width.AXES, "1", "where down is, body axes", in_firmware=False),
    ObservationBlock(
        "previous_motors",
        9,
        Width.MOTORS,
        "1",
        "the last motor fractions, before the idle, less the throttle",
    ),
    ObservationBlock("rotor_estimate", 10, Width.MOTORS, "rad/s", "modelled speed less that at rest"),
    ObservationBlock("rate_estimate", 11, Width.AXES, "rad/s", "predicted by the model, corrected by gyro"),
    ObservationBlock("rate_estimate_error", 12, Width.AXES, "rad/s", "setpoint - rate_estimate"),
    # With it among the terms the model's rotors are the measured ones: rate_estimate is predicted from them.
    ObservationBlock("rotor_measured", 13, Width.MOTORS, "rad/s", "ESCs' speed less that at rest"),
)
# Made by a model of the aircraft.
MODEL_BLOCKS = ("rotor_estimate", "rate_estimate", "rate_estimate_error", "rotor_measured")
ESC_BLOCKS = frozenset({"rotor_speed", "rotor_measured"})  # made of what ESCs tell
RATE_ERROR_INTEGRAL_LIMIT_RAD = 0.6
OBSERVATION_COUNT_MAX = 64
OBSERVATION_TERMS_MAX = 32
OBSERVATION_AGE_MAX = 16  # control steps
ESTIMATOR_DELAY_MAX = 8  # control steps from output to rotor that a model of an aircraft may have
MODEL_NUMBER_MAX = 1e9  # largest number of such a model; as a limit of change it means no limit
ESTIMATOR_CORRECTION_HZ = 10.0  # of the gyro on the predicted rate
OBSERVATION_MEMORY_MAX = 256  # floats kept between steps by all terms: 1 KiB of DTCM
POLICY_WEIGHT_COUNT_MAX = 12288  # 48 KiB of DTCM
POLICY_MEMORY_COUNT_MAX = 640  # floats of scratch and recurrent state together: 2.5 KiB of DTCM


@dataclass(frozen=True)
class ObservationTerm:
    """A block as a policy observes it: perhaps low-passed, then perhaps some steps old.

    Low-pass of cutoff f at the control rate r: y += a (x - y), a = float32(1 - exp(-2 pi f / r)), all in
    float32; the first step after a reset gives y = x. Age k: what this was k steps ago, 0 from before the
    reset.
    """

    block: ObservationBlock
    cutoff_hz: float | None = None
    age: int = 0  # control steps

    @property
    def name(self) -> str:
        """The block's."""
        return self.block.name

    @property
    def unit(self) -> str:
        """The block's."""
        return self.block.unit

    @property
    def text(self) -> str:
        """Text in a policy's metadata: NAME[~fHz][@k]."""
        cutoff = "" if self.cutoff_hz is None else f"~{self.cutoff_hz!r}".removesuffix(".0") + "Hz"
        return f"{self.name}{cutoff}" + (f"@{self.age}" if self.age else "")

    def count(self, motors: int) -> int:
        """Return the number of float32 values on an aircraft with `motors` motors."""
        return self.block.count(motors)

    def memory(self, motors: int) -> int:
        """Return the number of float32 values kept between steps: the low-pass's and the delayed ones."""
        return self.count(motors) * (self.age + (self.cutoff_hz is not None))

    def gain(self, control_rate_hz: int) -> float:
        """Return the low-pass's coefficient a, 0 < a < 1, exactly a float32; 0 for a term without one."""
        if self.cutoff_hz is None:
            return 0.0
        (gain,) = struct.unpack(
            "<f", struct.pack("<f", -math.expm1(-math.tau * self.cutoff_hz / control_rate_hz))
        )
        return float(gain)


SHOWN_MAX = 60  # characters of what a user wrote, in a message
_TERM = re.compile(
    r"(?P<name>[a-z_]+)(?:~(?P<cutoff>[0-9]{1,4}(?:\.[0-9]{1,3})?)Hz)?(?:@(?P<age>[0-9]{1,3}))?"
)


def observation_blocks(text: str) -> tuple[ObservationTerm, ...]:
    """Parse the terms in the comma-separated `text`. Raises ValueError, one line, for an unknown one."""
    return tuple(_observation_term(term) for term in text.split(","))


def _shown(text: str) -> str:
    """Quote a user's text for a message: one line, not too long."""
    return repr(text if len(text) <= SHOWN_MAX else f"{text[: SHOWN_MAX - 3]}...")


def _observation_term(text: str) -> ObservationTerm:
    known = {block.name: block for block in OBSERVATION_BLOCKS}
    found = _TERM.fullmatch(text)
    name = found["name"] if found else re.split("[~@]", text)[0]
    if name not in known:
        raise ValueError(f"unknown observation block {_shown(name)}, known are {', '.join(known)}")
    if not found:
        raise ValueError(
            f"observation {_shown(text)}, expected NAME, NAME~fHz, NAME@k or NAME~fHz@k, e.g. rate~15Hz@1"
        )
    cutoff, age = found["cutoff"], found["age"]
    if cutoff is not None and float(cutoff) == 0.0:
        raise ValueError(f"observation {text!r}: a low-pass at 0 Hz, expected more")
    if age is not None and not 1 <= int(age) <= OBSERVATION_AGE_MAX:
        raise ValueError(f"observation {text!r}: {int(age)} steps old, expected 1 to {OBSERVATION_AGE_MAX}")
    return ObservationTerm(known[name], None if cutoff is None else float(cutoff), int(age or 0))


def needs_model(terms: tuple[ObservationTerm, ...]) -> bool:
    """Return True if a policy that observes `terms` needs the constants of a model of its aircraft."""
    return any(term.name in MODEL_BLOCKS for term in terms)


def welcomes_model(terms: tuple[ObservationTerm, ...]) -> bool:
    """Return True if the firmware takes what an ESC does not tell from a model, if the policy has one."""
    return hears_rotors(terms)


def hears_rotors(terms: tuple[ObservationTerm, ...]) -> bool:
    """Return True if a policy that observes `terms` sees what ESCs tell."""
    return any(term.name in ESC_BLOCKS for term in terms)


def measures_rotors(terms: tuple[ObservationTerm, ...]) -> bool:
    """Return True if the rotors of the model of a policy that observes `terms` are the measured ones."""
    return any(term.name == "rotor_measured" for term in terms)


def observation_count(terms: tuple[ObservationTerm, ...], motors: int) -> int:
    """Return the width of the policy's input."""
    return sum(term.count(motors) for term in terms)


def observation_memory(terms: tuple[ObservationTerm, ...], motors: int) -> int:
    """Return the number of floats that these terms keep from step to step."""
    return sum(term.memory(motors) for term in terms)


def check_cutoffs(terms: tuple[ObservationTerm, ...], control_rate_hz: int) -> None:
    """Raise ValueError, one line, for a low-pass that is impossible at this control rate."""
    for term in terms:
        if term.cutoff_hz is not None and not term.cutoff_hz < control_rate_hz / 2:
            raise ValueError(
                f"observation {term.text!r}: a low-pass at {term.cutoff_hz:g} Hz, expected below "
                f"{control_rate_hz / 2:g} Hz, half the control rate"
            )


def check_observation(terms: tuple[ObservationTerm, ...], motors: int) -> None:
    """Raise ValueError, one line, naming the first limit of an observation that is exceeded."""
    for count, most, what in (
        (len(terms), OBSERVATION_TERMS_MAX, "has {} terms"),
        (observation_count(terms, motors), OBSERVATION_COUNT_MAX, "has {} values"),
        (observation_memory(terms, motors), OBSERVATION_MEMORY_MAX, "remembers {} values"),
    ):
        if count > most:
            raise ValueError(f"the observation {what.format(count)}, expected at most {most}; leave some out")
