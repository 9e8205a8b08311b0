"""The image itself behind the port: build/MATEKF722/neuroflight.bin on the emulated board, in lockstep.

The board is powered with the port and stands, between two exchanges, one cycle before the edge of the gyro
chip's data-ready line that the firmware reads next. An exchange lets the chip measure, and the board run to
the cycle before the edge after that: motor frames, receiver bytes and everything else take their time in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flash.messages import arming_reasons
from sim.board.board import Board
from sim.board.context import TIME_HZ
from sim.board.gyro_chip import MPU6500, READY, Alignment, accel_counts, gyro_counts
from sim.board.usart import SBUS
from sim.board.variables import Variable, read_variables
from sim.port import Reply, Sample, control_divider
from toolchain.contract import (
    CHANNEL_COUNT,
    GYRO_EDGE_RATE_HZ,
    GYRO_RATE_DEFAULT_HZ,
    SBUS_FOOTER,
    SBUS_FRAME_BYTES,
    SBUS_HEADER,
)
from toolchain.errors import LinkError

ALIGNMENT = Alignment.CW180  # of the MPU6500 on this board
FULL_VOLTS = 16.8  # of the pack that feeds it: four cells, full, at rest
RECEIVER = "USART2"
BOOT_S = 5.0  # from power to the first sample that the firmware reads
EDGE_CYCLES = TIME_HZ // GYRO_EDGE_RATE_HZ
_SBUS_ZERO_US, _SBUS_VALUE_MAX = 880, 2047
_READY_LINE = int(READY[2:])
_TRACE, _SAMPLES, _REASONS, _DIVIDER, _RATE = (
    f"firmware.{name}"
    for name in ("status.trace", "samples", "status.arming_reasons", "control_divider", "gyro_rate_hz")
)


class EmulatedPort:
    """FirmwarePort around a board of its own. What the board does not forgive comes as BoardError."""

    def __init__(self, image: Path, gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ) -> None:
        """Power a board with `image` in its flash, and boot it; its ELF lies beside it.

        Raises LinkError when either is missing, or the firmware does not come to read its gyro at that rate,
        BuildError when the ELF is none of ours, BoardError for what the image does wrong.
        """
        elf = image.with_suffix(".elf")
        for path in (image, elf):
            if not path.is_file():
                raise LinkError(f"{path}: not built yet; build it with `make firmware TARGET=MATEKF722`")
        names = (_TRACE, _SAMPLES, _REASONS, _DIVIDER, _RATE)
        self._variables = dict(zip(names, read_variables(elf, *names), strict=True))
        self._trace = self._variables[_TRACE]
        self.board = Board(image.read_bytes(), elf=elf, chip=MPU6500)
        try:
            self.board.hardware.adc.set_battery(FULL_VOLTS, 0.0)
            self._edge = self._boot()  # the cycle of the edge that the firmware reads next
            self.gyro_rate_hz = int(self._read(_RATE))
            self.motor_count = int(self._read(_TRACE)["motor_count"])
            if self.gyro_rate_hz != gyro_rate_hz:
                raise LinkError(
                    f"{image}: reads its gyro at {self.gyro_rate_hz} Hz as flashed, asked for "
                    f"{gyro_rate_hz} Hz: fly at {self.gyro_rate_hz} Hz"
                )
        except BaseException:
            self.board.close()
            raise
        self._divider = int(self._read(_DIVIDER))
        self.control_rate_hz = self.gyro_rate_hz // self._divider
        assert control_divider(self.gyro_rate_hz, self.control_rate_hz) == self._divider
        self._period = TIME_HZ // self.gyro_rate_hz
        self._samples = 0
        self._announced: list[tuple[int, list[int]]] = []  # number of the sample, channels
        self._reply: Reply | None = None

    def announce(self, channels_us: Sequence[int], samples: int) -> None:
        """See ForeseeingPort. The frame's last byte ends one gyro period before the sample's edge.

        Raises LinkError when it is too late for that.
        """
        wanted = self._edge + (samples - 1) * self._period
        end = self.board.hardware.usarts[RECEIVER].feed(sbus_frame(channels_us), SBUS, end=wanted)
        if end > wanted:
            late = 1e6 * (end - wanted) / TIME_HZ
            raise LinkError(f"a receiver frame is announced {late:.0f} us too late for its time on the line")
        self._announced.append((self._samples + samples, list(channels_us)))

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort. A frame must have been announced."""
        due = self._announced.pop(0)[1] if self._next_frame() == self._samples else None
        if due != (None if channels_us is None else list(channels_us)):
            raise LinkError("a receiver frame for the board must be announced before its time on the line")
        if not (np.isfinite(sample.gyro).all() and np.isfinite(sample.specific_force).all()):
            raise LinkError(f"gyro {sample.gyro}, force {sample.specific_force}: no chip measures that")
        self.board.hardware.gyro.measure(
            accel_counts(sample.specific_force.tolist(), ALIGNMENT),
            0,
            gyro_counts(sample.gyro.tolist(), ALIGNMENT),
        )
        self._edge += self._period
        self.board.run_to(self._edge - 1)
        self._samples += 1
        if int(self._read(_SAMPLES)) != self._samples:
            raise LinkError(
                f"the firmware has taken {self._read(_SAMPLES)} gyro samples, it was given {self._samples}"
            )
        values = self._dshot()
        control_step = (self._samples - 1) % self._divider == 0
        if control_step or self._reply is None or values.tobytes() != self._reply.dshot.tobytes():
            trace = self._read(_TRACE)
            self._reply = Reply(
                dshot=values,
                step=int(trace["step"]),
                setpoint=trace["setpoint"].astype(np.float32),
                gyro=trace["gyro"].astype(np.float32),
                throttle=float(trace["throttle"]),
                armed=bool(trace["armed"]),
            )
        return self._reply

    def arming_reasons(self) -> tuple[str, ...]:
        """See FirmwarePort."""
        return arming_reasons(int(self._read(_REASONS)))

    def close(self) -> None:
        """Give the board's memory back."""
        self.board.close()

    def _boot(self) -> int:
        """Run until the cycle before the first edge that the firmware listens to; that edge's cycle."""
        board, gyro, exti = self.board, self.board.hardware.gyro, self.board.hardware.exti
        limit = round(BOOT_S * TIME_HZ)
        while board.cycle < limit:
            edge = gyro.next_sample
            if edge is None:
                board.run_to(board.cycle + EDGE_CYCLES // 2)
            elif board.cycle < edge - 1:
                board.run_to(edge - 1)
            elif exti.words["IMR"] >> _READY_LINE & 1:
                return edge
            else:
                board.run_to(edge + EDGE_CYCLES // 2)
        reasons = ", ".join(self.arming_reasons()) or "it names no reason"
        raise LinkError(f"the firmware reads no gyro sample within {BOOT_S:g} s of its boot: {reasons}")

    def _next_frame(self) -> int | None:
        return self._announced[0][0] if self._announced else None

    def _dshot(self) -> NDArray[np.uint16]:
        """What each motor's ESC was told last; 0 until it was told anything."""
        last = [esc.last for esc in self.board.hardware.escs[: self.motor_count]]
        return np.array([0 if frame is None else frame.value for frame in last], np.uint16)

    def _read(self, name: str) -> Any:  # noqa: ANN401 - a number or a record
        variable: Variable = self._variables[name]
        data = self.board.engine.memory(variable.address, variable.size)
        return np.frombuffer(data, variable.dtype)[0]


def sbus_frame(channels_us: Sequence[int]) -> bytes:
    """The frame that a receiver sends for CHANNEL_COUNT pulse widths [us].

    Those outside 880..2159 are sent as the nearer end; whole microseconds between come out as they went in.
    """
    if len(channels_us) != CHANNEL_COUNT:
        raise ValueError(f"{len(channels_us)} channels, expected {CHANNEL_COUNT}")
    bits = 0
    for number, us in enumerate(channels_us):
        value = min(max(us - _SBUS_ZERO_US, 0) * 8 // 5, _SBUS_VALUE_MAX)
        bits |= value << 11 * number
    frame = bytes([SBUS_HEADER]) + bits.to_bytes(2 * 11, "little") + bytes([0, SBUS_FOOTER])
    assert len(frame) == SBUS_FRAME_BYTES
    return frame
