"""The firmware's C, called from Python: structs and signatures come from the real headers.

`scripted` is the core around a policy whose output a test sets (scripted_policy/policy.c), `Bench` flies
it sample by sample, `sbus` is an encoder of their own.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import socket
import struct
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cffi import FFI

from neuroflight.sim.ports.port import flight_settings
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import CHANNEL_ARM, CHANNEL_COUNT, CHANNEL_THROTTLE
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import locked, write_text_if_changed
from neuroflight.toolchain.policy.blob import PolicyBlob, blob_terms, pack
from neuroflight.toolchain.rendering.contract_header import render_contract
from neuroflight.toolchain.rendering.pid_table import render_pid_table
from tests.conftest import BUILD

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
SCRIPTED_POLICY = Path(__file__).parent / "scripted_policy"
SCRIPTED_BUILD = "NEUROFLIGHT_SCRIPTED_BUILD"  # environment: a folder that keeps it (mutants/workshop.py)
HEADERS = (
    "background.h",
    "firmware.h",
    "safety/safety.h",
    "safety/crash.h",
    "safety/takeoff.h",
    "control/pid.h",
    "control/control.h",
    "housekeeping/scheduler.h",
    "receiver/rates.h",
    "motors/dshot.h",
    "motors/dshot_telemetry.h",
    "msp/msp_port.h",
    "storage/policy_blob.h",
    "port/log_device.h",
    "port/spi_bus.h",
    "blackbox/blackbox.h",
    "storage/settings.h",
    "storage/settings_text.h",
    "common/crc32.h",
    "common/sha256.h",
    "common/decimal.h",
    "port/flash.h",
    "storage/settings_store.h",
    "storage/policy_slots.h",
    "storage/image_bank.h",
    "storage/image_probation.h",
    "storage/image_update.h",
    "storage/fault_log.h",
    "storage/card/card_log.h",
    "storage/card/sd_crc.h",
    "storage/flash_chip/flash_log.h",
    "usb/usb_device.h",
    "usb/usb_serial.h",
    "usb/usb_disk.h",
    "hal/host/flash_model.h",
    "msp/msp_payload.h",
    "msp/msp_request.h",
    "command_line/command_line.h",
    "common/printer.h",
    "common/nf_math.h",
    "sensing/gyro.h",
    "sensing/filters.h",
    "sensing/gyro_mean.h",
    "sensing/attitude.h",
    "housekeeping/battery.h",
    "common/crc8.h",
    "motors/dshot_command.h",
    "motors/motor_test.h",
    "housekeeping/alert.h",
    "receiver/gesture.h",
    "hal/host/board.h",
    "hal/host/changes.h",
    "blackbox/log_snapshot.h",
    "hal/host/replay.h",
    "runtime.h",
    "hal/host/convert.h",
    "hal/host/reference.h",
)
SYSTEM_HEADERS = ("stdint.h", "stdbool.h", "stddef.h")  # cffi knows their types

G_COUNTS = 2048  # 1 g at +-16 g over int16
SUCCESS, ERR_GYRO_RATE, ERR_ALIGNMENT, ERR_IDLE, ERR_OBSERVATION, ERR_POLICY = range(0, -6, -1)


@dataclass(frozen=True)
class Core:
    """A loaded library: `lib` has the functions and variables, `ffi` makes structs and arrays."""

    ffi: FFI
    lib: Any

    def new(self, ctype: str, *initial: object) -> Any:
        """A C object of its own."""
        return self.ffi.new(ctype, *initial)


def declarations(generated: Path, scratch: Path) -> str:
    """Everything that the headers of the core declare, for cffi."""
    empty = scratch / "system"
    empty.mkdir(parents=True, exist_ok=True)
    for name in SYSTEM_HEADERS:
        (empty / name).write_text("#define bool _Bool\n" if name == "stdbool.h" else "")
    includes = "".join(f'#include "{name}"\n' for name in HEADERS)
    search = [f"-I{path}" for path in (empty, FIRMWARE, FIRMWARE / "src", generated)]
    without = ["-D_Static_assert(...)=", "-D__attribute__(...)="]
    command = ["gcc", "-E", "-P", "-nostdinc", *without, *search, "-"]
    text = subprocess.run(command, input=includes, capture_output=True, text=True, check=True).stdout
    # To cffi a constant is a number that the header tells; these are tables of the library.
    return _with_short_enums(text.replace("extern const struct", "extern struct"))


def _with_short_enums(text: str) -> str:
    """`text` with each use of an enum as the integer that -fshort-enums makes of it; to cffi it is an int."""
    known = FFI()
    known.cdef(text)

    def integer(use: re.Match[str]) -> str:
        values = known.typeof(use.group()).relements.values()
        sign = "" if min(values) < 0 else "u"
        reach = max(values) if sign else max(max(values), -1 - min(values))
        bits = next(bits for bits in (8, 16, 32) if reach < 1 << bits - (not sign))
        return f"{sign}int{bits}_t"

    return re.sub(r"\benum \w+\b(?!\s*\{)", integer, text)


def load(library: Path, generated: Path, scratch: Path) -> Core:
    """`library` with the declarations that belong to it."""
    ffi = FFI()
    ffi.cdef(declarations(generated, scratch))
    return Core(ffi, ffi.dlopen(str(library)))


def scripted_blob(motors: int = 4) -> PolicyBlob:
    """The blob of the scripted policy, whose self-test expects 0."""
    blocks = "rate,rate_error,rate_error_delta,rate_error_integral,previous_action,throttle"
    return PolicyBlob(
        sequence=0,
        architecture_hash=0x01234567,
        filters_hash=contract.POLICY_FILTERS_NONE,
        control_rate_hz=1000,
        terms=blob_terms(contract.observation_blocks(blocks), 1000),
        aircraft="scripted",
        aircraft_sha256="5a" * 32,
        policy_sha256="00112233445566778899aabbccddeeff0123456789abcdeffedcba9876543210",
        idle=0.0,
        weights=np.array([1.0, -2.0], np.float32),
        selftest_observation=np.zeros((3, 13 + motors), np.float32),
        selftest_action=np.zeros((3, motors), np.float32),
        selftest_steps=1,
    )


def write_scripted(generated: Path, motors: int) -> None:
    """Writes what the scripted policy adds to the sources, where it has changed."""
    generated.mkdir(parents=True, exist_ok=True)
    write_text_if_changed(generated / "nf_contract.h", render_contract())
    blob = pack(scripted_blob(motors))
    for name in ("policy.c", "policy.h"):
        text = (SCRIPTED_POLICY / name).read_text().replace("@MOTORS@", str(motors))
        text = text.replace("@BLOB_BYTES@", str(len(blob))).replace("@BLOB@", ", ".join(map(str, blob)))
        write_text_if_changed(generated / name, text)
    write_text_if_changed(generated / "pid_table.c", render_pid_table(None, motors, 1000))


def make_scripted(scratch: Path, motors: int, firmware: Path = FIRMWARE) -> Path:
    """Builds the host target around the scripted policy, what has changed of it; returns the build directory.

    Raises BuildError.
    """
    generated, build = scratch / "generated", scratch / "build"
    write_scripted(generated, motors)
    # Relative: tests/coverage.py works inside the checkout, whose path may hold a space.
    folders = (("GENERATED", generated), ("BUILD", build))
    named = [f"{name}={os.path.relpath(path, firmware)}" for name, path in folders]
    make = ["make", "-s", f"-j{os.cpu_count() or 1}", "-C", str(firmware), "TARGET=HOST", *named]
    done = subprocess.run(make, capture_output=True, text=True)
    if done.returncode != 0:
        raise BuildError(done.stderr)
    return build


def kept_scripted(folder: Path, motors: int) -> Path:
    """The same in a folder that all workers, and the next run, find again."""
    with locked(folder):
        return make_scripted(folder, motors)


@pytest.fixture(scope="session")
def scripted_build() -> Path:
    """Build directory of the host target around the scripted policy with four motors."""
    return kept_scripted(Path(os.environ.get(SCRIPTED_BUILD, BUILD / "scripted")), motors=4)


@pytest.fixture(scope="session")
def hexacopter_build() -> Path:
    """The same with six motors."""
    return kept_scripted(BUILD / "hexacopter", motors=6)


@pytest.fixture(scope="session")
def scripted(scripted_build: Path, tmp_path_factory: pytest.TempPathFactory) -> Core:
    """The core around the scripted policy with four motors."""
    scratch = tmp_path_factory.mktemp("scripted_core")
    return load(scripted_build / "libneuroflight.so", scripted_build.parent / "generated", scratch)


@pytest.fixture(scope="session")
def hexacopter(hexacopter_build: Path, tmp_path_factory: pytest.TempPathFactory) -> Core:
    """The same with six motors."""
    scratch = tmp_path_factory.mktemp("hexacopter_core")
    return load(hexacopter_build / "libneuroflight.so", hexacopter_build.parent / "generated", scratch)


@pytest.fixture(scope="session")
def reference_core(reference_library: Path, tmp_path_factory: pytest.TempPathFactory) -> Core:
    """The core around the shipped policy."""
    return load(
        reference_library, reference_library.parent / "generated", tmp_path_factory.mktemp("reference")
    )


def encode_sbus(
    values: Sequence[int], *, frame_lost: bool = False, failsafe: bool = False, footer: int = 0
) -> bytes:
    """An SBUS frame of 16 values of 11 bits: one long little-endian number between header and flags."""
    number = sum(value << 11 * index for index, value in enumerate(values))
    flags = (4 if frame_lost else 0) | (8 if failsafe else 0)
    return bytes([0x0F, *number.to_bytes(22, "little"), flags, footer])


VALUE_OF_US = {880 + (5 * value + 4) // 8: value for value in range(2048)}


@pytest.fixture(scope="session")
def sbus() -> Callable[..., bytes]:
    """The function encode_sbus."""
    return encode_sbus


def encode_crsf(kind: int, payload: bytes) -> bytes:
    """A CRSF frame; channels are its kind 0x16 with the 22 bytes between SBUS's header and flags."""
    body, crc = bytes([kind]) + payload, 0
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (contract.CRC8_DVB_S2_POLY if crc & 0x80 else 0)) & 0xFF
    return bytes([0xC8, len(body) + 1]) + body + bytes([crc])


