"""Betaflight's settings by the search that finds a PID's (CMA-ES), on pulses at many throttles in the twin.

What is searched is what pilots tune: the sliders of its app (P and I, I, D, pitch over roll, filters of the
gyro and of D), yaw's P and I, the cutoff of I-term relax, TPA and thrust linearisation. Left as they are:
feedforward, which has no effect in the simulator (see sim/ports/betaflight/port.py); anti-gravity, which acts
while the throttle moves; the idle, which is the PID's too. RPM filter, dynamic notch and dynamic idle are not
in the simulator's build: it has no DShot, whose telemetry tells rotor speeds.

Pulses are flown whole: with the first second of each alone, the search finds settings that are worse over all
of it, because what I has gathered goes slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
from neuroflight.sim.ports.betaflight.tune import Tune
from neuroflight.training.evaluation.betaflight import record_betaflight
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.pid_tuning.cma_es import CmaEs
from neuroflight.training.pid_tuning.trial import (
    MARGIN,
    PENALTY,
    Trial,
    Tuning,
    held_commands,
    missed,
    throttles,
    training_commands,
    without_bias,
)
from neuroflight.training.pid_tuning.tuner import POPULATION, MakeTuner, search
from neuroflight.training.tasks.task import EpisodicTask, PulseTask, Setpoints, held

Settings = Mapping[str, int]

SPREAD = 0.3  # standard deviation of the search's first points
COMMANDS = 12  # pulses that each candidate flies
THROTTLE_MAX = 0.8  # of the pilot; that of a command is between 0 and this
HUNDRED = 100.0  # a point's 1, of knobs that are searched as they are


@dataclass(frozen=True)
class Knob:
    """A setting that is searched, or a factor of several."""

    default: float  # of Betaflight 4.6, as its `dump` says
    low: float
    high: float
    logarithmic: bool = True


GAIN_MAX = 250  # of P, I and D
KNOBS = {  # the first seven are factors of the defaults
    "P and I": Knob(1.0, 0.1, 4.0),  # of roll and pitch
    "I": Knob(1.0, 0.1, 4.0),  # of roll and pitch, once more
    "D": Knob(1.0, 0.1, 4.0),
    "pitch over roll": Knob(1.0, 0.3, 3.0),
    "yaw": Knob(1.0, 0.1, 4.0),  # P and I
    "gyro filter": Knob(1.0, 0.25, 2.0),  # at 2 the highest corner reaches Betaflight's limit of 1 kHz
    "D-term filter": Knob(1.0, 0.25, 2.0),
    "iterm_relax_cutoff": Knob(15, 1, 50),
    "tpa_rate": Knob(65, 0, 100, logarithmic=False),
    "thrust_linear": Knob(0, 0, 150, logarithmic=False),
}
PLAIN = ("iterm_relax_cutoff", "tpa_rate", "thrust_linear")
SCALED = {  # defaults of Betaflight 4.6, as its `dump` says, and the knobs that scale them
    "p_roll": (45, ("P and I",)),
    "i_roll": (80, ("P and I", "I")),
    "d_roll": (30, ("D",)),
    "d_max_roll": (40, ("D",)),
    "p_pitch": (47, ("P and I", "pitch over roll")),
    "i_pitch": (84, ("P and I", "I", "pitch over roll")),
    "d_pitch": (34, ("D", "pitch over roll")),
    "d_max_pitch": (46, ("D", "pitch over roll")),
    "p_yaw": (45, ("yaw",)),
    "i_yaw": (80, ("yaw",)),
    "gyro_lpf1_static_hz": (250, ("gyro filter",)),
    "gyro_lpf1_dyn_min_hz": (250, ("gyro filter",)),
    "gyro_lpf1_dyn_max_hz": (500, ("gyro filter",)),
    "gyro_lpf2_static_hz": (500, ("gyro filter",)),
    "dterm_lpf1_static_hz": (75, ("D-term filter",)),
    "dterm_lpf1_dyn_min_hz": (75, ("D-term filter",)),
    "dterm_lpf1_dyn_max_hz": (150, ("D-term filter",)),
    "dterm_lpf2_static_hz": (150, ("D-term filter",)),
}


def tune_betaflight(
    built: Betaflight,
    aircraft: Aircraft,
    change: float,
    *,
    seed: int,
    budget: int,
    progress: Callable[[int, Trial[Settings]], None],
    tuner: MakeTuner = CmaEs,
) -> Tuning[Settings]:
    """Search settings of least cost with about `budget` candidates (whole generations) of COMMANDS pulses
    each.

    change: the most that a motor value may change in 1 ms on average, fraction; tuner: what
    searches. The same arguments give the same settings. An interruption (KeyboardInterrupt) ends the search
    and keeps the best so far. Raises AircraftError if Betaflight cannot fly the aircraft, LinkError when one
    fails.
    """
    draw, rng, thrust = (np.random.default_rng(s) for s in np.random.SeedSequence([seed, 1]).spawn(3))
    pulses, levels = training_commands(COMMANDS, draw), throttles(COMMANDS, THROTTLE_MAX, thrust)
    flights = _Flights(built, without_bias(aircraft), change, seed, pulses, levels, held_commands())
    (defaults,) = flights.fly([{}])
    return search(
        tuner(start(), np.full(len(KNOBS), SPREAD), POPULATION, rng),
        lambda points: flights.fly([decoded(point) for point in points]),
        defaults,
        budget,
        progress,
    )


def start() -> Array:
    """Return the point of Betaflight's defaults."""
    return np.array(
        [math.log(knob.default) if knob.logarithmic else knob.default / HUNDRED for knob in KNOBS.values()]
    )


