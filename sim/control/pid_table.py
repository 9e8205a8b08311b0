"""The PID that an image gets beside its policy: that of the aircraft, as the toolchain compiles it in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.aircraft.model import Aircraft, load_aircraft, shipped
from sim.control.pid import mixer, pid_settings
from toolchain.rendering.pid_table import PidTable


def pid_table(aircraft: Aircraft) -> PidTable | None:
    """The aircraft's first PID, None if it has none."""
    if not aircraft.pids:
        return None
    name = aircraft.pids[0][0]
    settings = pid_settings(aircraft, name)
    return PidTable(
        aircraft=aircraft.name,
        name=name,
        gains=np.array(settings.gains),
        derivative_cutoff_hz=settings.derivative_cutoff_hz,
        idle=settings.idle,
        mixer=mixer(aircraft) if settings.mixer is None else np.array(settings.mixer).T,
    )


def shipped_pid_table(name: str) -> PidTable | None:
    """That of the shipped aircraft called `name`, None if none is called so: a policy only tells a name."""
    return pid_table(load_aircraft(name)) if name in shipped() else None


def named_pid_table(aircraft: str | Path) -> PidTable | None:
    """That of the aircraft which the user names or whose file the user gives. Raises AircraftError."""
    return pid_table(load_aircraft(aircraft))
