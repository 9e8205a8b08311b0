"""Changes of an aircraft since its file, by a fit of a later flight, and what may have done them.

A change counts where the fit tells the number, its interval, widened to three standard deviations and by
that of the file's own mark, leaves the file's number out, and the difference is one that a policy feels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.identification.fit.result import Fit, Parameter
from neuroflight.sim.identification.sag import Sag
from neuroflight.toolchain.contract import AXES

WIDER = 1.5  # times the interval's half: of a dozen numbers of an unchanged aircraft one in 30 logs is beyond
RELATIVE = {"authority": 0.05, "response": 0.08, "kick": 0.15, "drag": 0.4, "speed_max": 0.03}  # least
DELAY_S = 5e-4  # likewise, [s]
MOTOR = 0.04  # of the mean thrust
NOISIER = 1.6  # times the file's noise of the gyro
STEADY_M = 2.5e-3  # [m] that the centre of mass moved; twice that beside a weak motor, which is alike
RESISTANCE = 0.25  # of the pack's
SIDES = {"x": ("forward", "back"), "y": ("left", "right")}
# [known] of the file that tells how sure its own number is.
MARKS = {
    "response.up_s": "propulsion.response.time_constant_up_s",
    "response.down_s": "propulsion.response.time_constant_down_s",
    "delay_s": "propulsion.delay_s",
}


@dataclass(frozen=True)
class Change:
    """A number that is another one than the file says."""

    key: str  # as of the fit's parameters
    words: str
    unit: str
    before: float
    after: float
    low: float  # the 95 % interval of `after`
    high: float

    @property
    def ratio(self) -> float:
        """The number over the file's."""
        return self.after / self.before

    def document(self) -> dict[str, Any]:
        """Return it as JSON data."""
        return {"before": self.before, "after": self.after, "range": [self.low, self.high], "unit": self.unit}


@dataclass(frozen=True)
class Changes:
    """All that changed, by key, and in a pilot's words what it may be."""

    numbers: Mapping[str, Change]
    causes: tuple[str, ...]
    strengths: tuple[float, ...]  # thrust of each motor over that of the others; 1 where it is the file's

    def __bool__(self) -> bool:
        """Return True if anything changed."""
        return bool(self.causes)

    @property
    def uneven(self) -> bool:
        """True if a motor became weaker or stronger than the others, which no aircraft file tells."""
        return any(each != 1.0 for each in self.strengths)

    def document(self) -> dict[str, Any]:
        """Return them as JSON data."""
        return {
            "numbers": {key: each.document() for key, each in self.numbers.items()},
            "causes": list(self.causes),
            "motor_thrust": list(self.strengths),
        }


def find_changes(fit: Fit, aircraft: Aircraft, sag: Sag | None = None) -> Changes:
    """Compare a fit with the aircraft file that it began with. sag: of the flights' battery."""
    numbers = {each.key: each for each in _numbers(fit, aircraft, sag)}
    strengths = _strengths(fit, aircraft)
    causes = tuple(_causes(fit, numbers, strengths, sag, aircraft))
    return Changes(numbers, causes, strengths)


def _numbers(fit: Fit, aircraft: Aircraft, sag: Sag | None) -> Iterator[Change]:
    for one in fit.parameters.values():
        kind = one.key.partition(".")[0]
        if not one.told:
            continue
        if (least := RELATIVE.get(kind)) is not None and one.value > 0.0 and one.start > 0.0:
            sigma = math.log(one.high / one.low) / 2.0 if one.low > 0.0 else math.inf
            if abs(math.log(one.value / one.start)) > max(least, _wide(sigma, one, aircraft, math.log)):
                yield _change(one)
        elif one.key == "delay_s":
            sigma = (one.high - one.low) / 2.0
            if abs(one.value - one.start) > max(DELAY_S, _wide(sigma, one, aircraft, float)):
                yield _change(one)
        elif one.key.startswith("gyro.noise.") and one.start > 0.0 and one.value > NOISIER * one.start:
            yield _change(one)
    if sag is not None and aircraft.battery is not None:
        before, half = aircraft.battery.resistance, (sag.high - sag.low) / 2.0
        if abs(sag.resistance - before) > max(RESISTANCE * before, WIDER * half):
            yield Change(
                "battery.resistance_ohm", "resistance of the battery", "ohm", before, sag.resistance, sag.low,
                sag.high,
            )  # fmt: skip


