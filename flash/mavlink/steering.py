"""The companion's setpoints on their way to the firmware, and the arm switch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from neuroflight.flash.mavlink import commands, texts
from neuroflight.flash.mavlink.commands import Request
from neuroflight.flash.mavlink.customs import MODE_RECEIVER, Mode
from neuroflight.flash.mavlink.firmware import Firmware
from neuroflight.flash.mavlink.ground import Ground
from neuroflight.flash.mavlink.offboard import Offboard, Source
from neuroflight.flash.mavlink.setpoint_check import SetpointCheck
from neuroflight.flash.mavlink.setpoints import STEERING
from neuroflight.flash.monitoring.stream import Sample
from neuroflight.toolchain.contract import RECEIVER_OFF_FRAMES, FlightState

PERIOD_S = 0.02  # between channels that say the same; new ones go at once
SWITCHED_S = 1.0  # in which the firmware obeys the arm switch
OFF_FRAMES = RECEIVER_OFF_FRAMES + 1  # until the firmware has surely heard that the switch is off
FLYING = (FlightState.ARMED, FlightState.FAILSAFE_HOLD)


@dataclass(frozen=True)
class _Switching:
    """An arm or disarm command whose effect is awaited."""

    request: Request
    armed: bool
    deadline: float


class Steering:
    """The steering of one firmware."""

    def __init__(
        self, firmware: Firmware, ground: Ground, offboard: Offboard, clock: Callable[[], float]
    ) -> None:
        self._firmware, self._ground, self._offboard, self._clock = firmware, ground, offboard, clock
        self._check = SetpointCheck()
        self._mode = MODE_RECEIVER
        self._due = clock()
        self._switching: _Switching | None = None
        self._seen: Sample | None = None
        self._on = False  # the arm switch in the last channels
        self._offs = 0  # channels in a row without it

    @property
    def steered(self) -> bool:
        """True if a companion steers."""
        return self._offboard.owner is not None

    def mode(self, peer: int, others: Callable[[int], int]) -> int:
        """Return HEARTBEAT's custom_mode for a peer.

        The peer that steers gets the number it asked for, as clients stop their setpoints when they see
        another. others: returns the number for any other peer.
        """
        owner = self._offboard.owner
        if owner is None:
            return MODE_RECEIVER
        return self._mode if owner[0] == peer else others(peer)

    @property
    def due(self) -> float | None:
        """Time of the next channels to send [s]; None: none are sent."""
        return self._due if self._offboard.told(self._clock()) is not None else None

    def release(self) -> None:
        """Send nothing more; who waits for the arm switch hears that it is off."""
        self._answer(commands.CANCELLED)
        self._offboard.release()

    def expire(self) -> None:
        """End offboard if the companion has been silent for the time-out."""
        if self._offboard.expire(self._clock()):
            self._answer(commands.CANCELLED)
            silence = f"{self._offboard.timeout_s:g} s"
            self._ground.tell(texts.CRITICAL, f"Companion silent for {silence}: offboard ends, failsafe acts")

    def send(self) -> None:
        """Send channels if they are due."""
        self.expire()
        now = self._clock()
        told = self._offboard.told(now)
        if told is None or now < self._due:
            return
        self._due = now + PERIOD_S
        sticks = self._firmware.sticks
        self._on = told.armed and self._may_switch_on()
        self._offs = 0 if self._on else self._offs + 1
        if self._firmware.send_channels(sticks.frame(told.channels_us, armed=self._on)):
            self._check.sent(sticks.setpoint(told.channels_us), now)
            return
        self.release()
        self._ground.tell(texts.ERROR, "No channels taken: receiver_protocol msp is not flown yet, reboot")

    def _may_switch_on(self) -> bool:
        """Return True if the arm switch may be switched on.

        If it moves too early, or was not off long enough for the firmware to see it, it arms nothing.
        """
        ready = self._offs >= OFF_FRAMES and not self._firmware.safety.arming_flags
        return self._on or ready

    def handle(self, source: Source, message: Any) -> None:  # noqa: ANN401 - pymavlink's are untyped
        """Handle a message of setpoints.STEERING."""
        owner = self._offboard.owner
        if not self._offboard.allowed:
            self._ground.complain("Setpoints are not taken: start the gateway with --offboard")
            return
        if owner is not None and owner != source:
            self._ground.complain(f"Setpoints of system {source[1]} are not taken: another steers")
            return
        try:
            setpoint = STEERING[message.get_type()](message, self._firmware.sticks)
        except ValueError as error:
            self._ground.complain(str(error))
            return
        self._offboard.hear(source, setpoint, self._clock())
        if owner == source:
            self._due = self._clock()
            if setpoint.beyond:
                self._ground.complain("Setpoint beyond full stick: its end is flown")

    def look(self) -> None:
        """Update the arm switch and the check of setpoints from the firmware's new state."""
        sample, before = self._firmware.sample, self._seen
        self._seen = sample
        if sample is not None and sample is not before and self._check.see(sample, self._clock()):
            self._ground.tell(texts.ERROR, "Rates flown are not those of the settings: disarm, reboot")
        armed, switching = self._firmware.armed, self._switching
        if switching is None:
            # Disarmed by something else, such as a crash: arming again takes a new command.
            self._offboard.armed &= armed
        elif armed == switching.armed:
            self._answer(commands.ACCEPTED)
        elif self._clock() >= switching.deadline:
            self._offboard.armed &= armed
            for text in texts.arming_texts(self._firmware.safety.arming_flags) if switching.armed else ():
                self._ground.tell(text.severity, text.text)
            self._answer(commands.FAILED)

    # --- Commands: a MAV_RESULT each -------------------------------------------------------------------
    def choose(self, source: Source, mode: Mode) -> int:
        """Let `source` steer, or nobody, as `mode` says; returns the MAV_RESULT."""
        if not mode.offboard:
            return self._disable(source, mode)
        result = self._enable(source)
        if result == commands.ACCEPTED:
            self._mode = mode.number
        return result

    def _enable(self, source: Source) -> int:
        steered, flies = self.steered, False
        why = self._offboard.why_not(source, self._clock())
        if (
            not why
        ):  # asking the firmware takes time, which the steering companion must not lose to failing requests
            self._firmware.look()
            flies = self._firmware.safety.state in FLYING
            why = self._offboard.enable(source, self._clock(), armed=flies)
        if why:
            self._ground.refuse(f"Offboard denied: {why}")
            return int(commands.REJECTED if self._offboard.allowed else commands.DENIED)
        if not steered:
            self._on, self._offs = flies, 0
            self._ground.tell(texts.INFO, f"Offboard: system {source[1]} steers")
        return int(commands.ACCEPTED)

    def _disable(self, source: Source, mode: Mode) -> int:
        owner = self._offboard.owner
        if mode.owner_only and owner not in (None, source):
            self._ground.complain("Hold denied: another steers, and nothing here holds a position")
            return int(commands.DENIED)
        if owner is not None:
            self.release()
            self._ground.tell(texts.WARNING, "Offboard ends: no more channels are sent")
        return int(commands.ACCEPTED)

    def arm(self, request: Request) -> int:
        """Put the arm switch on; the result comes once the firmware has obeyed."""
        if self._check.wrong:
            why = "rates flown are not those of the settings: reboot"
        elif self._offboard.allowed and not self._firmware.sticks.arm:
            why = "no mode range switches arm on"
        else:
            why = self._offboard.arm(request.source, self._clock())
        if why:
            self._ground.refuse(f"Arming denied: {why}")
            return int(commands.REJECTED if self._offboard.may_arm else commands.DENIED)
        return self._switch(request, armed=True)

    def disarm(self, request: Request) -> int:
        """Put the arm switch off; the result comes once the firmware has obeyed."""
        if why := self._offboard.disarm(self._clock()):
            self._ground.refuse(f"Disarming denied: {why}")
            return int(commands.DENIED)
        self._due = self._clock()
        return self._switch(request, armed=False)

    def _switch(self, request: Request, *, armed: bool) -> int:
        self._answer(commands.CANCELLED)
        self._switching = _Switching(request, armed, self._clock() + SWITCHED_S)
        return int(commands.IN_PROGRESS)

    def _answer(self, result: int) -> None:
        if self._switching is not None:
            request, self._switching = self._switching.request, None
            self._ground.answer(request.source, commands.acknowledgement(request, result))
