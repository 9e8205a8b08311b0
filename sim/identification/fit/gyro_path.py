"""The way from the aircraft's turning to the gyro in a log: filters, as their response over frequency.

Betaflight names its filters in the header. Of those that move in flight (RPM and dynamic notches, low-passes
that follow the throttle) the mean is taken. Names and meanings are those of Betaflight 3.1 to 2025.12's
headers, read in public logs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.headers import Headers
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.scales import header_number
from neuroflight.sim.blackbox.units import Channels

Complex = NDArray[np.complex128]
Response = Callable[[Array], Complex]  # over frequencies [Hz]

SCALED = 6  # GYRO_SCALED among Betaflight's debug modes since 3.3: the gyro before its filters, in deg/s
ALIKE_MIN = 0.9  # correlation of a debug channel with the gyro that it is to be, below 50 Hz
ORDER = {0: 1, 1: 0, 2: 2, 3: 3}  # of PTn by Betaflight's filter type; 1 is the biquad
PT_SHORT = {
    n: 1.0 / np.sqrt(2.0 ** (1.0 / n) - 1.0) for n in (1, 2, 3)
}  # cutoff of each stage over that of a PTn
BUTTER_Q = 1.0 / np.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class GyroPath:
    """The way of the gyro, as far as it is known."""

    words: str  # for the user
    response: Response
    mixed: bool  # filters are there that the log does not tell: delay stands for them, too

    @property
    def delay_s(self) -> float:
        """Delay of slow turning [s]."""
        return float(-np.angle(self.response(np.array([1.0])))[0] / (2 * np.pi))


def mean_path(control_s: float, gyro_s: float) -> GyroPath:
    """Return the path of the mean of the samples of a control step, which Neuroflight takes."""
    count = max(1, round(control_s / gyro_s))
    late = 0.5 * (count - 1) * gyro_s
    return GyroPath(
        f"mean of the {count} samples of a control step", lambda f: np.exp(-2j * np.pi * f * late), False
    )


def raw_gyro(log: Log, told: Channels) -> tuple[Array | None, str]:
    """Return the gyro before the firmware's filters (N, 3) [rad/s] and its field; None: it was not logged."""
    if told.gyro_unfiltered is not None and told.gyro_unfiltered.any():
        return told.gyro_unfiltered.astype(np.float64), "gyroUnfilt"
    debug = log.matrix("debug", 3)
    if header_number(log.header, "debug_mode") != SCALED or debug is None or told.gyro is None:
        return None, ""
    raw = np.deg2rad(debug.astype(np.float64))
    # Is it what it is taken for? Axes and scale show in the slow part.
    width = max(1, round(log.rate_hz / 50.0))
    kernel = np.ones(width) / width
    for axis in range(3):
        one, other = (np.convolve(v, kernel, "valid") for v in (raw[:, axis], told.gyro[:, axis]))
        spread = float(one.std() * other.std())
        if spread == 0.0 or float(np.mean((one - one.mean()) * (other - other.mean()))) / spread < ALIKE_MIN:
            return None, ""
        if not 0.8 < float(one.std() / other.std()) < 1.25:
            return None, ""
    return raw, "debug (GYRO_SCALED)"


def logged_path(headers: Headers, raw: bool, whence: str) -> GyroPath:
    """Return the path of a Betaflight log's gyro by its header's filters; raw: before them."""
    values = headers.values
    if raw:
        return GyroPath(f"{whence}: before the firmware's filters", lambda f: np.ones(len(f), complex), False)
    stages: list[Response] = []
    said: list[str] = []

    def number(*names: str) -> float:
        for name in names:
            found = header_number(values, name)
            if found is not None:
                return found
        return 0.0

    def low_pass(kind: float, cutoff: float, name: str) -> None:
        if cutoff <= 0:
            return
        order = ORDER.get(int(kind), 1)
        stages.append(_biquad(cutoff) if order == 0 else _pt(order, cutoff))
        said.append(f"{name} {'biquad' if order == 0 else f'PT{order}'} {cutoff:g} Hz")

    moving = headers.integers("gyro_lpf1_dyn_hz") or headers.integers("gyro_lowpass_dyn_hz")
    first = number("gyro_lpf1_static_hz", "gyro_lowpass_hz", "gyro_lpf_hz")
    if len(moving) == 2 and moving[0] > 0:
        first = float(np.sqrt(moving[0] * moving[1]))
    low_pass(
        number("gyro_lpf1_type", "gyro_soft_type", "gyro_lowpass_type", "gyro_soft_lpf_type"),
        first,
        "low-pass",
    )
    second = number("gyro_lpf2_static_hz", "gyro_lowpass2_hz", "gyro_soft2_lpf_hz")
    low_pass(number("gyro_lpf2_type", "gyro_soft2_type", "gyro_lowpass2_type"), second, "low-pass 2")
    if not any(name in values for name in ("gyro_lpf1_static_hz", "gyro_lowpass_hz", "gyro_lpf_hz")):
        return GyroPath("not told by the header", lambda f: np.ones(len(f), complex), True)
    centres, cutoffs = headers.integers("gyro_notch_hz"), headers.integers("gyro_notch_cutoff")
    for middle, cutoff in zip(centres, cutoffs, strict=False):
        if middle > cutoff > 0:
            stages.append(_notch(middle, middle * cutoff / (middle**2 - cutoff**2)))
            said.append(f"notch {middle} Hz")
    count = int(number("dyn_notch_count"))
    if count and (quality := number("dyn_notch_q")) > 0:
        low, high = number("dyn_notch_min_hz") or 100.0, number("dyn_notch_max_hz") or 600.0
        centre = float(np.sqrt(low * high))
        stages.append(_power(_notch(centre, quality / 100.0), count))
        said.append(f"{count} dynamic notches")
    if (quality := number("rpm_filter_q", "gyro_rpm_notch_q")) > 0 and (
        harmonics := int(number("rpm_filter_harmonics", "gyro_rpm_notch_harmonics"))
    ):
        lowest = number("rpm_filter_min_hz", "gyro_rpm_notch_min") or 100.0
        for harmonic in range(1, harmonics + 1):
            stages.append(_power(_notch(2.0 * lowest * harmonic, quality / 100.0), 4))
        said.append(f"RPM filter, {harmonics} harmonics")

    def response(f: Array) -> Complex:
        value = np.ones(len(f), complex)
        for stage in stages:
            value = value * stage(f)
        return value

    return GyroPath(", ".join(said) or "no filters", response, False)


def _pt(order: int, cutoff: float) -> Response:
    stage = cutoff * PT_SHORT[order]
    return lambda f: (1.0 / (1.0 + 1j * f / stage)) ** order


def _biquad(cutoff: float) -> Response:
    return lambda f: 1.0 / (1.0 - (f / cutoff) ** 2 + 1j * f / cutoff / BUTTER_Q)


def _notch(centre: float, quality: float) -> Response:
    def response(f: Array) -> Complex:
        x = f / centre
        top = 1.0 - x**2
        return np.asarray(top / (top + 1j * x / quality))

    return response


def _power(one: Response, count: int) -> Response:
    return lambda f: one(f) ** count
