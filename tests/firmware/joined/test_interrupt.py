"""The background, interrupted by the gyro between two of its accesses, at one that a test chooses."""

from __future__ import annotations

import mmap
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cffi import FFI

from neuroflight.toolchain.contract import ArmingReason, FlightState, Refusal
from tests.firmware.joined.field import Field

NEEDED = ("attitude", "motor_test", "dshot_command", "status")  # in this order


def catcher(library: Path) -> tuple[FFI, Any]:
    """What interrupt.c has."""
    ffi = FFI()
    ffi.cdef("int interrupt_at(void *pages, size_t bytes, void (*handler)(void));")
    return ffi, ffi.dlopen(str(library))


class Split:
    """Memory for a firmware, cut in two before `forbidden`: the first touch of the front can interrupt."""

    def __init__(self, core: Any, library: Path) -> None:
        ffi = core.ffi
        front = ffi.offsetof("struct firmware", "forbidden") // 8 * 8
        at = {name: ffi.offsetof("struct firmware", name) for name in NEEDED}
        assert at["attitude"] < at["motor_test"] < at["dshot_command"] < front < at["status"]
        pages = -(-front // mmap.PAGESIZE)
        behind = -(-(ffi.sizeof("struct firmware") - front) // mmap.PAGESIZE)
        self._memory = mmap.mmap(-1, (pages + behind) * mmap.PAGESIZE)
        self._start, self._bytes = ffi.from_buffer(self._memory), pages * mmap.PAGESIZE
        self.fw = ffi.cast("struct firmware *", ffi.cast("char *", self._start) + self._bytes - front)
        self._ffi, self._lib = catcher(library)
        self.taken = 0

    def interrupt(self, handler: Callable[[], None]) -> None:
        """`handler` runs when something touches the front part next."""

        def take() -> None:
            self.taken += 1
            handler()

        self._handler = self._ffi.callback("void(void)", take)
        front = self._ffi.cast("void *", int(self._ffi.cast("uintptr_t", self._start)))
        assert self._lib.interrupt_at(front, self._bytes, self._handler) == 0


@pytest.fixture(scope="module")
def interrupt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """interrupt.c as a library."""
    library = tmp_path_factory.mktemp("interrupt") / "interrupt.so"
    source = Path(__file__).with_name("interrupt.c")
    flags = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]
    subprocess.run(["gcc", *flags, str(source), "-o", str(library)], check=True)
    return library


def test_a_status_is_of_one_control_step_when_a_sample_falls_into_its_copying(
    bench: Callable[..., Any], scripted: Any, interrupt: Path
) -> None:
    split = Split(scripted, interrupt)
    b = bench(1000, fw=split.fw)
    b.run(2100)
    assert b.status.attitude_known
    b.counts = (2000, 0, 0)

    def roll() -> None:
        for _ in range(100):
            b.sample()

    split.interrupt(roll)
    seen, after = b.status, b.status
    assert split.taken == 1
    assert after.attitude_deg[0] > 10
    assert (seen.trace.step, list(seen.attitude_deg)) == (after.trace.step, list(after.attitude_deg))


def test_a_record_is_of_one_control_step_when_a_sample_falls_into_its_copying(
    bench: Callable[..., Any], scripted: Any, interrupt: Path
) -> None:
    split = Split(scripted, interrupt)
    b = bench(1000, fw=split.fw, crash_detection=0, runaway_detection=0, plausibility_detection=0)
    b.arm()
    lib, cycles = scripted.lib, scripted.new("uint32_t *", 1)

    def fly() -> None:
        lib.scripted_action = [0.25, 0.5, 0.75, 1.0]
        b.counts = (100, 0, 0)
        b.run(20, arm=2000)
        cycles[0] = 2

    record = scripted.new("struct control_record *")
    split.interrupt(fly)
    lib.firmware_record(split.fw, cycles, record)
    assert split.taken == 1
    assert record.cycles == 2
    assert record.trace.step == b.trace.step
    assert list(record.trace.gyro) == list(b.trace.gyro)
    assert list(record.observation)[: record.observation_count] == list(lib.scripted_observation)
    assert list(record.action)[: record.action_count] == [0.25, 0.5, 0.75, 1.0]


def test_nothing_arms_when_the_switch_comes_while_the_background_looks_whether_flash_may_be_written(
    scripted: Any, chip: Callable[..., Any], interrupt: Path
) -> None:
    split = Split(scripted, interrupt)
    f = Field(scripted, chip(), fw=split.fw)
    f.boot()
    services = f.background.services

    def switch_on() -> None:
        f.arm = 2000
        for _ in range(50):
            f.sample()

    split.interrupt(switch_on)
    assert services.storing(services.context, True) == Refusal.NONE
    assert split.taken == 1
    assert f.fw.safety.state == FlightState.DISARMED, "flash is about to be written"
    assert f.fw.status.arming_reasons & 1 << ArmingReason.STORING
    services.storing(services.context, False)
    f.land()
    switch_on()
    assert f.fw.safety.state == FlightState.ARMED
    assert services.storing(services.context, True) == Refusal.ARMED
    f.land()
    switch_on()
    assert f.fw.safety.state == FlightState.ARMED, "a refusal forbids nothing"


@pytest.mark.parametrize("watched", ["runs", "sum"])
def test_a_mean_is_of_whole_runs_when_one_is_added_while_it_is_read(
    scripted: Any, interrupt: Path, watched: str
) -> None:
    """The struct lies across a page's end, `sum` behind it; who touches a page first is interrupted."""
    ffi, lib = scripted.ffi, scripted.lib
    own, catching = catcher(interrupt)
    memory = mmap.mmap(-1, 2 * mmap.PAGESIZE)
    start = int(ffi.cast("uintptr_t", ffi.from_buffer(memory)))
    before = ffi.offsetof("struct task_stats", "sum")
    assert ffi.offsetof("struct task_stats", "runs") < before
    stats = ffi.cast("struct task_stats *", start + mmap.PAGESIZE - before)
    lib.task_stats_init(stats, 1000)
    for _ in range(3):
        lib.task_stats_add(stats, 100, False)
    assert lib.task_stats_mean(stats) == 100
    taken: list[int] = []

    def run() -> None:
        taken.append(stats.runs)
        lib.task_stats_add(stats, (1 << 32) - 1, False)

    handler = own.callback("void(void)", run)
    page = own.cast("void *", start + (watched == "sum") * mmap.PAGESIZE)
    assert catching.interrupt_at(page, mmap.PAGESIZE, handler) == 0
    assert lib.task_stats_mean(stats) == (300 + (1 << 32) - 1) // 4
    assert taken == [3]
