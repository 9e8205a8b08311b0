"""The attitude-rate PID that flies, every policy's baseline: the firmware's C, one for each of N aircraft.

What stands here gives firmware/src/control/pid.c its inputs and an aircraft's numbers, those of an image:

u_axis = c (K_P e + K_I sum(e) dt - a K_D d gyro/dt) / 1000 with the rate error e and the gyro in deg/s,
spread over the motors by a mixer that follows from the geometry unless the settings name their own, lifted
until no motor is below zero, and narrowed if it spans more than the whole range. a falls from 1 at a
throttle, the breakpoint, to 1 - rate at full throttle; c is (nominal / measured)^2 of the battery's voltage,
1 to PID_COMPENSATION_MAX. Both are 1 where the settings do not name them.

With the published gains and mixer, without noise and delay, 1,000 commands give MAE 4.50 / 4.77 / 3.77 deg/s,
where Koch 2019, table 5.7, has 4.773 / 4.941 / 3.829. The derivative of the error, not of the gyro, gives the
same to 0.01 deg/s, lifting by half the span 0.2 deg/s more, and clipping at zero half as much error again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.library import library
from neuroflight.sim.control.pid_table import pid_mixer, pid_settings, settings_table
from neuroflight.toolchain.rendering.pid_table import PidTable, pid_gains


class Pid:
    """N of the firmware's PIDs, all with the same settings or each with its own."""

    def __init__(
        self,
        mix: Array,
        settings: PidSettings | Sequence[PidSettings],
        count: int,
        control_rate_hz: int,
        *,
        standing: bool = False,
    ) -> None:
        """mix: (M, 3), the share of each motor in roll, pitch, yaw; settings: for all, or `count` of them.

        `mix` is used, not the mixer of the settings. standing: the aircraft stand on the ground all the time,
        which the firmware knows: integrals do not grow. Raises BuildError, one line, without a C compiler.
        """
        each = [settings] if isinstance(settings, PidSettings) else list(settings)
        if len(each) not in (1, count):
            raise ValueError(f"{len(each)} settings for {count} controllers: expected 1 or {count}")
        self._count, self._motors = count, len(mix)
        self._ffi, self._c = (found := library(self._motors)).ffi, found.lib
        gains = [_members(settings_table(item, mix, "", ""), control_rate_hz) for item in each]
        self._gains = self._ffi.new("struct pid_gains[]", gains)
        self._memory = self._ffi.new("uint64_t[]", self._c.pids_size(count) // 8 + 1)
        self._pids = self._ffi.cast("struct pids *", self._memory)
        self._c.pids_init(self._pids, count, self._gains, len(each), standing)

    def reset(self) -> None:
        """Clear integral and derivative; the derivative of the next step is zero. The voltage stays."""
        self._c.pids_reset(self._pids)

    def compensate(self, voltage: Array | Array32) -> None:
        """Fly from now on by the packs' voltages (count,) [V], as filtered; NaN where none is known."""
        self._c.pids_compensate(self._pids, self._rows(voltage))

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """See Controller."""
        y = np.empty((self._count, self._motors), np.float32)
        given = self._rows(setpoint, 3), self._rows(gyro, 3), self._rows(throttle)
        self._c.pids_step(self._pids, *given, self._ffi.from_buffer("float[]", y))
        return y

    def _rows(self, values: Array | Array32, *width: int) -> Any:  # noqa: ANN401 - a pointer of cffi
        """Return a pointer to a row for each aircraft, which it keeps alive. Raises ValueError on others."""
        rows = np.ascontiguousarray(values, np.float32)
        if rows.shape != (self._count, *width):
            raise ValueError(f"got an array {rows.shape}, expected {(self._count, *width)}")
        return self._ffi.from_buffer("float[]", rows)


def _members(table: PidTable, control_rate_hz: int) -> dict[str, Any]:
    """Return the members of struct pid_gains."""
    numbers = {name: value.tolist() for name, value in pid_gains(table, control_rate_hz).items()}
    return {"motor_count": table.motor_count, "mix": table.mix, **numbers}


def aircraft_pid(
    aircraft: Aircraft,
    count: int = 1,
    control_rate_hz: int = 1000,
    name: str | None = None,
    *,
    standing: bool = False,
) -> Pid:
    """Return the PID called `name` in the aircraft file, its first one unless given. Raises AircraftError."""
    settings = pid_settings(aircraft, name)
    return Pid(pid_mixer(aircraft, settings), settings, count, control_rate_hz, standing=standing)