def _change(one: Parameter) -> Change:
    numbers = (float(value) for value in (one.start, one.value, one.low, one.high))
    return Change(one.key, one.words, one.unit, *numbers)


def _wide(half: float, one: Parameter, aircraft: Aircraft, of: Callable[[float], float]) -> float:
    """Return how far the fit and the file's number may be apart by chance; half: of the fit's interval.

    A number of a file that a fit wrote is as unsure as this fit's, where its mark does not say how sure.
    """
    mark = aircraft.known.get(MARKS.get(one.key, ""))
    own = 0.0 if aircraft.motor_thrust is None else half
    if mark is not None and mark.range is not None and mark.range[0] > 0.0:
        own = (of(mark.range[1]) - of(mark.range[0])) / 2.0
    return WIDER * math.hypot(half, own)


def _strengths(fit: Fit, aircraft: Aircraft) -> tuple[float, ...]:
    """Return the thrust of each motor over the mean of the others, beside the file's; 1 where it is that.

    The file's own are as sure as those of the fit.
    """
    motors = [one for key, one in fit.parameters.items() if key.startswith("motor.")]
    own, wider = aircraft.motor_thrust, WIDER if aircraft.motor_thrust is None else WIDER * math.sqrt(2.0)
    values = np.array([one.value for one in motors]) / (np.ones(len(motors)) if own is None else own)
    found = np.ones(len(motors))
    left = list(range(len(motors)))
    while len(left) > 2:  # the farthest first; the others' mean is then without it
        middle = float(np.median(values[left]))
        at = max(left, key=lambda number: abs(values[number] - middle))
        others = float(np.mean([values[number] for number in left if number != at]))
        one, share = motors[at], float(values[at]) / others
        half = (one.high - one.low) / 2.0
        if not one.told or abs(share - 1.0) <= max(MOTOR, wider * half):
            break
        found[at] = share
        left.remove(at)
    return tuple(found.tolist())


def _causes(
    fit: Fit,
    numbers: Mapping[str, Change],
    strengths: Sequence[float],
    sag: Sag | None,
    aircraft: Aircraft,
) -> Iterator[str]:
    """Yield a sentence for each thing that changed."""
    if fit.rewired:
        order = ", ".join(str(rotor + 1) for rotor in fit.order)
        yield f"the motors are in another order: the log's 1 to {len(fit.order)} drive the file's {order}"
    if fit.props_out:
        yield "the propellers turn the other way: props in became out, or the reverse"
    others = "the others" if aircraft.motor_thrust is None else "in the file, beside the others"
    for number, share in enumerate(strengths):
        if share < 1.0:
            yield (
                f"motor {number + 1} gives {100 * (1 - share):.0f} % less thrust than {others}: a bent "
                "or wrong propeller, a bearing, a motor or an ESC that is dying; mend it before you train"
            )
        elif share > 1.0:
            yield (
                f"motor {number + 1} gives {100 * (share - 1):.0f} % more thrust than {others}: another "
                "propeller, or the others are worn"
            )
    yield from _responses(numbers)
    if "delay_s" in numbers:
        moved = 1e3 * (numbers["delay_s"].after - numbers["delay_s"].before)
        yield (
            f"commands reach the rotors {abs(moved):.1f} ms {'later' if moved > 0 else 'sooner'}: another "
            "protocol or firmware of the ESCs, another loop time or gyro filter"
        )
    yield from _turning(fit, numbers, aircraft, voltage=sag is not None)
    yield from _centre(fit, STEADY_M if all(each == 1.0 for each in strengths) else 2.0 * STEADY_M)
    if noisy := [axis for axis in AXES if f"gyro.noise.{axis}" in numbers]:
        worst = max(numbers[f"gyro.noise.{axis}"].ratio for axis in noisy)
        yield (
            f"the gyro is {worst:.1f} times as noisy about {_and(noisy)}: a propeller out of balance, a "
            "loose screw, a worn bearing; look before you fly"
        )
    if "battery.resistance_ohm" in numbers and sag is not None:
        one = numbers["battery.resistance_ohm"]
        yield (
            f"the battery's resistance is {1e3 * one.after:.0f} instead of {1e3 * one.before:.0f} mΩ: "
            f"{'an old, cold or smaller pack' if one.ratio > 1.0 else 'a better pack'}, which sags by "
            f"{sag.current * one.after:.1f} V at this flight's mean {sag.current:.0f} A ({sag.current_from})"
        )
    if sag is not None and aircraft.battery is not None and sag.cells not in (None, aircraft.battery.cells):
        yield (
            f"the battery gave {sag.rest:.1f} V without load, as {sag.cells} cells do; the file has "
            f"{aircraft.battery.cells}"
        )


