"""The control path of the board's image, executed on an emulated Cortex-M7, gives the host's bits.

The image's own functions are called one by one with arguments in RAM; nothing of the chip is emulated.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.control.observation import Observer
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    DTCM,
    FLASH_BASE,
    FLASH_BYTES,
    ITCM,
    SRAM1,
    SRAM2,
    ArmingReason,
    Mode,
    ModeRange,
    Region,
    observation_blocks,
    observation_count,
)
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program

MEMORY = (ITCM, Region("flash", FLASH_BASE, FLASH_BYTES), DTCM, SRAM1, SRAM2)
FIRMWARE_BYTES = DTCM.size  # struct firmware with the weights lies there on the board
TRACE_BYTES = 34 + 2 * 4  # struct control_trace up to the last motor; without pointers, so equal on both
GYRO_HZ, CW180, MPU6500 = 1000, 2, 0
G_COUNTS = 2048
BOOT_STEPS, FLIGHT_STEPS = 1010, 400
OBSERVATION_BYTES = 2048  # struct observation has some 1100
TERMS = (
    "rate_error,rate_error_integral,rate,rate~15Hz,rate_error_delta~80Hz@1,previous_action~40Hz@2,"
    "throttle@16,throttle~5Hz@3,rate@7,previous_action"
)


def sample_bytes(step: int, counts: tuple[int, int, int]) -> bytes:
    """struct imu_sample of a level aircraft whose accelerometer's last bit moves; CW180 turns x and y."""
    return np.array([*counts, 0, 0, G_COUNTS + step % 2, 0, 1], "<i2").tobytes()


class Board:
    """The image in the memory of a CPU that only runs what it is told to."""

    def __init__(self, image: Path, host: Host) -> None:
        """host: its settings and PID, whose structs have no pointers, are the board's too."""
        program = load_program(image)
        self._core = CortexM7(program, MEMORY)
        self.firmware = self._core.allocate(FIRMWARE_BYTES)
        self._argument, self._out = self._core.allocate(64), self._core.allocate(8)
        settings, pid = (self._kept(data) for data in (host.settings_bytes(), host.pid_bytes()))
        weights = self._kept(host.weights_bytes())
        # AAPCS gives a small enum and a bool one byte, the others are padding.
        straight, header = 0, self._kept(host.header_bytes())
        words = (GYRO_HZ, CW180, straight, MPU6500, settings, weights, header, 1, pid)
        config = b"".join(word.to_bytes(4, "little") for word in words)
        self._core.write(self._argument, config)
        assert self._core.call("firmware_init", self.firmware, self._argument) == 0
        self._core.call("firmware_forbid", self.firmware, ArmingReason.BATTERY_UNKNOWN, 0)

    def _kept(self, data: bytes) -> int:
        address = self._core.allocate(len(data))
        self._core.write(address, data)
        return address

    def power(self, voltage: float) -> None:
        """What the background has measured."""
        self._core.call("firmware_power", self.firmware, number=voltage)

    def step(self, frame: bytes, sample: bytes) -> tuple[bytes, bytes]:
        """One control step; returns the DShot values and the trace, as they lie in memory."""
        self._core.write(self._argument, frame)
        self._core.call("firmware_receive", self.firmware, self._argument, len(frame))
        self._core.write(self._argument, sample)
        self._core.call("firmware_sample", self.firmware, self._argument, self._out)
        trace = self._core.call("firmware_trace", self.firmware)
        return self._core.read(self._out, 8), self._core.read(trace, TRACE_BYTES)


class Host:
    """The same calls into the shared library."""

    def __init__(self, core: Any) -> None:
        self._core = core
        self.firmware = core.new("struct firmware *")
        self.settings = core.new("struct nf_settings *")
        core.lib.settings_default(self.settings)
        self.settings.arming_delay_ms = BOOT_GRACE_MS
        self.settings.mode5 = ModeRange(Mode.CHIRP, 5, 1700, 2100).packed
        self.settings.chirp_s = 1.0
        lib, self._pid = core.lib, core.ffi.addressof(core.lib, "pid_gains_built_in")
        self._header = core.ffi.cast(
            "struct nf_policy_blob_header *", core.ffi.addressof(lib.policy_blob.header)
        )
        config = core.new(
            "struct firmware_config *",
            {
                "gyro_rate_hz": GYRO_HZ,
                "alignment": CW180,
                "gyro_chip": MPU6500,
                "settings": self.settings,
                "weights": lib.policy_weights,
                "policy": self._header,
                "policy_good": True,
                "pid": self._pid,
            },
        )
        assert lib.firmware_init(self.firmware, config) == 0
        lib.firmware_forbid(self.firmware, ArmingReason.BATTERY_UNKNOWN, False)
        self._dshot = core.new("uint16_t[4]")

    def settings_bytes(self) -> bytes:
        return bytes(self._core.ffi.buffer(self.settings))

    def header_bytes(self) -> bytes:
        return bytes(self._core.ffi.buffer(self._header))

    def pid_bytes(self) -> bytes:
        return bytes(self._core.ffi.buffer(self._pid))

    def power(self, voltage: float) -> None:
        self._core.lib.firmware_power(self.firmware, voltage)

    def weights_bytes(self) -> bytes:
        return bytes(self._core.ffi.buffer(self._core.lib.policy_weights))

    def step(self, frame: bytes, sample: bytes) -> tuple[bytes, bytes]:
        lib, ffi = self._core.lib, self._core.ffi
        lib.firmware_receive(self.firmware, frame, len(frame))
        lib.firmware_sample(
            self.firmware, ffi.cast("struct imu_sample *", ffi.from_buffer(sample)), self._dshot
        )
        trace = ffi.buffer(lib.firmware_trace(self.firmware))
        return bytes(ffi.buffer(self._dshot)), bytes(trace[:TRACE_BYTES])


