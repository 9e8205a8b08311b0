"""Scenarios: what the pilot's sticks do in a flight, from a seed or from a file.

A file is TOML:

    name = "left then right"
    mount = "centre"            # centre, rig or free
    [[segment]]
    duration_s = 0.5
    setpoint_deg_s = [0, 0, 120]   # roll right +, pitch nose down +, yaw left +
    throttle = 0.2              # 0 unless given
    receiver = "lost"           # "on" unless given; "lost" sends no frames
    controller = "pid"          # "policy" unless given: how the pilot's switch stands
    height_m = 2.0              # instead of throttle: the pilot flies there by eye, 0 is landing
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Flags
from neuroflight.sim.control import sticks
from neuroflight.sim.flight.freestyle import FRAME_S, stick_strokes
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
from neuroflight.toolchain.errors import ScenarioError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml

Rates = tuple[float, float, float]  # roll, pitch, yaw [deg/s]
STILL: Rates = (0.0, 0.0, 0.0)
COMMAND_SIGMA_DEG_S = 100.0  # Koch 2019, ch. 5: training and test commands from N(0, 100 deg/s)
PULSE_IDLE_S, PULSE_HOLD_S, PULSE_REST_S = 0.5, 2.0, 2.0  # Koch 2019, ch. 5
PULSE_S = PULSE_IDLE_S + PULSE_HOLD_S + PULSE_REST_S
TURN_DEG_S = 720.0  # rate of the acrobatic figures: a full turn in half a second
HOVER_S = 15.0  # of centred sticks at the end of `flight`
COMMANDS = 10  # of `flight` and `pulses`
FILE_BYTES_MAX = 1 << 20
SEGMENTS_MAX = 10_000
SEGMENT_S_MIN, SEGMENT_S_MAX = 0.001, 3600.0  # one control step at 1 kHz to an hour
HEIGHT_MAX_M = 100.0


@dataclass(frozen=True)
class Segment:
    """Sticks held still for a while, or those of a pilot who flies to a height; see eye_pilot."""

    duration_s: float
    setpoint_deg_s: Rates = STILL  # roll, pitch, yaw [deg/s], body frame
    throttle: float = 0.0  # 0..1
    receiver: bool = True  # False: the transmitter is silent
    pid: bool = False  # the switch chooses the PID
    height_m: float | None = None  # above the start, in place of roll, pitch and throttle; 0: land


@dataclass(frozen=True)
class Scenario:
    """A flight's sticks from the first armed control step on."""

    name: str
    segments: tuple[Segment, ...]
    mount: Mount = Mount.CENTRE
    episode_s: float | None = None  # length of each of its equal episodes; None: the whole is one
    hover_s: float = 0.0  # of centred sticks at its end, behind the episodes; 0: none

    def under_pid(self) -> Scenario:
        """Return the same flight with the pilot's switch at the PID."""
        return replace(self, segments=tuple(replace(segment, pid=True) for segment in self.segments))

    @property
    def by_eye(self) -> bool:
        """True if sticks depend on what the pilot sees: `timeline` then has only their beginnings."""
        return any(segment.height_m is not None for segment in self.segments)

    @property
    def duration_s(self) -> float:
        """Length of the flight [s]."""
        return sum(segment.duration_s for segment in self.segments)

    def timeline(self, control_rate_hz: int) -> tuple[NDArray[np.uint16], Flags]:
        """Return channels [us] (N, CHANNEL_COUNT), and True where the receiver is heard (N,), per step.

        Raises ScenarioError on sticks beyond their ends or a flight shorter than one control step.
        """
        counts = self.steps(control_rate_hz)
        if counts.sum() < 1:
            raise ScenarioError(
                f"scenario {self.name}: shorter than one control step at {control_rate_hz} Hz"
            )
        us = sticks.channels(
            [segment.setpoint_deg_s for segment in self.segments],
            [segment.throttle for segment in self.segments],
            armed=True,
            pid=[segment.pid for segment in self.segments],
        )
        heard = np.array([segment.receiver for segment in self.segments])
        return np.repeat(us, counts, axis=0), np.repeat(heard, counts)

    def steps(self, control_rate_hz: int) -> NDArray[np.int64]:
        """Return the control steps of each segment."""
        ends = np.cumsum([segment.duration_s for segment in self.segments])
        steps: NDArray[np.int64] = np.diff(np.rint(ends * control_rate_hz).astype(np.int64), prepend=0)
        return steps

    def episodes(self) -> int:
        """Return the number of equal episodes that the figures are averaged over."""
        return 1 if self.episode_s is None else round((self.duration_s - self.hover_s) / self.episode_s)