@pytest.fixture(scope="session")
def crsf() -> Callable[..., bytes]:
    """The function encode_crsf."""
    return encode_crsf


def sticks(*, arm: int = 1000, throttle: int = 1000, **channel_us: int) -> list[int]:
    """16 channels [us] in the wire's order, centred but for those given (c0=..., c1=...)."""
    channels = [1500] * CHANNEL_COUNT
    channels[CHANNEL_THROTTLE] = throttle
    channels[CHANNEL_ARM] = arm
    for name, us in channel_us.items():
        channels[int(name[1:])] = us
    return channels


def frame_of(*, frame_lost: bool = False, failsafe: bool = False, **channels_us: int) -> bytes:
    """An SBUS frame of `sticks`."""
    values = [VALUE_OF_US[us] for us in sticks(**channels_us)]
    return encode_sbus(values, frame_lost=frame_lost, failsafe=failsafe)


class Bench:
    """A firmware of its own, flown sample by sample."""

    def __init__(
        self,
        core: Core,
        gyro_hz: int = 1000,
        *,
        alignment: int = 0,
        pid: Any = None,
        policy_good: bool = True,
        expect: int = SUCCESS,
        fw: Any = None,
        **settings: float,
    ) -> None:
        """pid: a struct pid_gains, none unless given; fw: where the firmware lies; settings: those that are
        not as in a simulated flight."""
        self.core, self.gyro_hz = core, gyro_hz
        self.fw = core.new("struct firmware *") if fw is None else fw
        self.settings = core.new("struct nf_settings *")
        core.lib.settings_default(self.settings)
        for name, value in flight_settings(settings).items():
            setattr(self.settings, name, value)
        self.pid = core.new("struct pid_gains *") if pid is None else pid
        config = core.new(
            "struct firmware_config *",
            {
                "gyro_rate_hz": gyro_hz,
                "alignment": alignment,
                "settings": self.settings,
                "weights": core.lib.policy_weights,
                "policy_good": policy_good,
                "pid": self.pid,
            },
        )
        self.error = core.lib.firmware_init(self.fw, config)
        assert self.error == expect
        core.lib.firmware_forbid(self.fw, contract.ArmingReason.BATTERY_UNKNOWN, False)
        self._dshot = core.new("uint16_t[8]")
        self._samples = 0
        self.counts = (0, 0, 0)
        self.accel = (0, 0, G_COUNTS)  # level, at rest
        self.valid = True
        self.alive = True  # the chip's least bit moves, as that of any real one

    def send(self, frame: bytes) -> None:
        """Receiver bytes for the control step that is due."""
        self.core.lib.firmware_receive(self.fw, frame, len(frame))

    def stick(self, *, frame_lost: bool = False, failsafe: bool = False, **channels_us: int) -> None:
        """A receiver frame with these sticks."""
        self.send(frame_of(frame_lost=frame_lost, failsafe=failsafe, **channels_us))

    def sample(self) -> list[int]:
        """One gyro sample; returns the DShot values."""
        x, y, z = self.accel
        self._samples += self.alive
        accel = (x, y, z + self._samples % 2)
        sample = self.core.new("struct imu_sample *", (self.counts, accel, 0, self.valid))
        self.core.lib.firmware_sample(self.fw, sample, self._dshot)
        return list(self._dshot)[: self.trace.motor_count]

    def run(self, ms: float, *, every_ms: int | None = 10, **channels_us: int) -> list[int]:
        """Fly with frames of these sticks each `every_ms` (None: silence); returns the last DShot values."""
        frame = frame_of(frame_lost=False, failsafe=False, **channels_us)
        values: list[int] = []
        for _ in range(round(ms * self.gyro_hz / 1000)):
            if self.core.lib.firmware_control_due(self.fw):
                heard = every_ms is not None and self.fw.control_steps % every_ms == 0
                self.send(frame if heard else b"")
            values = self.sample()
        return values

    def arm(self) -> None:
        """Boot, calibrate, switch off, switch on."""
        self.run(1001)
        assert not self.armed
        self.stick(arm=2000)
        self.sample()
        assert self.armed

    @property
    def trace(self) -> Any:
        return self.core.lib.firmware_trace(self.fw)

    @property
    def armed(self) -> bool:
        return bool(self.trace.armed)

    @property
    def status(self) -> Any:
        status = self.core.new("struct firmware_status *")
        self.core.lib.firmware_status(self.fw, status)
        return status

    @property
    def reasons(self) -> int:
        """Bit field of what forbids arming."""
        return int(self.status.arming_reasons)


