"""The aircraft's PID as the toolchain compiles it into an image beside the policy."""

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
        tpa_rate=settings.tpa_rate,
        tpa_breakpoint=settings.tpa_breakpoint,
        nominal_voltage=settings.nominal_voltage,
        mix=settings.mix,
    )


def shipped_pid_table(name: str) -> PidTable | None:
    """The PID of the shipped aircraft `name`; None if there is none: a policy holds only a name."""
    return pid_table(load_aircraft(name)) if name in shipped() else None


def named_pid_table(aircraft: str | Path) -> PidTable | None:
    """The PID of a shipped aircraft or of an aircraft file. Raises AircraftError."""
    return pid_table(load_aircraft(aircraft))