def pulses(seed: int, count: int, name: str = "pulses", throttle: float = 0.0) -> Scenario:
    """Draw `count` commands one after another: still, a command drawn for each axis, still again."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(0.0, COMMAND_SIGMA_DEG_S, (count, 3))
    segments: list[Segment] = []
    for roll, pitch, yaw in drawn.clip(-RATE_FULL_STICK_DEG_S, RATE_FULL_STICK_DEG_S).tolist():
        segments += (
            Segment(PULSE_IDLE_S, throttle=throttle),
            Segment(PULSE_HOLD_S, (roll, pitch, yaw), throttle),
            Segment(PULSE_REST_S, throttle=throttle),
        )
    return Scenario(name, tuple(segments), episode_s=PULSE_S)


def flight(seed: int, count: int, throttle: float = 0.0) -> Scenario:
    """Return the same commands and a hover, which shows whether the aircraft holds."""
    commands = pulses(seed, count, "flight", throttle)
    hover = Segment(HOVER_S, throttle=throttle)
    return replace(commands, segments=(*commands.segments, hover), hover_s=HOVER_S)


def turn(name: str, axis: int, throttle: float = 0.0) -> Scenario:
    """Return one full turn about `axis` and back to still."""
    rates = [0.0, 0.0, 0.0]
    rates[axis] = TURN_DEG_S
    still = Segment(PULSE_IDLE_S, throttle=throttle)
    fast = Segment(360 / TURN_DEG_S, (rates[0], rates[1], rates[2]), throttle)
    return Scenario(name, (still, fast, still))


def turns(throttle: float = 0.0) -> Scenario:
    """Return full turns about each axis, both ways, at TURN_DEG_S and at full stick, with rests."""
    segments = [Segment(PULSE_IDLE_S, throttle=throttle)]
    for rate, axis, sign in product((TURN_DEG_S, float(RATE_FULL_STICK_DEG_S)), range(3), (1.0, -1.0)):
        rates = [0.0, 0.0, 0.0]
        rates[axis] = sign * rate
        segments.append(Segment(360 / rate, (rates[0], rates[1], rates[2]), throttle))
        segments.append(Segment(PULSE_IDLE_S, throttle=throttle))
    return Scenario("turns", tuple(segments))


def sticks_flight() -> Scenario:
    """Arm on the ground, take off, hover, climb, turn, descend, land, close the throttle."""
    segments = (
        Segment(0.5),
        Segment(5.0, height_m=1.5),
        Segment(5.0, height_m=4.0),
        Segment(2.0, (0.0, 0.0, 90.0), height_m=4.0),
        Segment(5.0, height_m=1.5),
        Segment(6.0, height_m=0.0),
        Segment(0.5),
    )
    return Scenario("sticks", segments, Mount.FREE)


def freestyle(seed: int) -> Scenario:
    """Draw a minute of a pilot's cruising and aerobatics from `seed`; see `sim.flight.freestyle`."""
    rates, throttle = stick_strokes(seed)
    flown = zip(rates.tolist(), throttle.tolist(), strict=True)
    segments = (Segment(FRAME_S, (roll, pitch, yaw), thrust) for (roll, pitch, yaw), thrust in flown)
    return Scenario("freestyle", tuple(segments))


