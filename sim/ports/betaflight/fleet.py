"""Many Betaflights at a time, each a copy of one that has booted, been calibrated and armed at rest.

Boot, calibration and arming take seconds, and every flight would repeat them to the bit: the gyro stands
still meanwhile. So they are done once, and each aircraft gets a copy of the process as it stands then (see
clock.c): its integral and filters are at rest, its motors idle since a sample. A copy flies one episode and
ends with it, so that no episode depends on another one.

Copies see the gyro as it is: its bias stays in it, as it does for the controllers that fly beside them.
"""

from __future__ import annotations

import array
import math
import resource
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.control import sticks
from neuroflight.sim.control.motors import motor_fractions
from neuroflight.sim.physics.twin import Live
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.port import (
    AT_REST,
    STOP_US,
    TIME_MARGIN,
    BetaflightPort,
    aircraft_settings,
    dshot_of_widths,
    wire_rates,
)
from neuroflight.sim.ports.betaflight.process import ANSWER_S, BetaflightProcess
from neuroflight.sim.ports.betaflight.tune import Tune
from neuroflight.sim.ports.simulator_link import load_link
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    CALIBRATION_MS,
    CHANNEL_COUNT,
    GYRO_RATE_DEFAULT_HZ,
)
from neuroflight.toolchain.errors import LinkError

ARM_LIMIT_S = 10.0  # of its time, from power-on
SWITCH_OFF_S = (max(BOOT_GRACE_MS, CALIBRATION_MS) + 50) / 1000  # before the first try to arm
SWITCH_PERIOD_S = 0.1  # of each further try: on, then off
FRAME_S = 0.01  # between receiver frames until it is armed
DESCRIPTORS = 64  # open files of a program beside the sockets to copies
_KINDS = {"float64": "double[]", "float32": "float[]", "uint16": "uint16_t[]", "bool": "bool[]"}


