"""The lockstep loop: a twin and a firmware behind a port, one gyro sample at a time.

At each sample the port gets the twin's gyro and answers with DShot values, which act on the twin from the
next sample on. Until the firmware is armed the aircraft is held where it is; after the scenario the pilot
closes the throttle and switches off, and the motors must stop. Receiver frames go out just before the
control step they belong to: when the sticks changed, but no closer than SBUS can send them, and every 10 ms
in any case. Receiver frames are decided 4 ms (FRAME_SPACING_S) ahead of their control step, further at low
gyro rates, because a frame takes that long on a serial line: on every port alike, and a port that simulates
the line gets the frame at once. A battery that the twin flies on is told to the port at each control step,
and rotor speeds as ESCs answer to the frames before it, where the firmware asks for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.control import sticks
from neuroflight.sim.control.motors import each_fraction, motor_fractions
from neuroflight.sim.flight.eye_pilot import EyePilot
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.esc import rotor_words
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.port import (
    BatteryPort,
    FirmwarePort,
    Reply,
    RotorPort,
    Sample,
    SerialReceiverPort,
    control_divider,
)
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    CALIBRATION_MS,
    CHANNEL_ARM,
    CHANNEL_THROTTLE,
    DSHOT_MIN,
)
from neuroflight.toolchain.errors import LinkError, TraceError

FRAME_S = 0.003  # an SBUS frame is 25 x 12 bits at 100 kbaud
FRAME_SPACING_S = 0.004  # a frame and a gap
FRAME_PERIOD_S = 0.010  # between frames of unchanged sticks
SWITCH_OFF_S = (max(BOOT_GRACE_MS, CALIBRATION_MS) + 50) / 1000  # before the first try to arm
SWITCH_PERIOD_S = 0.1  # of each further try: off, then on
ARM_LIMIT_S = 10.0  # from power-on; a noisy gyro may need more than one calibration
DISARM_LIMIT_S = 1.0  # from the pilot's switch to stopped motors
PROGRESS_S = 0.1  # of flight between two calls of `progress`
LOG_S = 0.1  # of flight between two calls of `logged`
LOG_END_LIMIT_S = 1.0  # from stopped motors to the end of the log

Progress = Callable[[float], None]  # gets the flown part, 0..1


def fly(
    twin: Twin,
    port: FirmwarePort,
    scenario: Scenario,
    *,
    motor_order: Sequence[int] | None = None,
    progress: Progress | None = None,
    broken_off: Callable[[Trace], None] = lambda trace: None,
    logged: Callable[[], bool] | None = None,
    watch: Callable[[], None] = lambda: None,
) -> Trace:
    """Boot and arm the firmware, fly `scenario` and disarm; row 0 is the first armed control step.

    Arming and disarming are flown but not recorded.

    twin: one aircraft at rest, at the port's gyro rate. port: freshly booted. motor_order: output i of the
    firmware drives rotor motor_order[i]; a mis-wired aircraft, for tests. broken_off: gets the trace up to
    there when an error ends the flight after it was armed; the error goes on. logged: called from time to
    time, takes what the firmware has logged and tells whether the log has ended; the pilot waits a second
    for it. watch: called at each row of the trace, after its control step, to look at the twin.
    Raises LinkError when the firmware does not arm or disarm or the link fails, ScenarioError on impossible
    sticks.
    """
    pilot = _Pilot(scenario, port.control_rate_hz)
    link = _Lockstep(twin, port, pilot, motor_order, logged)
    steps = pilot.steps
    rows = _Rows(steps, port.motor_count)
    every = max(1, round(PROGRESS_S * port.control_rate_hz))
    try:
        rows.put(_arm(link, scenario), link.rate)
        watch()
        for k in range(1, steps):
            rows.put(link.control_step(), link.rate)
            watch()
            if progress is not None and k % every == 0:
                progress(k / steps)
        _disarm(link)
        if logged is not None:
            _see_log_out(link, logged)
    except BaseException:  # an interruption by the user as well
        if rows.count:
            with suppress(TraceError):  # the flight may have ended because of a NaN
                broken_off(rows.trace(port.control_rate_hz))
        raise
    return rows.trace(port.control_rate_hz)


def stand(twin: Twin, port: FirmwarePort, steps: int) -> None:
    """Boot the firmware and leave it disarmed for `steps` control steps, receiver and sensors as in `fly`.

    twin, port: as of `fly`. Raises LinkError when it arms or the link fails.
    """
    still = Scenario("disarmed", (Segment(1.0),))
    link = _Lockstep(twin, port, _Pilot(still, port.control_rate_hz, on=False), None, None)
    for _ in range(steps):
        link.control_step()
        if link.armed:
            raise LinkError("the firmware is armed with the switch off")


class _Rows:
    """The recorded values of up to N control steps."""

    def __init__(self, steps: int, motors: int) -> None:
        self.count = 0  # so far
        self._setpoint = np.zeros((steps, 3), np.float32)
        self._rate = np.zeros((steps, 3))
        self._gyro = np.zeros((steps, 3), np.float32)
        self._dshot = np.zeros((steps, motors), np.uint16)
        self._throttle = np.zeros(steps, np.float32)

    def put(self, reply: Reply, rate: Array) -> None:
        """Keep the reply and the true rate (3,) [rad/s] of the next control step."""
        step = self.count
        self._setpoint[step] = reply.setpoint
        self._rate[step] = rate
        self._gyro[step] = reply.gyro
        self._dshot[step] = reply.dshot
        self._throttle[step] = reply.throttle
        self.count = step + 1

    def trace(self, control_rate_hz: int) -> Trace:
        """Return the trace of all steps so far."""
        count = self.count
        dshot = self._dshot[:count]
        return Trace(
            t=np.arange(count) / control_rate_hz,
            setpoint=self._setpoint[:count],
            rate=self._rate[:count],
            gyro=self._gyro[:count],
            motors=motor_fractions(dshot),
            dshot=dshot,
            throttle=self._throttle[:count],
        )


Frame = tuple[int, ...]  # channels [us]; equal ones of a pilot are one object


class _Pilot:
    """The pilot: sticks low, the switch until the firmware is armed; the scenario; the switch off."""

    def __init__(self, scenario: Scenario, control_rate_hz: int, on: bool = True) -> None:
        """Lay out the sticks; on: False leaves the switch off."""
        known: dict[Frame, Frame] = {}

        def frame(channels: NDArray[np.uint16]) -> Frame:
            """Return one shared object for all equal `channels`."""
            new = tuple(channels.tolist())
            return known.setdefault(new, new)

        channels, heard = scenario.timeline(control_rate_hz)
        self.steps = len(channels)
        self._frames = _frames(channels, heard, frame)
        self.eye = EyePilot(scenario, control_rate_hz) if scenario.by_eye else None
        self._frame = frame
        off = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False)
        self._off = frame(off)
        # The switch goes on with the sticks where the scenario begins, throttle low as arming demands.
        on_sticks = channels[0].copy()
        on_sticks[CHANNEL_THROTTLE] = off[CHANNEL_THROTTLE]
        self._on = frame(on_sticks)
        landed = channels[-1].copy()
        landed[[CHANNEL_THROTTLE, CHANNEL_ARM]] = off[[CHANNEL_THROTTLE, CHANNEL_ARM]]
        self._landed = frame(landed)
        self._first = round(SWITCH_OFF_S * control_rate_hz) if on else None
        self._period = round(SWITCH_PERIOD_S * control_rate_hz)

    def switched(self, step: int) -> bool:
        """Return True if the switch is on at control step `step` before arming."""
        if self._first is None:
            return False
        phase = step - self._first
        return phase >= 0 and phase % self._period < self._period // 2

    def sticks(self, step: int, armed_at: int | None) -> Frame | None:
        """Return channels at control step `step`, None for no frame. armed_at: the first armed step."""
        if armed_at is None:
            return self._on if self.switched(step) else self._off
        k = step - armed_at
        if k >= self.steps:
            return self._landed
        by_eye = None if self.eye is None else self.eye.channels(k)
        return self._frames[k] if by_eye is None else self._frame(by_eye)


def _frames(
    channels: NDArray[np.uint16], heard: Flags, frame: Callable[[NDArray[np.uint16]], Frame]
) -> list[Frame | None]:
    """Return the frame of each step of a timeline, None where the receiver is silent."""
    changes = (channels[1:] != channels[:-1]).any(axis=1) | (heard[1:] != heard[:-1])
    bounds = [0, *(np.flatnonzero(changes) + 1).tolist(), len(channels)]
    frames: list[Frame | None] = []
    for begin, end in pairwise(bounds):
        frames += [frame(channels[begin]) if heard[begin] else None] * (end - begin)
    return frames


_NO_REASON = (
    "it names no reason; the pilot's arm switch is AUX 1: give the mode arm a range there, "
    "such as mode1=arm aux1 1700 2100"
)


class _Lockstep:
    """Twin and firmware together, advanced by whole control steps."""

    def __init__(
        self,
        twin: Twin,
        port: FirmwarePort,
        pilot: _Pilot,
        motor_order: Sequence[int] | None,
        logged: Callable[[], bool] | None,
    ) -> None:
        motors = twin.aircraft.motor_count
        if twin.count != 1:
            raise ValueError(f"the loop flies one aircraft, the twin has {twin.count}")
        if port.motor_count != motors:
            raise LinkError(
                f"the firmware drives {port.motor_count} motors, aircraft {twin.aircraft.name} has {motors}: "
                f"build a policy trained for it"
            )
        if port.gyro_rate_hz != twin.rate_hz:
            raise LinkError(
                f"the firmware's gyro runs at {port.gyro_rate_hz} Hz, the twin at {twin.rate_hz} Hz"
            )
        order = list(range(motors)) if motor_order is None else list(motor_order)
        if sorted(order) != list(range(motors)):
            raise ValueError(f"motor order {order} is no permutation of {motors} motors")
        self._twin, self._port, self.pilot = twin, port, pilot
        self._outputs = [order.index(motor) for motor in range(motors)]  # that drive each motor
        self._serial = port if isinstance(port, SerialReceiverPort) else None
        self._battery = twin.battery
        self._measures = port if self._battery is not None and isinstance(port, BatteryPort) else None
        self._rotors = port if isinstance(port, RotorPort) and port.hears_rotors else None
        self._order = order
        self._divider = control_divider(port.gyro_rate_hz, port.control_rate_hz)
        self._spacing = round(FRAME_SPACING_S * port.control_rate_hz)
        self._period = round(FRAME_PERIOD_S * port.control_rate_hz)
        # Control steps from the decision on a frame to its step: it must end one sample before that.
        lead_s = max(FRAME_SPACING_S, FRAME_S + 2 / port.gyro_rate_hz)
        self._lead = math.ceil(round(lead_s * port.control_rate_hz, 6))
        self._logged = logged
        self._log_every = max(1, round(LOG_S * port.control_rate_hz))
        self._planned: dict[int, Frame] = {}  # frames by control step
        self._frame: Frame | None = None  # the last one planned
        self._frame_step = 0
        self._sample = Sample(0.0, *(np.zeros(3), np.eye(3)), *np.zeros((3, 3)))
        self._samples = 0  # so far
        self._held = True
        self._motors = np.zeros((1, motors))
        self._reply: Reply | None = None  # whose fractions `_motors` holds
        self.rate = np.zeros(3)  # true body rate [rad/s] when the last control step began
        self.step = 0  # control steps so far
        self.armed = False  # at the last of them
        self._armed_at: int | None = None  # the first of them that was
        self.control_rate_hz = port.control_rate_hz

    def control_step(self) -> Reply:
        """Run one control period; returns the reply to its first sample."""
        self.rate[:] = self._twin.live.rate[0]
        if self._measures is not None and self._battery is not None:
            self._measures.set_battery(self._battery.voltage.item(), self._battery.current.item())
        reply = self._exchange(self._planned.pop(self.step, None))
        self.armed = reply.armed
        if reply.armed and self._armed_at is None:
            self._armed_at = self.step
        if self.pilot.eye is not None and self._armed_at is not None:
            live = self._twin.live
            self.pilot.eye.see(live.position[0], live.velocity[0], live.rotation[0])
        self._plan(self.step + self._lead)
        for _ in range(1, self._divider):
            self._exchange(None)
        self.step += 1
        if self._logged is not None and self.step % self._log_every == 0:
            self._logged()
        return reply

    def arming_reasons(self) -> str:
        """Return the firmware's reasons against arming, as text."""
        return ", ".join(self._port.arming_reasons()) or _NO_REASON

    def _plan(self, step: int) -> None:
        """Decide whether a frame is sent at control step `step`."""
        frame = self.pilot.sticks(step, self._armed_at)
        if frame is None:
            return
        since = step - self._frame_step
        if self._frame is not None and since < (self._period if frame is self._frame else self._spacing):
            return
        self._frame, self._frame_step = frame, step
        self._planned[step] = frame
        if self._serial is not None:
            self._serial.announce(frame, step * self._divider - self._samples)

    def _exchange(self, channels: Frame | None) -> Reply:
        twin, sample = self._twin, self._sample
        sample.time_s = self._samples / twin.rate_hz
        # One aircraft's (1, ...) into (...), which numpy broadcasts.
        live = twin.live
        sample.gyro[:] = live.gyro
        sample.specific_force[:] = live.accelerometer
        sample.rotation[:] = live.rotation
        sample.velocity[:] = live.velocity
        sample.position[:] = live.position
        self._samples += 1
        if self._rotors is not None and self._samples % self._divider == 0:
            self._rotors.set_rotors(rotor_words(live.rotor_speed[0, self._order]))
        reply = self._port.exchange(sample, channels)
        if reply is not self._reply:
            self._command(reply)
        if self._held:
            twin.measure()
        else:
            twin.step(self._motors)
        return reply

    def _command(self, reply: Reply) -> None:
        """Take the motors from a new reply, and whether the aircraft is held."""
        if self._reply is None or reply.dshot.tobytes() != self._reply.dshot.tobytes():
            fractions = each_fraction(reply.dshot)
            self._motors[0] = [fractions[output] for output in self._outputs]
        self._reply = reply
        # Until the firmware is armed the aircraft is held at rest: only its sensors are sampled.
        self._held = self._held and not reply.armed
        if self._held and (reply.dshot >= DSHOT_MIN).any():
            raise LinkError(f"the firmware turns motors while it is disarmed: DShot {reply.dshot.tolist()}")


