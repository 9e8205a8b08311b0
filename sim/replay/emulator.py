"""A log on the emulated board: the very image, the flight's state in its memory, the flight's inputs.

The board boots with the log's settings. Then `struct firmware` gets the state of the log, its own pointers
excepted, and every gyro sample comes from the chip with the logged counts. What reaches the control path by
other ways is put where the image takes it, as `runtime_sample` is called by the gyro's interrupt: so nothing
depends on how long the background took.

What the chip cannot be made to say is written instead: that a transfer failed or samples were lost, into the
sample that `runtime_sample` is given; whether a step missed its deadline, and the words of the ESCs, into
the arguments of `firmware_deadline` and `firmware_rotors`. Silence is the chip's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.board.core.engine import Outcome
from neuroflight.sim.board.debug.variables import pointers_in, read_variables
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.replay.inputs import ANSWER, Answers, Flight, Progress, unpacked, words_of_samples
from neuroflight.toolchain.contract import LogEdge, Weights
from neuroflight.toolchain.errors import LinkError, TraceError

SILENCE_EDGES_MAX = 400  # periods of the gyro until the image must have told of a silence
_FIRMWARE = "firmware"
_ROTORS = "firmware_rotors"
_STOPS = ("runtime_sample", "runtime_gyro_silent", "firmware_deadline", _ROTORS)
_ONE, _NONE = b"\1", b"\0"
_EDGES = {  # flag, and the variable of the background that says it
    LogEdge.POSTED: "posted",
    LogEdge.ACKNOWLEDGED: "acknowledged",
    LogEdge.CALIBRATE: "calibrate",
}
_WEIGHTS = {LogEdge.WEIGHTS_BAD: bytes([Weights.BAD]), LogEdge.WEIGHTS_GOOD: bytes([Weights.RENEWED])}


class BoardReplay(EmulatedPort):
    """A board that is given the inputs of a log instead of those of a twin."""

    def __init__(self, image: Path, gyro_rate_hz: int, settings: Mapping[str, float]) -> None:
        """Boot the image with these settings. Raises as EmulatedPort does."""
        super().__init__(image, gyro_rate_hz, settings)
        elf = image.with_suffix(".elf")
        (self._firmware,) = read_variables(elf, _FIRMWARE)
        self._pointers = pointers_in(elf, _FIRMWARE)
        self._values = np.frombuffer(self._memory(), self._firmware.dtype)[0]  # in the board's memory
        symbols = self.board.symbols
        missing = [name for name in _STOPS if name not in symbols]
        if missing:
            raise LinkError(f"{elf}: no function {missing[0]}; build image and program from one source")
        self._stops = {symbols[name] & ~1: name for name in _STOPS}
        self.board.engine.set_breakpoints(self._stops)

    @property
    def state_bytes(self) -> int:
        return self._firmware.size

    def restore_firmware(self, state: bytes) -> None:
        """Put `state` into `struct firmware`, its own pointers excepted."""
        wanted, own = bytearray(state), self._memory()
        for place in self._pointers:
            wanted[place] = own[place]
        self.board.engine.set_memory(self._firmware.address, bytes(wanted))

    def run(self, flight: Flight, progress: Progress = lambda _: None) -> Answers:
        """Replay each control step of `flight` and return the answers."""
        inputs = flight.inputs
        words = words_of_samples(inputs, self._last_words())
        told = self._values["status"]["trace"]
        steps = len(flight)
        answers = np.zeros(steps, ANSWER)
        every = max(1, flight.control_rate_hz // 10)
        for k in range(steps):
            self._silence(int(inputs.silences[k]), int(inputs.forbidden[k]))
            count = int(inputs.samples[k])
            for i in range(count):
                last = i == count - 1
                self._sample(words[k, i], not inputs.invalid[k, i], int(inputs.lost[k]) if last else 0)
                if last:
                    self._edges(flight, k)
                self._go_on(flight, k, control_step=last)
            for name in ANSWER.fields or ():
                answers[name][k] = told[name]
            if k % every == 0:
                progress(k / steps)
        return unpacked(answers, flight.motor_count)

    def _memory(self) -> memoryview:
        return self.board.engine.view(self._firmware.address, self._firmware.size)

    def _last_words(self) -> tuple[int, ...]:
        """Return the chip's words of the last good sample, as the firmware remembers it."""
        last = self._values["gyro"]["last"]
        return (*last["accel"].tolist(), int(last["temperature"]), *last["gyro"].tolist())

    def _run_on(self) -> str:
        """Run to the next stop, or to the cycle before the gyro's next edge; the stop's name, or ""."""
        engine = self.board.engine
        engine.skip_breakpoint()
        outcome = engine.run(self._edge - 1)
        if outcome is Outcome.BREAKPOINT:
            return self._stops[engine.pc & ~1]
        if outcome is not Outcome.REACHED:
            raise LinkError(
                f"the board does not go on ({outcome.name}), its resets: {', '.join(engine.resets)}"
            )
        return ""

    def _sample(self, words: NDArray[np.int16], valid: bool, lost: int) -> None:
        """Let the chip measure, and the board run until it has taken that; it stands at `runtime_sample`."""
        x, y, z, temperature, *gyro = words.tolist()
        self._gyro.measure((x, y, z), temperature, (gyro[0], gyro[1], gyro[2]))
        self._edge += self._period
        stop = self._run_on()
        if stop != "runtime_sample":
            raise LinkError(
                f"the board took no gyro sample at its edge, but came to {stop or 'the next edge'}"
            )
        engine = self.board.engine
        sample = engine.register(1)  # the second argument
        layout = self._firmware.dtype["gyro"]["last"].fields
        assert layout is not None
        engine.set_memory(sample + layout["valid"][1], _ONE if valid else _NONE)
        engine.set_memory(sample + layout["lost"][1], lost.to_bytes(2, "little"))

    def _go_on(self, flight: Flight, step: int, *, control_step: bool) -> None:
        """Run to the cycle before the next edge, through control step `step` if the sample is one."""
        stop = self._run_on()
        if control_step:
            if stop == _ROTORS:
                words = flight.inputs.rotors[step].astype("<u2").tobytes()
                self.board.engine.set_memory(self.board.engine.register(1), words)
                stop = self._run_on()
            missed = bool(flight.inputs.flags[step] & LogEdge.MISSED)
            if stop != "firmware_deadline":
                raise LinkError(f"gyro sample of step {step}: no control step came of it")
            self.board.engine.set_register(1, int(missed))
            stop = self._run_on()
        if stop:
            raise LinkError(
                f"the board came to {stop} after the sample of step {step}, expected the next edge"
            )

    def _edges(self, flight: Flight, k: int) -> None:
        """Hand over the background's and the receiver's values to control step `k`, the next one."""
        inputs = flight.inputs
        flags = int(inputs.flags[k])
        self._put("forbidden", inputs.forbidden[k].tobytes())
        self._put("voltage_gain", inputs.gain[k].tobytes())
        for flag, name in _EDGES.items():
            self._put(name, _ONE if flags & flag else _NONE)
        self._put("weights", next((word for flag, word in _WEIGHTS.items() if flags & flag), _NONE))
        data = inputs.receiver[k, : int(inputs.received[k])].tobytes()
        if flags & LogEdge.POSTED:
            self._put("posted_us", data)
        elif data:
            self.board.hardware.dma.requests[f"{self.receiver_uart}_RX"].give(data)

    def _put(self, name: str, data: bytes) -> None:
        fields = self._firmware.dtype.fields
        assert fields is not None
        self.board.engine.set_memory(self._firmware.address + fields[name][1], data)

    def _silence(self, times: int, forbidden: int) -> None:
        """Keep the gyro silent until the image has reported it `times` times."""
        if not times:
            return
        self._gyro.silent = True
        for _ in range(times * SILENCE_EDGES_MAX):
            self._edge += self._period
            while (stop := self._run_on()) == "runtime_gyro_silent":
                self._put("forbidden", np.uint32(forbidden).tobytes())
                times -= 1
            if stop:
                raise LinkError(f"the silent gyro brought the board to {stop}")
            if times <= 0:
                self._gyro.silent = False
                return
        raise LinkError("the gyro is silent, but the image does not tell")


def replay_on_board(image: Path, flight: Flight, progress: Progress = lambda _: None) -> Answers:
    """Replay each control step of `flight` on the board and return the answers.

    Raises LinkError where the image is missing or does not take a sample, TraceError for a log that does not
    fit it, BoardError for what the image does wrong.
    """
    board = BoardReplay(image, flight.gyro_rate_hz, flight.boot_settings())
    with closing(board):
        if board.state_bytes != len(flight.state):
            raise TraceError(
                f"{flight.path}: its state has {len(flight.state)} bytes, {image} has {board.state_bytes}: "
                "another source or policy flew; build that one"
            )
        board.restore_firmware(flight.state)
        return board.run(flight, progress)
