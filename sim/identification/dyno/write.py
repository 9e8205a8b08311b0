"""Write a fit into an aircraft file: keys of its propulsion change, all other lines and comments stay."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from neuroflight.sim.aircraft.edit import Changes, Value, edit_aircraft
from neuroflight.sim.aircraft.model import RPM, TorqueResponse, load_aircraft
from neuroflight.sim.identification.dyno.fit import Fit
from neuroflight.sim.identification.dyno.points import PointsFit
from neuroflight.sim.identification.dyno.robust_fit import Estimate
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import replacing

DIGITS = 6  # significant, of a number written
NOTE = "# Fitted by `neuroflight dyno fit` to "
NOTE_MAX = 200  # characters of the data's name
# What K_T and K_Q take the place of.
DIMENSIONLESS = {"c_t": "thrust_coefficient", "c_q": "torque_ratio_m", "air_density_kg_m3": None}
RESPONSE_KEYS = {
    "torque": ("gain", "torque_up_n_m", "torque_down_n_m"),
    "first_order": ("time_constant_up_s", "time_constant_down_s"),
}
Renames = dict[str, dict[str, str | None]]  # by table: a key and the one in its place, or None


def write_fit(
    source: Path, target: Path, fit: Fit | PointsFit, data: str, inertia: float | None = None
) -> None:
    """Write the aircraft of `source` with the propulsion of `fit` to `target`, which may be the same.

    data: what was fitted, for a comment. inertia: of the rotor [kg m^2], written too if given; else the
    file's own turns rates into torques. The latency is not written: an aircraft's delay holds the control
    loop's sample too. What the fit does not know stays as it is. Raises AircraftError, with `target` as it
    was, on a source that is no valid aircraft or cannot be edited, and on points not of a rotor at rest.
    """
    if isinstance(fit, PointsFit) and fit.doubts:
        raise AircraftError(f"{target} is not written: {fit.doubts[0]}")
    known = load_aircraft(source).propulsion.rotor_inertia
    text = source.read_bytes().decode("utf-8-sig")
    if not fit.torque_ratio and "c_q" in tomllib.loads(text).get("propulsion", {}):
        raise AircraftError(
            f"{target} is not written: the log has no torque, and c_q of {source} goes with its c_t; give "
            "thrust_coefficient and torque_ratio_m there instead"
        )
    changes = _changes(fit, inertia, known)
    renames: Renames = {"propulsion": DIMENSIONLESS}
    if fit.response is not None:
        (others,) = (keys for kind, keys in RESPONSE_KEYS.items() if kind != fit.response.kind)
        renames["propulsion.response"] = dict(
            zip(others, [*RESPONSE_KEYS[fit.response.kind], None], strict=False)
        )
    edited = _renamed(text, renames)
    if tomllib.loads(edited) != _expected(text, renames):
        raise AircraftError(
            f"aircraft file {source}: cannot be edited as it is written; give it plain tables "
            f"[propulsion] and [propulsion.response]"
        )
    with replacing(target) as aside:
        aside.write_bytes(_with_note(edited, changes, data).encode())
        try:
            edit_aircraft(aside, changes)
        except AircraftError as error:
            raise AircraftError(str(error).replace(str(aside), str(target))) from error


def _changes(fit: Fit | PointsFit, inertia: float | None, known: float) -> Changes:
    propulsion: dict[str, Value] = {}
    if fit.speed_curve is not None:
        propulsion["speed_curve_rpm"] = tuple(_rounded(term.value / RPM) for term in fit.speed_curve)
    propulsion["thrust_coefficient"] = _terms(fit.thrust_coefficient)
    if fit.torque_ratio:
        propulsion["torque_ratio_m"] = _terms(fit.torque_ratio)
    if inertia is not None:
        propulsion["rotor_inertia_kg_m2"] = inertia
    if fit.response is None:
        return {"propulsion": propulsion}
    response = fit.response.response(known if inertia is None else inertia)
    values: tuple[float, ...]
    if isinstance(response, TorqueResponse):
        values = (response.gain, response.torque_up, response.torque_down)
    else:
        values = (response.time_constant_up, response.time_constant_down)
    keys = zip(RESPONSE_KEYS[fit.response.kind], map(_rounded, values), strict=True)
    return {"propulsion": propulsion, "propulsion.response": {"kind": fit.response.kind, **dict(keys)}}


def _terms(terms: tuple[Estimate, ...]) -> float | tuple[float, ...]:
    values = tuple(_rounded(term.value) for term in terms)
    return values[0] if len(values) == 1 else values


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _lines(text: str) -> list[tuple[str, str, str]]:
    """Return each line with the table it stands in and the key it assigns, empty without one."""
    found = []
    table = ""
    for line in text.splitlines(keepends=True):
        header = re.match(r"\s*\[\s*([\w.-]+)\s*\]", line)
        key = re.match(r"\s*([\w-]+)\s*=", line)
        if header or line.lstrip().startswith("[["):
            table = header[1] if header else ""
        found.append((line, table, key[1] if key else ""))
    return found


def _renamed(text: str, renames: Renames) -> str:
    """Return `text` with the keys of `renames` renamed, their values 0, or without such lines."""
    lines = []
    for line, table, key in _lines(text):
        names = renames.get(table, {})
        if key not in names:
            lines.append(line)
        elif (name := names[key]) is not None:
            lines.append(f"{name} = 0.0" + ("\r\n" if line.endswith("\r\n") else "\n"))
    return "".join(lines)


def _expected(text: str, renames: Renames) -> dict[str, object]:
    """Return the document that `_renamed` should make of `text`."""
    document = tomllib.loads(text)
    for path, names in renames.items():
        table = document
        for part in path.split("."):
            table = table.get(part, {})
        for old, new in names.items():
            if table.pop(old, None) is not None and new is not None:
                table[new] = 0.0
    return document


def _with_note(text: str, changes: Changes, data: str) -> str:
    """Return `text` with a note below [propulsion] that tells which of its numbers were fitted."""
    keys = [*changes["propulsion"], *(["response"] if len(changes) > 1 else [])]
    shown = "".join(character for character in data if character.isprintable())[:NOTE_MAX]
    note = f"{NOTE}{shown}: {', '.join(keys)}"
    lines = []
    for line, table, _ in _lines(text):
        if table == "propulsion" and line.startswith(NOTE):
            continue
        lines.append(line)
        if re.match(r"\s*\[\s*propulsion\s*\]", line):
            newline = "\r\n" if line.endswith("\r\n") else "\n"
            lines.append(note + newline)
    return "".join(lines)
