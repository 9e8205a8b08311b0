"""Write a fit into an aircraft file: keys of its propulsion change, all other lines and comments stay."""

from __future__ import annotations

from pathlib import Path

from neuroflight.sim.aircraft.edit import Changes, Value, edit_aircraft
from neuroflight.sim.aircraft.known import How, Known
from neuroflight.sim.aircraft.model import RPM, TorqueResponse, load_aircraft
from neuroflight.sim.identification.dyno.fit import Fit
from neuroflight.sim.identification.dyno.points import PointsFit
from neuroflight.sim.identification.dyno.robust_fit import Estimate
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.strict_toml import parse_toml

DIGITS = 6  # significant, of a number written
NOTE = "# Fitted by `neuroflight dyno fit` to "
NOTE_MAX = 200  # characters of the data's name
DIMENSIONLESS = ("c_t", "c_q", "air_density_kg_m3")  # K_T and K_Q take their place
RESPONSE_KEYS = {
    "torque": ("gain", "torque_up_n_m", "torque_down_n_m"),
    "first_order": ("time_constant_up_s", "time_constant_down_s"),
}


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
    document = parse_toml(source.read_bytes(), f"aircraft file {source}", AircraftError)
    if not fit.torque_ratio and "c_q" in document["propulsion"]:
        raise AircraftError(
            f"{target} is not written: the log has no torque, and c_q of {source} goes with its c_t; give "
            "thrust_coefficient and torque_ratio_m there instead"
        )
    changes = _changes(fit, inertia, known)
    fitted = [key for key, value in changes["propulsion"].items() if value is not None]
    shown = "".join(character for character in data if character.isprintable())[:NOTE_MAX]
    told = f"{shown}: {', '.join([*fitted, *(['response'] if len(changes) > 1 else [])])}"
    mark = Known(How.MEASURED, None, f"dyno fit to {shown}"[:NOTE_MAX])
    marked = {f"propulsion.{key}": mark for key in fitted} | dict.fromkeys(list(changes)[1:], mark)
    edit_aircraft(source, changes, target, (NOTE, told), marked)


def _changes(fit: Fit | PointsFit, inertia: float | None, known: float) -> Changes:
    propulsion: dict[str, Value | None] = dict.fromkeys(DIMENSIONLESS)
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
    others = {key: None for keys in RESPONSE_KEYS.values() for key in keys}
    if isinstance(response, TorqueResponse):
        values = (response.gain, response.torque_up, response.torque_down)
    else:
        values = (response.time_constant_up, response.time_constant_down)
    keys = zip(RESPONSE_KEYS[fit.response.kind], map(_rounded, values), strict=True)
    return {
        "propulsion": propulsion,
        "propulsion.response": {"kind": fit.response.kind, **others, **dict(keys)},
    }


def _terms(terms: tuple[Estimate, ...]) -> float | tuple[float, ...]:
    values = tuple(_rounded(term.value) for term in terms)
    return values[0] if len(values) == 1 else values


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