def decoded(point: Array) -> dict[str, int]:
    """Return the settings at a point of the search."""
    values = {
        name: min(max(math.exp(x) if knob.logarithmic else HUNDRED * x, knob.low), knob.high)
        for (name, knob), x in zip(KNOBS.items(), point.tolist(), strict=True)
    }
    found = {
        name: round(default * math.prod(values[knob] for knob in knobs))
        for name, (default, knobs) in SCALED.items()
    }
    found = {name: value if name.endswith("_hz") else min(value, GAIN_MAX) for name, value in found.items()}
    return found | {name: round(value) for name, value in values.items() if name in PLAIN}


@dataclass(frozen=True, eq=False)
class _Flights:
    """The flights that every candidate makes."""

    built: Betaflight
    aircraft: Aircraft
    change: float  # the limit
    seed: int  # of the gyro's noise
    commands: Array  # (n, 3) [rad/s], of the pulses
    throttle: Array32  # (n,), 0..1
    large: Array  # (m, 3) [rad/s], held

    def fly(self, candidates: Sequence[Settings]) -> list[Trial[Settings]]:
        """Fly each of the candidates. Large commands are flown at half of the greatest throttle."""
        half = np.full(len(self.large), THROTTLE_MAX / 2, np.float32)
        throttle = np.concatenate([self.throttle, half])
        with self._armed(candidates) as armed:
            flown = record_betaflight(
                armed,
                self.aircraft,
                _Commands(self.commands, self.large),
                episodes=len(armed) * len(throttle),
                seed=self.seed,
                throttle=np.tile(throttle, len(armed)),
            )
        firsts = range(0, len(flown.rate), len(throttle))
        return [
            self._trial(settings, _rows(flown, first, len(throttle)))
            for settings, first in zip(candidates, firsts, strict=True)
        ]

    @contextmanager
    def _armed(self, candidates: Sequence[Settings]) -> Iterator[list[ArmedBetaflight]]:
        """Arm a Betaflight with each of the settings, all at the same time: each mostly waits."""
        with ExitStack() as ends, ThreadPoolExecutor(len(candidates)) as pool:
            booting = [pool.submit(self._arm, settings) for settings in candidates]
            for future in booting:
                ends.callback(_close, future)
            yield [future.result() for future in booting]

    def _arm(self, settings: Settings) -> ArmedBetaflight:
        return ArmedBetaflight(self.built, self.aircraft, as_tune(settings) if settings else None)

    def _trial(self, settings: Settings, flown: Flights) -> Trial[Settings]:
        pulses = len(self.commands)
        pulsed, large = _rows(flown, 0, pulses), _rows(flown, pulses, len(self.large))
        assert pulsed.motors is not None
        mae = float(tracking(pulsed.setpoint, pulsed.rate, pulsed.step_s).mae.mean())
        change = effort(pulsed.motors, pulsed.step_s).change
        excess = max(0.0, change / (MARGIN * self.change) - 1.0)
        end = round(EpisodicTask().hold_s / large.step_s)
        beyond = missed(replace(large, setpoint=large.setpoint[:, :end], rate=large.rate[:, :end]))
        return Trial(settings, mae, change, beyond, mae + PENALTY * (excess + beyond))


@dataclass(frozen=True, eq=False)
class _Commands:
    """Pulses, and large commands that are held meanwhile, repeated for each candidate: all fly at a time."""

    name: ClassVar[str] = "pulses and large commands"
    commands: Array  # (n, 3) [rad/s], of the pulses
    large: Array  # (m, 3) [rad/s]

    @property
    def duration_s(self) -> float:
        """See Task."""
        return PulseTask().duration_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        pulses = PulseTask().of(self.commands, rate_hz)
        each = np.concatenate([pulses, held(self.large, self.duration_s, rate_hz)])
        return np.tile(each, (count // len(each), 1, 1))


def _rows(flown: Flights, first: int, count: int) -> Flights:
    """Return these episodes of `flown`."""
    rows = slice(first, first + count)
    assert flown.motors is not None
    return Flights(
        flown.setpoint[rows], flown.rate[rows], flown.output[rows], flown.step_s, motors=flown.motors[rows]
    )


def as_tune(settings: Settings, name: str = "candidate") -> Tune:
    """Return settings as a pilot's file would hold them."""
    return Tune(
        name,
        tuple((key, str(value)) for key, value in settings.items()),
        tuple(f"{name}:{number}" for number in range(1, len(settings) + 1)),
    )


def _close(booting: Future[ArmedBetaflight]) -> None:
    """End a Betaflight, unless it never came up."""
    if booting.exception() is None:
        booting.result().close()
