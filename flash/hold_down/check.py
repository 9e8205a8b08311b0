"""The check: pulses of each motor, gentle ones first, until what they do is sure or the limit is reached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from neuroflight.flash.board.turn import Axes
from neuroflight.flash.hold_down.pulses import Pulses
from neuroflight.flash.hold_down.reaction import Array, Reaction, Record, reactions
from neuroflight.flash.hold_down.wiring import Layout, Wiring, find_wiring
from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.flash.motors.readiness import check_ready
from neuroflight.toolchain.contract import MSP_ACCELERATION_COUNTS, Msp

PULSES = 4  # of a motor in each round
ROUNDS_AT_LIMIT = 3
LOUDER = 1.4  # from one round to the next
LOOKS = 25  # at the accelerometer


@dataclass(frozen=True, eq=False)
class Checked:
    """The outcome of all rounds."""

    wiring: Wiring
    reactions: tuple[Reaction, ...]  # motor order, about the aircraft's true axes
    fraction: float  # of the last pulses


def acceleration(client: Client) -> Array:
    """Return the mean of some looks at the accelerometer, body axes, (3,) [g]."""
    looks = [messages.raw_imu(client.request(Msp.RAW_IMU)).acceleration for _ in range(LOOKS)]
    return np.asarray(np.mean(looks, axis=0) / MSP_ACCELERATION_COUNTS)


def check(
    client: Client,
    layout: Layout,
    control_rate_hz: int,
    seen: Axes,
    fraction: float,
    limit: float,
    tell: Callable[[str], None] = lambda line: None,
) -> Checked:
    """Turn each motor until its wiring is known, or nothing more is to be done within `limit`.

    seen: the body's true axes in the firmware's (nose.py). fraction: of the first pulses; limit: of the last.
    tell: gets a line for each round. Raises LinkError, with the motors stopped.
    """
    to_body, count, rng = np.array(seen), len(layout.spins), np.random.default_rng()
    rounds = _fractions(fraction, limit)
    records: list[Record] = []
    for number, now in enumerate(rounds):
        tell(f"pulses of {now:.0%} of each motor's range")
        for motor in range(count):
            check_ready(client)
            with Pulses(client, count, control_rate_hz, now, rng) as pulses:
                told = pulses.record(motor, PULSES)
            turned = replace(told, rates=told.rates @ to_body.T)
            if number == 0 or now != rounds[number - 1]:  # what other pulses did is no part of a mean
                records = [*records[:motor], turned, *records[motor + 1 :]]
            else:
                records[motor] = _joined(records[motor], turned)
        found = reactions(records)
        wiring = find_wiring(layout, found)
        if not any(wiring.unsure):
            break
    return Checked(wiring, found, now)


def _joined(before: Record, after: Record) -> Record:
    """Return the record of both."""
    return Record(
        times=np.concatenate([before.times, after.times]),
        rates=np.concatenate([before.rates, after.rates]),
        level=np.concatenate([before.level, after.level]),
        rpm=after.rpm,
    )


def _fractions(first: float, limit: float) -> list[float]:
    """Return the fraction of each round."""
    found = [min(first, limit)]
    while found[-1] < limit:
        found.append(round(min(limit, LOUDER * found[-1]), 3))
    return found + [limit] * (ROUNDS_AT_LIMIT - 1)
