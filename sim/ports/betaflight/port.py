"""Betaflight behind the port: its SITL over the simulator link, in lockstep with the twin.

What flies is Betaflight 4.6 with its default PID and filters, or a pilot's (see tune.py). SETTINGS says what
differs from its defaults: linear sticks without smoothing, so that its setpoint follows the sticks at once,
as for every other controller; and what flights on a rig need. Airmode is on from the first armed step, so
that it flies scenarios at zero throttle with the full authority of its PID. Feedforward has no effect: it
needs the spacing of receiver frames, and the SITL sees a new one in each loop; with its gains at 0 it flies
the same.

Its gyro loop and PID run at 8 kHz of its own time and hold a slower gyro's sample; it answers each state
packet with the motor values of its first loop after it. They act on the twin from the next sample on. The
gyro's counts are those of every port's chip, less their mean over the first second: a board removes its
gyro's bias, the SITL does not. Nor does the SITL detect a lost receiver: the sticks keep their position.

The wire's axes: forward, right, down, and back to forward, left, up inside Betaflight. Its motors are
numbered and turn as this project's do.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import Transport
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control import sticks
from neuroflight.sim.physics.imu import RATE_PER_COUNT, counts
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.process import BetaflightProcess
from neuroflight.sim.ports.betaflight.tune import RELEASE_TEXT, Tune
from neuroflight.sim.ports.port import Reply, Sample, control_divider
from neuroflight.sim.ports.simulator_link import RECEIVER, SEA_LEVEL_PA, SERVO
from neuroflight.sim.ports.simulator_link import state_packet as link_packet
from neuroflight.toolchain.contract import (
    CALIBRATION_MS,
    DSHOT_MIN,
    DSHOT_SPAN,
    DSHOT_STOP,
    GRAVITY,
    GYRO_RATE_DEFAULT_HZ,
    Msp,
)
from neuroflight.toolchain.errors import AircraftError, LinkError

ROW_RATE_HZ = 1000  # of the trace; Betaflight's own loop is faster
IDLE = 0.055  # motor fraction of its armed motors at zero thrust: motor_idle = 550, its default
SETTINGS = (
    "aux 0 0 0 1700 2100 0 0",  # the arm switch: channel 5
    "set pwr_on_arm_grace = 0",  # the loop waits for itself
    "set small_angle = 180",  # a rig arms in any attitude
    "set runaway_takeoff_prevention = OFF",  # hard turns on a rig are no runaway take-off
    "set airmode_start_throttle_percent = 0",
    "set rc_smoothing = OFF",
    "set rates_type = ACTUAL",
    *(f"set {axis}_rc_rate = 100" for axis in ("roll", "pitch", "yaw")),  # 1000 deg/s, in tens
    *(f"set {axis}_srate = 100" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_expo = 0" for axis in ("roll", "pitch", "yaw")),
)
AT_REST = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY]))
ARMING_REASONS = (  # in the order of their bits
    *("NO_GYRO", "FAILSAFE", "RX_LOSS", "NOT_RECOVERED", "FAILSAFE_SWITCH", "RUNAWAY_TAKEOFF"),
    *("CRASH_DETECTED", "THROTTLE", "ANGLE", "BOOT_GRACE_TIME", "NO_PREARM", "LOAD", "CALIBRATING", "CLI"),
    *("CMS_MENU", "BST", "MSP", "PARALYZE", "GPS", "RESCUE_SWITCH", "DSHOT_TELEMETRY", "REBOOT_REQUIRED"),
    *("DSHOT_BITBANG", "ACC_CALIBRATION", "MOTOR_PROTOCOL", "CRASH_FLIP", "ALTITUDE_HOLD", "POSITION_HOLD"),
    "ARM_SWITCH",
)
CORNERS = ((-1, -1), (1, -1), (-1, 1), (1, 1))  # signs of x and y of the first four motors


@dataclass(frozen=True)
class Frame:
    """The places and turning directions of motors in one of its mixers."""

    settings: tuple[str, ...]  # that choose the mixer
    signs: tuple[tuple[int, int], ...]  # of x and y, by motor
    spins: tuple[int, ...]  # seen from above, +1 counter-clockwise; unless YAW_REVERSED


FRAMES = {  # by the number of motors; the quad is its default
    4: Frame((), CORNERS, (-1, 1, 1, -1)),
    6: Frame(("mixer HEX6X",), (*CORNERS, (0, -1), (0, 1)), (1, 1, -1, -1, -1, 1)),
}
CENTRED_M = 1e-3  # a motor nearer to an axis than this stands on it
YAW_REVERSED = "set yaw_motors_reversed = ON"
PROMPT, CLI_ERROR = b"\n# ", b"###ERROR"
CLI_ANSWER_S = 30.0  # real, for one line; on a busy machine it takes seconds
CLI_BYTES_MAX = 1 << 16
STOP_US, FULL_US = 1000.0, 2000.0  # pulse widths of a stopped motor and of one at full power
COUNTS_PER_DEG_S = 16.4  # of its virtual gyro, which drops fractions of a count
# Betaflight truncates the times of packets to nanoseconds: a time slightly too large becomes the right one,
# a time slightly too small would become one nanosecond less.
TIME_MARGIN = 1e-9

WIRE_RATE_PER_COUNT = float(np.deg2rad(1 / COUNTS_PER_DEG_S))  # [rad/s]
WIRE_SIGNS = np.array([1.0, -1.0, -1.0])  # forward, left, up to forward, right, down


class BetaflightPort:
    """FirmwarePort around a Betaflight of its own, which ends with the port."""

    def __init__(
        self,
        betaflight: Betaflight,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Sequence[str] = SETTINGS,
        tune: Tune | None = None,
        motor_count: int = 4,
    ) -> None:
        """Start it, set it up over its command line and restart it. Raises LinkError.

        settings: lines of its command line, laid over its defaults; tune: a pilot's, laid over them;
        motor_count: of the mixer that they leave it with.
        """
        self.motor_count = motor_count
        self.gyro_rate_hz = gyro_rate_hz
        self.control_rate_hz = ROW_RATE_HZ
        self._divider = control_divider(gyro_rate_hz, ROW_RATE_HZ)
        self._period_ns = 1_000_000_000 // gyro_rate_hz
        with BetaflightProcess(betaflight) as blank:
            eeprom = configured(blank, settings, tune)
        self._process = BetaflightProcess(betaflight, eeprom)
        self._samples = 0
        self._calibration = CALIBRATION_MS * gyro_rate_hz // 1000  # samples
        self._sum = np.zeros(3, np.int64)  # of counts
        self._bias = np.zeros(3, np.int32)  # counts
        self._hear(sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False))
        self._packet = b""  # the last servo packet
        self._dshot = np.zeros(motor_count, np.uint16)
        self._reply: Reply | None = None

    @property
    def process(self) -> BetaflightProcess:
        return self._process

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        time_s = self._samples / self.gyro_rate_hz * (1 + TIME_MARGIN)
        if channels_us is not None:
            self._hear(np.array(channels_us, np.uint16))
            self._process.send_receiver(RECEIVER.pack(time_s, *channels_us))
        raw = self._unbiased(counts(sample.gyro))
        self._process.send_state(state_packet(time_s, raw, sample))
        self._process.run(self._period_ns)
        moved = False
        for packet in self._process.servo_packets():
            if packet != self._packet:
                self._packet, self._dshot, moved = packet, dshot_values(packet, self.motor_count), True
        step, after = divmod(self._samples, self._divider)
        self._samples += 1
        if after == 0 or self._reply is None:
            gyro = raw.astype(np.float32) * RATE_PER_COUNT
            armed = bool(self._dshot.all())
            self._reply = Reply(self._dshot, step, self._setpoint, gyro, self._throttle, armed)
        elif moved:
            self._reply = replace(self._reply, dshot=self._dshot, armed=bool(self._dshot.all()))
        return self._reply

    def stand(self, channels_us: Sequence[int], count: int) -> None:
        """Let `count` samples pass from power-on, all at rest, after a receiver frame.

        It comes out as it would of `count` exchanges, in a fraction of their time: its loop holds a sample.
        """
        time_s = self._samples / self.gyro_rate_hz * (1 + TIME_MARGIN)
        self._hear(np.array(channels_us, np.uint16))
        self._process.send_receiver(RECEIVER.pack(time_s, *channels_us))
        self._process.send_state(state_packet(time_s, np.zeros(3, np.int32), AT_REST))
        self._process.run(count * self._period_ns)
        self._process.servo_packets()  # of stopped motors
        self._samples += count

    def _hear(self, channels: NDArray[np.uint16]) -> None:
        self._setpoint = sticks.setpoint(channels)
        self._throttle = float(sticks.throttle(channels[None])[0])

    def _unbiased(self, raw: NDArray[np.int16]) -> NDArray[np.int32]:
        """Subtract the gyro's bias from counts; it is 0 until it is known."""
        if self._samples < self._calibration:
            self._sum += raw
        elif self._samples == self._calibration:
            self._bias = np.rint(self._sum / self._calibration).astype(np.int32)
        return raw - self._bias

    def arming_reasons(self) -> tuple[str, ...]:
        with Client(self._process.open_line()) as client:
            flags = messages.status_ex(client.request(Msp.STATUS_EX)).arming_flags
        return tuple(name for bit, name in enumerate(ARMING_REASONS) if flags >> bit & 1)

    def close(self) -> None:
        self._process.close()


