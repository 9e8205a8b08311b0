"""The firmware's C core as a shared library behind the port: the host program without its sockets."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flash import messages
from flash.client import Client
from sim.ports.port import Reply, Sample, control_divider, setting_changes
from toolchain.contract import CHANNEL_COUNT, GYRO_RATE_DEFAULT_HZ, MOTOR_COUNT_MAX, MSP_PAYLOAD_MAX, Msp
from toolchain.errors import LinkError

ERR_SETTINGS = -15  # nf_err.h
_REPLY_BYTES = 2 * MSP_PAYLOAD_MAX


class _Trace(ctypes.Structure):
    """`struct reference_trace` of firmware/hal/host/reference.h."""

    _fields_ = (
        ("step", ctypes.c_uint32),
        ("setpoint", ctypes.c_float * 3),
        ("gyro", ctypes.c_float * 3),
        ("throttle", ctypes.c_float),
        ("armed", ctypes.c_uint8),
        ("motors", ctypes.c_uint8),
        ("reserved", ctypes.c_uint16),
        ("dshot", ctypes.c_uint16 * MOTOR_COUNT_MAX),
    )


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
        self._library = _load(library)
        self._memory = (ctypes.c_uint64 * (self._library.reference_size() // 8 + 1))()
        changes = setting_changes(settings or {})
        texts = (ctypes.c_char_p * max(1, len(changes)))(*(change.encode() for change in changes))
        error = self._library.reference_init(self._memory, gyro_rate_hz, texts, len(changes))
        if error == ERR_SETTINGS:
            raise LinkError(
                f"{library}: the firmware refuses the settings {', '.join(changes)}: look up their limits"
            )
        if error:
            raise LinkError(
                f"{library}: the firmware refuses a gyro rate of {gyro_rate_hz} Hz (error {error}): "
                f"choose a multiple of its policy's control rate, or build it anew with `make host`"
            )
        self._channels = (ctypes.c_uint16 * CHANNEL_COUNT)()
        self._rates = (ctypes.c_double * 3)()
        self._force = (ctypes.c_double * 3)()
        self._dshot = (ctypes.c_uint16 * MOTOR_COUNT_MAX)()
        self._trace = _Trace()
        self._answer = b""

    def receiver(self, channels_us: Sequence[int]) -> None:
        """Hand over one receiver frame, CHANNEL_COUNT pulse widths [us]."""
        self._channels[:] = list(channels_us)
        self._library.reference_receiver(self._memory, self._channels)

    def power(self, volts: float, amps: float, control_us: float = 0.0) -> None:
        """Set voltage [V] and current [A] of the battery, and the duration of each control step [us]."""
        self._library.reference_power(self._memory, volts, amps, control_us)

    def sample(self, gyro: NDArray[np.float64], specific_force: NDArray[np.float64]) -> bytes:
        """Take one sample of gyro (3,) [rad/s] and accelerometer (3,) [m/s^2], body axes.

        Returns the DShot values as uint16 bytes.
        """
        x, y, z = gyro.tolist()
        fx, fy, fz = specific_force.tolist()
        self._rates[:] = [x, -y, -z]  # the wire's axes: forward, right, down
        self._force[:] = [fx, -fy, -fz]
        self._library.reference_sample(self._memory, self._rates, self._force, self._dshot)
        return bytes(self._dshot)

    def silent(self) -> bytes:
        """Report that the gyro sent nothing for GYRO_BAD_MS. Returns as `sample`."""
        self._library.reference_silent(self._memory, self._dshot)
        return bytes(self._dshot)

    def trace(self) -> _Trace:
        """The last control step; overwritten by the next call."""
        self._library.reference_trace(self._memory, ctypes.byref(self._trace))
        return self._trace

    def write(self, data: bytes) -> None:
        """MSP request bytes in (flash.transport.Transport)."""
        reply = ctypes.create_string_buffer(_REPLY_BYTES)
        count = self._library.reference_msp(self._memory, data, len(data), reply, len(reply))
        self._answer += reply.raw[:count]

    def read(self, timeout: float) -> bytes:
        """MSP reply bytes out; they are there at once or never."""
        answer, self._answer = self._answer, b""
        return answer

    def close(self) -> None:
        """Nothing to release: the memory is Python's."""


class ReferencePort:
    """FirmwarePort around the library: the fastest way to fly the firmware bit for bit."""

    def __init__(
        self,
        library: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
    ) -> None:
        """Boot a fresh firmware. Raises LinkError as Reference does."""
        self.reference = Reference(library, gyro_rate_hz, settings)
        policy = messages.policy_info(Client(self.reference).request(Msp.POLICY_INFO))
        self.motor_count = policy.action_count
        self.gyro_rate_hz = gyro_rate_hz
        self.control_rate_hz = policy.control_rate_hz
        self._divider = control_divider(self.gyro_rate_hz, self.control_rate_hz)
        self._until_control = 0
        self._values = b""
        self._reply: Reply | None = None

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort."""
        if channels_us is not None:
            self.reference.receiver(channels_us)
        values = self.reference.sample(sample.gyro, sample.specific_force)
        if self._until_control == 0 or values != self._values or self._reply is None:
            self._reply, self._values = self._read(values), values
        self._until_control = (self._until_control or self._divider) - 1
        return self._reply

    def arming_reasons(self) -> tuple[str, ...]:
        """See FirmwarePort; asked over MSP."""
        status = messages.status_ex(Client(self.reference).request(Msp.STATUS_EX))
        return messages.arming_reasons(status.arming_flags)

    def close(self) -> None:
        """See FirmwarePort."""
        self.reference.close()

    def _read(self, values: bytes) -> Reply:
        trace = self.reference.trace()
        return Reply(
            dshot=np.frombuffer(values, np.uint16, self.motor_count),
            step=trace.step,
            setpoint=np.array(trace.setpoint, np.float32),
            gyro=np.array(trace.gyro, np.float32),
            throttle=trace.throttle,
            armed=bool(trace.armed),
        )


def _load(path: Path) -> ctypes.CDLL:
    if not path.is_file():
        raise LinkError(f"{path}: not built yet; build it with `make host`")
    try:
        library = ctypes.CDLL(str(path.resolve()))
        size_t, pointer = ctypes.c_size_t, ctypes.c_void_p
        signatures = {
            "reference_size": (size_t, ()),
            "reference_init": (ctypes.c_int, (pointer, ctypes.c_uint, pointer, size_t)),
            "reference_receiver": (None, (pointer, pointer)),
            "reference_power": (None, (pointer, ctypes.c_double, ctypes.c_double, ctypes.c_double)),
            "reference_sample": (None, (pointer, pointer, pointer, pointer)),
            "reference_silent": (None, (pointer, pointer)),
            "reference_trace": (None, (pointer, pointer)),
            "reference_msp": (size_t, (pointer, ctypes.c_char_p, size_t, pointer, size_t)),
        }
        for name, (result, arguments) in signatures.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise LinkError(
            f"{path}: not the firmware's reference library ({error}); build it with `make host`"
        ) from error
    return library
