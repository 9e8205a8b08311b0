"""The lockstep loop: a twin and a firmware behind a port, one gyro sample at a time.

At each sample the port gets the twin's gyro and answers with DShot values, which act on the twin from the
next sample on. Until the firmware is armed the aircraft is held where it is; after the scenario the pilot
closes the throttle and switches off, and the motors must stop. Receiver frames go out just before the
control step they belong to: when the sticks changed, but no closer than SBUS can send them, and every 10 ms
in any case. Receiver frames are decided 4 ms (FRAME_SPACING_S) ahead of their control step, further at low
gyro rates, because a frame takes that long on a serial line: on every port alike, and a port that simulates
the line gets the frame at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sim.control import sticks
from sim.control.motors import motor_fractions
from sim.flight.scenario import Scenario
from sim.flight.trace import Trace
from sim.physics.twin import Twin
from sim.ports.port import FirmwarePort, Reply, Sample, SerialReceiverPort, control_divider
from toolchain.contract import BOOT_GRACE_MS, CALIBRATION_MS, CHANNEL_ARM, CHANNEL_THROTTLE
from toolchain.errors import LinkError

FRAME_S = 0.003  # an SBUS frame is 25 x 12 bits at 100 kbaud
FRAME_SPACING_S = 0.004  # a frame and a gap
FRAME_PERIOD_S = 0.010  # between frames of unchanged sticks
SWITCH_OFF_S = (max(BOOT_GRACE_MS, CALIBRATION_MS) + 50) / 1000  # before the first try to arm
SWITCH_PERIOD_S = 0.1  # of each further try: off, then on
ARM_LIMIT_S = 10.0  # from power-on; a noisy gyro may need more than one calibration
DISARM_LIMIT_S = 1.0  # from the pilot's switch to stopped motors
PROGRESS_S = 0.1  # of flight between two calls of `progress`

Progress = Callable[[float], None]  # gets the flown part, 0..1


def fly(
    twin: Twin,
    port: FirmwarePort,
    scenario: Scenario,
    *,
    motor_order: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> Trace:
    """Boot and arm the firmware, fly `scenario` and disarm; row 0 is the first armed control step.

    Arming and disarming are flown but not recorded.

    twin: one aircraft at rest, at the port's gyro rate. port: freshly booted. motor_order: output i of the
    firmware drives rotor motor_order[i]; a mis-wired aircraft, for tests.
    Raises LinkError when the firmware does not arm or disarm or the link fails, ScenarioError on impossible
    sticks.
    """
    pilot = _Pilot(scenario, port.control_rate_hz)
    link = _Lockstep(twin, port, pilot, motor_order)
    steps = pilot.steps
    rows = np.zeros(steps, _row(port.motor_count))
    rows[0] = _arm(link, scenario)
    every = max(1, round(PROGRESS_S * port.control_rate_hz))
    for k in range(1, steps):
        rows[k] = link.control_step()
        if progress is not None and k % every == 0:
            progress(k / steps)
    _disarm(link)
    return Trace(
        t=np.arange(steps) / port.control_rate_hz,
        motors=motor_fractions(rows["dshot"]),
        **{name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()},
    )


Row = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32], NDArray[np.uint16], float]


def _row(motors: int) -> np.dtype[np.void]:
    """What is kept of a control step, in the order of `Row`."""
    return np.dtype(
        [
            ("setpoint", np.float32, 3),
            ("rate", np.float64, 3),
            ("gyro", np.float32, 3),
            ("dshot", np.uint16, motors),
            ("throttle", np.float32),
        ]
    )


class _Pilot:
    """Sticks low and the switch off and on until the firmware is armed; the scenario; the switch off."""

    def __init__(self, scenario: Scenario, control_rate_hz: int) -> None:
        self._channels, self._heard = scenario.timeline(control_rate_hz)
        self.steps = len(self._channels)
        self._off = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False)
        # The switch goes on with the sticks where the scenario begins, throttle low as arming demands.
        self._on = self._channels[0].copy()
        self._on[CHANNEL_THROTTLE] = self._off[CHANNEL_THROTTLE]
        self._landed: NDArray[np.uint16] = self._channels[-1].copy()
        self._landed[[CHANNEL_THROTTLE, CHANNEL_ARM]] = self._off[[CHANNEL_THROTTLE, CHANNEL_ARM]]
        self._first = round(SWITCH_OFF_S * control_rate_hz)
        self._period = round(SWITCH_PERIOD_S * control_rate_hz)

    def switched(self, step: int) -> bool:
        """Whether the switch is on at control step `step`, while it has not armed yet."""
        phase = step - self._first
        return phase >= 0 and phase % self._period < self._period // 2

    def sticks(self, step: int, armed_at: int | None) -> NDArray[np.uint16] | None:
        """Channels at control step `step`; None: nothing is sent. armed_at: the first armed step."""
        if armed_at is None:
            return self._on if self.switched(step) else self._off
        k = step - armed_at
        if k >= self.steps:
            return self._landed
        return self._channels[k] if self._heard[k] else None


class _Lockstep:
    """Twin and firmware together, advanced by whole control steps."""

    def __init__(
        self, twin: Twin, port: FirmwarePort, pilot: _Pilot, motor_order: Sequence[int] | None
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
        self._twin, self._port, self.pilot, self._order = twin, port, pilot, order
        self._serial = port if isinstance(port, SerialReceiverPort) else None
        self._divider = control_divider(port.gyro_rate_hz, port.control_rate_hz)
        self._spacing = round(FRAME_SPACING_S * port.control_rate_hz)
        self._period = round(FRAME_PERIOD_S * port.control_rate_hz)
        # Control steps from the decision on a frame to its step: it must end one sample before that.
        lead_s = max(FRAME_SPACING_S, FRAME_S + 2 / port.gyro_rate_hz)
        self._lead = math.ceil(round(lead_s * port.control_rate_hz, 6))
        self._planned: dict[int, NDArray[np.uint16]] = {}  # frames by control step
        self._frame: NDArray[np.uint16] | None = None  # the last one planned
        self._frame_step = 0
        self._sample = 0
        self._held = True
        self._motors = np.zeros((1, motors))
        self._values: bytes | None = None  # DShot values whose fractions `_motors` holds
        self.step = 0  # control steps so far
        self.armed = False  # at the last of them
        self._armed_at: int | None = None  # the first of them that was
        self.control_rate_hz = port.control_rate_hz

    def control_step(self) -> Row:
        """Run one control period."""
        rate = self._twin.rate[0].copy()
        reply = self._exchange(self._planned.pop(self.step, None))
        self.armed = reply.armed
        if reply.armed and self._armed_at is None:
            self._armed_at = self.step
        self._plan(self.step + self._lead)
        for _ in range(1, self._divider):
            self._exchange(None)
        self.step += 1
        return reply.setpoint, rate, reply.gyro, reply.dshot, reply.throttle

    def arming_reasons(self) -> str:
        """What the firmware says keeps it disarmed."""
        return ", ".join(self._port.arming_reasons()) or "it names no reason"

    def _plan(self, step: int) -> None:
        """Decide whether a frame belongs to control step `step`."""
        channels = self.pilot.sticks(step, self._armed_at)
        if channels is None:
            return
        since = step - self._frame_step
        changed = self._frame is None or not np.array_equal(channels, self._frame)
        if self._frame is not None and since < (self._spacing if changed else self._period):
            return
        self._frame, self._frame_step = channels, step
        self._planned[step] = channels
        if self._serial is not None:
            self._serial.announce(channels.tolist(), step * self._divider - self._sample)

    def _exchange(self, channels: NDArray[np.uint16] | None) -> Reply:
        twin = self._twin
        sample = Sample(
            time_s=self._sample / twin.rate_hz,
            gyro=twin.gyro[0],
            rotation=twin.rotation[0],
            velocity=twin.velocity[0],
            position=twin.position[0],
            specific_force=twin.accelerometer[0],
        )
        reply = self._port.exchange(sample, None if channels is None else channels.tolist())
        values = reply.dshot.tobytes()
        if values != self._values:
            self._motors[0, self._order] = motor_fractions(reply.dshot)
            self._values = values
        # Until the firmware is armed the aircraft is held at rest: only its sensors are sampled.
        self._held = self._held and not reply.armed
        if self._held:
            if reply.dshot.any():
                raise LinkError(
                    f"the firmware turns motors while it is disarmed: DShot {reply.dshot.tolist()}"
                )
            twin.measure()
        else:
            twin.step(self._motors)
        self._sample += 1
        return reply


def _arm(link: _Lockstep, scenario: Scenario) -> Row:
    """Boot with the switch off, then switch on until armed; returns the first armed control step."""
    while link.step < ARM_LIMIT_S * link.control_rate_hz:
        switched = link.pilot.switched(link.step)
        row = link.control_step()
        if link.armed and not switched:
            raise LinkError("the firmware is armed with the switch off: start a fresh one for each flight")
        if link.armed:
            return row
    raise LinkError(
        f"the firmware did not arm within {ARM_LIMIT_S:g} s of scenario {scenario.name}'s boot: "
        f"{link.arming_reasons()}"
    )


def _disarm(link: _Lockstep) -> None:
    """Go on with the switch off until all motors are commanded to stop."""
    values = None
    for _ in range(math.ceil(DISARM_LIMIT_S * link.control_rate_hz)):
        values = link.control_step()[3]
        if not link.armed and not values.any():
            return
    assert values is not None
    raise LinkError(
        f"the firmware did not disarm within {DISARM_LIMIT_S:g} s of the pilot's switch: "
        f"it is {'armed' if link.armed else 'disarmed'}, DShot {values.tolist()}"
    )
