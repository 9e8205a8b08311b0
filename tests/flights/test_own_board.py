"""A board that no table knows, from its own `dump hardware` to a flight of its image on an emulated one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.trace import load_trace
from neuroflight.toolchain.boards.facts import GyroPlace, Pin, Uart
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.files import locked
from neuroflight.toolchain.image.build import build
from tests.conftest import BUILD, ROOT, SHIPPED
from tests.toolchain.boards.betaflight import dump

NAME = "OF-MY-OWN"
SCENARIO = "[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [60, -40, 30]\nthrottle = 0.4\n"


@pytest.mark.slow
def test_a_board_from_its_own_dump_flies_the_librarys_bits(
    reference_library: Path,
    board_image: Path,  # whose objects are the same
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its gyro is the second one, on the underside and another SPI; motors and receiver sit elsewhere."""
    known = find_board("MATEKF722SE")
    board = replace(
        known,
        name=NAME,
        gyros=(*known.gyros[:1], GyroPlace(2, Pin("B", 12), Pin("B", 10), 5)),
        osd=None,
        motors=tuple(map(Pin.of, ("PC8", "PA15", "PB0", "PB1"))),
        uarts={**known.uarts, 3: Uart(None, Pin("B", 11))},
    )
    text, target = tmp_path / "dump.txt", tmp_path / "mine.toml"
    text.write_text(dump(board) + "set gyro_to_use = SECOND\nserial 3 64 115200 57600 0 115200\n")
    words = [str(text), "--gyro", "icm42688p", "--out", str(target)]
    assert main(["board", "target", "import", *words]) == 0
    with locked(BUILD / "own-board"):
        build(str(target), SHIPPED, ROOT, BUILD, pid_table(load_aircraft("nf1")))
    scenario = tmp_path / "turn.toml"
    scenario.write_text(SCENARIO)
    traces = []
    for on, folder in (("board", BUILD / NAME), ("library", reference_library.parent)):
        path = tmp_path / f"{on}.npz"
        flight = ["--scenario", str(scenario), "--build", str(folder), "--trace", str(path), "--json"]
        assert main(["fly", "--on", on, *flight]) == 0
        traces.append(load_trace(path))
    capsys.readouterr()
    assert traces[0].same(traces[1])
