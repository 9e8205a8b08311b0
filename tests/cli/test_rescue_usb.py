"""`neuroflight board rescue` and `flash` on an emulated chip in its ROM, by pyusb over USB/IP."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import usb.backend.libusb1

from neuroflight.cli.board import rescue
from neuroflight.cli.main import main
from neuroflight.cli.options import PORT_VARIABLE
from neuroflight.flash.rom import dfu_board
from neuroflight.flash.rom.segments import read_segments
from neuroflight.toolchain.contract import FLASH_BYTES
from tests.cli.test_rescue import small_image
from tests.flash.rom.conftest import SLOT_B, Served, flash_with
from tests.peers.usb_computer import plug
from tests.sampling import sampled

FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "small.bin"
    path.write_bytes(small_image())
    return path


@pytest.fixture
def chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Served]]:
    """A chip in its ROM at this computer's only cable."""
    served = []
    monkeypatch.setattr(dfu_board, "WAIT_S", 0.0)  # the image that is written comes back by no USB
    monkeypatch.delenv(PORT_VARIABLE, raising=False)

    def make(content: bytes = FULL) -> Served:
        served.append(Served(None, content))
        plug(served[-1].usb_port, tmp_path / "links", monkeypatch.setattr)
        return served[-1]

    yield make
    for one in served:
        one.close()


@pytest.mark.parametrize("words", sampled([["board", "rescue"], ["board", "flash"]], ["board", "flash"]))
def test_it_finds_the_board_tells_the_plan_writes_compares_and_starts(
    chip: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    board = chip()
    assert main([*words, "--unchecked", str(image)]) == 0
    told, err = capsys.readouterr()
    assert "--port dfu:1-2, the only board in the USB boot loader of its ROM" in err
    assert "chip   0x452, boot loader in its ROM, on dfu:1-2\n" in told and "takes  about 6 s by USB" in told
    assert "safety propellers off" in told and "1,528 bytes written and read back equal\n" in told
    board.stop()
    under = bytearray(FULL)
    under[:0x4000] = b"\xff" * 0x4000
    under[0x10000:0x40000] = b"\xff" * 0x30000
    under[0x60000:] = b"\xff" * 0x20000
    assert board.idle.flash() == flash_with((*read_segments(image), SLOT_B), bytes(under))
    board.idle.board.run(0.02)
    assert not board.idle.board.hardware.rom.runs


@pytest.mark.parametrize(
    ("words", "result"),
    [
        (["rescue", "--dry-run"], "nothing written"),
        (["rescue", "--verify-only"], "equal"),
        (["flash", "--dry-run"], "nothing written"),
    ],
)
def test_nothing_is_written_when_it_only_looks(
    chip: Callable[..., Served],
    image: Path,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    result: str,
) -> None:
    board = chip(flash_with((*read_segments(image), SLOT_B), FULL))
    assert main(["board", *words, str(image), "--port", "dfu", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["result"] == result
    board.stop()
    assert board.idle.board.hardware.flash.operations == 0
    assert board.idle.board.hardware.rom.runs


def test_one_line_says_what_is_not_done(
    chip: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    board = chip()
    other = tmp_path / "other.bin"
    other.write_bytes(small_image(b""))
    for words, said in (
        (["rescue", "--unchecked", image, "--port", "dfu:3-4"], "there are dfu:1-2"),
        (["rescue", "--unchecked", other, "--port", "dfu"], "names no board"),
        (["rescue", image, "--port", "dfu"], "is not known to be checked"),
        (["flash", image, "--port", "dfu"], "is not known to be checked"),
        (["flash", image, "--port", "dfu", "--keep-policy"], "--keep-policy: got it for a board without"),
        (["info"], "a board waits in the boot loader"),
    ):
        assert main(["board", *map(str, words)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "Traceback" not in err
        assert said in err or words == ["info"]
    board.stop()
    assert board.idle.flash() == FULL and board.idle.board.hardware.flash.operations == 0


def test_one_line_says_how_to_get_libusb_where_there_is_none(
    image: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("libusb0", "libusb1", "openusb"):
        monkeypatch.setattr(f"usb.backend.{name}.get_backend", lambda find_library=None: None)
    assert usb.backend.libusb1.get_backend() is None
    assert main(["board", "rescue", "--unchecked", str(image), "--port", "dfu"]) == 1
    err = capsys.readouterr().err
    assert "no libusb on this computer" in err and "libusb-1.0-0" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("running", "said"),
    [
        (
            dfu_board.Running(False, "Betaflight 4.5.1 on SPEEDYBEEF7V3", ("SPEEDYBEEF7V3",)),
            "and the image is for a MATEKF722",
        ),
        (dfu_board.Running(False, "Betaflight 4.5.1 on MATEKF722", ("MATEKF722", "STM32F7X2")), "give --yes"),
    ],
)
def test_a_firmware_of_another_make_is_replaced_on_the_right_board_and_if_wanted(
    image: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    running: dfu_board.Running,
    said: str,
) -> None:
    """Nothing is asked of it: its ROM is not entered."""

    class Quiet:
        name, closed = "serial:/dev/ttyACM0:115200", False

        def close(self) -> None:
            self.closed = True

    client = Quiet()
    monkeypatch.setattr(dfu_board, "runs_firmware", lambda port: True)
    monkeypatch.setattr(dfu_board, "read_running", lambda client: running)
    monkeypatch.setattr(rescue, "connect", lambda port: client)
    assert main(["board", "rescue", "--unchecked", str(image), "--port", "/dev/ttyACM0"]) == 1
    err = capsys.readouterr().err
    assert said in err and "nothing was written" in err and err.count("\n") == 1
    assert client.closed
