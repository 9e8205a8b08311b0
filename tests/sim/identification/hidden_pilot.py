"""A pilot of free flights who sees the aircraft: he keeps it up and level, and between that does as he likes.

He sits between the loop and a firmware: the loop's own sticks arm and disarm, his fly in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.control import sticks
from neuroflight.sim.ports.port import BatteryPort, FirmwarePort, Reply, RotorPort, Sample
from neuroflight.toolchain.contract import CHANNEL_ARM

FRAME_S = 0.01  # between two positions of his sticks
HAND_S = 0.02  # time constant of his hands
LEVEL_PER_S, LEVEL_MAX_DEG_S = 4.0, 250.0  # rate for each radian that he is off, and its limit
LEAN_PER_M_S, LEAN_MAX = 0.06, 0.8  # tangent of his lean for each m/s that lacks, and its limit
HEIGHT_PER_S, CLIMB_M_S = 0.8, 3.0  # speed for each metre that lacks, and its limit
THRUST_PER_M_S = 0.25  # share of the hover's throttle for each m/s that lacks


@dataclass(frozen=True)
class Move:
    """A stretch of a flight."""

    duration_s: float
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [deg/s], on top of levelling
    levels: bool = True  # he keeps it level (or leaning, with `speed`)
    throttle: float | None = None  # None: he keeps the height
    speed: tuple[float, float] = (0.0, 0.0)  # [m/s], world x and y, that he wants


class PilotedPort:
    """A firmware whose sticks are the pilot's while its arm switch is on."""

    def __init__(self, port: FirmwarePort, moves: Sequence[Move], hover: float) -> None:
        """hover: throttle at which it hovers, as he feels it."""
        self._port = port
        self.motor_count = port.motor_count
        self.gyro_rate_hz, self.control_rate_hz = port.gyro_rate_hz, port.control_rate_hz
        self._ends = np.cumsum([move.duration_s for move in moves])
        self._moves, self._hover = tuple(moves), hover
        self._every = round(FRAME_S * port.gyro_rate_hz)
        self._on = self._armed = False
        self._samples = self._since = 0  # samples so far, and since it was armed
        self._hands = np.array([0.0, 0.0, 0.0, hover])
        self._start: Array | None = None
        self.hears_rotors = isinstance(port, RotorPort) and port.hears_rotors

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        if channels_us is not None:
            self._on = channels_us[CHANNEL_ARM] > 1500
        if self._armed and self._on:
            channels_us = None
            if self._samples % self._every == 0:
                channels_us = self._sticks(sample)
            self._since += 1
        self._samples += 1
        reply = self._port.exchange(sample, channels_us)
        self._armed = reply.armed
        return reply

    def set_battery(self, volts: float, amps: float) -> None:
        if isinstance(self._port, BatteryPort):
            self._port.set_battery(volts, amps)

    def set_rotors(self, words: object) -> None:
        assert isinstance(self._port, RotorPort)
        self._port.set_rotors(words)  # type: ignore[arg-type]

    def arming_reasons(self) -> tuple[str, ...]:
        return self._port.arming_reasons()

    def close(self) -> None:
        self._port.close()

    def _sticks(self, sample: Sample) -> tuple[int, ...]:
        if self._start is None:
            self._start = sample.position.copy()
        at = min(
            int(np.searchsorted(self._ends, self._since / self.gyro_rate_hz, "right")), len(self._moves) - 1
        )
        move = self._moves[at]
        wanted = np.array([*move.rates, self._thrust(sample) if move.throttle is None else move.throttle])
        if move.levels:
            lean = LEAN_PER_M_S * (np.array(move.speed) - sample.velocity[:2])
            lean *= min(1.0, LEAN_MAX / max(1e-9, float(np.hypot(*lean))))
            up = sample.rotation.T @ (np.array([*lean, 1.0]) / np.sqrt(1.0 + lean @ lean))
            off = (
                np.array([-up[1], up[0]])
                if up[2] > 0
                else np.array([-up[1], up[0]]) / max(0.05, float(np.hypot(up[0], up[1])))
            )
            wanted[:2] += np.clip(np.rad2deg(LEVEL_PER_S * off), -LEVEL_MAX_DEG_S, LEVEL_MAX_DEG_S)
        self._hands += (wanted - self._hands) * (1.0 - np.exp(-FRAME_S / HAND_S))
        rates = np.clip(self._hands[:3], -990.0, 990.0)
        made = sticks.channels(tuple(rates), float(np.clip(self._hands[3], 0.0, 1.0)), armed=True)
        return tuple(int(width) for width in made)

    def _thrust(self, sample: Sample) -> float:
        assert self._start is not None
        climb = np.clip(HEIGHT_PER_S * (self._start[2] - sample.position[2]), -CLIMB_M_S, CLIMB_M_S)
        upright = max(0.5, float(sample.rotation[2, 2]))
        thrust = self._hover * (1.0 + THRUST_PER_M_S * (climb - sample.velocity[2])) / upright**0.7
        return float(np.clip(thrust, 0.3 * self._hover, 0.95))


def taps(rng: np.random.Generator, length_s: float) -> list[Move]:
    """Hover with taps of one stick at a time, to and fro."""
    moves = [Move(1.0)]
    while sum(move.duration_s for move in moves) < length_s:
        axis, size = int(rng.integers(3)), float(rng.uniform(80, 160) * rng.choice([-1, 1]))
        for sign in (1.0, -1.0):
            rates = [0.0, 0.0, 0.0]
            rates[axis] = sign * size
            moves += [Move(0.12, (rates[0], rates[1], rates[2])), Move(float(rng.uniform(0.2, 0.5)))]
    return moves


def freestyle(rng: np.random.Generator, length_s: float) -> list[Move]:
    """Rolls, flips, spins, punch-outs that end in a fall through the own wash, and fast turns."""
    moves = [Move(1.5)]
    while sum(move.duration_s for move in moves) < length_s:
        side = float(rng.choice([-1, 1]))
        match rng.integers(6):
            case 0:
                moves += [Move(360 / 600, (600 * side, 0, 0), False, 0.15), Move(1.5)]
            case 1:
                moves += [Move(360 / 550, (0, -550, 0), False, 0.15), Move(1.8)]
            case 2:
                moves += [Move(0.9, (0, 0, 300 * side)), Move(0.6)]
            case 3:
                moves += [Move(float(rng.uniform(0.3, 0.6)), throttle=float(rng.uniform(0.7, 1.0)))]
                moves += [Move(float(rng.uniform(0.4, 0.8)), throttle=0.05), Move(2.2)]
            case 4:
                way = rng.uniform(-np.pi, np.pi)
                speed = rng.uniform(5, 11)
                moves += [Move(2.5, speed=(speed * np.cos(way), speed * np.sin(way))), Move(1.5)]
            case _:
                moves += taps(rng, 3.0)[1:]
    return moves


def cruise(rng: np.random.Generator, length_s: float) -> list[Move]:
    """Calm flight: slow turns and changes of speed, nothing fast."""
    moves = [Move(1.5)]
    while sum(move.duration_s for move in moves) < length_s:
        way, speed = rng.uniform(-np.pi, np.pi), rng.uniform(1, 6)
        yaw = float(rng.uniform(-60, 60))
        moves.append(
            Move(float(rng.uniform(1.5, 3)), (0, 0, yaw), speed=(speed * np.cos(way), speed * np.sin(way)))
        )
    return moves


STYLES = {"taps": taps, "freestyle": freestyle, "cruise": cruise}