def _responses(numbers: Mapping[str, Change]) -> Iterator[str]:
    """Yield what became of the rotors' response."""
    times = [
        each.ratio if key.endswith("_s") else 1.0 / each.ratio
        for key, each in numbers.items()
        if key.startswith("response.")
    ]
    if not times:
        return
    share = math.exp(sum(map(math.log, times)) / len(times))
    heavier = "kick" in numbers and numbers["kick"].ratio > 1.0
    if share > 1.0:
        why = (
            "heavier propellers"
            if heavier
            else "other propellers, tired motors or ESCs, or other ESC settings"
        )
        yield f"the rotors take {100 * (share - 1):.0f} % longer to answer: {why}"
    else:
        yield (
            f"the rotors answer in {100 * (1 - share):.0f} % less time: lighter propellers, or other motors "
            "or ESC settings"
        )


def _turning(fit: Fit, numbers: Mapping[str, Change], aircraft: Aircraft, *, voltage: bool) -> Iterator[str]:
    """Yield what became of the authority about each axis."""
    turned = {axis: numbers[f"authority.{axis}"].ratio for axis in AXES if f"authority.{axis}" in numbers}
    if not turned:
        return
    told = ", ".join(f"{axis} {ratio:.2f}" for axis, ratio in turned.items())
    lifts = ""
    if fit.thrust is not None and abs(fit.thrust - 1.0) > RELATIVE["authority"]:
        grams = 1e3 * aircraft.mass_properties.mass
        lifts = (
            f"; the accelerometer says {fit.thrust:.2f} times the lift over weight: "
            f"{grams / fit.thrust:.0f} g instead of {grams:.0f} g, if the rotors push as before"
        )
    charge = "" if voltage else ", or a weaker battery (log its voltage to tell them apart)"
    logs = [math.log(ratio) for ratio in turned.values()]
    if len(turned) == len(AXES) and (max(logs) < 0.0 or min(logs) > 0.0):
        less = logs[0] < 0.0
        why = f"heavier, or rotors that push less{charge}" if less else "lighter, or rotors that push more"
        yield (
            f"it turns {'less' if less else 'more'} for the same motors about all axes ({told} times): "
            f"{why}{lifts}"
        )
        return
    for axis, ratio in turned.items():
        word = "less" if ratio < 1.0 else "more"
        away = "further from" if ratio < 1.0 else "nearer to"
        where = {
            "roll": f"something heavy sits {away} the middle, to the side or up and down",
            "pitch": f"something heavy (camera, battery) sits {away} the middle, forward or back",
            "yaw": f"something heavy sits {away} the middle, or propellers of another pitch",
        }[axis]
        yield f"{axis} turns {abs(ratio - 1.0) * 100:.0f} % {word} for the same motors: {where}{lifts}"


def _centre(fit: Fit, least: float) -> Iterator[str]:
    """Yield where the weight went, by the place where the motors' mean thrust holds it; least [m]."""
    for way, (ahead, behind) in SIDES.items():
        one = fit.parameters[f"centre.{way}"]
        if one.told and abs(one.value) > max(least, WIDER * (one.high - one.low) / 2.0):
            yield (
                f"the weight sits {1e3 * abs(one.value):.0f} mm further {ahead if one.value > 0 else behind} "
                "than in the file: battery or camera moved"
            )


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
