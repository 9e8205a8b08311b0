"""Rates of each style, against the setpoints that Betaflight's SITL makes of the same sticks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.blackbox.firmware import firmware
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.blackbox.rates import Style, readings
from neuroflight.sim.blackbox.sticks import is_stick
from neuroflight.sim.blackbox.units import channels
from tests.peers.betaflight_logs import VIRTUAL, flown, save
from tests.sampling import PROVES

FULL_RATE = ("set blackbox_sample_rate = 1/1", "set blackbox_high_resolution = ON", "set rc_smoothing = OFF")
AXES = ("roll", "pitch", "yaw")
# rc_rate, srate, expo of roll, pitch, yaw.
SETTINGS = {
    Style.BETAFLIGHT: ((130, 204, 80), (60, 50, 30), (40, 0, 25)),
    Style.RACEFLIGHT: ((37, 60, 45), (80, 20, 0), (50, 0, 20)),
    Style.KISS: ((100, 160, 80), (70, 20, 60), (50, 0, 20)),
    Style.ACTUAL: ((12, 20, 7), (90, 67, 67), (54, 0, 20)),
    Style.QUICK: ((100, 130, 90), (80, 67, 67), (54, 0, 20)),
}
ROUNDED = 0.0501  # [deg/s] half of the tenths that are logged


def sticks(path: Path) -> Path:
    """Write a scenario of random stick positions on each axis, of which a fifth are at the ends."""
    rng = np.random.default_rng(6)
    size = (60 if PROVES else 24, 3)
    places = np.where(
        rng.random(size) < 0.2, rng.choice([-1000, 1000], size), 2 * rng.integers(-500, 501, size)
    )
    strokes = [
        f"[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = {row}\nthrottle = 0.3\n" for row in places.tolist()
    ]
    path.write_text('name = "sticks"\nmount = "centre"\n' + "".join(strokes))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("style", "more"),
    [
        (Style.QUICK, ("set quickrates_rc_expo = OFF", "set deadband = 12", "set yaw_deadband = 20")),
        pytest.param(Style.QUICK, ("set quickrates_rc_expo = ON",), marks=pytest.mark.slow),
        *(pytest.param(style, (), marks=pytest.mark.slow) for style in SETTINGS if style is not Style.QUICK),
    ],
)
def test_rates_are_betaflights_when_it_logs_sticks_and_setpoint(
    style: Style, more: tuple[str, ...], tmp_path: Path
) -> None:
    told = [f"set rates_type = {style.name}"]
    for name, numbers in zip(("rc_rate", "srate", "expo"), SETTINGS[style], strict=True):
        told += [f"set {axis}_{name} = {number}" for axis, number in zip(AXES, numbers, strict=True)]
    data, _ = flown(str(sticks(tmp_path / "sticks.toml")), VIRTUAL, *FULL_RATE, *told, *more)
    log = read_log(save(tmp_path / "LOG00001.BFL", data))
    hand, setpoint = log.matrix("rcCommand", 3), log.matrix("setpoint", 3)
    assert hand is not None and setpoint is not None
    assert (np.abs(hand).max(axis=0) >= 4800).all()
    near = [
        np.abs(reading.curve(hand / 10) - setpoint / 10).max()
        for reading in readings(log.header, firmware(log.header))
    ]
    # The log does not tell quickrates_rc_expo: one of both is right, and the other far away.
    assert min(near) < ROUNDED and (len(near) == 1 or (len(near) == 2 and max(near) > 10))
    asked = channels(log).pilot
    assert asked.throttle is not None and is_stick(asked.throttle).all()