def _arm(link: _Lockstep, scenario: Scenario) -> Reply:
    """Boot with the switch off, then switch on until armed; returns the first armed control step's reply."""
    while link.step < ARM_LIMIT_S * link.control_rate_hz:
        switched = link.pilot.switched(link.step)
        reply = link.control_step()
        if link.armed and not switched:
            raise LinkError("the firmware is armed with the switch off: start a fresh one for each flight")
        if link.armed:
            return reply
    raise LinkError(
        f"the firmware did not arm within {ARM_LIMIT_S:g} s of scenario {scenario.name}'s boot: "
        f"{link.arming_reasons()}"
    )


def _disarm(link: _Lockstep) -> None:
    """Continue with the switch off until all motors are commanded to stop."""
    values = None
    for _ in range(math.ceil(DISARM_LIMIT_S * link.control_rate_hz)):
        values = link.control_step().dshot
        if not link.armed and not values.any():
            return
    assert values is not None
    raise LinkError(
        f"the firmware did not disarm within {DISARM_LIMIT_S:g} s of the pilot's switch: "
        f"it is {'armed' if link.armed else 'disarmed'}, DShot {values.tolist()}"
    )


def _see_log_out(link: _Lockstep, logged: Callable[[], bool]) -> None:
    """Continue until the log has ended, for LOG_END_LIMIT_S at most."""
    end = link.step + math.ceil(LOG_END_LIMIT_S * link.control_rate_hz)
    every = max(1, round(LOG_S * link.control_rate_hz))
    while not logged() and link.step < end:
        for _ in range(every):
            link.control_step()