def aircraft_settings(aircraft: Aircraft) -> tuple[str, ...]:
    """Return SETTINGS and those for the aircraft's motors. Raises AircraftError if no FRAMES fits."""
    places = aircraft.rotor_positions[:, :2]
    signs = np.sign(np.where(np.abs(places) < CENTRED_M, 0.0, places))
    frame = FRAMES.get(aircraft.motor_count)
    turned = 0 if frame is None else int(np.dot(aircraft.spins, frame.spins))
    if frame is None or not np.array_equal(signs, frame.signs) or abs(turned) != aircraft.motor_count:
        raise AircraftError(
            f"aircraft {aircraft.name}: its {aircraft.motor_count} motors stand or turn otherwise than "
            "Betaflight's quad in X (1 rear right, 2 front right, 3 rear left, 4 front left, neighbours in "
            "opposite senses) or hexacopter in X (also 5 right, 6 left); fly it on another port"
        )
    return (*SETTINGS, *frame.settings, *(() if turned > 0 else (YAW_REVERSED,)))


def configured(process: BetaflightProcess, settings: Sequence[str], tune: Tune | None = None) -> bytes:
    """Return the EEPROM file of a fresh Betaflight after `settings`, lines of its command line, and a
    pilot's.

    The process has ended afterwards. Raises LinkError naming the line that it refuses.
    """
    with process.open_line() as line:
        _enter(line, b"#")
        for setting in settings:
            _enter(line, setting.encode() + b"\n")
        for place, setting in () if tune is None else zip(tune.places, tune.lines, strict=True):
            _enter(line, setting.encode() + b"\n", place)
        line.write(b"save\n")
        return process.restarted()


