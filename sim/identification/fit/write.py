"""A fit as an aircraft file: the start's text with what the log told, each number marked.

K_T and the geometry are the start's; inertia carries what the log told of roll and pitch, and yaw's follows
theirs. An axis that turns more than the parts' inertia lets it raises K_T.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence

import numpy as np

from neuroflight.sim.aircraft.edit import newline_of, with_key, with_known, without_marks
from neuroflight.sim.aircraft.known import How, Known
from neuroflight.sim.aircraft.model import (
    FILE_BYTES_MAX,
    RPM,
    Aircraft,
    FirstOrderResponse,
    aircraft_file,
)
from neuroflight.sim.aircraft.props_out import SUFFIX
from neuroflight.sim.identification.fit.model import Theta, shaped
from neuroflight.sim.identification.fit.parameters import authority, faster_by
from neuroflight.sim.identification.fit.result import Fit, Parameter
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited

PART = "fitted"  # the name of the part that carries what is fitted
DIMENSIONLESS = frozenset(("c_t", "c_q", "air_density_kg_m3"))  # K_T and K_Q take their place
MASS = 1e-6  # [kg] of it
TIGHT = 0.999  # largest moment over the other two of a body


def start_text(source: str) -> str:
    """Read the start file's text by name or path. Raises AircraftError."""
    if source.endswith(SUFFIX):
        raise AircraftError(
            f"{source}: got an aircraft with its propellers out, expected a file to begin with; name it "
            f"without {SUFFIX}: the fit finds the direction by itself"
        )
    path = aircraft_file(source)
    return read_limited(path, f"aircraft file {path}", FILE_BYTES_MAX, AircraftError).decode("utf-8-sig")


def fitted_text(text: str, start: Aircraft, fit: Fit) -> str:
    """Return the text of an aircraft file, the start's being `text`, with the fit in it and marks [known].

    What the logs did not tell stays: its number and its mark. A number that says what was told by others
    (moments of inertia an authority at the flown throttle) is such that with those that stay it says the
    same. Raises AircraftError where no such aircraft can be.
    """
    marks: dict[str, Known] = {}
    told = fit.parameters

    def put(table: str, key: str, value: float, of: Parameter) -> None:
        """Write a number and its mark, whose range is that of `of`, relative to its value."""
        nonlocal text
        text = with_key(text, table, key, _rounded(value))
        scale = value / of.value if of.value else 1.0
        bounds = (of.low * scale, of.high * scale)
        marks[f"{table}.{key}"] = Known(How.MEASURED, bounds, f"fit of {fit.name}")

    text = _wired(text, start, fit)
    values = _told_values(fit)
    propulsion = shaped(start.propulsion, values)
    factors, kick = _told_factors(start, fit, values)
    first_order = isinstance(propulsion.response, FirstOrderResponse)
    if first_order:
        for side in ("up", "down"):
            if (one := told[f"response.{side}_s"]).told:
                put("propulsion.response", f"time_constant_{side}_s", one.value, one)
    if told["delay_s"].told:
        put("propulsion", "delay_s", max(0.0, told["delay_s"].value), told["delay_s"])
    if propulsion.speed_curve != shaped(start.propulsion, fit.layout.values(fit.layout.start)).speed_curve:
        curve = tuple(_rounded(term / RPM) for term in propulsion.speed_curve)
        text = with_key(text, "propulsion", "speed_curve_rpm", curve)
        marks["propulsion.speed_curve_rpm"] = Known(How.MEASURED, None, f"fit of {fit.name}")
    thrust, added = _inertia(start, factors)
    moments = np.diag(start.mass_properties.inertia)
    yaw = float((moments[2] + added[2]) / moments[2])  # over the start's
    said = f"fit of {fit.name}: moment over inertia"
    one = told["authority.yaw"]
    ratio = factors[2] * yaw / thrust if one.told else 1.0
    lists = {}
    if thrust > 1.0:
        lists["thrust_coefficient"] = tuple(thrust * term for term in start.propulsion.thrust_coefficient)
    if one.told:
        lists["torque_ratio_m"] = tuple(ratio * term for term in start.propulsion.torque_ratio)
        value = lists["torque_ratio_m"][0]
        bounds = (value * one.low / one.value, value * one.high / one.value)
        marks["propulsion.torque_ratio_m"] = Known(How.MEASURED, bounds, said)
    text = _with_coefficients(text, start, lists)
    if (sag := told.get("sag")) is not None and sag.told and sag.value > 0.0 and start.battery is not None:
        # It is resistance times power: with the torque that is written.
        put("battery", "resistance_ohm", sag.value * start.battery.resistance / (ratio * thrust), sag)
    if told["kick"].told:
        put("propulsion", "rotor_inertia_kg_m2", kick * yaw * start.propulsion.rotor_inertia, told["kick"])
    if not first_order:
        text, marks = _torques(text, marks, fit, start, kick * yaw if told["kick"].told else 1.0)
    if told["drag"].told and told["drag"].value >= 0.0:
        drag = told["drag"].value * yaw * start.propulsion.drag_coefficient
        put("propulsion", "drag_coefficient", min(1.0, drag), told["drag"])
    for kind in ("noise", "vibration"):
        if all(told[f"gyro.{kind}.{axis}"].told for axis in AXES):
            shaken = tuple(_rounded(told[f"gyro.{kind}.{axis}"].value) for axis in AXES)
            text = with_key(text, "gyro", f"{kind}_deg_s", shaken)
            marks[f"gyro.{kind}_deg_s"] = Known(How.MEASURED, None, f"fit of {fit.name}")
    rows = [told[f"gyro.turn.{axis}"] for axis in AXES]
    if any(one.told for one in rows):
        turns = tuple(_rounded(one.value if one.told else one.start) for one in rows)
        text = with_key(text, "gyro", "misalignment_deg", turns)
    for axis, one in enumerate(rows):
        if one.told:
            mark = Known(How.MEASURED, (one.low, one.high), f"fit of {fit.name}")
            marks[f"gyro.misalignment_deg[{axis}]"] = mark
    text = _with_centre(text, start, [told["centre.x"], told["centre.y"]])
    sides = [told[f"authority.{axis}"].told for axis in AXES[:2]]
    if any(sides):
        text, part = _with_part(text, start, added)
        marks[f"part.{part}.inertia_kg_m2"] = Known(How.MEASURED, None, said)
    motors = [one for key, one in told.items() if key.startswith("motor.")]
    if all(one.told for one in motors):
        text = with_key(text, "logged", "motor_thrust", tuple(_rounded(one.value) for one in motors))
    if all(sides):  # of thrust over inertia neither is known, and neither's guess costs anything
        written = tomllib.loads(text)
        of = [f"propulsion.{key}" for key in ("thrust_coefficient", "c_t") if key in written["propulsion"]]
        of += [key for key in ("part", "motor_part", "propeller_part") if key in written]
        marks |= {key: Known(How.MEASURED, None, said) for key in of}
        del marks[f"part.{part}.inertia_kg_m2"]
    return with_known(text, marks)


