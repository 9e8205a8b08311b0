"""The NF1's PID on any aircraft: its gains scaled by authority, axis by axis.

A gain turns deg/s into a motor fraction, and authority turns that into rad/s^2. With gains in the reverse
proportion of authority the loop of another aircraft is the NF1's again, but for lag, delay and noise.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from neuroflight.sim.aircraft.model import Aircraft, PidSettings, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.authority import authority_at
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer, pid_settings
from neuroflight.sim.design.figures import hovering
from neuroflight.training.evaluation.controllers import PID_RATE_HZ, ControllerSpec

SCALED = "pid:scaled"
REFERENCE, ITS_PID = "nf1", "flying"


def scaled_pid(aircraft: Aircraft) -> ControllerSpec:
    """Return the NF1's `flying` PID with gains for the aircraft."""
    reference = load_aircraft(REFERENCE)
    own = pid_settings(reference, ITS_PID)
    factor = authority(reference) / authority(aircraft)
    (roll, pitch, yaw) = (
        (scale * p, scale * i, scale * d) for scale, (p, i, d) in zip(factor.tolist(), own.gains, strict=True)
    )
    settings: PidSettings = replace(
        own, gains=(roll, pitch, yaw), mixer=None, nominal_voltage=aircraft.propulsion.supply_voltage
    )
    mix = mixer(aircraft)
    return ControllerSpec(
        name=SCALED,
        build=lambda count: Pid(mix, settings, count, PID_RATE_HZ),
        standing=lambda count: Pid(mix, settings, count, PID_RATE_HZ, standing=True),
        control_rate_hz=PID_RATE_HZ,
        idle=settings.idle,
        facts={"pid": "scaled"},
        mix=settings.mix,
        gyro_filters=settings.gyro_filters,
    )


def authority(aircraft: Aircraft) -> Array:
    """Compute the authority of the hovering aircraft, (3,) [rad/s^2]; at full command if it cannot hover."""
    hover = hovering(aircraft)
    return authority_at(aircraft, 1.0 if hover is None else float(hover.throttle.mean()))


@cache
def reference_authority() -> tuple[float, float, float]:
    """Return the authority of the NF1."""
    roll, pitch, yaw = authority(load_aircraft(REFERENCE)).tolist()
    return roll, pitch, yaw