def state_packet(time_s: float, raw: NDArray[np.integer], sample: Sample) -> bytes:
    """Return a state packet from which Betaflight makes the gyro counts `raw` (3,) and the sample's forces.

    It reads rates in forward, right, down and scales them to counts of its own, dropping fractions; it
    negates all three forces.
    """
    x, y, z = wire_rates(raw).tolist()
    fx, fy, fz = sample.specific_force.tolist()
    return link_packet(time_s, (x, y, z), (-fx, -fy, -fz), sample, SEA_LEVEL_PA)


def wire_rates(raw: NDArray[np.integer]) -> Array:
    """Compute rates [rad/s] in the axes of the wire that Betaflight makes the counts `raw` of, both (..., 3).

    They lie in the middle of the rates that give this count; 0 for a count of 0.
    """
    number = raw.astype(np.float64)
    rates: Array = (number + 0.5 * np.sign(number)) * (WIRE_RATE_PER_COUNT * WIRE_SIGNS)
    return rates


def dshot_of_widths(widths: Array32) -> NDArray[np.uint16]:
    """Compute DShot values of pulse widths [us], any shape: 0 for a stopped motor."""
    fraction = (widths.astype(np.float64) - STOP_US) / (FULL_US - STOP_US)
    fraction = np.minimum(np.maximum(fraction, 0.0), 1.0)
    value = DSHOT_MIN + np.floor(DSHOT_SPAN * fraction + 0.5)
    return np.where(fraction > 0.0, value, DSHOT_STOP).astype(np.uint16)


def dshot_values(packet: bytes, motors: int) -> NDArray[np.uint16]:
    """Return DShot values (motors,) behind a servo packet: 0 where one stops. Raises LinkError on another."""
    if len(packet) != SERVO.size:
        raise LinkError(f"Betaflight: a servo packet of {len(packet)} bytes, expected {SERVO.size}")
    count, *widths = SERVO.unpack(packet)
    if count != motors:
        raise LinkError(f"Betaflight: a servo packet of {count} motors, expected {motors}")
    if not all(math.isfinite(width) for width in widths[:count]):
        raise LinkError(f"Betaflight: pulse widths {widths[:count]}, expected {STOP_US} to {FULL_US} us")
    return dshot_of_widths(np.array(widths[:count], np.float32))


def _enter(line: Transport, text: bytes, place: str = "") -> None:
    """Send text to the command line and await its prompt. Raises LinkError on an error or a time-out.

    place: where a pilot's file has the text.
    """
    line.write(text)
    heard = b""
    deadline = time.monotonic() + CLI_ANSWER_S
    while not heard.endswith(PROMPT) and len(heard) < CLI_BYTES_MAX and time.monotonic() < deadline:
        heard += line.read(CLI_ANSWER_S)
    said, answer = (" ".join(part.decode(errors="replace").split()) for part in (text, heard))
    if place and heard.endswith(PROMPT):
        _check_taken(place, said, answer)
    elif CLI_ERROR in heard or not heard.endswith(PROMPT):
        raise LinkError(f"Betaflight: its command line answers {answer!r} to {said!r}, expected a prompt")


def _check_taken(place: str, said: str, answer: str) -> None:
    """Raise LinkError unless a pilot's line got the value in it: what is no number is 0 for Betaflight."""
    name, value = said.removeprefix("set ").split(" = ")
    _, error, words = answer.partition(CLI_ERROR.decode())
    _, _, taken = answer.partition(f"{name} set to ")
    taken = taken.removesuffix("#").strip()
    if error or taken.lower() != value.lower():
        reason = words.strip("# ") if error else f"it takes it as {taken or 'nothing'}"
        raise LinkError(f"{place}: Betaflight {RELEASE_TEXT} refuses `{said}` ({reason})")
