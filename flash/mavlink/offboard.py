"""The interlocks between a companion's setpoints over MAVLink and SET_RAW_RC.

Nothing is sent before a companion whose setpoints already come enables it, and nothing once its setpoints
have been missing for the timeout: then the firmware's own failsafe acts. Only enabling again resumes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from neuroflight.toolchain.contract import (
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    THROTTLE_LOW_US,
)

Source = tuple[int, int, int]  # peer, system id, component id

TIMEOUT_S = 0.3  # default; the firmware holds after 0.1 s of silence more, and stops after 1 s
SOURCES_MAX = 8  # sources whose setpoints are kept
OFF_S = 0.3  # time after a disarm in which channels send "off" while no companion steers
IDLE: Mapping[int, int] = {
    CHANNEL_ROLL: CHANNEL_MID_US,
    CHANNEL_PITCH: CHANNEL_MID_US,
    CHANNEL_YAW: CHANNEL_MID_US,
    CHANNEL_THROTTLE: CHANNEL_MIN_US,
}


@dataclass(frozen=True)
class Setpoint:
    """Channels [us] that a companion asked for, by their number in the firmware."""

    channels_us: Mapping[int, int]  # the four sticks at least
    beyond: bool = False  # it asked for more than the sticks can say


@dataclass(frozen=True)
class Told:
    """The channels that are to be sent now."""

    channels_us: Mapping[int, int]
    armed: bool


class Offboard:
    """The state of the interlocks. Times are seconds of one clock, never going back."""

    def __init__(self, *, allowed: bool, may_arm: bool, timeout_s: float = TIMEOUT_S) -> None:
        self.allowed, self.may_arm, self.timeout_s = allowed, may_arm, timeout_s
        self.owner: Source | None = None  # who steers
        self.armed = False  # the arm switch, as it is sent
        self._heard: dict[Source, tuple[float, Setpoint]] = {}
        self._off_until = 0.0

    def hear(self, source: Source, setpoint: Setpoint, now: float) -> None:
        """Record a valid setpoint."""
        self._heard.pop(source, None)
        self._heard[source] = now, setpoint
        while len(self._heard) > SOURCES_MAX:
            oldest = next(known for known in self._heard if known != self.owner)
            del self._heard[oldest]

    def why_not(self, source: Source, now: float) -> str:
        """Return the reason why `source` may not steer, "" if it may."""
        if not self.allowed:
            return "start the gateway with --offboard to let a companion steer"
        if self.owner not in (None, source):
            return f"system {self.owner[1]} steers" if self.owner else ""
        if self._fresh(source, now) is None:
            return "send setpoints first, then enable"
        return ""

    def enable(self, source: Source, now: float, *, armed: bool) -> str:
        """Let `source` steer; return the reason if it may not, "" if it does.

        armed: whether the firmware is armed and flies: then its switch stays on.
        """
        why = self.why_not(source, now)
        if not why and self.owner is None:
            self.owner, self.armed = source, armed
        return why

    def release(self) -> None:
        """Send nothing more: the firmware's failsafe acts if it is armed."""
        self.owner, self.armed, self._off_until = None, False, 0.0

    def arm(self, source: Source, now: float) -> str:
        """Switch the arm switch on; return the reason if that is refused, "" if it is on."""
        setpoint = self._fresh(source, now)
        if not self.may_arm:
            return "start the gateway with --allow-arm to arm over MAVLink"
        if self.owner != source or setpoint is None:
            return "enable offboard first: only who steers may arm"
        if setpoint.channels_us[CHANNEL_THROTTLE] > THROTTLE_LOW_US:
            return "ask for no thrust to arm"
        self.armed = True
        return ""

    def disarm(self, now: float) -> str:
        """Switch the arm switch off; return the reason if refused, "" if it is off. Any source may."""
        if not self.allowed:
            return "the channels are not ours: use the transmitter"
        self.armed = False
        if self.owner is None:
            self._off_until = now + OFF_S
        return ""

    def expire(self, now: float) -> bool:
        """Return True if the companion has just been silent for the timeout; sending stops then."""
        if self.owner is None or self._fresh(self.owner, now) is not None:
            return False
        self.release()
        return True

    def told(self, now: float) -> Told | None:
        """Return the channels to send now, or None."""
        if self.owner is not None:
            setpoint = self._fresh(self.owner, now)
            return Told(setpoint.channels_us, self.armed) if setpoint is not None else None
        return Told(IDLE, armed=False) if now < self._off_until else None

    def beyond(self) -> bool:
        """Return True if the steering companion asks for more than the sticks can express."""
        return self.owner is not None and self.owner in self._heard and self._heard[self.owner][1].beyond

    def _fresh(self, source: Source, now: float) -> Setpoint | None:
        at, setpoint = self._heard.get(source, (-self.timeout_s, None))
        return setpoint if now - at < self.timeout_s else None
