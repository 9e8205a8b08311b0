"""A fit as an aircraft file: the start's text with what the log told, each number marked.

K_T and the geometry are the start's; inertia carries what the log told of roll and pitch, and yaw's follows
theirs. An axis that turns more than the parts' inertia lets it raises K_T.
"""

from __future__ import annotations

import re
import tomllib

import numpy as np

from neuroflight.sim.aircraft.edit import Value, newline_of, with_key
from neuroflight.sim.aircraft.known import How, Known, known_line
from neuroflight.sim.aircraft.model import (
    FILE_BYTES_MAX,
    RPM,
    Aircraft,
    FirstOrderResponse,
    aircraft_file,
)
from neuroflight.sim.aircraft.props_out import SUFFIX
from neuroflight.sim.identification.fit.model import shaped
from neuroflight.sim.identification.fit.result import Fit, Parameter
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited

PART = "fitted"  # the name of the part that carries what is fitted
DIMENSIONLESS = ("c_t", "c_q", "air_density_kg_m3")  # K_T and K_Q take their place
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

    What the logs did not tell stays. Raises AircraftError where no such aircraft can be.
    """
    marks: dict[str, Known] = {}
    propulsion = shaped(start.propulsion, fit.theta)
    told = fit.parameters

    def put(table: str, key: str, value: Value, of: Parameter | None, scale: float = 1.0) -> None:
        nonlocal text
        text = with_key(text, table, key, value)
        if of is not None and not isinstance(value, tuple):
            bounds = (of.low * scale, of.high * scale)
            marks[f"{table}.{key}"] = Known(How.MEASURED, bounds, f"fit of {fit.name}")

    text = _wired(text, start, fit)
    response = propulsion.response
    if isinstance(response, FirstOrderResponse):
        for side in ("up", "down"):
            one = told[f"response.{side}_s"]
            put("propulsion.response", f"time_constant_{side}_s", _rounded(one.value), one)
    if told["delay_s"].told:
        put("propulsion", "delay_s", _rounded(max(0.0, told["delay_s"].value)), told["delay_s"])
    curve = tuple(_rounded(term / RPM) for term in propulsion.speed_curve)
    text = with_key(text, "propulsion", "speed_curve_rpm", curve)
    marks["propulsion.speed_curve_rpm"] = Known(
        How.MEASURED if told["curve"].told else How.GUESSED, None, f"fit of {fit.name}"
    )
    factors = np.array([abs(told[f"factor.{axis}"].value) for axis in AXES])
    thrust, added = _inertia(start, factors)
    moments = np.diag(start.mass_properties.inertia)
    yaw = float((moments[2] + added[2]) / moments[2])  # over the start's
    ratio = factors[2] * yaw / thrust
    spin_up = told["kick"].value * yaw
    terms = tuple(_rounded(thrust * term) for term in start.propulsion.thrust_coefficient)
    ratios = tuple(_rounded(ratio * term) for term in start.propulsion.torque_ratio)
    dimensionless = any(key in tomllib.loads(text)["propulsion"] for key in DIMENSIONLESS)
    if thrust > 1.0 or dimensionless:
        for key in DIMENSIONLESS:
            text = with_key(text, "propulsion", key, None)
        text = with_key(text, "propulsion", "thrust_coefficient", terms[0] if len(terms) == 1 else terms)
    if told["factor.yaw"].told or dimensionless:
        text = with_key(text, "propulsion", "torque_ratio_m", ratios[0] if len(ratios) == 1 else ratios)
        _mark(
            marks,
            "propulsion.torque_ratio_m",
            told["factor.yaw"],
            fit,
            start.propulsion.torque_ratio[0] * yaw / thrust,
        )
    if told["kick"].told:
        put(
            "propulsion",
            "rotor_inertia_kg_m2",
            _rounded(start.propulsion.rotor_inertia * spin_up),
            told["kick"],
            start.propulsion.rotor_inertia * yaw,
        )
        if not isinstance(response, FirstOrderResponse):
            text, marks = _torques(text, marks, fit, start, spin_up)
    elif not isinstance(response, FirstOrderResponse):
        text, marks = _torques(text, marks, fit, start, 1.0)
    if told["drag"].told and told["drag"].value >= 0.0:
        put(
            "propulsion",
            "drag_coefficient",
            _rounded(min(1.0, told["drag"].value * start.propulsion.drag_coefficient)),
            told["drag"],
            start.propulsion.drag_coefficient,
        )
    if all(told[f"gyro.noise.{axis}"].told for axis in AXES):
        noise = tuple(_rounded(told[f"gyro.noise.{axis}"].value) for axis in AXES)
        text = with_key(text, "gyro", "noise_deg_s", noise)
        marks["gyro.noise_deg_s"] = Known(How.MEASURED, None, f"fit of {fit.name}")
    text = _with_part(text, start, added)
    marks[f"part.{PART}.inertia_kg_m2"] = Known(How.MEASURED, None, f"fit of {fit.name}: moment over inertia")
    return with_marks(text, marks)


def _mark(marks: dict[str, Known], key: str, of: Parameter, fit: Fit, scale: float) -> None:
    marks[key] = Known(How.MEASURED, (of.low * scale, of.high * scale), f"fit of {fit.name}")


def _torques(
    text: str, marks: dict[str, Known], fit: Fit, start: Aircraft, spin_up: float
) -> tuple[str, dict[str, Known]]:
    """Write a torque response; spin_up: the rotors' inertia over the start's."""
    inertia = start.propulsion.rotor_inertia * spin_up
    for name, key in (("gain", "gain"), ("torque_up", "torque_up_n_m"), ("torque_down", "torque_down_n_m")):
        one = fit.parameters[f"response.{name}"]
        if one.told or name == "gain":
            text = with_key(text, "propulsion.response", key, _rounded(one.value * inertia))
            _mark(marks, f"propulsion.response.{key}", one, fit, inertia)
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


def _with_part(text: str, start: Aircraft, added: np.ndarray) -> str:
    newline = newline_of(text)
    centre = ", ".join(f"{value:.6g}" for value in start.mass_properties.centre)
    lines = [
        "",
        "[[part]]",
        f'name = "{_free_name(text)}"',
        f"mass_kg = {MASS!r}",
        "position_m = [0.0, 0.0, 0.0]",
        f"centre_of_mass_m = [{centre}]",
        f"inertia_kg_m2 = [{', '.join(f'{value:.6g}' for value in added)}]",
        "",
    ]
    return text.rstrip("\r\n") + newline + newline.join(lines)


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


def with_marks(text: str, marks: dict[str, Known]) -> str:
    """Put marks into table [known], in place of those of the same keys."""
    newline = newline_of(text)
    lines, inside, kept = [], False, []
    for line in text.splitlines():
        header = line.strip().startswith("[")
        if header:
            inside = line.strip() == "[known]"
            if inside:
                continue
        if inside:
            key = re.match(r"\s*(\"[^\"]+\"|'[^']+'|[A-Za-z0-9_-]+)\s*=", line)
            if not (key and key[1].strip("\"'") in marks):
                kept.append(line)
            continue
        lines.append(line)
    while kept and not kept[-1].strip():
        kept.pop()
    found = [*lines, *([""] if lines and lines[-1].strip() else []), "[known]", *kept]
    found += [known_line(key, mark) for key, mark in marks.items()]
    return newline.join(found) + newline


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