def _told_values(fit: Fit) -> Theta:
    """Return what the rotors do: the fit's values of what was told, the start's of the rest."""
    values = fit.layout.values(fit.layout.start)
    told, theta = fit.parameters, fit.theta
    if told["curve"].told:
        values["bend"] = theta["bend"]
    if "speed_max" in told and told["speed_max"].told:
        values |= {"log_top": theta["log_top"], "foot": theta["foot"]}
    return values


def _told_factors(start: Aircraft, fit: Fit, values: Theta) -> tuple[np.ndarray, float]:
    """Return the factors (3,) of moment over inertia, and that of rotor inertia, over the start's.

    With the curve of `values` they say the authority and the kick that were told at the flown throttle.
    What was not told keeps the start's numbers.
    """
    told = fit.parameters
    at = authority(start, values | {f"factor.{axis}": 1.0 for axis in AXES}, fit.wiring, fit.usual, fit.volts)
    rows = [told[f"authority.{axis}"] for axis in AXES]
    factors = np.array([one.value / by if one.told else 1.0 for one, by in zip(rows, at, strict=True)])
    faster = [faster_by(start, each, fit.usual, fit.volts) for each in (fit.theta, values)]
    return factors, told["kick"].value * faster[0] / faster[1]


def _with_coefficients(text: str, start: Aircraft, lists: Mapping[str, tuple[float, ...]]) -> str:
    """Write coefficients of [propulsion]; both where these take the place of dimensionless ones."""
    written = dict(lists)
    if lists and not DIMENSIONLESS.isdisjoint(tomllib.loads(text)["propulsion"]):
        old = start.propulsion
        written = {"thrust_coefficient": old.thrust_coefficient, "torque_ratio_m": old.torque_ratio, **lists}
        text = without_marks(text, [f"propulsion.{key}" for key in DIMENSIONLESS])
        for key in DIMENSIONLESS:
            text = with_key(text, "propulsion", key, None)
    for key, terms in written.items():
        each = tuple(map(_rounded, terms))
        text = with_key(text, "propulsion", key, each[0] if len(each) == 1 else each)
    return text


