"""The firmware's C core as a shared library behind the port: the host program without its sockets."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from cffi import FFI

from neuroflight.flash.link.client import Client
from neuroflight.sim.arrays import Array
from neuroflight.sim.compiled import contract_declarations
from neuroflight.sim.physics.esc import Words
from neuroflight.sim.ports.port import (
    AnsweredPort,
    AskedPort,
    Reply,
    Sample,
    flight_settings,
    setting_changes,
)
from neuroflight.sim.structs import struct_declaration
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    GYRO_RATE_DEFAULT_HZ,
    MOTOR_COUNT_MAX,
    MSP_PAYLOAD_MAX,
    STRUCTS,
    FirmwareError,
)
from neuroflight.toolchain.contract.policy_format import struct_format
from neuroflight.toolchain.errors import LinkError

HEADER = Path(__file__).resolve().parents[2] / "firmware" / "hal" / "host" / "reference.h"
_REPLY_BYTES = 2 * MSP_PAYLOAD_MAX
_LOG_BYTES = 65536
_REPLY = struct.Struct(struct_format(STRUCTS["reference_trace"]))


class Reference:
    """One instance of the C core: sticks and rates in, DShot values out, MSP bytes both ways."""

    name = "reference library"

    def __init__(
        self,
        library: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
    ) -> None:
        """Load and boot with these settings, the others at their defaults.

        Raises LinkError when the library is missing, is none, or refuses to start.
        """
        self._ffi, self._library = _load(library)
        self._memory = np.zeros(self._library.reference_size() // 8 + 1, np.uint64)
        self._self = self._ffi.from_buffer("uint64_t[]", self._memory)
        changes = setting_changes(settings or {})
        texts = [self._ffi.new("char[]", change.encode()) for change in changes]
        error = self._library.reference_init(self._self, gyro_rate_hz, texts, len(changes))
        if error == FirmwareError.ERR_SETTINGS:
            raise LinkError(
                f"{library}: the firmware refuses the settings {', '.join(changes)}: look up their limits"
            )
        if error:
            raise LinkError(
                f"{library}: the firmware refuses a gyro rate of {gyro_rate_hz} Hz (error {error}): "
                f"choose a multiple of its policy's control rate, or build it anew with `make host`"
            )
        self._measured = np.zeros(6)  # body rates, specific force
        self._dshot = np.zeros(MOTOR_COUNT_MAX, np.uint16)
        self._outputs = self._ffi.from_buffer("uint16_t[]", self._dshot)
        self._trace = self._ffi.new("struct reference_trace *")
        self._answer = b""
        self._log = bytearray(_LOG_BYTES)
        self._take = self.sampler(self._measured)

    def receiver(self, channels_us: Sequence[int]) -> None:
        """Hand over one receiver frame, CHANNEL_COUNT pulse widths [us]."""
        assert len(channels_us) == CHANNEL_COUNT
        self._library.reference_receiver(self._self, [int(us) for us in channels_us])

    def power(self, volts: float, amps: float, control_us: float = 0.0) -> None:
        """Set voltage [V] and current [A] of the battery, and the duration of each control step [us]."""
        self._library.reference_power(self._self, volts, amps, control_us)

    def rotors(self, words: Words) -> None:
        """Set what each ESC, by output, answered to the last frame: (MOTOR_COUNT_MAX,), for the next step."""
        self._library.reference_rotors(self._self, self._ffi.from_buffer("uint16_t[]", words))

    def sample(self, gyro: Array, specific_force: Array) -> bytes:
        """Take one sample of gyro (3,) [rad/s] and accelerometer (3,) [m/s^2], body axes.

        Returns the DShot values as uint16 bytes.
        """
        self._measured[:3], self._measured[3:] = gyro, specific_force
        self._take()
        return self._dshot.tobytes()

    def sampler(self, measured: Array) -> Callable[[], bool]:
        """Return a function that takes a sample from `measured` at each call and returns whether DShot values
        changed.

        measured: body rates [rad/s] and specific force [m/s^2], (6,) or longer, contiguous; it must live as
        long as what is returned.
        """
        gyro = self._ffi.cast("double *", measured.ctypes.data)
        return partial(self._library.reference_sample, self._self, gyro, gyro + 3, self._outputs)

    def dshot(self) -> bytes:
        return self._dshot.tobytes()

    def blackbox(self) -> bytes:
        """Return the bytes logged since the last call, which may end in the middle of a log.

        From the first call on logs are kept for the next one: up to 64 KiB, what is more is dropped.
        """
        log = self._ffi.from_buffer("uint8_t[]", self._log)
        return bytes(self._log[: self._library.reference_blackbox(self._self, log, len(log))])

    def silent(self) -> bytes:
        """Report that the gyro sent nothing for GYRO_BAD_MS. Returns as `sample`."""
        self._library.reference_silent(self._self, self._outputs)
        return self._dshot.tobytes()

    def trace(self) -> Any:  # noqa: ANN401 - a struct of cffi
        """Read the last control step, a struct reference_trace; overwritten by the next call."""
        self._library.reference_trace(self._self, self._trace)
        return self._trace

    def trace_bytes(self) -> Any:  # noqa: ANN401 - a buffer of cffi
        """Read the last control step as the bytes of a struct reference_trace."""
        return self._ffi.buffer(self.trace())

    def link(self, port: int, data: bytes = b"", capacity: int = _REPLY_BYTES) -> bytes:
        """Pass MSP bytes to port 0 or 1 and return the answer; without any, return unsolicited bytes."""
        reply = bytearray(capacity)
        told = self._ffi.from_buffer("uint8_t[]", reply)
        return bytes(reply[: self._library.reference_link(self._self, port, data, len(data), told, capacity)])

    def link_reset(self, port: int) -> None:
        self._library.reference_link_reset(self._self, port)

    def write(self, data: bytes) -> None:
        """Pass MSP request bytes to port 0 (flash.transport.Transport)."""
        self._answer += self.link(0, data)

    def read(self, timeout: float) -> bytes:
        """Return MSP reply bytes; they are there at once or never."""
        answer, self._answer = self._answer + self.link(0), b""
        return answer

    def close(self) -> None:
        """Do nothing: the memory is Python's."""