@pytest.fixture(scope="session")
def frame() -> Callable[..., bytes]:
    """The function frame_of."""
    return frame_of


@pytest.fixture
def bench(scripted: Core) -> Callable[..., Bench]:
    """Makes benches; the scripted policy answers 0 until the test sets something else."""
    scripted.lib.scripted_action = [0.0] * 4
    return lambda *args, **kwargs: Bench(scripted, *args, **kwargs)


# --- Flash ---------------------------------------------------------------------------------------
class Chip:
    """A flash of its own (hal/host/flash_model.c), erased, for what stores things there."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self._memory = core.new("uint64_t[]", contract.FLASH_BYTES // 8)
        self._bytes = core.ffi.cast("uint8_t *", self._memory)
        self.model = core.new("struct flash_model *")
        self.flash = core.new("struct flash *")
        self.content = b"\xff" * contract.FLASH_BYTES

    @property
    def content(self) -> bytes:
        """All of it."""
        return bytes(self.core.ffi.buffer(self._memory))

    @content.setter
    def content(self, content: bytes) -> None:
        self.core.ffi.memmove(self._memory, content, contract.FLASH_BYTES)
        self.power_on()

    def power_on(self) -> None:
        """Start anew with what is there; no cut is to come."""
        self.core.lib.flash_model_init(self.model, self._bytes)
        self.flash[0] = self.core.lib.flash_model_interface(self.model)

    def cut(self, at: int, kind: int, seed: int) -> None:
        """Power goes at the operation `at` from here."""
        self.core.lib.flash_model_cut(self.model, at, kind, seed)

    @property
    def operations(self) -> int:
        """Erased sectors and programmed words since power came."""
        return int(self.model.operations)

    def region(self, region: contract.Region) -> bytes:
        """What a part of it holds."""
        start = region.address - contract.FLASH_BASE
        return bytes(self.core.ffi.buffer(self._bytes + start, region.size))

    def fill(self, address: int, data: bytes) -> None:
        """Put bytes there past all rules."""
        self.core.ffi.memmove(self._bytes + (address - contract.FLASH_BASE), data, len(data))


@pytest.fixture
def chip(scripted: Core) -> Callable[..., Chip]:
    """Makes erased flashes, for the core around the scripted policy unless told otherwise."""
    return lambda core=scripted: Chip(core)


@pytest.fixture(scope="session")
def scripted_policy_blob() -> PolicyBlob:
    """The blob that is compiled into the scripted policy."""
    return scripted_blob()


# --- The host program ---------------------------------------------------------------------------
LOOPBACK = "127.0.0.1"
WAIT_S = 5.0  # how long an answer may take before the test fails
API_REQUEST, API_REPLY = b"$M<\x00\x01\x01", b"$M>\x03\x01\x00\x01\x2f\x2c"


class Program:
    """The running program and a simulator's sockets around it."""

    def __init__(self, build: Path, *options: str) -> None:
        self.alive = True
        self._states = 0
        self.sockets = contextlib.ExitStack()
        self.motor, self.servo, self.trace = (self._socket() for _ in range(3))
        self._sender = self._socket()
        ports = {"motor": self.motor, "servo": self.servo, "trace": self.trace}
        command = [
            str(build / "neuroflight"),
            *(f"--{name}-port={sock.getsockname()[1]}" for name, sock in ports.items()),
            *(f"--{name}-port=0" for name in ("state", "receiver", "power", "msp")),
            f"--set=arming_delay_ms={contract.BOOT_GRACE_MS}",
            *options,
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        word, *pairs = self.process.stdout.readline().split()
        assert word == "ready"
        self.ports = {name: int(port) for name, port in (pair.split("=") for pair in pairs)}

    def _socket(self) -> socket.socket:
        sock = self.sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sock.bind((LOOPBACK, 0))
        sock.settimeout(WAIT_S)
        return sock

    def send(self, port: str, packet: bytes) -> None:
        self._sender.sendto(packet, (LOOPBACK, self.ports[port]))

    def state(self, rates_frd: Sequence[float] = (0, 0, 0), time_s: float = 0) -> None:
        """A state packet of an aircraft that stands level; its accelerometer's least bits move."""
        self._states += self.alive
        down = -9.80665 - 0.01 * (self._states % 2)
        fields = (time_s, *rates_frd, 0.0, 0.0, down, *[0.0] * 11)
        self.send("state", struct.pack(contract.SIM_STATE_FORMAT, *fields))

    def power(self, volts: float = 16.8, amps: float = 0.0, control_us: float = 0.0) -> None:
        """A power packet."""
        fields = (contract.SIM_POWER_MAGIC, 0.0, volts, amps, control_us)
        self.send("power", struct.pack(contract.SIM_POWER_FORMAT, *fields))

    def sticks(
        self, arm: int = 1000, throttle: int = 1000, roll: int = 1500, pid: int = 1500, time_s: float = 0.0
    ) -> None:
        channels = [roll, 1500, throttle, 1500, arm, pid, *[1500] * 10]
        self.send("receiver", struct.pack(contract.SIM_RECEIVER_FORMAT, time_s, *channels))

    def motors(self) -> tuple[float, ...]:
        return struct.unpack(contract.SIM_MOTOR_FORMAT, self.motor.recv(100))

    def step(self, rates_frd: Sequence[float] = (0, 0, 0)) -> tuple[float, ...]:
        self.state(rates_frd)
        return self.motors()

    def last_trace(self) -> tuple[float, ...]:
        return struct.unpack(contract.SIM_TRACE_FORMAT, self.trace.recv(100))

    def silent(self) -> bool:
        """Whether no more packets have come, once the program has seen to everything sent so far."""
        with self.connect() as peer:
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY
        return not select.select([self.motor, self.servo, self.trace], [], [], 0)[0]

    def connect(self) -> socket.socket:
        """An MSP peer."""
        return socket.create_connection((LOOPBACK, self.ports["msp"]), WAIT_S)

    def end(self, number: signal.Signals = signal.SIGTERM) -> str:
        """Tell it to end; returns its words on stderr."""
        self.process.send_signal(number)
        assert self.process.wait(WAIT_S) == 0
        assert self.process.stderr is not None
        return self.process.stderr.read()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()  # and it writes down what a measured build has counted
        try:
            self.process.wait(WAIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()
        self.sockets.close()


@pytest.fixture
def start(scripted_build: Path) -> Iterator[Callable[..., Program]]:
    """Starts programs (around the scripted policy unless told otherwise) that end with the test."""
    with contextlib.ExitStack() as running:

        def make(*options: str, build: Path = scripted_build) -> Program:
            program = Program(build, *options)
            running.callback(program.close)
            return program

        yield make