class ArmedBetaflight:
    """A Betaflight that stands armed at rest, to be copied; use it in a `with`, or close it."""

    def __init__(
        self,
        betaflight: Betaflight,
        aircraft: Aircraft,
        tune: Tune | None = None,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
    ) -> None:
        """Boot and arm it with a gyro that stands still; tune: laid over its defaults.

        Raises AircraftError if it cannot fly the aircraft, LinkError if it refuses a setting, does not start
        or arm.
        """
        self.tune = tune
        settings = aircraft_settings(aircraft)
        self.port = BetaflightPort(betaflight, gyro_rate_hz, settings, tune, aircraft.motor_count)
        try:
            self.samples = self._arm()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ArmedBetaflight:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it and all its copies. May be called twice."""
        self.port.close()

    @property
    def gyro_rate_hz(self) -> int:
        return self.port.gyro_rate_hz

    @property
    def process(self) -> BetaflightProcess:
        return self.port.process

    def _arm(self) -> int:
        """Arm it; return the samples until then."""
        rate = self.gyro_rate_hz
        off, on = (sticks.channels((0.0, 0.0, 0.0), 0.0, armed=armed).tolist() for armed in (False, True))
        every, period = math.ceil(FRAME_S * rate), round(SWITCH_PERIOD_S * rate)
        first = round(SWITCH_OFF_S * rate)  # with which it may arm
        begun = first // every * every
        for _ in range(0, begun, every):
            self.port.stand(off, every)
        for sample in range(begun, round(ARM_LIMIT_S * rate)):
            switched = on if sample >= first and (sample - first) % period < period // 2 else off
            if self.port.exchange(AT_REST, switched if sample % every == 0 else None).armed:
                return sample + 1
        raise LinkError(
            f"Betaflight: it did not arm within {ARM_LIMIT_S:g} s: {', '.join(self.port.arming_reasons())}"
        )


class BetaflightFleet:
    """Copies of armed Betaflights, one for each aircraft of a twin; use it in a `with`."""

    def __init__(self, armed: Sequence[ArmedBetaflight], live: Live) -> None:
        """live: of the twin, whose aircraft get copies of each of `armed` in turn, equally many.

        Raises LinkError if the system does not give as many processes, or they did not arm at the same time.
        """
        count = len(live.rate)
        each, rest = divmod(count, len(armed))
        first = armed[0]
        if rest:
            raise ValueError(f"{count} aircraft for {len(armed)} Betaflights")
        if any((one.samples, one.process.now_ns) != (first.samples, first.process.now_ns) for one in armed):
            raise LinkError("Betaflight: settings that make it arm at another time fly alone only")
        self._rate = first.gyro_rate_hz
        self._period_ns = 1_000_000_000 // self._rate
        self._samples = first.samples
        self._widths = np.full((count, first.port.motor_count), STOP_US, np.float32)
        self._rates = np.zeros((count, 3))
        self._channels = np.zeros((count, CHANNEL_COUNT), np.uint16)
        self._heard = np.zeros(count, np.bool_)
        _allow_files(count)
        with ExitStack() as undo:
            copies = [undo.enter_context(one.process.copy()) for one in armed for _ in range(each)]
            self._sockets = array.array("i", [copy.fileno() for copy in copies])
            self._end = undo.pop_all()
        self._link = load_link()
        rows: dict[str, NDArray[Any]] = {"rates": self._rates, "widths": self._widths, "heard": self._heard}
        rows |= {"channels": self._channels, "force": live.accelerometer, "rotation": live.rotation}
        rows |= {"velocity": live.velocity, "position": live.position}
        self._state = self._link.ffi.new("struct fleet *")
        self._state.count = count
        self._state.motors = first.port.motor_count
        self._kept = {"sockets": self._link.ffi.from_buffer("int[]", self._sockets)}
        self._kept |= {
            name: self._link.ffi.from_buffer(_KINDS[values.dtype.name], values)
            for name, values in rows.items()
        }
        for name, pointer in self._kept.items():
            setattr(self._state, name, pointer)
        self._state.limit_ns = first.process.now_ns

    def __enter__(self) -> BetaflightFleet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the copies, which end with their sockets. May be called twice."""
        self._end.close()

    def exchange(self, raw: NDArray[np.int16], channels: NDArray[np.uint16] | None) -> Array:
        """Return motor fractions (N, M) that follow on a sample with the gyro counts `raw` (N, 3).

        channels: (N, CHANNEL_COUNT) [us], a receiver frame for each; None: none. The other sensors are the
        twin's. Raises LinkError when one of them fails.
        """
        state, lib = self._state, self._link.lib
        self._rates[:] = wire_rates(raw)
        self._heard[:] = channels is not None
        if channels is not None:
            self._channels[:] = channels
        state.time_s = self._samples / self._rate * (1 + TIME_MARGIN)
        state.limit_ns += self._period_ns
        self._samples += 1
        result = lib.fleet_send(state)
        if result == lib.LINK_NEW:
            result = lib.fleet_await(state)
        while result == lib.LINK_AGAIN:
            result = lib.fleet_await(state)
        if result == lib.LINK_SILENT:
            raise LinkError(f"Betaflight: copy {state.next + 1} does not come back within {ANSWER_S:g} s")
        if result != lib.LINK_NEW:
            raise LinkError(f"Betaflight: copy {state.next + 1} is gone (errno {state.error})")
        return motor_fractions(dshot_of_widths(self._widths))


def _allow_files(count: int) -> None:
    """Let this program hold sockets to that many copies. Raises LinkError if the system does not."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = count + DESCRIPTORS
    if soft != resource.RLIM_INFINITY and soft < wanted:
        if hard != resource.RLIM_INFINITY and hard < wanted:
            raise LinkError(
                f"{count} Betaflights at a time take {wanted} open files, this system allows {hard}; "
                "fly fewer commands"
            )
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
