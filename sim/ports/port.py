"""The interface of every firmware that flies in lockstep: gyro samples in, motor values out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.logs.messages import log_info
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.physics.esc import Words
from neuroflight.toolchain.contract import (
    AXES,
    BOOT_GRACE_MS,
    ESC_SILENT,
    MOTOR_COUNT_MAX,
    RATE_FULL_STICK_DEG_S,
    FallbackCause,
    Msp,
)
from neuroflight.toolchain.errors import LinkError


class Sample:
    """State of the twin at one gyro sample: body x forward, y left, z up; world x north, y west, z up.

    The loop fills one object anew for each sample: a port that keeps something of it copies it. All its
    numbers but the time lie in one block, `values`, which C code may be pointed at once.
    """

    __slots__ = ("gyro", "position", "rotation", "specific_force", "time_s", "values", "velocity")

    def __init__(
        self,
        time_s: float,
        gyro: Array,
        rotation: Array,
        velocity: Array,
        position: Array,
        specific_force: Array,
    ) -> None:
        """Copy the arrays, of the shapes below."""
        self.values = values = np.empty(21)
        self.time_s = time_s  # since the port's first sample
        self.gyro = values[0:3]  # (3,) [rad/s], measured, unrounded
        self.specific_force = values[3:6]  # (3,) [m/s^2], body, as the accelerometer measures it
        self.rotation = values[6:15].reshape(3, 3)  # (3, 3) attitude, body to world
        self.velocity = values[15:18]  # (3,) [m/s], world
        self.position = values[18:21]  # (3,) [m], world
        self.gyro[:], self.specific_force[:], self.rotation[:] = gyro, specific_force, rotation
        self.velocity[:], self.position[:] = velocity, position

    def copy(self) -> Sample:
        return Sample(
            self.time_s, self.gyro, self.rotation, self.velocity, self.position, self.specific_force
        )


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer of the firmware to one gyro sample; all fields but `dshot` are of its last control step."""

    dshot: NDArray[np.uint16]  # (M,) values of 11 bits, by output
    step: int  # number of the control step, rising by one
    setpoint: Array32  # (3,) [rad/s], from the sticks
    gyro: Array32  # (3,) [rad/s], as the controller used it
    throttle: float  # pilot's thrust, 0..1
    armed: bool


class FirmwarePort(Protocol):
    """A firmware in lockstep: one reply a gyro sample, the first sample is a control step.

    A reply is never changed once it is given. Where it holds what the one before held, it is the same object.

    A port is flown once, from its boot; a new flight takes a new port. All failures of the other side
    are LinkErrors.
    """

    motor_count: int
    gyro_rate_hz: int
    control_rate_hz: int

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """Send one gyro sample, before it a receiver frame unless `channels_us` is None; await the reply.

        channels_us: CHANNEL_COUNT pulse widths [us], only ever given at a control step.
        """

    def arming_reasons(self) -> tuple[str, ...]:
        """Return the names of the reasons against arming; empty if there are none or the port cannot tell."""

    def close(self) -> None:
        """End the firmware. May be called twice."""


@runtime_checkable
class SerialReceiverPort(FirmwarePort, Protocol):
    """A port that sends receiver frames over a simulated serial line, which takes time."""

    def announce(self, channels_us: Sequence[int], samples: int) -> None:
        """Put these channels on the line; the exchange `samples` after the next one will pass them.

        Frames are announced in order, each before its exchange.
        """


@runtime_checkable
class BatteryPort(FirmwarePort, Protocol):
    """A port whose firmware measures a battery: a full one at rest, until the port is told of another."""

    def set_battery(self, volts: float, amps: float) -> None:
        """Set the battery's voltage at its terminals [V] and the current out of it [A] from now on."""


@runtime_checkable
class RotorPort(FirmwarePort, Protocol):
    """A port whose firmware may hear rotor speeds from the ESCs, over the motor wires."""

    hears_rotors: bool  # as its setting motor_telemetry says

    def set_rotors(self, words: Words) -> None:
        """Set what the ESCs answer, by output, to the frames of the sample that is exchanged next.

        Given before each sample that a control step follows; the control step has them. words: (M,),
        toolchain/contract/motors.py.
        """


class PolicyPort(FirmwarePort, Protocol):
    """A port whose firmware flies a policy, and the PID in its place where the policy must not fly."""

    def refused(self) -> FallbackCause:
        """Return why the policy must not fly any more; NONE: it may."""


@dataclass(frozen=True)
class Logged:
    """The state of a firmware's blackbox."""

    busy: bool  # a log is being written
    frames: int  # this and what follows: of the present or last log
    dropped: int  # control steps that it lacks
    bytes: int


