"""A decoded log as files: CSV as the format's own tools write it, and NumPy's .npz."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from neuroflight.sim.blackbox.log import Integers, Log
from neuroflight.sim.blackbox.units import channels
from neuroflight.toolchain.files import replacing

ROWS = 4096  # written at a time


def save_csv(path: Path, log: Log) -> None:
    """Write a row each frame: fields of main frames, then what slow frames told last; numbers of the format.

    The column of time is called `time (us)`, as blackbox_decode calls it.
    """
    columns = {_heading(name): column for name, column in log.columns.items()}
    columns |= {
        name: held for name in log.slow if (held := log.held(name)) is not None and name not in columns
    }
    _write(path, columns)


def save_gps_csv(path: Path, log: Log) -> None:
    """Write a row for each GPS frame, as logged; the time is that of `save_csv`."""
    _write(path, {_heading(name): column for name, column in log.gps.items()})


def _heading(name: str) -> str:
    return "time (us)" if name == "time" else name


def _write(path: Path, columns: dict[str, Integers]) -> None:
    matrix = np.stack(list(columns.values()), axis=1)
    with replacing(path) as aside, aside.open("w", encoding="ascii", newline="") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(matrix), ROWS):
            lines = (",".join(map(str, row)) for row in matrix[start : start + ROWS].tolist())
            file.write("\n".join(lines) + "\n")


def save_npz(path: Path, log: Log) -> None:
    """Write columns as logged, and in physical units.

    `field/NAME` (N,), `slow/NAME` (K,), `slow_row` (K,) and `gps/NAME` (G,) are the format's numbers; `t`,
    `setpoint`, `gyro`, `throttle`, `motors`, `dshot`, `rpm`, `voltage`, `current` have units
    (sim.blackbox.units), those that the log has; `headers` and `events` are JSON.
    """
    told = channels(log)
    arrays: dict[str, object] = {f"field/{name}": column for name, column in log.columns.items()}
    arrays |= {f"slow/{name}": column for name, column in log.slow.items()}
    arrays["slow_row"] = log.slow_row
    arrays |= {f"gps/{name}": column for name, column in log.gps.items()}
    arrays["t"] = told.time()
    for name in ("setpoint", "gyro", "throttle", "motors", "dshot", "rpm", "voltage", "current"):
        if (array := getattr(told, name)) is not None:
            arrays[name] = array
    arrays["headers"] = np.array(json.dumps(log.header))
    events = [{"kind": one.kind, "name": one.name, "row": one.row, **one.values} for one in log.events]
    arrays["events"] = np.array(json.dumps(events))
    with replacing(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def save_headers(path: Path, log: Log) -> Path:
    """Write the header lines beside the CSV file at `path`, as blackbox_decode --save-headers does.

    Without them the gyro's scale is unknown. Returns the path of the file.
    """
    beside = path.with_suffix(".headers.csv")
    with replacing(beside) as aside, aside.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("fieldname", "fieldvalue"))
        rows.writerows(log.header.items())
    return beside
