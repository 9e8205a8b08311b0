"""What the whole control task takes on the Cortex-M7: from the gyro's bytes in memory to the motors' frame.

A flight of the firmware's C core is recorded and played to the linked image on an emulated core, byte by
byte: the gyro's DMA, the receiver's line at its speed, the battery. The image's own interrupt handler runs,
drivers included, and its motor values must be those of the recorded flight, to the bit.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.debug.variables import read_variables
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import (
    ARMING_DELAY_MS,
    DTCM,
    FLASH_BASE,
    FLASH_BYTES,
    GYRO_COUNTS,
    GYRO_EDGE_RATE_HZ,
    GYRO_FULL_SCALE_DEG_S,
    ITCM,
    SRAM1,
    SRAM2,
    Region,
)
from neuroflight.toolchain.cortex_m7.cycles import (
    CORE_HZ,
    DEVICE_CYCLES,
    Route,
    price_routes,
    route_costs,
    route_of,
)
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program
from neuroflight.toolchain.image.build import build
from tests.firmware.board.conftest import Chip, Sketch
from tests.firmware.board.registers import registers_in_use

ROOT = Path(__file__).resolve().parents[2]
POLICY = "nf1"  # the shipped one
AIRCRAFT, SEED, GYRO_HZ = "nf1", 1, 4000
CYCLES_BAR, VARIES_BAR = 22_000, 0.05
LOGGED_BAR = 0.02  # of a control step's instructions

PERIPHERALS = Region("peripherals", 0x40000000, 0x80000)
SYSTEM = Region("system", 0xE0000000, 0x100000)
MEMORY = (Region("flash", FLASH_BASE, FLASH_BYTES), ITCM, DTCM, SRAM1, SRAM2, PERIPHERALS, SYSTEM)
DMA1_S5NDTR = 0x4002608C  # of the receiver's ring
DMA2_LISR, DMA2_SCR = 0x40026400, 0x40026410
STREAM_BYTES = 0x18
ADC_DONE, GYRO_DONE = 1 << 5, 1 << 21  # DMA_LISR TCIF0, TCIF2
RING_BYTES = 256
MOTOR_STREAM, MOTOR_LOW = 6, 22  # of DMA2, writes port C; the bit of BSRR that ends motor 1's pulse (PC6)
GRAVITY, ACCEL_COUNTS = 9.80665, 2048  # m/s^2; counts a g
PACK_MV = 16_800 // 11  # at the pin
EVERY = 40  # gyro samples from one call of the background to the next: 10 ms
BYTE_US = 120  # of SBUS: 12 bits at 100 kbaud


@dataclass(frozen=True)
class Step:
    """What went into the firmware at one gyro sample, and what came out."""

    gyro: tuple[int, ...]  # counts, chip axes
    accel: tuple[int, ...]
    frame: bytes  # of the receiver, whole before this sample; empty for none
    dshot: tuple[int, ...]
    armed: bool


@dataclass(frozen=True)
class Row:
    """The control task around one policy."""

    policy: str
    network: str
    steps: int  # armed control steps
    routes: int  # distinct ones
    instructions: tuple[int, int]  # fewest, most
    cycles: tuple[float, float] | None  # predicted, device accesses included
    no_cycles_reason: str | None
    device_accesses: int  # in a control step
    between: tuple[int, int]  # instructions of a gyro sample that is no control step
    logged: float  # part of a control step's instructions that the log adds, at most
    logged_between: int  # instructions that it adds to a gyro sample that is no control step, at most

    @property
    def varies(self) -> float:
        """(worst - best) / worst, of cycles where there are some."""
        best, worst = self.cycles or self.instructions
        return (worst - best) / worst


def rows(steps: int, say: Callable[[str], None] = lambda text: None) -> list[Row]:
    """The control task over `steps` armed control steps of a flight, around the shipped policy."""
    with tempfile.TemporaryDirectory(prefix="neuroflight-bench-") as folder:
        return [_row(POLICY, steps, Path(folder) / POLICY, say)]


def print_table(measured: Sequence[Row]) -> None:
    """The rows, beside what they may take at most."""
    print(
        f"{'the control task on the Cortex-M7':36}{'instructions':>16}{'cycles':>18}{'varies':>8}{'8 kHz':>8}"
    )
    for row in measured:
        cycles = "" if row.cycles is None else _span(*map(round, row.cycles))
        share = "" if row.cycles is None else f"{row.cycles[1] * GYRO_EDGE_RATE_HZ / CORE_HZ:.0%}"
        name = f"{row.policy}: {row.network}"
        print(f"{name:36}{_span(*row.instructions):>16}{cycles:>18}{row.varies:>8.1%}{share:>8}")
        print(f"{'  a gyro sample between':36}{_span(*row.between):>16}")
    print(f"{'  at most':36}{'':>16}{CYCLES_BAR:>18,}{VARIES_BAR:>8.1%}")
    for row in measured:
        flown = f"{row.policy}: {row.steps:,} armed steps on {row.routes:,} routes, motor values the host's"
        print(f"{flown}; {row.device_accesses} device accesses, taken as {DEVICE_CYCLES} cycles more each")
        print(
            f"{row.policy}: the log adds {row.logged:.2%} at most to a control step, "
            f"{row.logged_between} instructions to the {_span(*row.between)} of a sample between"
        )
        if row.no_cycles_reason:
            print(row.no_cycles_reason)


def _span(least: int, most: int) -> str:
    return f"{least:,}" if least == most else f"{least:,}..{most:,}"


def _row(name: str, steps: int, folder: Path, say: Callable[[str], None]) -> Row:
    policy = ROOT / "training" / "policies" / name / "policy.onnx"
    pid = pid_table(load_aircraft(AIRCRAFT))
    say(f"{name}: building")
    report = build("MATEKF722", policy, ROOT, folder, pid)
    build("HOST", policy, ROOT, folder, pid)
    say(f"{name}: flying")
    flown = _flight(folder / "HOST" / "libneuroflight.so", steps)
    say(f"{name}: playing it to the image")
    elf = folder / "MATEKF722" / "neuroflight.elf"
    board = _Board(elf)
    control_every = GYRO_HZ // report.policy.control_rate_hz
    routes, between = _played(board, flown, control_every)
    bare_routes, bare_between = _played(_Board(elf, logs=False), flown, control_every)
    code = disassemble(elf, lines=True)
    priced = price_routes(list(dict.fromkeys(routes)), code)
    counts = [cost.instructions for cost in priced.costs]
    taken_by = {
        route: cost.instructions for route, cost in zip(dict.fromkeys(routes), priced.costs, strict=True)
    }
    others = list(dict.fromkeys([*between, *bare_routes, *bare_between]))
    costs = route_costs(others, code, price=False)
    taken_by |= {route: cost.instructions for route, cost in zip(others, costs, strict=True)}
    accesses = board.device_accesses()
    taken = [cost.cycles_with_devices(accesses) for cost in priced.costs]
    cycles = [cycles for cycles in taken if cycles is not None]
    return Row(
        policy=name,
        network=report.policy.network,
        steps=len(routes),
        routes=len(set(routes)),
        instructions=(min(counts), max(counts)),
        cycles=(min(cycles), max(cycles)) if cycles else None,
        no_cycles_reason=priced.no_cycles_reason,
        device_accesses=accesses,
        between=(min(taken_by[route] for route in between), max(taken_by[route] for route in between)),
        logged=max(
            taken_by[with_log] / taken_by[bare] - 1
            for with_log, bare in zip(routes, bare_routes, strict=True)
        ),
        logged_between=max(
            taken_by[with_log] - taken_by[bare] for with_log, bare in zip(between, bare_between, strict=True)
        ),
    )


def _played(board: _Board, flown: Sequence[Step], control_every: int) -> tuple[list[Route], list[Route]]:
    """Routes of the armed control steps and of the armed samples between them, in the flight's order."""
    routes: list[Route] = []
    between: list[Route] = []
    with board.core.recording() as runs:
        for index, (step, heard) in enumerate(zip(flown, _line(flown), strict=True)):
            control = index % control_every == 0
            board.edges(step, heard)
            runs.clear()
            board.take(step)
            if step.armed:
                (routes if control else between).append(route_of(runs))
            if index % EVERY == EVERY - 1:
                board.background()
    return routes, between