@runtime_checkable
class BlackboxPort(FirmwarePort, Protocol):
    """A port whose firmware logs its flight."""

    def logged(self) -> Logged:
        """Return the state of its log, between two exchanges."""


class AskedPort:
    """The answers of a firmware that is asked over MSP, as its ports give them."""

    motor_count: int
    gyro_rate_hz: int
    control_rate_hz: int
    _divider: int  # gyro samples in a control step

    def _msp(self) -> Client:
        """Open a client on the firmware's MSP link."""
        raise NotImplementedError

    def _ask_policy(self, gyro_rate_hz: int) -> None:
        """Ask for motors and rates of the firmware's policy."""
        with self._msp() as msp:
            policy = messages.policy_info(msp.request(Msp.POLICY_INFO))
        self.motor_count, self.control_rate_hz = policy.action_count, policy.control_rate_hz
        self.gyro_rate_hz = gyro_rate_hz
        self._divider = control_divider(gyro_rate_hz, policy.control_rate_hz)

    def arming_reasons(self) -> tuple[str, ...]:
        with self._msp() as msp:
            return messages.arming_reasons(records.safety(msp.request(Msp.SAFETY)).arming_flags)

    def refused(self) -> FallbackCause:
        with self._msp() as msp:
            return records.safety(msp.request(Msp.SAFETY)).refused_cause

    def logged(self) -> Logged:
        with self._msp() as msp:
            info = log_info(msp.request(Msp.LOG_INFO))
        return Logged(info.logging, info.frames, info.dropped, info.bytes)


class AnsweredPort:
    """The answers of ESCs to the frames of a firmware: RotorPort, as ports that hand them over have it."""

    hears_rotors = False
    _words: Words | None = None  # all outputs', to the frame of the next sample
    _answered: Words | None = None  # and to that of the last one

    def _ask_rotors(self, settings: Mapping[str, float]) -> None:
        """Ask for rotor speeds if a firmware with these settings does."""
        self.hears_rotors = bool(settings.get("motor_telemetry", 0))

    def set_rotors(self, words: Words) -> None:
        """See RotorPort; outputs without an ESC are silent."""
        told = np.full(MOTOR_COUNT_MAX, ESC_SILENT, np.uint16)
        told[: len(words)] = words
        self._words = told

    def _rotors(self) -> Words | None:
        """Return what the ESCs answered to the last sample's frame, at each sample; None: nothing was set."""
        answered, self._answered, self._words = self._answered, self._words, None
        return answered


def twin_settings(aircraft: Aircraft) -> dict[str, float]:
    """Return settings for the twin of `aircraft`: without gyro noise the check for a stuck gyro is off."""
    return {} if any(aircraft.gyro.noise) else {"gyro_stuck_ms": 0}


# Scenarios are flown with sticks that are linear, so that the setpoint is what a scenario asks for, and the
# same for every port (sim/control/sticks.py).
FULL_STICK_DEG_S = float(RATE_FULL_STICK_DEG_S)
FLIGHT_RATES = {
    f"{axis}_{name}": value
    for axis in AXES
    for name, value in (("rate", FULL_STICK_DEG_S), ("max", FULL_STICK_DEG_S), ("expo", 0.0))
}


def flight_settings(settings: Mapping[str, float] | None) -> dict[str, float]:
    """Return settings of a simulated flight: the given ones, with defaults for rates, arming delay, ground
    and what arming asks for.

    The motors of a twin are where its file says: nobody has to check them first. Simulated ESCs play no
    start-up tune, which is what a board waits for. In another style than scenarios' rates are those that are
    given, or the style's defaults. And unless it is given, nothing is below: the aircraft is in the air when
    it is armed, as the training's are. With ground, give ground_detection=1.
    """
    given = dict(settings or {})
    rates = {} if given.get("rates_style", 0) else FLIGHT_RATES
    return {"arming_delay_ms": BOOT_GRACE_MS, "ground_detection": 0, "motor_check": 0, **rates, **given}


def setting_changes(settings: Mapping[str, float]) -> tuple[str, ...]:
    """Format settings as the firmware's programs take them: NAME=VALUE."""
    return tuple(f"{name}={value!r}" for name, value in settings.items())


def control_divider(gyro_rate_hz: int, control_rate_hz: int) -> int:
    """Return the gyro samples in a control step. Raises LinkError unless it is a whole number."""
    if control_rate_hz <= 0 or gyro_rate_hz % control_rate_hz:
        raise LinkError(
            f"control rate {control_rate_hz} Hz does not divide the gyro rate {gyro_rate_hz} Hz: "
            f"choose a gyro rate that is a multiple of it"
        )
    return gyro_rate_hz // control_rate_hz
