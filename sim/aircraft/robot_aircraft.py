"""An aircraft file from a model of another simulator, which marks what that model does not say.

Parts and rotors are the model's. Of the drives it takes what the model's motor plugins say; what they leave
out is another aircraft's, if the user names one, else a value that is marked as assumed. Thrust, torque and
speed are never assumed.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.edit import with_known
from neuroflight.sim.aircraft.known import SOURCE_MAX, How, Known, is_named
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, parse_aircraft
from neuroflight.sim.aircraft.robot import VERTICAL, Drive, Robot, read_xml
from neuroflight.sim.aircraft.robot_parts import hub_of
from neuroflight.sim.aircraft.robot_text import Writer
from neuroflight.sim.aircraft.sdf import read_sdf
from neuroflight.sim.aircraft.urdf import read_urdf
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX
from neuroflight.toolchain.errors import AircraftError

ROTORS_MIN = 3


@dataclass(frozen=True, eq=False)
class Imported:
    """An aircraft file made of a model."""

    text: str
    aircraft: Aircraft
    assumed: tuple[str, ...]  # values in it that the model does not give
    notes: tuple[str, ...]


def read_robot(path: Path) -> Robot:
    """Return the content of a URDF or SDF file. Raises AircraftError, one line."""
    where = str(path)
    if not path.is_file():
        raise AircraftError(f"{where}: no such file; expected a .urdf or .sdf")
    root = read_xml(path, where)
    if root.tag == "robot":
        return read_urdf(root, where)
    if root.tag == "sdf":
        return read_sdf(root, path, where)
    raise AircraftError(f"{where}: its root is <{root.tag!s:.60}>, expected <robot> (URDF) or <sdf>")


def import_aircraft(
    path: Path, *, like: str | None = None, spins: Sequence[str] | None = None, name: str | None = None
) -> Imported:
    """Return the aircraft of a URDF or SDF file.

    like: a shipped name or a file, of the aircraft that has what the model does not say; spins: "cw" or "ccw"
    of each rotor, in the model's order; name: of the aircraft, None: the model's. Raises AircraftError, one
    line, naming what is missing or cannot be flown.
    """
    robot, where = read_robot(path), str(path)
    drives = _turning(robot, spins, where)
    if spins is not None:
        robot = replace(robot, spins_by="")
    other = None if like is None else load_aircraft(like)
    writer = Writer(robot, drives, where, other, like)
    text = writer.text(name or _name(robot.name), path.name)
    if guessed := _guessed(text, writer.assumed):
        text = with_known(text, guessed)
    try:
        aircraft = parse_aircraft(text.encode(), where)
    except AircraftError as error:
        raise AircraftError(f"{error} (of the aircraft that {path.name} makes)") from error
    held = [f"joint {joint} moves in the model; here it is fixed at its zero" for joint in robot.held]
    return Imported(text, aircraft, tuple(writer.assumed), (*held, *writer.notes))


def _guessed(text: str, assumed: Sequence[str]) -> dict[str, Known]:
    """Return the marks of what is assumed: "KEY: reason" or "[TABLE]: reason", as the writer says it."""
    document = tomllib.loads(text)
    marks: dict[str, Known] = {}
    for line in assumed:
        key, _, reason = line.partition(": ")
        places = (key.strip("[]"), f"propulsion.{key}", f"propulsion.response.{key}")
        marks |= {
            place: Known(How.GUESSED, None, reason[:SOURCE_MAX])
            for place in places
            if is_named(document, place)
        }
    return marks


def _turning(robot: Robot, spins: Sequence[str] | None, where: str) -> list[Drive]:
    """Return the drives in the order of the aircraft file's rotors, each with its spin, checked."""
    drives = list(robot.drives)
    if all(drive.number is not None for drive in drives):
        drives.sort(key=lambda drive: drive.number or 0)
    if not ROTORS_MIN <= len(drives) <= MOTOR_COUNT_MAX:
        raise AircraftError(
            f"{where}: {len(drives)} rotors, expected {ROTORS_MIN} to {MOTOR_COUNT_MAX}: links that a motor "
            f"plugin names (motorConstant, turningDirection, linkName), or on continuous joints about z"
        )
    for drive in drives:
        if drive.link not in robot.links:
            raise AircraftError(
                f"{where}: a motor plugin turns link {drive.link!r}, which is not in the file"
            )
        axis = robot.axes.get(drive.link, robot.links[drive.link].pose.turn[:, 2])
        if abs(axis[2]) < VERTICAL * float(np.linalg.norm(axis)):
            pointing = ", ".join(f"{part:.3g}" for part in axis)
            raise AircraftError(
                f"{where}: rotor {drive.link} turns about [{pointing}], expected z: all thrust is along "
                f"the body's z here"
            )
    names = ", ".join(drive.link for drive in drives)
    if spins is not None:
        wrong = next((spin for spin in spins if spin not in ("cw", "ccw")), None)
        if wrong is not None or len(spins) != len(drives):
            raise AircraftError(f"--spins {','.join(spins)}: expected cw or ccw for each of: {names}")
        drives = [
            replace(drive, spin=1 if spin == "ccw" else -1) for drive, spin in zip(drives, spins, strict=True)
        ]
    if any(drive.spin is None for drive in drives):
        raise AircraftError(
            f"{where}: does not say which way its rotors turn; give --spins, cw or ccw seen from above for "
            f"each of: {names}"
        )
    return _in_bench_order(robot, drives)


def _in_bench_order(robot: Robot, drives: list[Drive]) -> list[Drive]:
    """Return four rotors in X as 1 rear right, 2 front right, 3 rear left, 4 front left; others as given."""
    centre = np.mean([hub_of(robot, drive) for drive in drives], axis=0)
    places = {}
    for drive in drives:
        x, y, _ = hub_of(robot, drive) - centre
        if min(abs(x), abs(y)) > 1e-3:
            places[y > 0.0, x > 0.0] = drive
    return [places[key] for key in sorted(places)] if len(places) == len(drives) == 4 else drives


def _name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:32] or "imported"
