"""Aircraft that are built otherwise than their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.ports.port import FirmwarePort, Reply, Sample

Port = TypeVar("Port", bound=FirmwarePort)
AIRCRAFT = Path(__file__).parents[2] / "sim" / "aircraft"
OTHER_WAY = {'spin = "cw"': 'spin = "ccw"', 'spin = "ccw"': 'spin = "cw"'}


def reversed_aircraft(name: str, folder: Path) -> Aircraft:
    """The shipped aircraft `name`, every motor turning the other way; its file is written to `folder`."""
    lines = (AIRCRAFT / f"{name}.toml").read_text().splitlines()
    path = folder / f"{name}.toml"
    path.write_text("\n".join(OTHER_WAY.get(line, line) for line in lines) + "\n")
    aircraft = load_aircraft(path)
    assert (aircraft.spins == -load_aircraft(name).spins).all()
    return aircraft


def board_axes(angles_deg: Sequence[float]) -> NDArray[np.float64]:
    """The axes of a board in the body's, as columns: turned by (roll, pitch, yaw) as the settings say it.

    By yaw clockwise seen from above, then the arrow upwards by pitch, then its left side downwards by roll,
    each about the board's own axes.
    """
    turned = np.eye(3)
    for axis in (2, 1, 0):
        angle = -np.radians(angles_deg[axis])
        turn = np.eye(3)
        one, other = (axis + 1) % 3, (axis + 2) % 3
        turn[[one, other], [one, other]] = np.cos(angle)
        turn[one, other], turn[other, one] = -np.sin(angle), np.sin(angle)
        turned = turned @ turn
    return turned


def drifting(port: Port, drift_deg_s: Sequence[float], hz: float = 0.0) -> Port:
    """The port, its gyro so far off from the moment on at which the aircraft is armed, or shaking so far."""
    seen = Sample(0.0, np.zeros(3), np.eye(3), *np.zeros((3, 3)))
    drift, exchange = np.radians(drift_deg_s), port.exchange
    armed = False

    def drifted(sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        nonlocal armed
        seen.time_s = sample.time_s
        seen.gyro[:] = sample.gyro + drift * armed * np.cos(2 * np.pi * hz * sample.time_s)
        seen.specific_force[:] = sample.specific_force
        reply = exchange(seen, channels_us)
        armed = reply.armed
        return reply

    port.exchange = drifted  # type: ignore[method-assign]
    return port


def on_turned_board(port: Port, angles_deg: Sequence[float]) -> Port:
    """The port, what its gyro chip sits on turned in the aircraft; its settings need not say the same."""
    to_board = board_axes(angles_deg).T
    seen = Sample(0.0, np.zeros(3), np.eye(3), *np.zeros((3, 3)))
    exchange = port.exchange

    def turned(sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        seen.time_s = sample.time_s
        seen.gyro[:] = to_board @ sample.gyro
        seen.specific_force[:] = to_board @ sample.specific_force
        return exchange(seen, channels_us)

    port.exchange = turned  # type: ignore[method-assign]
    return port