AT_THROTTLE: dict[str, tuple[str, Callable[[int, int, float], Scenario]]] = {  # that the pilot chooses
    "flight": (f"{COMMANDS} commands one after another (unless --count), then a hover of 15 s", flight),
    "pulse": (
        "one command: 0.5 s still, 2 s held, 2 s still",
        lambda seed, _, throttle: pulses(seed, 1, "pulse", throttle),
    ),
    "pulses": (
        f"commands like `pulse`'s, one after another ({COMMANDS} unless --count)",
        lambda seed, count, throttle: pulses(seed, count, throttle=throttle),
    ),
    "roll": ("a full turn to the right in half a second", lambda _, __, throttle: turn("roll", 0, throttle)),
    "flip": ("a full turn forward in half a second", lambda _, __, throttle: turn("flip", 1, throttle)),
    "turns": (
        "twelve full turns: each axis, both ways, at 720 and 1,000 deg/s",
        lambda _, __, throttle: turns(throttle),
    ),
}
BUILDERS: dict[str, tuple[str, Callable[[int, int, float], Scenario]]] = {
    **AT_THROTTLE,
    "sticks": (
        "take-off to landing by eye, in free flight: fly it with --ground",
        lambda *_: sticks_flight(),
    ),
    "freestyle": (
        "a minute of cruising and aerobatics, drawn from the seed",
        lambda seed, *_: freestyle(seed),
    ),
}


def load_scenario(
    name: str, seed: int, count: int = COMMANDS, mount: Mount | None = None, throttle: float = 0.0
) -> Scenario:
    """Load a scenario by name, drawn from `seed`, or from the file at that path; `mount` overrides its own.

    throttle: of those of AT_THROTTLE. Raises ScenarioError naming what is unknown or malformed.
    """
    if count < 1 or count * 3 + 1 > SEGMENTS_MAX:
        raise ScenarioError(f"count: got {count}, expected 1 to {(SEGMENTS_MAX - 1) // 3} commands")
    if seed < 0:
        raise ScenarioError(f"seed: got {seed}, expected 0 or more")
    scenario = BUILDERS[name][1](seed, count, throttle) if name in BUILDERS else _read(Path(name))
    return scenario if mount is None else replace(scenario, mount=mount)


def _read(path: Path) -> Scenario:
    if not path.is_file():
        raise ScenarioError(
            f"scenario {str(path)!r}: no such file; give the path of a .toml file or one of: "
            f"{', '.join(BUILDERS)}"
        )
    where = f"scenario file {path}"
    return parse_scenario(read_limited(path, where, FILE_BYTES_MAX, ScenarioError), where, path.stem)


def parse_scenario(data: bytes, where: str, name: str) -> Scenario:
    """Parse the bytes of a scenario file; `where` names it in messages, `name` is its default name."""

    def scenario(table: StrictTable) -> Scenario:
        return Scenario(
            name=table.text("name", name),
            segments=table.parts("segment", 1, SEGMENTS_MAX, _segment),
            mount=table.choice("mount", {item.value: item for item in Mount}, Mount.CENTRE.value),
        )

    return StrictTable(parse_toml(data, where, ScenarioError), where, ScenarioError).whole(scenario)


def _segment(table: StrictTable) -> Segment:
    full = RATE_FULL_STICK_DEG_S
    return Segment(
        duration_s=table.number("duration_s", SEGMENT_S_MIN, SEGMENT_S_MAX),
        setpoint_deg_s=table.vector("setpoint_deg_s", -full, full),
        throttle=table.number("throttle", 0.0, 1.0, 0.0),
        receiver=table.choice("receiver", {"on": True, "lost": False}, "on"),
        pid=table.choice("controller", {"policy": False, "pid": True}, "policy"),
        height_m=table.optional_number("height_m", 0.0, HEIGHT_MAX_M),
    )
