"""A Python controller behind the port: another algorithm in the firmware's control path.

Gyro counts and their conversion, sticks, throttle mix, idle and DShot values are the firmware's, in
float32. Arming is reduced to what makes flights comparable: after a second of gyro averaging (its mean is the
bias; motion is not looked for) the switch going on with the throttle low arms, the switch going off or a
receiver lost for 1 s disarms, and after 100 ms of silence the sticks count as centred. A PID follows the
battery's voltage as the firmware's does. A policy that observes rotor speeds has them from ESCs that answer
every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array32
from neuroflight.sim.control import sticks
from neuroflight.sim.control.battery_voltage import BatteryVoltage
from neuroflight.sim.control.controller import Controller, PolicyController
from neuroflight.sim.control.gyro_filter import GyroFilter
from neuroflight.sim.control.motors import dshot_values, throttle_mix
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.physics.esc import Words, words_speed
from neuroflight.sim.physics.imu import RATE_PER_COUNT, counts
from neuroflight.sim.ports.port import Reply, Sample, control_divider
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    CALIBRATION_MS,
    CHANNEL_ARM,
    CHANNEL_THROTTLE,
    ESC_STANDS,
    GYRO_RATE_DEFAULT_HZ,
    IDLE_DEFAULT,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    SWITCH_ON_US,
    THROTTLE_LOW_US,
    Mix,
)
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters


class ControllerPort:
    """FirmwarePort around a Controller of one aircraft."""

    def __init__(
        self,
        controller: Controller,
        motor_count: int,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        control_rate_hz: int = 1000,
        idle: float = IDLE_DEFAULT,
        *,
        mix: Mix = Mix.ATTITUDE_FIRST,
        gyro_filters: GyroFilters = UNFILTERED,
    ) -> None:
        """gyro_filters: before the controller.

        Raises LinkError when the control rate does not divide the gyro rate.
        """
        self.motor_count = motor_count
        self.gyro_rate_hz = gyro_rate_hz
        self.control_rate_hz = control_rate_hz
        self._controller = controller
        self._idle, self._mix = idle, mix
        self._divider = control_divider(gyro_rate_hz, control_rate_hz)
        self._filter = GyroFilter(gyro_filters, 1, motor_count, control_rate_hz, self._divider)
        self._calibration = CALIBRATION_MS * gyro_rate_hz // 1000  # samples
        self._grace = max(CALIBRATION_MS, BOOT_GRACE_MS) * gyro_rate_hz // 1000
        self._hold = RECEIVER_HOLD_MS * gyro_rate_hz // 1000
        self._lost = RECEIVER_LOST_MS * gyro_rate_hz // 1000
        self._still = np.zeros((self._calibration, 3))  # gyro of the samples that the bias is taken from
        self._bias = np.zeros(3, np.float32)  # [rad/s]
        self._samples = 0
        self._volts = math.nan  # of the battery, where one is known
        self._battery = BatteryVoltage(control_rate_hz)
        self._hear(sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False))
        self._age = self._lost  # samples since the last frame
        self._switch = True  # as of the step before: on, so that a switch left on does not arm
        self._armed = False
        self._reply: Reply | None = None
        self.hears_rotors = gyro_filters.rpm is not None or (
            isinstance(controller, PolicyController) and controller.hears_rotors
        )
        self._words = np.full(motor_count, ESC_STANDS, np.uint16)  # the ESCs' to the frame of the next sample
        self._answered = self._words  # and to that of the last one

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        if self._samples < self._calibration:
            self._still[self._samples] = sample.gyro
            if self._samples == self._calibration - 1:
                total = counts(self._still).sum(axis=0, dtype=np.int64)
                self._bias = total.astype(np.float32) / np.float32(self._calibration) * RATE_PER_COUNT
        self._age += 1
        if channels_us is not None:
            self._hear(np.array(channels_us, np.uint16))
            self._age = 0
        if self._samples % self._divider == 0:
            self._filter.told(words_speed(self._answered)[None])
        self._filter.add((counts(sample.gyro).astype(np.float32) * RATE_PER_COUNT - self._bias)[None])
        if isinstance(self._controller, PolicyController) and self._controller.senses:
            self._controller.sense(words_speed(self._answered)[None], sample.rotation[None])
        self._answered = self._words
        if self._samples % self._divider == 0 or self._reply is None:
            self._reply = self._control(self._filter.read()[0], self._samples // self._divider)
        self._samples += 1
        return self._reply

    def set_battery(self, volts: float, amps: float) -> None:
        self._volts = volts

    def set_rotors(self, words: Words) -> None:
        self._words = words

    def arming_reasons(self) -> tuple[str, ...]:
        """See FirmwarePort; always empty: it waits for calibration and the switch only."""
        return ()

    def close(self) -> None:
        """See FirmwarePort."""

    def _hear(self, channels: NDArray[np.uint16]) -> None:
        self._channels = channels
        self._setpoint = sticks.setpoint(channels)
        self._throttle = sticks.throttle(channels[None])

    def _control(self, gyro: Array32, step: int) -> Reply:
        setpoint = np.zeros(3, np.float32) if self._age >= self._hold else self._setpoint
        throttle = self._throttle
        self._arm()
        dshot = np.zeros(self.motor_count, np.uint16)
        if self._armed:
            y = self._controller.step(setpoint[None], gyro[None], throttle)
            dshot = dshot_values(throttle_mix(y, throttle, self._mix), self._idle)[0]
        if isinstance(self._controller, Pid) and self._battery.due(step):
            self._controller.compensate(self._battery.measure(np.array([self._volts])))
        return Reply(dshot, step, setpoint, gyro, float(throttle[0]), self._armed)

    def _arm(self) -> None:
        switch = bool(self._channels[CHANNEL_ARM] >= SWITCH_ON_US)
        low = self._channels[CHANNEL_THROTTLE] <= THROTTLE_LOW_US
        if not switch or self._age >= self._lost:
            self._armed = False
        elif not self._armed and not self._switch and low and self._samples >= self._grace:
            self._controller.reset()
            self._armed = True
        self._switch = switch
