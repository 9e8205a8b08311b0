"""The PID of an aircraft as the firmware is given it, and what stands beside a policy in an image.

The twin's PIDs (`sim.control.pid`) and an image get the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.identity import shipped_as, told
from neuroflight.sim.aircraft.model import Aircraft, PidSettings, aircraft_file, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import AircraftError, BuildError
from neuroflight.toolchain.policy.model import PolicyModel
from neuroflight.toolchain.rendering.pid_table import PidTable


@dataclass(frozen=True)
class Beside:
    """The controllers beside a policy in an image."""

    aircraft: Aircraft | None  # None: not known, and no PID is wanted
    name: str  # of it: a shipped one's, or a path
    own: bool  # whether the policy was trained on it
    pid: PidTable | None  # None: the user wants none


def mixer(aircraft: Aircraft) -> Array:
    """Return the share of each motor (M) in roll, pitch and yaw (3), (M, 3); the largest of an axis is 1.

    A rotor left of the centre of mass (y > 0) rolls right, one behind it (x < 0) pitches the nose down, one
    that turns clockwise yaws left by its reaction. Of all shares that turn one axis alone and add no
    thrust, these are the smallest.
    """
    x, y = aircraft.rotor_positions[:, :2].T
    moments = np.stack([y, -x, -aircraft.spins, np.ones(aircraft.motor_count)])  # a newton of each rotor
    shares = np.linalg.pinv(moments)[:, :3]
    scaled: Array = shares / np.abs(shares).max(axis=0)
    return scaled


def pid_mixer(aircraft: Aircraft, settings: PidSettings) -> Array:
    """Return the mixer (M, 3) that the settings name, else that of the geometry."""
    return mixer(aircraft) if settings.mixer is None else np.array(settings.mixer).T


def pid_settings(aircraft: Aircraft, name: str | None = None) -> PidSettings:
    """Return the settings of the PID called `name`, the first one unless given. Raises AircraftError."""
    pids = dict(aircraft.pids)
    if not pids:
        raise AircraftError(
            f"aircraft {aircraft.name}: no [pid.NAME] table with roll, pitch, yaw gains; add one, or let "
            f"`neuroflight pid tune --out` do it"
        )
    if name is not None and name not in pids:
        raise AircraftError(f"aircraft {aircraft.name}: no PID {name!r}; it has: {', '.join(pids)}")
    return pids[name or next(iter(pids))]


def settings_table(settings: PidSettings, mix: Array, aircraft: str, name: str) -> PidTable:
    """Return a PID as the toolchain takes it; mix: (M, 3), used whatever the settings name."""
    return PidTable(
        aircraft=aircraft,
        name=name,
        gains=np.array(settings.gains),
        derivative_cutoff_hz=settings.derivative_cutoff_hz,
        idle=settings.idle,
        mixer=mix,
        tpa_rate=settings.tpa_rate,
        tpa_breakpoint=settings.tpa_breakpoint,
        nominal_voltage=settings.nominal_voltage,
        mix=settings.mix,
    )


def pid_table(aircraft: Aircraft) -> PidTable | None:
    """Return the aircraft's first PID, None if it has none."""
    if not aircraft.pids:
        return None
    name, settings = aircraft.pids[0]
    return settings_table(settings, pid_mixer(aircraft, settings), aircraft.name, name)


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
            f"aircraft {name} has no PID to fall back to: find one with `neuroflight pid tune --aircraft "
            f"{name} --out {aircraft_file(name)}`; {stops}"
        )
    return Beside(aircraft, name, own, None if no_pid else pid_table(aircraft))
