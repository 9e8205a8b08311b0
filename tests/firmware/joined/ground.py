"""A whole firmware on a bench, two peers on its ports: what a request changes, and going back to before it.

`Ground` has the core's own structs around a simulated board, so that a test sees what reached flash and the
motors without asking over the lines that it tests. A state is kept and taken up again in no time.
"""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import CHANNEL_ARM, CHANNEL_COUNT, CHANNEL_THROTTLE, ArmingReason, Msp
from tests.firmware.conftest import Chip, Core

GYRO_HZ = 1000
FRAME_MS = 10
ACTION = 0.25  # of the scripted policy, in flight
ROOM = 4096
STANDING = [0, 0, 0, 0]
API_VERSION = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION))


@dataclass(frozen=True)
class Request:
    """A command with a payload."""

    command: int
    payload: bytes = b""

    def frame(self, version: Version = Version.V2) -> bytes:
        """As it goes over the line."""
        return encode(Message(version, Direction.REQUEST, self.command, self.payload))


@dataclass(frozen=True)
class Seen:
    """All of the firmware that a request may change, but for what it only counts."""

    flash_operations: int
    settings: bytes  # as changed and perhaps not saved
    wish: int  # of a motor test
    given: int  # values to it
    command: int  # asked of the motors' controllers
    forbidden: int  # reasons against arming, but for a command line that noise may have opened
    rebooting: bool
    posted: bool  # channels


@dataclass(frozen=True)
class State:
    """Everything, to be taken up again."""

    parts: tuple[bytes, ...]
    flash: bytes | None  # None: erased as at the beginning
    operations: int
    ms: int
    channels: tuple[int, ...]
    silent: bool