# --- The recorded flight ------------------------------------------------------------------------------
class _Recorder:
    """A port that notes what passes."""

    def __init__(self, port: ReferencePort) -> None:
        self._port = port
        self.motor_count, self.gyro_rate_hz = port.motor_count, port.gyro_rate_hz
        self.control_rate_hz = port.control_rate_hz
        self.steps: list[Step] = []

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        reply = self._port.exchange(sample, channels_us)
        deg_s = np.degrees(sample.gyro) * (GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S)
        self.steps.append(
            Step(
                gyro=_chip(deg_s),
                accel=_chip(sample.specific_force * (ACCEL_COUNTS / GRAVITY)),
                frame=b"" if channels_us is None else _sbus(channels_us),
                dshot=tuple(reply.dshot.tolist()),
                armed=reply.armed,
            )
        )
        return reply

    def arming_reasons(self) -> tuple[str, ...]:
        return self._port.arming_reasons()

    def close(self) -> None:
        self._port.close()


def _chip(counts: NDArray[np.float64]) -> tuple[int, ...]:
    """Body axes as the MPU6500 of this board sees them, turned by 180 degrees."""
    whole = np.clip(np.rint(counts * (-1.0, -1.0, 1.0)), -GYRO_COUNTS, GYRO_COUNTS - 1)
    return tuple(int(value) for value in whole)


