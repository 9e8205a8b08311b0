"""The firmware's logs on a chip of the emulated board, with nothing but the bus between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from neuroflight.toolchain.contract import LogError, LogState
from tests.firmware.conftest import Core

CYCLES_A_SECOND = 216_000_000
ROUND = CYCLES_A_SECOND // 4000  # of the background: one for each gyro sample
SLOW_HZ, FAST_HZ = 54e6 / 256, 54e6 / 4
BUS_BYTES = 520
DONE, LATER, FAILED = range(3)  # enum log_answer


class PowerCut(Exception):  # noqa: N818
    """The board has lost its power."""


class LogRecorder:
    """A board's background, as far as it is about such a chip; `cycle` is its time [1/216 us]."""

    look = 0  # cycles that a look whether a transfer has ended takes

    def __init__(self, core: Core, chip: Any, log: str) -> None:
        """chip: an SdCard or a FlashChip. log: of the firmware's structs, struct LOG and LOG_init."""
        self.core, self.lib, ffi = core, core.lib, core.ffi
        self.chip, self._log = chip, log
        self.cycle = CYCLES_A_SECOND // 100
        self.round = ROUND
        self.transfers = 0
        self.most = 0  # transfers in one step
        chip.on_power_cut = self._cut
        self.bytes = ffi.new("uint8_t[]", BUS_BYTES)
        self._busy_until, self._hz = 0, 0.0
        self._selected, self._transaction = False, 0
        self._kept = [
            ffi.callback("void(void *, size_t)", self._start),
            ffi.callback("bool(void *)", self._done),
            ffi.callback("void(void *, bool)", self._select),
            ffi.callback("void(void *, bool)", self._speed),
            ffi.callback("uint32_t(void *)", lambda context: self.cycle // 216_000 & 0xFFFFFFFF),
        ]
        self.bus = ffi.new("struct spi_bus *", (ffi.NULL, self.bytes, *self._kept))
        self._error: Exception | None = None
        self.boot()

    def boot(self) -> None:
        """The board starts; the chip stays as it is."""
        self.log = self.core.new(f"struct {self._log} *")
        self.device = self.core.new("struct log_device *")
        getattr(self.lib, f"{self._log}_init")(self.log, self.bus, self.device)

    # ---- the bus ----

    def _cut(self) -> None:
        self._error = PowerCut()

    def passed(self, count: int, got: bytes) -> None:
        """Hears of a transfer's bytes."""

    def _start(self, context: object, count: int) -> None:
        assert self.cycle >= self._busy_until, "a transfer is under way"
        assert 0 < count <= BUS_BYTES
        try:
            sent = bytes(self.core.ffi.buffer(self.bytes, count))
            length = round(8 * CYCLES_A_SECOND / self._hz)
            got = self.chip.exchange(
                sent,
                self.cycle,
                length,
                self._hz,
                3,
                selected=self._selected,
                transaction=self._transaction,
            )
            self.core.ffi.buffer(self.bytes, count)[:] = got
            self._busy_until = self.cycle + length * count
            self.passed(count, got)
        except Exception as error:  # a callback cannot raise
            self._error = error
        self.transfers += 1

    def _done(self, context: object) -> bool:
        self.cycle += self.look
        return self.cycle >= self._busy_until

    def _select(self, context: object, selected: bool) -> None:
        assert self.cycle >= self._busy_until, "the select line moves within a transfer"
        self._transaction += selected != self._selected
        self._selected = selected

    def _speed(self, context: object, fast: bool) -> None:
        self._hz = FAST_HZ if fast else SLOW_HZ

    # ---- the background ----

    @property
    def seconds(self) -> float:
        return self.cycle / CYCLES_A_SECOND

    def step(self, rounds: int = 1) -> None:
        """Rounds of the background. Raises what the card raised, PowerCut too."""
        for _ in range(rounds):
            before = self.transfers
            self.device.step(self.device.context)
            self.most = max(self.most, self.transfers - before)
            if self._error is not None:
                raise self._error
            self.cycle += self.round

    def until(self, done: Callable[[], bool], seconds: float = 5.0) -> None:
        """Rounds until something is so; fails where it is not in time."""
        end = self.cycle + round(seconds * CYCLES_A_SECOND)
        while not done():
            assert self.cycle < end, f"not within {seconds} s: {self.status.state}, error {self.status.error}"
            self.step()

    @property
    def status(self) -> Any:
        status = self.core.new("struct log_device_status *")
        self.device.status(self.device.context, status)
        return status

    @property
    def state(self) -> LogState:
        return LogState(self.status.state)

    @property
    def error(self) -> LogError:
        return LogError(self.status.error)

    def ready(self) -> None:
        self.until(lambda: self.state == LogState.READY)

    def begin(self) -> int:
        return self._answer(lambda: int(self.device.begin(self.device.context)))

    def write(self, data: bytes) -> int:
        return int(self.device.write(self.device.context, data, len(data)))

    def end(self, seconds: float = 5.0) -> int:
        """Asks until the log has ended."""
        return self._answer(lambda: int(self.device.end(self.device.context)), seconds)

    def record(self, data: bytes, rate: float = 125_000.0) -> list[tuple[float, int]]:
        """Gives `data` at so many bytes a second, refused ones again; (time, bytes taken), by rounds."""
        taken, begun, history = 0, self.cycle, []
        limit = begun + round((len(data) / rate * 3 + 5) * CYCLES_A_SECOND)
        while taken < len(data):
            assert self.cycle < limit, f"{taken} of {len(data)} bytes: {self.state!r}, {self.error!r}"
            due = min(len(data), int((self.cycle - begun) / CYCLES_A_SECOND * rate) + 1)
            if due > taken:
                taken += self.write(data[taken:due])
            history.append((self.seconds, taken))
            self.history = history
            self.step()
        return history

    def read(self, index: int, size: int = 200) -> bytes:
        """A whole log, by pieces."""
        pieces, offset = [], 0
        while piece := self.read_at(index, offset, size):
            pieces.append(piece)
            offset += len(piece)
        return b"".join(pieces)

    def read_at(self, index: int, offset: int, size: int = 200) -> bytes:
        buffer, count = self.core.new("uint8_t[]", size), self.core.new("size_t *")

        def asked() -> int:
            count[0] = size
            return int(self.device.read(self.device.context, index, offset, buffer, count))

        assert self._answer(asked) == DONE
        return bytes(buffer[0 : count[0]])

    def entry(self, index: int) -> tuple[str, int] | None:
        entry = self.core.new("struct log_entry *")
        if self._answer(lambda: int(self.device.entry(self.device.context, index, entry))) == FAILED:
            return None
        return self.core.ffi.string(entry.name).decode(), int(entry.bytes)

    def erase(self) -> int:
        return self._answer(lambda: int(self.device.erase(self.device.context)), 60.0)

    def _answer(self, ask: Callable[[], int], seconds: float = 5.0) -> int:
        answer = LATER

        def ended() -> bool:
            nonlocal answer
            answer = ask()
            return answer != LATER

        self.until(ended, seconds)
        return answer

    def close(self) -> None:
        self.chip.close()