class ReferencePort(AskedPort, AnsweredPort):
    """FirmwarePort around the library: the fastest way to fly the firmware bit for bit."""

    def __init__(
        self,
        library: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
    ) -> None:
        """Boot a fresh firmware. Raises LinkError as Reference does."""
        wanted = flight_settings(settings)
        self.reference = Reference(library, gyro_rate_hz, wanted)
        self._ask_rotors(wanted)
        self._ask_policy(gyro_rate_hz)
        self._until_control = 0
        self._sample: Sample | None = None  # whose values `_take` takes
        self._take: Callable[[], bool]
        self._reply: Reply | None = None

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        if channels_us is not None:
            self.reference.receiver(channels_us)
        rotors = self._rotors()
        if self._until_control == 0 and rotors is not None:
            self.reference.rotors(rotors)
        if sample is not self._sample:
            self._sample, self._take = sample, self.reference.sampler(sample.values)
        changed = self._take()
        if self._until_control == 0 or changed or self._reply is None:
            self._reply = self._read()
        self._until_control = (self._until_control or self._divider) - 1
        return self._reply

    def set_battery(self, volts: float, amps: float) -> None:
        self.reference.power(volts, amps)

    def close(self) -> None:
        self.reference.close()

    def _msp(self) -> Client:
        return Client(self.reference)

    def _read(self) -> Reply:
        step, setpoint, gyro, throttle, armed, *_ = _REPLY.unpack_from(self.reference.trace_bytes())
        return Reply(
            dshot=np.frombuffer(self.reference.dshot(), np.uint16, self.motor_count),
            step=step,
            setpoint=np.frombuffer(setpoint, np.float32),
            gyro=np.frombuffer(gyro, np.float32),
            throttle=throttle,
            armed=bool(armed),
        )


@cache
def _interface() -> FFI:
    """Return the library's functions as its header declares them."""
    ffi = FFI()
    ffi.cdef(struct_declaration("reference_trace") + contract_declarations(HEADER))
    return ffi


def _load(path: Path) -> tuple[FFI, Any]:
    if not path.is_file():
        raise LinkError(f"{path}: not built yet; build it with `make host`")
    if not HEADER.is_file():
        raise LinkError(f"{HEADER}: missing; the reference library runs from a whole checkout")
    ffi = _interface()
    try:
        library = ffi.dlopen(str(path.resolve()))
        for name in dir(library):  # one that is missing is noticed here
            getattr(library, name)
    except (OSError, AttributeError) as error:
        raise LinkError(
            f"{path}: not the firmware's reference library ({error}); build it with `make host`"
        ) from error
    return ffi, library
