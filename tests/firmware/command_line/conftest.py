"""A firmware with two peers, as a library: what is typed on port 0, MSP on either, gyro samples when told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from neuroflight.flash.link import records, requests
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.toolchain.contract import BOOT_GRACE_MS, SETTINGS, ArmingReason, Msp, Task

GYRO_HZ = 1000  # one control step a sample, one sample a millisecond
G = 9.80665
PROMPT = "# "
STANDS_BEFORE_BOARD = (
    *("struct firmware", "float[2]", f"struct task_stats[{len(Task)}]"),
    *("struct background", "struct runtime"),
)
PIECE = 96  # bytes that come at once, as over TCP
CAPACITY = 4096


class IdleFirmware:
    """An idle firmware, which stands level."""

    def __init__(self, core: Any, *settings: str) -> None:
        self.core, self.lib, ffi = core, core.lib, core.ffi
        core.lib.scripted_action = [0.0] * 4
        self._memory = core.new("uint64_t[]", self.lib.reference_size() // 8 + 1)
        self._dshot = core.new("uint16_t[8]")
        self._rates = core.new("double[3]")
        texts = [
            core.new("char[]", text.encode()) for text in (f"arming_delay_ms={BOOT_GRACE_MS}", *settings)
        ]
        assert self.lib.reference_init(self._memory, GYRO_HZ, core.new("char *[]", texts), len(texts)) == 0
        self._out = core.new("uint8_t[]", CAPACITY)
        self._samples = 0
        self.ffi = ffi
        self.board = self._part("struct host_board *", STANDS_BEFORE_BOARD)

    def _part(self, pointer: str, before: Sequence[str]) -> Any:
        """A part of the instance, behind parts of those types: struct reference of reference.c."""
        at = 0
        for name in (*before, pointer.removesuffix(" *")):
            align = max(self.ffi.alignof(name), 8 if name == "float[2]" else 1)
            at = (at + align - 1) // align * align
            start, at = at, at + self.ffi.sizeof(name)
        return self.ffi.cast(pointer, self.ffi.cast("uint8_t *", self._memory) + start)

    def stored(self) -> list[str]:
        """The settings in flash that are not at their defaults, by name; those that a start would load."""
        flash, settings = self.core.new("struct flash *"), self.core.new("struct nf_settings *")
        flash[0] = self.lib.flash_model_interface(self.ffi.addressof(self.board, "flash"))
        self.lib.settings_load(settings, flash)
        default = self.core.new("struct nf_settings *")
        self.lib.settings_default(default)
        named = [setting.name for setting in SETTINGS]
        return [name for name in named if self._bytes(settings, name) != self._bytes(default, name)]

    def _bytes(self, settings: Any, name: str) -> bytes:
        return bytes(self.ffi.buffer(self.ffi.addressof(settings, name)))

    def break_flash(self) -> None:
        """From here on it takes nothing."""
        self.lib.flash_model_cut(self.ffi.addressof(self.board, "flash"), 0, 0, 1)

    @property
    def operations(self) -> int:
        """Of flash so far."""
        return int(self.board.flash.operations)

    # --- Flying
    def run(self, ms: int, *, arm: int = 1000, throttle: int = 1000, heard: bool = True) -> list[int]:
        """Samples, a receiver packet each 10 ms, port 0 served between. Returns the DShot values."""
        channels = [1500, 1500, throttle, 1500, arm, *[1000] * 11]
        for _ in range(ms):
            if heard and self._samples % 10 == 0:
                self.lib.reference_receiver(self._memory, channels)
            self._samples += 1
            force = self.core.new("double[3]", [0.0, 0.0, G + 0.01 * (self._samples % 2)])
            self.lib.reference_sample(self._memory, self._rates, force, self._dshot)
            self.unasked += self.link(b"") if self.served else b""
        return list(self._dshot)[:4]

    def wait(self, seconds: int) -> None:
        """Time goes by: gyro samples that nobody took."""
        firmware = self.ffi.cast("struct firmware *", self._memory)  # stands first in the instance
        for _ in range(seconds):
            self.lib.firmware_lost(firmware, GYRO_HZ)
            self.unasked += self.link(b"")

    unasked = b""  # what port 0 said meanwhile
    served = True  # it can send

    def boot(self) -> IdleFirmware:
        self.run(1400)
        assert self.reasons() == ()
        return self

    @property
    def armed(self) -> bool:
        trace = self.core.new("struct reference_trace *")
        self.lib.reference_trace(self._memory, trace)
        return bool(trace.armed)

    # --- Talking
    def link(self, data: bytes, *, port: int = 0, capacity: int = CAPACITY) -> bytes:
        """One call: these bytes in, the answer out."""
        count = self.lib.reference_link(self._memory, port, data, len(data), self._out, capacity)
        assert count <= capacity
        return bytes(self._out[0:count])

    def hang_up(self, port: int = 0) -> None:
        self.lib.reference_link_reset(self._memory, port)

    def pause(self, port: int = 0) -> None:
        self.lib.reference_link_pause(self._memory, port)

    def send(self, data: bytes, *, port: int = 0, capacity: int = CAPACITY, piece: int = PIECE) -> bytes:
        """All that is answered to these bytes, which come as a line with little room brings them."""
        said = b""
        for start in range(0, len(data), piece):
            said += self.link(data[start : start + piece], port=port, capacity=capacity)
            while more := self.link(b"", port=port, capacity=capacity):
                said += more
        return said

    def open(self) -> str:
        said = self.send(b"#").decode()
        assert said.endswith(PROMPT), said
        return said

    def type(self, text: str, **kwargs: int) -> str:
        """What a line, or several, is answered, echo and prompt included."""
        return self.send(text.encode() + b"\r", **kwargs).decode()

    def tell(self, line: str) -> list[str]:
        """What one line is answered, without its echo and the prompt."""
        said = self.type(line)
        assert said.startswith(line + "\r\n"), said
        assert said.endswith(PROMPT), said
        return said.removeprefix(line + "\r\n").removesuffix(PROMPT).split("\r\n")[:-1]

    def ask(self, command: int, payload: bytes = b"", *, port: int = 1) -> Message:
        said = self.send(encode(Message(Version.V2, Direction.REQUEST, command, payload)), port=port)
        (answer,) = Decoder().feed(said)
        assert isinstance(answer, Message)
        assert answer.command == command
        return answer

    def reasons(self) -> tuple[ArmingReason, ...]:
        flags = records.safety(self.ask(Msp.SAFETY).payload).arming_flags
        return tuple(reason for reason in ArmingReason if flags >> reason & 1)

    def settings(self) -> list[bytes]:
        """All of them, as SETTING_GET tells them on the other port."""
        return [self.ask(Msp.SETTING_GET, requests.setting_index(i)).payload for i in range(len(SETTINGS))]

    def set(self, name: str, value: float | str, kind: str) -> Message:
        index = next(i for i, setting in enumerate(SETTINGS) if setting.name == name)
        return self.ask(Msp.SETTING_SET, requests.setting_set(index, value, kind=kind))


@pytest.fixture
def idle(scripted: Any) -> IdleFirmware:
    """An idle firmware that nothing forbids to arm."""
    return IdleFirmware(scripted).boot()


@pytest.fixture
def make_idle(scripted: Any) -> Callable[..., IdleFirmware]:
    """What makes others, which have not booted yet."""
    return lambda *settings: IdleFirmware(scripted, *settings)


def lines_of(said: str) -> Sequence[str]:
    return said.replace("\r", "").split("\n")