class Ground:
    """The firmware and its surroundings; a millisecond a sample."""

    def __init__(self, core: Core, **settings: float) -> None:
        self.core, self.lib, ffi = core, core.lib, core.ffi
        self.chip = Chip(core)
        self.board = core.new("struct host_board *")
        self.hal = core.new("struct hal *")
        self.firmware = core.new("struct firmware *")
        self.stats = core.new("struct task_stats[]", len(contract.Task))
        self.background = core.new("struct background *")
        self.runtime = core.new("struct runtime *")
        self._memory = core.new("uint64_t[]", 4)  # aligned as weights are
        self._weights = ffi.cast("float *", self._memory)
        self.lib.host_board_install(self.chip._bytes)
        self.lib.host_board_init(self.board, self.chip._bytes)
        self.hal[0] = self.lib.host_board_hal(self.board)
        self.runtime.hal, self.runtime.firmware = self.hal, self.firmware
        self.runtime.stats, self.runtime.background = self.stats, self.background
        self.log = core.new("struct log_ring *")
        self.runtime.log = self.log
        self._rates, self._force = core.new("double[3]"), core.new("double[3]", [0, 0, -9.80665])
        self._reply, self._channels = core.new("uint8_t[]", ROOM), core.new("uint16_t[]", CHANNEL_COUNT)
        self.channels = [contract.CHANNEL_MID_US] * 4 + [contract.CHANNEL_MIN_US] * (CHANNEL_COUNT - 4)
        self.channels[CHANNEL_THROTTLE] = contract.CHANNEL_MIN_US
        self.silent, self.ms = False, 0
        self.reason: int | None = None  # why the last request was refused, a Refusal
        self._parts = (
            *(self.board, self.firmware, self.background, self.runtime, self.hal),
            *(self.stats, self._memory),
        )
        self._boot({"arming_delay_ms": contract.BOOT_GRACE_MS, **settings})

    def _boot(self, settings: dict[str, float]) -> None:
        core = self.core
        changes = core.new("struct setting_change[]", len(settings))
        for change, (name, value) in zip(changes, settings.items(), strict=True):
            change.index = self.lib.settings_find(name.encode())
            if isinstance(value, int):
                change.value.as_uint32_t = value
            else:
                change.value.as_float = value
        config = core.new("struct background_config *")
        board = config.board
        config.firmware, config.weights, config.stats = self.firmware, self._weights, self.stats
        config.pid = core.ffi.addressof(self.lib, "pid_gains_built_in")
        board.hal, board.alignment = self.hal, contract.SIM_GYRO_ALIGNMENT
        board.identity = self.lib.host_identity
        board.changes, board.change_count = changes, len(settings)
        board.gyro_rate_hz, board.cycles_hz = GYRO_HZ, 10**9
        self.lib.scripted_action = [0.0] * 4
        assert self.lib.background_start(self.background, config) == 0
        self.lib.scripted_action = [ACTION] * 4

    # --- Time ---------------------------------------------------------------------------------
    def run(self, ms: int) -> list[int]:
        """Let it go on; returns the values at the motors."""
        for _ in range(ms):
            if self.ms % FRAME_MS == 0 and not self.silent:
                self._channels[0:CHANNEL_COUNT] = self.channels
                self.lib.receiver_line_put(self.core.ffi.addressof(self.board, "line"), self._channels)
            self._force[2] = -9.80665 - 0.01 * (self.ms % 2)
            sample = self.core.new("struct imu_sample *")
            sample[0] = self.lib.host_board_sample(self._rates, self._force)
            self.lib.runtime_sample(self.runtime, sample)
            self.lib.runtime_background(self.runtime)
            self.ms += 1
        return self.motors

    def get_ready(self) -> None:
        """Until the switch would arm it."""
        self.run(contract.BOOT_GRACE_MS + contract.CALIBRATION_MS)
        assert self.firmware.status.arming_reasons == 0

    def take_off(self) -> None:
        """Armed, in the middle of the throttle."""
        self.channels[CHANNEL_ARM] = contract.CHANNEL_MAX_US
        self.run(3 * FRAME_MS)
        self.channels[CHANNEL_THROTTLE] = contract.CHANNEL_MID_US
        self.run(10 * FRAME_MS)
        assert self.armed

    # --- Lines --------------------------------------------------------------------------------
    def send(self, data: bytes, port: int = 0) -> bytes:
        """Bytes from the peer of a port; returns what goes to it."""
        count = self.lib.runtime_link(self.runtime, port, data, len(data), self._reply, ROOM)
        return bytes(self.core.ffi.buffer(self._reply, count))

    def ask(self, request: Request, port: int = 0, version: Version = Version.V2) -> bool:
        """A request on its own; returns whether it was carried out."""
        reply = self.send(request.frame(version), port)
        found = [event for event in Decoder().feed(reply) if isinstance(event, Message)]
        streamed = (Msp.STREAM_SAMPLE, Direction.REPLY)
        (said,) = (message for message in found if (message.command, message.direction) != streamed)
        assert said.command == request.command
        self.reason = said.payload[0] if said.direction is Direction.ERROR and said.payload else None
        return said.direction is Direction.REPLY

    def pause(self, port: int = 0) -> None:
        """The peer says nothing for longer than within a frame."""
        self.lib.runtime_link_pause(self.runtime, port)

    def leave(self, port: int = 0) -> None:
        """The peer hangs up."""
        self.lib.runtime_link_reset(self.runtime, port)

    def answers(self, port: int = 0) -> bool:
        """Does a request for the API's version get its answer at once?

        What a command line said before may look like the beginning of a frame: clients give that up when
        the line is silent.
        """
        decoder = Decoder()
        said = self.send(API_VERSION, port) + b"".join(self.send(b"", port) for _ in range(20))
        return any(
            isinstance(event, Message)
            and (event.command, event.direction) == (Msp.API_VERSION, Direction.REPLY)
            for event in [*decoder.feed(said), *decoder.flush()]
        )

    # --- What it has become -------------------------------------------------------------------
    @property
    def motors(self) -> list[int]:
        return list(self.board.dshot)[:4]

    @property
    def armed(self) -> bool:
        return bool(self.firmware.status.trace.armed)

    @property
    def seen(self) -> Seen:
        fw, background = self.firmware, self.background
        edited = self.core.ffi.addressof(background, "edited")
        return Seen(
            self.board.flash.operations,
            bytes(self.core.ffi.buffer(edited)),
            fw.motor_test.wish,
            fw.motor_test.refreshed,
            fw.dshot_command.asked | fw.dshot_command.left,
            fw.forbidden & ~(1 << ArmingReason.CLI),
            background.rebooting,
            fw.posted,
        )

    def keep(self) -> State:
        """Everything as it is now."""
        parts = tuple(bytes(self.core.ffi.buffer(part)) for part in self._parts)
        operations = self.board.flash.operations
        flash = self.chip.content if operations else None
        return State(parts, flash, operations, self.ms, tuple(self.channels), self.silent)

    def go_back(self, state: State) -> None:
        """Everything as it was."""
        if self.board.flash.operations != state.operations:
            memory = state.flash or b"\xff" * contract.FLASH_BYTES
            self.core.ffi.memmove(self.chip._memory, memory, contract.FLASH_BYTES)
        for part, kept in zip(self._parts, state.parts, strict=True):
            self.core.ffi.memmove(part, kept, len(kept))
        self.ms, self.channels, self.silent = state.ms, list(state.channels), state.silent
