"""The share of what a pilot's sticks made of a flight's rates that an aircraft file, or a fit, predicts.

A controller answers gusts and wash by the motors, so that of the rates as they are a true file explains
little, or less than none, of a windy flight. What goes with the sticks, which no gust moves, is what a file
has to say: the part of both spectra that is coherent with the setpoint's, in the band of a pilot's hands.
Source: Bendat and Piersol, Random Data, chapter 6, from memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.fit.estimate import Data, Wiring, prepare, say
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.gyro_path import Complex
from neuroflight.sim.identification.fit.model import Layout, layout, turned
from neuroflight.toolchain.contract import AXES

SLOW_S = 0.4  # of the means that pictures of rates leave out
WINDOW_S, WINDOWS_MIN = 0.5, 6  # of spectra
BAND_HZ = (2.0, 20.0)  # that pilots steer in
DOUBT_MAX = 0.15  # standard deviation of a share
HELD_S, HELD_PARTS = (
    5.0,
    8,
)  # length of the stretches, every fourth of which is held back; so many in a short log
HELD_OF = 4


def held_back(flight: Flight, times: Array) -> Flags:
    """Return which rows at `times` [s] of a flight are held back: a quarter of it, in stretches."""
    last = flight.pieces[-1]
    stretch = min(HELD_S, (last.start_s + last.seconds) / HELD_PARTS)
    return np.asarray((times // stretch).astype(int) % HELD_OF == HELD_OF - 1)


def straight(aircraft: Aircraft) -> Wiring:
    """Return the wiring as the file has it."""
    return Wiring(tuple(range(aircraft.motor_count)), tuple(aircraft.spins.tolist()))


def predict(data: Data, laid: Layout, theta: Array, wiring: Wiring) -> tuple[Array, Array]:
    """Return measured and predicted rates (N, 3) [rad/s] of a piece, both behind the fit's high-pass."""
    model, values = data.model, laid.values(theta)
    said, _, _ = say(model, values, wiring)
    return model.measured, data.heard(turned(model.course(said), values))


def explained(
    flights: Sequence[Flight],
    aircraft: Aircraft,
    keep: Callable[[Flight, Array], Flags] | None = None,
    fitted: tuple[Layout, Array, Wiring] | None = None,
) -> Array:
    """Compute the share (3,) of what the pilot's sticks made of the rates that is predicted, at most 1.

    By an aircraft as its file says, or by the parameters `fitted` of a fit that started there. keep: which
    rows at times (N,) [s] of a flight count, all unless given. NaN where the sticks moved an axis too little
    to tell, or were not logged.
    """
    if fitted is None:
        laid = layout(aircraft, speeds=False, pack=any(flight.pack for flight in flights))
        fitted = laid, laid.start, straight(aircraft)
    sums = [_Spectra() for _ in AXES]
    for data in prepare(flights, aircraft, keep):
        asked = data.model.piece.asked
        if asked is None:
            continue
        measured, said = predict(data, *fitted)
        for axis, sum_of in enumerate(sums):
            sum_of.add(
                asked[:, axis],
                measured[:, axis],
                (measured - said)[:, axis],
                data.used,
                data.model.piece.step_s,
            )
    return np.array([one.share() for one in sums])


class _Spectra:
    """Sums over windows of spectra of a command, of what was measured, and of what is left of it."""

    def __init__(self) -> None:
        self.windows = 0
        self.command: Array | None = None  # (F,) power
        self.cross: list[Complex] = []  # (F,) with the command, of both
        self.power: list[Array] = []  # (F,) of both

    def add(self, command: Array, measured: Array, left: Array, used: Flags, step: float) -> None:
        """Add the windows of a piece whose rows all count."""
        size = round(WINDOW_S / step)
        band = slice(round(BAND_HZ[0] * WINDOW_S), round(BAND_HZ[1] * WINDOW_S) + 1)
        taper = np.hanning(size + 1)[:-1]
        for start in range(0, len(command) - size + 1, size // 2):
            rows = slice(start, start + size)
            if not used[rows].all():
                continue
            one, *others = (
                np.fft.rfft(taper * (course[rows] - course[rows].mean()))[band] / size
                for course in (command, measured, left)
            )
            if self.command is None:
                self.command = np.zeros(len(one))
                self.cross = [np.zeros(len(one), complex) for _ in others]
                self.power = [np.zeros(len(one)) for _ in others]
            self.windows += 1
            self.command += np.abs(one) ** 2
            for at, other in enumerate(others):
                self.cross[at] += np.conj(one) * other
                self.power[at] += np.abs(other) ** 2

    def share(self) -> float:
        """Return the share of what goes with the command that is not left, chance taken off."""
        if self.command is None or self.windows < WINDOWS_MIN or not self.command.all():
            return np.nan
        found = []
        for cross, power in zip(self.cross, self.power, strict=True):
            together = np.abs(cross) ** 2 / self.command
            # What does not go with the command still does by chance in a finite number of windows.
            chance = (power - together) / (self.windows - 1)
            sure = np.maximum(together - chance, 0.0)
            doubt = np.sqrt((2.0 * sure * chance + chance**2).sum())
            found.append((float((together - chance).sum()), float(doubt)))
        (measured, _), (left, doubt) = found
        return np.nan if doubt > DOUBT_MAX * measured else float(min(1.0, 1.0 - left / measured))


def quick(rates: Array, width: int) -> tuple[Array, Array]:
    """Return rates (N, K) less their mean over `width` rows around, and that mean, where all are there."""
    sums = np.cumsum(np.vstack([np.zeros(rates.shape[1]), rates]), axis=0)
    mean = (sums[width:] - sums[:-width]) / width
    return rates[width // 2 : width // 2 + len(mean)] - mean, mean
