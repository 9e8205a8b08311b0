"""Recorded commands from a file, whatever its kind; and as a scenario to fly."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.flight import WHOLE, Part
from neuroflight.sim.blackbox.sticks import TELL_RATES
from neuroflight.sim.flight.scenario import Scenario, load_scenario
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.recorded.commands import ROWS_MAX, Commands, part_of
from neuroflight.sim.recorded.log import SUFFIXES as LOG_SUFFIXES
from neuroflight.sim.recorded.log import read_commands, split_number
from neuroflight.sim.recorded.sidecar import headers_beside
from neuroflight.sim.recorded.table import parse_table
from neuroflight.toolchain.errors import ScenarioError, TraceError
from neuroflight.toolchain.files import file_size

CSV, NPZ = ".csv", ".npz"
BYTES_MAX = {CSV: 256 << 20, NPZ: 1 << 30}  # of a file, by its suffix
SUFFIXES = (*BYTES_MAX, *LOG_SUFFIXES)
_TIME, _THROTTLE = "t", "throttle"
_SETPOINTS = {"setpoint": 180.0 / np.pi, "setpoint_deg_s": 1.0}  # arrays: deg/s of their unit
_NUMBER_BYTES_MAX = 8  # of an array's element
_DAMAGED = (OSError, ValueError, EOFError, MemoryError, NotImplementedError, zipfile.BadZipFile)


def is_recording(name: str) -> bool:
    """Return True if `name` is a file of recorded commands rather than a scenario, by its suffix."""
    return split_number(Path(name))[0].suffix.lower() in SUFFIXES


def load_commands(
    path: Path, part: Part = WHOLE, told: Mapping[str, str] | None = None, *, cut: bool = False
) -> Commands:
    """Load the commands of an archive, a table or a log; FILE:N is log N of the file, from 1.

    part: the part to load; told: header lines that the user gives in place of the log's, by name; cut: limit
    rates beyond full stick to full stick. Raises ScenarioError for a file that is missing, damaged or of
    another kind, or that commands what no stick can.
    """
    path, number = split_number(path)
    where = f"recording {path}"
    suffix = path.suffix.lower()
    try:
        if "\0" in str(path) or not path.is_file():
            raise ScenarioError(f"{where}: no such file; give the path of a file of {', '.join(SUFFIXES)}")
        if suffix in LOG_SUFFIXES:
            return read_commands(path, number, part, told, cut=cut)
        if suffix not in BYTES_MAX:
            raise ScenarioError(f"{where}: expected a file of {', '.join(SUFFIXES)}")
        if (size := file_size(path)) > BYTES_MAX[suffix]:
            raise ScenarioError(f"{where}: {size} bytes, expected at most {BYTES_MAX[suffix]}; cut it")
        if suffix == NPZ:
            return _from_arrays(path, where, part, cut=cut)
        lines = {**headers_beside(path), **(told or {})}
        chosen = not TELL_RATES.isdisjoint(told or {})
        return parse_table(path.read_bytes(), where, path.stem, part, lines, cut=cut, chosen=chosen)
    except TraceError as error:
        raise ScenarioError(f"recording {error}") from error
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error}") from error


def load_flight(
    name: str,
    seed: int,
    count: int,
    mount: Mount | None = None,
    part: Part = WHOLE,
    told: Mapping[str, str] | None = None,
    *,
    cut: bool = False,
    throttle: float = 0.0,
) -> tuple[Scenario, tuple[str, ...]]:
    """Load a scenario by name or from its file, or recorded commands; return it with notes for the user.

    part, told, cut: only for recorded commands, see `load_commands`; throttle: see `load_scenario`.
    Raises ScenarioError as `load_scenario` and `load_commands` do.
    """
    if not is_recording(name):
        if part != WHOLE or told or cut:
            raise ScenarioError(
                f"--from, --to, --header and --cut-rates: of recorded commands, got the scenario {name}"
            )
        return load_scenario(name, seed, count, mount, throttle), ()
    commands = load_commands(Path(name), part, told, cut=cut)
    return commands.scenario(mount), commands.warnings()


def _from_arrays(path: Path, where: str, part: Part, *, cut: bool) -> Commands:
    """Read a trace, or an archive with t [s], setpoint [rad/s] or setpoint_deg_s, and perhaps throttle."""
    try:
        with zipfile.ZipFile(path):
            pass  # raises for what numpy would take as something else than an archive
        with np.load(path, allow_pickle=False) as archive:
            known = set(archive.files)
            name = next((each for each in _SETPOINTS if each in known), None)
            if name is None or _TIME not in known:
                raise ScenarioError(
                    f"{where}: arrays {', '.join(sorted(known))[:100] or 'none'}; expected {_TIME} [s] and "
                    f"setpoint [rad/s] or setpoint_deg_s, and {_THROTTLE} (0..1) if there is one"
                )
            time = _array(archive, _TIME, where)
            setpoint = _array(archive, name, where) * _SETPOINTS[name]
            throttle = _array(archive, _THROTTLE, where) if _THROTTLE in known else np.zeros(len(time))
    except _DAMAGED as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(f"{where}: damaged or no .npz file ({reason}); record it anew") from error
    return part_of(where, (time, setpoint, throttle), part, path.stem, cut=cut)


def _array(archive: np.lib.npyio.NpzFile, name: str, where: str) -> Array:
    """Read an array as float64, refused before it is unpacked if it is too large."""
    assert archive.zip is not None  # it is open
    size = archive.zip.getinfo(f"{name}.npy").file_size
    if size > (ROWS_MAX + 1) * 3 * _NUMBER_BYTES_MAX:
        raise ScenarioError(f"{where}: {name} has {size} bytes, expected at most {ROWS_MAX} rows; cut it")
    array = archive[name]
    if array.dtype.kind not in "fiu" or array.ndim < 1:
        raise ScenarioError(f"{where}: {name} is {array.dtype} {array.shape}, expected rows of numbers")
    return np.asarray(array, np.float64)
