"""The aircraft of a policy, and its PID as the toolchain compiles it into an image beside the policy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.aircraft.identity import shipped_as, told
from sim.aircraft.model import Aircraft, aircraft_file, load_aircraft
from sim.control.pid import mixer, pid_settings
from toolchain.errors import BuildError
from toolchain.policy.model import PolicyModel
from toolchain.rendering.pid_table import PidTable


@dataclass(frozen=True)
class Beside:
    """What stands beside a policy in an image."""

    aircraft: Aircraft | None  # None: not known, and no PID is wanted
    name: str  # of it: a shipped one's, or a path
    own: bool  # whether the policy was trained on it
    pid: PidTable | None  # None: the user wants none


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


def beside(
    policy: PolicyModel, where: str, name: str | None = None, *, other: bool = False, no_pid: bool = False
) -> Beside:
    """Find what stands beside `policy` in an image: the PID of its own aircraft.

    where: the policy, in messages. name: of the aircraft, or its file; None: the policy's own, where that is
    a shipped one. other: an aircraft that the policy was not trained on is meant. no_pid: no PID is wanted.
    Raises BuildError, one line, on another aircraft and on one without a PID, AircraftError on no aircraft.
    """
    trained = f"{where} was trained on aircraft {told(policy.aircraft, policy.aircraft_sha256)}"
    stops = "--no-pid builds an image whose motors stop where the policy must not fly on"
    if name is None and (name := shipped_as(policy.aircraft_sha256)) is None:
        if no_pid:
            return Beside(None, "", own=True, pid=None)
        raise BuildError(
            f"{trained}, which is no shipped one: name its file with --aircraft FILE, whose PID is built in; "
            f"{stops}"
        )
    aircraft = load_aircraft(name)
    own = aircraft.is_meant_by(policy.aircraft_sha256)
    if not own and not other:
        raise BuildError(
            f"{trained}, and --aircraft {name} is {told(aircraft.name, aircraft.sha256)}: name the one that "
            "it was trained on, train one on this, or add --other-aircraft if that is meant"
        )
    if not aircraft.pids and not no_pid:
        raise BuildError(
            f"aircraft {name} has no PID to fall back to: find one with `neuroflight tune-pid --aircraft "
            f"{name} --write {aircraft_file(name)}`; {stops}"
        )
    return Beside(aircraft, name, own, None if no_pid else pid_table(aircraft))
