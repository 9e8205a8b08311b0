"""The lockstep loop: a twin and a firmware behind a port, one gyro sample at a time.

At each sample the port gets the twin's gyro and answers with DShot values, which act on the twin from
the next sample on. Until the firmware is armed the aircraft is held where it is. Receiver frames go out
just before the control step they belong to: when the sticks changed, but no closer than SBUS can send
them, and every 10 ms in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sim import sticks
from sim.motors import motor_fractions
from sim.port import FirmwarePort, Reply, Sample, control_divider
from sim.scenario import Scenario
from sim.trace import Trace
from sim.twin import Twin
from toolchain.contract import BOOT_GRACE_MS, CALIBRATION_MS, CHANNEL_THROTTLE
from toolchain.errors import LinkError

FRAME_SPACING_S = 0.004  # an SBUS frame is 25 x 12 bits at 100 kbaud = 3 ms, and a gap
FRAME_PERIOD_S = 0.010  # between frames of unchanged sticks
SWITCH_OFF_S = (max(BOOT_GRACE_MS, CALIBRATION_MS) + 50) / 1000  # before the first try to arm
SWITCH_PERIOD_S = 0.1  # of each further try: off, then on
ARM_LIMIT_S = 10.0  # from power-on; a noisy gyro may need more than one calibration
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
    """Boot and arm the firmware, then fly `scenario`; row 0 is the first armed control step.

    twin: one aircraft at rest, at the port's gyro rate. port: freshly booted. motor_order: output i of the
    firmware drives rotor motor_order[i]; a mis-wired aircraft, for tests.
    Raises LinkError when the firmware does not arm or the link fails, ScenarioError on impossible sticks.
    """
    channels, heard = scenario.timeline(port.control_rate_hz)
    link = _Lockstep(twin, port, motor_order)
    steps = len(channels)
    rows = np.zeros(steps, _row(port.motor_count))
    rows[0] = _arm(link, scenario, channels[0])
    every = max(1, round(PROGRESS_S * port.control_rate_hz))
    for k in range(1, steps):
        rows[k] = link.control_step(channels[k] if heard[k] else None)
        if progress is not None and k % every == 0:
            progress(k / steps)
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


class _Lockstep:
    """Twin and firmware together, advanced by whole control steps."""

    def __init__(self, twin: Twin, port: FirmwarePort, motor_order: Sequence[int] | None) -> None:
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
        self._twin, self._port, self._order = twin, port, order
        self._divider = control_divider(port.gyro_rate_hz, port.control_rate_hz)
        self._spacing = round(FRAME_SPACING_S * port.control_rate_hz)
        self._period = round(FRAME_PERIOD_S * port.control_rate_hz)
        self._frame: NDArray[np.uint16] | None = None  # the last one sent
        self._frame_step = 0
        self._sample = 0
        self._held = True
        self._motors = np.zeros((1, motors))
        self._values: bytes | None = None  # DShot values that `_motors` stands for
        self.step = 0  # control steps so far
        self.armed = False  # at the last of them
        self.control_rate_hz = port.control_rate_hz

    def control_step(self, channels: NDArray[np.uint16] | None) -> Row:
        """Run one control period with the sticks at `channels`; None: the transmitter is silent."""
        rate = self._twin.rate[0].copy()
        reply = self._exchange(channels if self._due(channels) else None)
        for _ in range(1, self._divider):
            self._exchange(None)
        self.step += 1
        self.armed = reply.armed
        return reply.setpoint, rate, reply.gyro, reply.dshot, reply.throttle

    def arming_reasons(self) -> str:
        """What the firmware says keeps it disarmed."""
        return ", ".join(self._port.arming_reasons()) or "it names no reason"

    def _due(self, channels: NDArray[np.uint16] | None) -> bool:
        if channels is None:
            return False
        since = self.step - self._frame_step
        changed = self._frame is None or not np.array_equal(channels, self._frame)
        if self._frame is not None and since < (self._spacing if changed else self._period):
            return False
        self._frame, self._frame_step = channels, self.step
        return True

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
        # Until it is armed the aircraft stands: only its gyro goes on.
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


def _arm(link: _Lockstep, scenario: Scenario, first: NDArray[np.uint16]) -> Row:
    """Boot with the switch off, then switch on until armed; returns the first armed control step.

    The switch goes on with the sticks where the scenario begins, throttle low as arming demands.
    """
    off = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False)
    on = first.copy()
    on[CHANNEL_THROTTLE] = off[CHANNEL_THROTTLE]
    rate = link.control_rate_hz
    period = round(SWITCH_PERIOD_S * rate)
    while link.step < ARM_LIMIT_S * rate:
        phase = link.step - round(SWITCH_OFF_S * rate)
        switched = phase >= 0 and phase % period < period // 2
        row = link.control_step(on if switched else off)
        if link.armed and not switched:
            raise LinkError("the firmware is armed with the switch off: start a fresh one for each flight")
        if link.armed:
            return row
    raise LinkError(
        f"the firmware did not arm within {ARM_LIMIT_S:g} s of scenario {scenario.name}'s boot: "
        f"{link.arming_reasons()}"
    )
