"""A simulated dynamometer: records one rotor driven through steps and a ramp of throttle.

A recording is what a bench logs: time, throttle, rotor speed, thrust and torque. The torque is the
propeller's drag, without the reaction to the rotor's own acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.aircraft.model import Propulsion
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.signal import JUMP, SETTLED_S, jumps, without_spikes
from neuroflight.sim.physics.rotor import speeds_along, target_speed, thrust_and_torque

STEP_LEVELS = (0.25, 0.5, 0.75, 1.0)  # throttle; Koch 2019, chapter 5
RAMP_S = 40.0  # 0 to 1 and back; Koch 2019, chapter 5
REST_S, HOLD_S = 1.0, 2.0  # [s], throttle off before the first step and after each, throttle held
HELD_S = 0.95  # [s] that throttle has to be held for to count as a step: Koch holds it for 1 s
SIMULATION_HZ = 2000  # fine against the fastest rotor's lag of some 10 ms
RATE_HZ_MIN, RATE_HZ_MAX = 10, SIMULATION_HZ
JITTER, LOST = 0.5, 0.05  # of an uneven log: part of a period that rows are off, part of rows missing


@dataclass(frozen=True)
class Phase:
    """A stretch of an experiment in which throttle moves evenly."""

    duration: float  # [s]
    first: float  # throttle at its beginning, 0..1
    last: float  # and at its end


def steps_held(hold: float, top: float = 1.0) -> tuple[Phase, ...]:
    """Return a step to each of STEP_LEVELS of `top`, held for `hold` [s], with as long a rest after it."""
    held = [(Phase(hold, top * level, top * level), Phase(hold, 0.0, 0.0)) for level in STEP_LEVELS]
    return (Phase(REST_S, 0.0, 0.0), *(phase for pair in held for phase in pair))


def ramp(length: float, top: float = 1.0) -> tuple[Phase, ...]:
    """Return throttle that rises evenly to `top` and falls again in `length` [s], with rests around it."""
    rising, falling = Phase(length / 2, 0.0, top), Phase(length / 2, top, 0.0)
    return (Phase(REST_S, 0.0, 0.0), rising, falling, Phase(HOLD_S, 0.0, 0.0))


STEPS = steps_held(HOLD_S)
RAMP = ramp(RAMP_S)
KINDS = ("steps", "ramp")
EXPERIMENTS = {"steps": STEPS, "ramp": RAMP, "all": (*STEPS, *RAMP)}


@dataclass(frozen=True)
class Step:
    """Figures of one step from rest."""

    level: float  # throttle
    rise: float  # [s], from the command to 90 % of the settled speed
    speed: float  # [rad/s], settled: the median of the last half second
    thrust: float  # [N]
    torque: float  # [N m]


def duration(experiment: tuple[Phase, ...]) -> float:
    """Return the length of an experiment [s]."""
    return sum(phase.duration for phase in experiment)


def throttle_at(time: Array, experiment: tuple[Phase, ...]) -> Array:
    """Return the commanded throttle at `time` [s], any shape; outside the experiment that of its ends."""
    lengths = np.array([phase.duration for phase in experiment])
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    first = np.array([phase.first for phase in experiment])
    last = np.array([phase.last for phase in experiment])
    index = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
    part = np.clip((time - starts[index]) / lengths[index], 0.0, 1.0)
    throttle: Array = first[index] + (last[index] - first[index]) * part
    return throttle


def sample_times(length: float, rate_hz: float, rng: np.random.Generator | None = None) -> Array:
    """Return the times of a log's rows over `length` [s]; with `rng` uneven, and some rows lost."""
    count = int(length * rate_hz)
    if rng is None:
        return np.arange(count) / rate_hz
    time = np.cumsum(rng.uniform(1 - JITTER, 1 + JITTER, count)) / rate_hz
    return time[(rng.random(count) >= LOST) & (time < length)]


def run(propulsion: Propulsion, experiment: tuple[Phase, ...], time: Array) -> Recording:
    """Drive one rotor, at rest first, through `experiment`; read it at `time` [s], (N,), rising.

    Speed, thrust and torque are those of `sim.physics.rotor`, the command acts the aircraft's `delay` late.
    """
    dt = 1.0 / SIMULATION_HZ
    grid = np.arange(int(time[-1] / dt) + 3, dtype=np.float64) * dt
    targets = target_speed(throttle_at(grid, experiment), propulsion)
    speeds = speeds_along(targets[:1], targets[:-1, None], dt, propulsion)[:, 0]
    speed = np.interp(time - propulsion.delay, grid, speeds)
    thrust, torque = thrust_and_torque(speed, propulsion)
    return Recording(time, throttle_at(time, experiment), speed, thrust, torque)


def disturbed(
    recording: Recording,
    rng: np.random.Generator,
    *,
    noise: float = 0.0,
    of_reading: bool = False,
    outliers: float = 0.0,
) -> Recording:
    """Return `recording` as a poor bench would log it: speed, thrust and torque with noise and outliers.

    noise: standard deviation, as a fraction of the channel's largest value or, `of_reading`, of each value.
    outliers: fraction of a channel's values replaced by anything from 0 to twice its largest value.
    """
    channels: dict[str, Array] = {}
    for name in ("speed", "thrust", "torque"):
        true: Array = getattr(recording, name)
        full = float(np.abs(true).max())
        values = true + noise * rng.standard_normal(len(true)) * (np.abs(true) if of_reading else full)
        hit = rng.random(len(true)) < outliers
        channels[name] = np.where(hit, rng.uniform(0.0, 2.0 * full, len(true)), values)
    return replace(recording, **channels)  # type: ignore[arg-type]


def steps(recording: Recording) -> tuple[Step, ...]:
    """Compute the figures of every jump of throttle from rest that is held for at least HELD_S."""
    rows = jumps(recording)
    ends = np.append(rows, len(recording.time))
    speed = without_spikes(recording.speed, recording.starts)
    found = []
    for row, end in zip(rows, ends[1:], strict=True):
        end = min([end, *(start for start in recording.starts if start > row)])
        time = recording.time[row:end] - recording.time[row]
        level = float(np.median(recording.throttle[row:end]))
        if recording.throttle[row - 1] > JUMP or level <= JUMP or time[-1] < HELD_S:
            continue
        if np.ptp(without_spikes(recording.throttle[row:end])) > JUMP:  # a ramp begins with this jump
            continue
        last = slice(row + int(np.searchsorted(time, time[-1] - SETTLED_S)), end)
        settled = float(np.median(recording.speed[last]))
        found.append(
            Step(
                level=level,
                rise=float(time[np.argmax(speed[row:end] >= 0.9 * settled)]),
                speed=settled,
                thrust=float(np.median(recording.thrust[last])),
                torque=float(np.median(recording.torque[last])),
            )
        )
    return tuple(found)
