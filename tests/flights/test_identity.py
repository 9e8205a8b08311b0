"""The image on the emulated board flies the bits of the host build, and repeats a flight to the bit."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.control_timing import ControlMeter, Work
from neuroflight.sim.board.debug.profile import TaskCount, task_counts
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort, PortSnapshot
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.cortex_m7.cycles import Route
from neuroflight.toolchain.cortex_m7.disassembly import disassemble

Flown = Callable[..., Trace]
MINUTE = load_scenario("pulses", seed=5, count=14)
CHANGE, HOLD_S = 5, 0.1  # commands from one controller to the other; how long each is held


def two_seconds() -> Scenario:
    """Commands like those of `pulses`, closer together; the PID begins, the policy takes over, twice."""
    commands = np.random.default_rng(5).normal(0.0, 100.0, (20, 3)).tolist()
    return Scenario(
        "two seconds",
        tuple(
            Segment(HOLD_S, (roll, pitch, yaw), 0.1 * (k % 9), pid=k // CHANGE % 2 == 0)
            for k, (roll, pitch, yaw) in enumerate(commands)
        ),
    )


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """The file to be flashed."""
    return board_image.with_suffix(".bin")


def test_the_image_flies_the_bits_of_the_host_program_when_controllers_change(
    image: Path, host_program: Path, flown: Flown
) -> None:
    on_board = flown(EmulatedPort(image), two_seconds())
    assert len(on_board.t) == 2_000
    assert np.ptp(on_board.dshot, axis=0).min() > 1_000  # every motor has something to do
    assert flown(HostPort(host_program), two_seconds()).same(on_board)


def test_flights_differ_when_another_controller_flies(reference_library: Path, flown: Flown) -> None:
    policy = Scenario("a part", two_seconds().segments[CHANGE : CHANGE + 2])
    flights = [flown(ReferencePort(reference_library), each) for each in (policy, policy.under_pid())]
    assert not np.array_equal(flights[0].dshot, flights[1].dshot)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["policy", "pid"])
def test_the_image_flies_the_bits_of_the_host_build_for_a_minute(
    image: Path, host_program: Path, reference_library: Path, flown: Flown, controller: str
) -> None:
    scenario = MINUTE if controller == "policy" else MINUTE.under_pid()
    on_board = flown(EmulatedPort(image), scenario, seed=5)
    assert len(on_board.t) >= 60_000
    assert (on_board.dshot > 0).all()
    assert flown(HostPort(host_program), scenario, seed=5).same(on_board)
    assert flown(ReferencePort(reference_library), scenario, seed=5).same(on_board)


@pytest.mark.slow
@pytest.mark.parametrize(
    "phase_us",
    [pytest.param(us, marks=[] if us == 60 else [pytest.mark.slow]) for us in range(0, 125, 4)],
)
def test_the_bits_are_the_same_when_the_gyro_chips_clock_has_another_phase(
    image: Path, reference_library: Path, flown: Flown, phase_us: int
) -> None:
    segments = two_seconds().segments[CHANGE - 1 : CHANGE + 1]
    scenario = Scenario("some", segments)

    def later(board: Board) -> Callable[[int], None]:
        board.hardware.gyro.phase = phase_us * TIME_HZ // 1_000_000
        return board.run_to

    port = EmulatedPort(image, attach=later)
    on_board = flown(port, scenario)
    assert flown(ReferencePort(reference_library), scenario).same(on_board)


# ---- repeated flights ----
HANDLER = "gyro_sample_handler"


class RecordedPort(EmulatedPort):
    """Keeps a snapshot of the flight and all calls after it."""

    def __init__(self, image: Path, armed_for: int) -> None:
        """armed_for: samples with the motors armed before the snapshot."""
        super().__init__(image)
        self._until = armed_for
        self.snapshot: PortSnapshot | None = None
        self._calls: list[tuple[Callable[..., object], tuple[object, ...]]] = []

    def announce(self, channels_us: Sequence[int], samples: int) -> None:
        self._calls.append((EmulatedPort.announce, (list(channels_us), samples)))
        super().announce(channels_us, samples)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        if self._until == 0:
            self.snapshot = self.save()
            self._calls.clear()
        kept = sample.copy()
        self._calls.append((EmulatedPort.exchange, (kept, channels_us)))
        reply = super().exchange(sample, channels_us)
        self._until -= reply.armed
        return reply

    def again(self, port: EmulatedPort) -> None:
        """Repeat the calls after the snapshot on `port`, this one or one with the same image."""
        assert self.snapshot is not None
        port.restore(self.snapshot)
        for call, arguments in self._calls:
            call(port, *arguments)


def facts(port: EmulatedPort) -> tuple[object, ...]:
    """All state in which two runs may differ."""
    engine, report = port.board.engine, port.board.report()
    ram = engine.memory(0x20000000, 0x40000)
    return engine.cycle, engine.instructions, engine.trace_hash, ram, str(report), task_counts(engine)


def flown_once(port: EmulatedPort, scenario: Scenario) -> Trace:
    """A flight after which the port is still open."""
    rng = np.random.default_rng((1, 1))
    with closing(
        Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
    ) as twin:
        return fly(twin, port, scenario)


@pytest.fixture(scope="module")
def recorded(image: Path) -> Iterator[RecordedPort]:
    """A flight of 0.2 s with a snapshot in its middle; the policy takes over from the PID in it."""
    scenario = Scenario("some", two_seconds().segments[CHANGE - 1 : CHANGE + 1])
    with closing(RecordedPort(image, armed_for=360)) as port:
        flown_once(port, scenario)
        yield port


def test_a_flight_goes_on_identically_when_its_middle_is_restored(recorded: RecordedPort) -> None:
    assert recorded.snapshot is not None
    first = facts(recorded)
    recorded.restore(recorded.snapshot)
    assert facts(recorded)[2] != first[2]
    recorded.again(recorded)
    assert facts(recorded) == first


@pytest.mark.slow
def test_a_flight_is_the_same_when_its_control_tasks_are_counted_on_another_board(
    recorded: RecordedPort, image: Path
) -> None:
    elf = image.with_suffix(".elf")
    code = disassemble(elf)
    meters: list[ControlMeter] = []

    def attach(board: Board) -> Callable[[int], None]:
        meters.append(ControlMeter(board, elf, code))
        return meters[0].run_to

    with closing(EmulatedPort(image, attach=attach)) as port:
        assert recorded.snapshot is not None
        port.restore(recorded.snapshot)
        before = handled(port)
        recorded.again(port)
        assert facts(port) == facts(recorded)
        after = handled(port)
    runs = meters[0].runs()
    addresses = list(code)
    taken = [
        (run.times, instructions(run.route, addresses))
        for kind, found in runs.items()
        for run in found
        if kind.work is not Work.ALGORITHM
    ]
    assert sum(times for times, _ in taken) == after.activations - before.activations
    assert sum(times * one for times, one in taken) == after.instructions - before.instructions
    controllers = {kind.controller for kind in runs if kind.work is Work.TASK}
    assert controllers == {"policy", "pid", ""}  # the last one disarmed


def instructions(route: Route, addresses: Sequence[int]) -> int:
    """How many a route executes; `addresses`: of all there are, ascending."""
    return sum(
        times * (bisect_left(addresses, start + size) - bisect_left(addresses, start))
        for (start, size), times in route
    )


def handled(port: EmulatedPort) -> TaskCount:
    """Counts of the handler of the gyro's samples so far."""
    return next(task for task in task_counts(port.board.engine) if task.handler == HANDLER)


@pytest.mark.slow
def test_two_flights_are_the_same_when_they_begin_alike_or_in_the_middle_of_one(image: Path) -> None:
    scenario = two_seconds()
    with closing(RecordedPort(image, armed_for=4_000)) as port, closing(EmulatedPort(image)) as other:
        trace = flown_once(port, scenario)
        first = facts(port)
        assert flown_once(other, scenario).same(trace)
        assert facts(other) == first
        port.again(other)
        assert facts(other) == first