def _torques(
    text: str, marks: dict[str, Known], fit: Fit, start: Aircraft, spin_up: float
) -> tuple[str, dict[str, Known]]:
    """Write a torque response; spin_up: the rotors' inertia over the start's, with which the rest stays."""
    inertia = start.propulsion.rotor_inertia * spin_up
    for name, key in (("gain", "gain"), ("torque_up", "torque_up_n_m"), ("torque_down", "torque_down_n_m")):
        one = fit.parameters[f"response.{name}"]
        if one.told:
            text = with_key(text, "propulsion.response", key, _rounded(one.value * inertia))
            mark = Known(How.MEASURED, (one.low * inertia, one.high * inertia), f"fit of {fit.name}")
            marks[f"propulsion.response.{key}"] = mark
        elif spin_up != 1.0:
            text = with_key(text, "propulsion.response", key, _rounded(one.start * inertia))
    return text, marks


def _inertia(start: Aircraft, factors: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the factor of K_T, 1 or more, and the moments (3,) that are added to the parts'."""
    moments = np.diag(start.mass_properties.inertia)
    thrust = max(1.0, float(factors[:2].max()))
    for _ in range(600):
        target = moments.copy()
        target[:2] *= thrust / factors[:2]
        target[2] *= target[:2].sum() / moments[:2].sum()
        added = target - moments
        if added.max() <= TIGHT * (added.sum() - added.max()) or added.max() < 1e-9:
            break
        thrust *= 1.01
    return thrust, np.maximum(added, 1e-12)


def _with_part(text: str, start: Aircraft, added: np.ndarray) -> tuple[str, str]:
    """Add the part that carries what is fitted; returns its name, too."""
    newline, name = newline_of(text), _free_name(text)
    centre = ", ".join(f"{value:.6g}" for value in start.mass_properties.centre)
    lines = [
        "",
        "[[part]]",
        f'name = "{name}"',
        f"mass_kg = {MASS!r}",
        "position_m = [0.0, 0.0, 0.0]",
        f"centre_of_mass_m = [{centre}]",
        f"inertia_kg_m2 = [{', '.join(f'{value:.6g}' for value in added)}]",
        "",
    ]
    return text.rstrip("\r\n") + newline + newline.join(lines), name


def _with_centre(text: str, start: Aircraft, centre: Sequence[Parameter]) -> str:
    """Move all parts against the motors so that the centre of mass is where the log says."""
    moved = np.array([one.value if one.told else 0.0 for one in centre] + [0.0])
    parts = sum(float(part["mass_kg"]) for part in tomllib.loads(text).get("part", []))
    if not moved.any() or parts <= 0.0:
        return text
    by = moved * start.mass_properties.mass / parts

    def placed(match: re.Match[str]) -> str:
        place = np.array([float(each) for each in match[2].split(",") if each.strip()]) + by
        return f"{match[1]}{', '.join(str(_rounded(each)) for each in place)}{match[3]}"

    pieces = re.split(r"(?m)^(?=[ \t]*\[)", text)
    for number, piece in enumerate(pieces):
        if re.match(r"[ \t]*\[\[[ \t]*part[ \t]*\]\]", piece):
            pieces[number] = re.sub(r"(?m)^([ \t]*position_m[ \t]*=[ \t]*\[)([^\]]*)(\])", placed, piece)
    return "".join(pieces)


def _free_name(text: str) -> str:
    names = {part.get("name") for part in tomllib.loads(text).get("part", [])}
    name, number = PART, 1
    while name in names:
        number += 1
        name = f"{PART} {number}"
    return name


def _wired(text: str, start: Aircraft, fit: Fit) -> str:
    """Bring [[rotor]] tables into the logged motors' order, with their spins."""
    if not fit.rewired and not fit.props_out:
        return text
    pieces = re.split(r"(?m)^(?=[ \t]*\[)", text)
    places = [
        number for number, piece in enumerate(pieces) if re.match(r"[ \t]*\[\[[ \t]*rotor[ \t]*\]\]", piece)
    ]
    if len(places) != len(fit.order):
        raise AircraftError(
            f"aircraft {start.name}: its file has no [[rotor]] tables of its own, and the log "
            f"says that {'motors have another order' if fit.rewired else 'props are out'}: give such a file"
        )
    rotors = [pieces[number] for number in places]
    for place, rotor, spin in zip(places, fit.order, fit.spins, strict=True):
        word = "ccw" if spin > 0 else "cw"
        pieces[place] = re.sub(
            r"(?m)^([ \t]*spin[ \t]*=[ \t]*)[\"'][a-z]+[\"']", rf'\g<1>"{word}"', rotors[rotor]
        )
    return "".join(pieces)


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
