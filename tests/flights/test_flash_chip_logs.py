"""Logs of flights on a board with a flash chip: on the chip, fetched over MSP, cut short with the power."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.fly.blackbox import FlightLog
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.board.devices.flash_chip import KINDS, FlashChip, FlashMemory
from neuroflight.sim.flight import loop
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.stamp import stamp
from tests.cli.test_board import Running
from tests.cli.test_fly_blackbox import assert_log_is_trace
from tests.firmware.storage.flash_chip.reading import logs_of
from tests.sampling import sampled

NOR, NAND = "HGLRCF722", "ARESF7"
CHIPS = {NOR: "W25Q128", NAND: "W25N01G"}
Built = Callable[[str], Path]


@pytest.fixture
def built(board_image: Path, tmp_path: Path) -> Built:
    """Makes a board's image."""

    def make(name: str) -> Path:
        elf = tmp_path / f"{name}.elf"
        stamp(board_image, pack(allocate(find_board(name))), elf)
        copied = ["arm-none-eabi-objcopy", "-O", "binary", "--gap-fill", "0xFF", "--remove-section=.slot_b"]
        subprocess.run([*copied, elf, elf.with_suffix(".bin")], check=True)
        return elf.with_suffix(".bin")

    return make


def fly(image: Path, chip: FlashChip | Path, seconds: float = 0.4) -> Trace:
    """A flight, up to the end of its log."""
    port, log = EmulatedPort(image, card=chip), FlightLog()
    log.told = port.logged
    twin = Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, rng=np.random.default_rng(1))
    scenario = Scenario("some time", (Segment(seconds, (100.0, -100.0, 50.0), 0.3),))
    with closing(port), closing(twin):
        return loop.fly(twin, port, scenario, logged=log.watch)


def content(path: Path, name: str) -> dict[int, bytes]:
    memory = FlashMemory(KINDS[CHIPS[name]], path)
    logs = logs_of(memory)
    memory.close()
    return logs


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled([NOR, NAND], NOR))
def test_the_log_on_the_chip_is_the_flight(built: Built, tmp_path: Path, name: str) -> None:
    chip = tmp_path / "chip.bin"
    trace = fly(built(name), chip)
    logs = content(chip, name)
    assert list(logs) == [1]
    path = tmp_path / "log.bbl"
    path.write_bytes(logs[1])
    log = read_log(path)
    assert log.ended and log.lost == 0
    save_trace(tmp_path / "flown.npz", trace)
    assert_log_is_trace(log, tmp_path / "flown.npz")


@pytest.mark.slow
@pytest.mark.parametrize("name", [NOR, NAND])
def test_logs_are_listed_fetched_and_erased_over_msp(
    built: Built, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    image, chip, got = built(name), tmp_path / "chip.bin", tmp_path / "got"
    got.mkdir()
    for seconds in (0.2, 0.3):
        fly(image, chip, seconds)
    logs = content(chip, name)
    assert list(logs) == [1, 2]
    board = Running(image, "--card", str(chip))
    try:
        port = ["--port", f"serial:{board.port}:{board.baud}"]
        assert main(["board", "logs", "fetch", "--all", "--out", str(got), *port]) == 0
        assert [(got / f"LOG0000{i}.BBL").read_bytes() for i in (1, 2)] == list(logs.values())
        capsys.readouterr()
        assert main(["board", "logs", "erase", "--copies", str(got), "--yes", *port]) == 0
        assert main(["board", "logs", "list", *port]) == 0
        assert "no log is kept there" in capsys.readouterr().out
    finally:
        board.end()
    assert content(chip, name) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", [NOR, NAND])
def test_a_log_is_there_up_to_its_last_page_when_the_power_goes_in_flight(
    built: Built, tmp_path: Path, name: str
) -> None:
    """The board starts anew with the supply: what it then finds is the log up to the page that was torn."""
    image, chip = built(name), FlashChip(CHIPS[name])
    nand = chip.kind.nand
    chip.cut_at(16 if nand else 130)
    with contextlib.suppress(LinkError):
        fly(image, chip)
    logs = logs_of(chip.memory)
    payload, pages = (2042, 15) if nand else (250, 129)
    assert len(logs[1]) in ((pages - 1) * payload, pages * payload)
    path = tmp_path / "cut.bbl"
    path.write_bytes(logs[1])
    log = read_log(path)
    assert not log.ended
    assert len(log.columns["time"]) > 10
