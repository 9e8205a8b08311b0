"""Which reading of the sticks a gyro proves, on flights whose rates are known."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.blackbox.firmware import Firmware, Maker
from neuroflight.sim.blackbox.proof import choose
from neuroflight.sim.blackbox.rates import RatesError, Reading, readings

RATE_HZ = 500.0
ROWS = 3000
UNTOLD = Firmware(Maker.BETAFLIGHT, (4, 3, 0))  # whose header lost rates_type: five styles
SEED = 7


def sticks_of(rng: np.random.Generator) -> np.ndarray:
    """Draw stick movements like a pilot's: strokes of 0.1 to 0.6 s, smoothed."""
    held = np.repeat(rng.uniform(-450, 450, (60, 3)), rng.integers(50, 300, 60), axis=0)[:ROWS]
    kernel = np.ones(20) / 20
    return np.rint(np.stack([np.convolve(held[:, axis], kernel, "same") for axis in range(3)], axis=1))


def flight(commands: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a gyro [deg/s] that follows the commands with a first-order lag of 30 ms, and noise."""
    gyro, now = np.empty_like(commands), np.zeros(3)
    for row, command in enumerate(commands):
        now = now + (command - now) / (0.03 * RATE_HZ)
        gyro[row] = now
    return gyro + rng.normal(0, 8, gyro.shape)


def header(rng: np.random.Generator) -> dict[str, str]:
    rates = {"rc_rates": rng.integers(20, 150, 3), "rates": rng.integers(30, 80, 3)}
    rates["rc_expo"] = rng.integers(0, 60, 3)
    return {name: ",".join(map(str, numbers.tolist())) for name, numbers in rates.items()}


def test_the_reading_that_was_flown_is_found_among_all_when_the_header_does_not_name_it() -> None:
    rng = np.random.default_rng(SEED)
    found = asked = 0
    for _ in range(60):
        every, sticks = readings(header(rng), UNTOLD), sticks_of(rng)
        rows = np.ones(len(sticks), bool)
        flown: Reading = every[rng.integers(len(every))]
        commands = flown.curve(sticks)
        try:
            chosen, note = choose(every, sticks, flight(commands, rng), rows, RATE_HZ)
        except RatesError as error:  # another fits as well: asked for, never assumed
            assert "as well as" in str(error)
            asked += 1
            continue
        assert not note and np.abs(chosen.curve(sticks) - commands).max() <= max(
            2.0, 0.03 * np.abs(commands).max()
        )
        found += 1
    assert found >= 36, f"{found} found, {asked} asked"


@pytest.mark.parametrize("factor", [0.0, 0.25, 0.5, 1.8, -1.0])
def test_rates_are_refused_when_the_gyro_turned_otherwise(factor: float) -> None:
    rng = np.random.default_rng(SEED)
    (reading,) = readings({**header(rng), "rates_type": "0"}, UNTOLD)
    sticks = sticks_of(rng)
    gyro = flight(factor * reading.curve(sticks), rng)
    with pytest.raises(RatesError, match="the gyro does not follow the sticks by Betaflight rates"):
        choose([reading], sticks, gyro, np.ones(len(sticks), bool), RATE_HZ)


def test_nothing_is_decided_when_nothing_was_flown() -> None:
    rng = np.random.default_rng(SEED)
    every, sticks = readings(header(rng), UNTOLD), sticks_of(rng)
    rows, gyro = np.ones(len(sticks), bool), np.zeros((len(sticks), 3))
    for seen, told in ((None, rows), (gyro, np.zeros_like(rows))):
        with pytest.raises(RatesError, match="between which its gyro does not decide"):
            choose(every, sticks, seen, told, RATE_HZ)
        chosen, note = choose(every[:1], sticks, seen, told, RATE_HZ)
        assert chosen is every[0] and note.startswith("not held against the gyro")
    # A stick at rest is the same by each of them.
    chosen, note = choose(every, np.zeros_like(sticks), gyro, rows, RATE_HZ)
    assert chosen is every[0] and note.endswith("too little was asked of the sticks")