def _sbus(channels_us: Sequence[int]) -> bytes:
    values = [max(0, min(2047, (us - 880) * 8 // 5)) for us in channels_us]
    number = sum(value << 11 * index for index, value in enumerate(values))
    return bytes([0x0F, *number.to_bytes(22, "little"), 0, 0])


def _line(steps: Sequence[Step]) -> list[bytes]:
    """What the receiver's line brings before each gyro sample.

    Bytes come at the line's speed, the last of a frame one gyro period before the sample that it belongs to.
    """
    heard = [bytearray() for _ in steps]
    for index, step in enumerate(steps):
        for left, byte in enumerate(reversed(step.frame)):
            before = 1 + left * BYTE_US * GYRO_HZ // 1_000_000
            heard[max(0, index - before)].insert(0, byte)
    return [bytes(some) for some in heard]


def _flight(library: Path, steps: int) -> list[Step]:
    """Commands flown from boot until `steps` armed control steps are done."""
    scenario = load_scenario("pulses", SEED, steps // 1000 + 1, throttle=0.3)
    settings = {"arming_delay_ms": ARMING_DELAY_MS, "ground_detection": 1}  # as the image
    port = _Recorder(ReferencePort(library, GYRO_HZ, settings))
    rng = np.random.default_rng(SEED)
    twin = Twin(load_aircraft(AIRCRAFT), rate_hz=GYRO_HZ, mount=scenario.mount, rng=rng)
    with closing(port), closing(twin):
        fly(twin, port, scenario)
    first = next(index for index, step in enumerate(port.steps) if step.armed)
    return port.steps[: first + steps * GYRO_HZ // port.control_rate_hz]


# --- The image ----------------------------------------------------------------------------------------
class _Board:
    """The image after its start-up, whose interrupts and DMA are played by hand."""

    def __init__(self, elf: Path, *, logs: bool = True) -> None:
        with elf.open("rb") as file:
            sketch = Sketch(ELFFile(file), registers_in_use(), cycles_a_read=2000)
        Chip(sketch, 0x70)
        program = load_program(elf)
        sketch.run(program.symbol("msp_lines_serve").address)
        self.core = CortexM7(program, MEMORY)
        for region in MEMORY:
            self.core.write(region.address, bytes(sketch.uc.mem_read(region.address, region.size)))
        at = {name: program.symbol(name).address for name in program.symbols}
        self._response, self._ring = at["gyro_response"], at["receiver_ring_bytes"]
        self._words, self._conversions = at["motor_words"], at["power_conversions"]
        self._runtime = at["runtime"]
        self._head = 0
        written, taken = read_variables(elf, "log_ring.written", "log_ring.taken")
        self._written, self._taken = written.address, taken.address
        if not logs:
            self._poke(at["log_ring"], 0)  # no record is open, as with blackbox_device=none
        counts = round(PACK_MV / 3300 * 4095)
        self.core.write(self._conversions, struct.pack("<64H", *[counts, 0] * 32))

    def edges(self, step: Step, heard: bytes) -> None:
        """The chip's data-ready edges of one sample, which DMA then reads; the receiver's line was heard."""
        self._hear(heard)
        for _ in range(GYRO_EDGE_RATE_HZ // GYRO_HZ):
            self.core.call("gyro_edge_handler")
        self._finish(step)

    def take(self, step: Step) -> None:
        """The interrupt of the finished read: the task itself."""
        self.core.call("gyro_sample_handler")
        self._poke(DMA2_LISR, 0)
        if (dshot := self._frame()) != step.dshot:
            raise AssertionError(f"the image sends {dshot}, the host {step.dshot}: not the same firmware")
        self._end(MOTOR_STREAM)

    def background(self) -> None:
        """One round of it, the battery measured meanwhile."""
        self._poke(DMA2_LISR, ADC_DONE)
        self.core.call("runtime_background", self._runtime)
        self._poke(DMA2_LISR, 0)
        self._poke(self._taken, self._peek(self._written))  # all that the log has kept is written

    def device_accesses(self) -> int:
        """How often a control step touches a register of a peripheral."""
        most = 0
        for _ in range(2 * GYRO_HZ // 1000):
            self.core.call("gyro_edge_handler")
            self._finish(Step((0, 0, 0), (0, 0, 0), b"", (), armed=False))
            most = max(most, self.core.accesses(PERIPHERALS, "gyro_sample_handler"))
            self._end(MOTOR_STREAM)
        return most

    def _finish(self, step: Step) -> None:
        """DMA has moved what the chip said."""
        self.core.write(self._response, struct.pack(">B7h", 0, *step.accel, 0, *step.gyro))
        for stream in (2, 3):
            self._end(stream)
        self._poke(DMA2_LISR, GYRO_DONE)

    def _end(self, stream: int) -> None:
        address = DMA2_SCR + STREAM_BYTES * stream
        self._poke(address, self._peek(address) & ~1)

    def _hear(self, heard: bytes) -> None:
        for byte in heard:
            self.core.write(self._ring + self._head, bytes([byte]))
            self._head = (self._head + 1) % RING_BYTES
        self._poke(DMA1_S5NDTR, RING_BYTES - self._head)

    def _frame(self) -> tuple[int, ...]:
        """The motor values in the frame that DMA would send."""
        words = struct.unpack("<48I", self.core.read(self._words, 192))[1::3]  # each bit's second third
        return tuple(_value([word >> MOTOR_LOW + motor & 1 for word in words]) for motor in range(4))

    def _peek(self, address: int) -> int:
        return int.from_bytes(self.core.read(address, 4), "little")

    def _poke(self, address: int, value: int) -> None:
        self.core.write(address, value.to_bytes(4, "little"))


def _value(ends: Sequence[int]) -> int:
    """The 11 bits that a DShot frame begins with; 1: the bit's pulse ends after a third of it."""
    return int("".join("0" if end else "1" for end in ends[:11]), 2)