@pytest.fixture(scope="module")
def board(board_image: Path, host: Host) -> Board:
    return Board(board_image, host)


@pytest.fixture(scope="module")
def host(reference_core: Any) -> Host:
    return Host(reference_core)


def test_the_boards_control_path_gives_the_hosts_bits_when_armed_and_shaken(
    board: Board,
    host: Host,
    sbus: Any,
) -> None:
    rng, power = np.random.default_rng(31), np.random.default_rng(32)
    values: set[bytes] = set()
    axes: set[int] = set()
    voltages: list[float] = []
    for step in range(BOOT_STEPS + FLIGHT_STEPS):
        flying = step >= BOOT_STEPS
        sigma = 10 if not flying else 10 ** rng.uniform(0, 4)
        x, y, z = np.clip(rng.normal(40, sigma, 3).round(), -32768, 32767).astype(int).tolist()
        sticks = rng.integers(172, 1812, 4)
        sticks[2] = 192 if step < BOOT_STEPS + 20 else sticks[2]
        pid = 1792 if step // 90 % 2 else 192  # the controllers take turns
        chirp = 1792 if step // 20 % 3 else 192
        channels = [*sticks.tolist(), 1792 if flying else 192, pid, *[992] * 2, chirp, *[992] * 7]
        frame = sbus(channels) if step % 7 == 0 else b""
        if flying and step == BOOT_STEPS:
            frame = sbus([992, 992, 192, 992, 1792, *[992] * 11])
        sample = sample_bytes(step, (x, y, z))
        if step % 10 == 0:
            voltages.append(power.choice([0.0, power.uniform(12.5, 17.0)]))
            host.power(voltages[-1])
            board.power(voltages[-1])
        ours, theirs = host.step(frame, sample), board.step(frame, sample)
        assert ours == theirs, f"step {step}"
        values.add(ours[0])
        if flying and host.firmware.chirp.sweep.added != 0.0:
            axes.add(host.firmware.chirp.sweep.axis)
        assert (ours[0] != bytes(8)) == flying, f"armed from step {BOOT_STEPS} on, and only then: {step}"
    assert axes == {0, 1, 2}, "the chirp must have run"
    assert len(values) > FLIGHT_STEPS / 2, "the outputs must have moved"
    sagging = [voltage for voltage in voltages[-FLIGHT_STEPS // 10 :] if 14.0 < voltage < 16.0]
    assert len(sagging) > 5, "the PID must have flown by packs that sag"


class BoardObservation:
    """observation.c of the image, set up for `text` as observation_init would."""

    def __init__(self, image: Path, text: str) -> None:
        self._core = core = CortexM7(load_program(image), MEMORY)
        terms = observation_blocks(text)
        self._width = observation_count(terms, 4)
        lists = (
            bytes(term.block.code for term in terms),
            bytes(term.age for term in terms),
            np.array([term.gain(1000) for term in terms], "<f4").tobytes(),
        )
        self._self, self._input = core.allocate(OBSERVATION_BYTES), core.allocate(36)
        self._values, self._out = core.allocate(4 * 10), core.allocate(4 * 64)
        # struct observation up to its period: three lists of terms (held.h), their count, motors, seconds.
        head = b"".join(self._kept(data).to_bytes(8, "little") for data in lists)
        head += len(terms).to_bytes(4, "little") + (4).to_bytes(4, "little") + np.float32(1e-3).tobytes()
        core.write(self._self, head)
        self.reset()

    def _kept(self, data: bytes) -> int:
        address = self._core.allocate(len(data))
        self._core.write(address, data)
        return address

    def reset(self) -> None:
        self._core.call("observation_reset", self._self)

    def step(self, values: NDArray[np.float32], throttle: NDArray[np.float32]) -> bytes:
        """values: rate, setpoint and previous action, (10,); throttle: (1,)."""
        self._core.write(self._values, values.tobytes())
        places = np.array([self._values, self._values + 12, self._values + 24], "<u4")
        self._core.write(self._input, places.tobytes() + throttle.tobytes())
        self._core.call("observation_step", self._self, self._input, self._out)
        return self._core.read(self._out, 4 * self._width)


def test_the_boards_observation_is_the_twins_bits_when_its_terms_have_a_past(board_image: Path) -> None:
    compiled = BoardObservation(board_image, TERMS)
    observer = Observer(observation_blocks(TERMS), 1, 4, 1000)
    rng = np.random.default_rng(32)
    seen = set()
    for step in range(400):
        if step in (100, 101, 250):
            compiled.reset()
            observer.reset(np.arange(1))
        values = (rng.normal(size=10) * 10 ** rng.uniform(-3, 1.5)).astype(np.float32)
        throttle = rng.random(1, np.float32)
        rate, setpoint, action = np.split(values[None], [3, 6], axis=1)
        expected = observer.observe(slice(None), setpoint, rate, action, throttle)
        assert compiled.step(values, throttle) == expected[0].tobytes(), f"step {step}"
        seen.add(expected[0].tobytes())
    assert len(seen) == 400
