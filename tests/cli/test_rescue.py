"""`neuroflight board rescue`, and `neuroflight image emulate --boot0 --chip` on whose port it works."""

from __future__ import annotations

import json
import re
import signal
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import neuroflight.flash.rom.rescue
from neuroflight.cli.main import main
from neuroflight.flash.rom.segments import read_segments
from neuroflight.sim.board.serial.bridge import TcpEnd
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BASE,
    FLASH_BYTES,
    FLASH_POLICY_SLOTS,
    IMAGE_HEADER_FORMAT,
    IMAGE_HEADER_OFFSET,
    IMAGE_LAYOUT,
    IMAGE_MAGIC,
    image_checksum,
    image_field_offset,
)
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.conftest import scripted_blob
from tests.flash.rom.conftest import BOOT, SLOT_B, Served, flash_with
from tests.forked import Forked

FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))
LIMIT_S = 60.0  # of a test that hangs


def small_image(board: bytes = b"MATEKF722") -> bytes:
    """Flash with a boot part that waits for ever and a bank that is whole."""
    bank = bytearray(IMAGE_HEADER_OFFSET + 96)
    policy = scripted_blob()
    asks = (policy.architecture_hash, policy.filters_hash, 1000, 2, 17, 4)
    told = (IMAGE_MAGIC, IMAGE_LAYOUT, 0, 0, len(bank), 0, b"\0\1\0\0", b"abcdefgh", board, *asks)
    struct.pack_into(IMAGE_HEADER_FORMAT, bank, IMAGE_HEADER_OFFSET, *told)
    struct.pack_into("<I", bank, image_field_offset("crc"), image_checksum(bank))
    before = BOOT.ljust(FLASH_POLICY_SLOTS[0].address - FLASH_BASE, b"\xff")
    before += pack(replace(policy, build=b"abcdefgh"))
    return before.ljust(FLASH_BANK_A.address - FLASH_BASE, b"\xff") + bytes(bank)


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "small.bin"
    path.write_bytes(small_image())
    return path


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """Chips in their ROM behind TCP."""
    served = []

    def make(content: bytes = b"") -> Served:
        served.append(Served(TcpEnd(), content))
        return served[-1]

    yield make
    for one in served:
        one.close()


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that the command ends in, with exit code 1."""
    assert main(["board", "rescue", "--unchecked", *map(str, arguments)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Traceback" not in error
    return error


def test_it_tells_the_plan_writes_compares_and_starts(
    serve: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chip = serve(FULL)
    assert main(["board", "rescue", "--unchecked", str(image), "--port", chip.end.name]) == 0
    told = capsys.readouterr().out
    assert "MATEKF722 0.1.0, build 6162636465666768, bank A" in told
    erased = "sector 0 (boot part); sector 4 (policy slot); sector 5 (bank A); sector 7 (policy slot)"
    assert f"erase  {erased}\n" in told
    assert "sector 1 (settings); sector 2 (settings); sector 3 (fault log); sector 6 (bank B)" in told
    assert "safety propellers off" in told
    assert "1,528 bytes written and read back equal" in told
    assert "start  the image runs; let BOOT go" in told
    chip.stop()
    under = bytearray(FULL)
    under[:0x4000] = b"\xff" * 0x4000
    under[0x10000:0x40000] = b"\xff" * 0x30000
    under[0x60000:] = b"\xff" * 0x20000
    assert chip.idle.flash() == flash_with((*read_segments(image), SLOT_B), bytes(under))
    assert not chip.idle.board.hardware.rom.runs


@pytest.mark.parametrize("option", ["--dry-run", "--verify-only"])
def test_nothing_is_written_when_it_only_looks(
    serve: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    chip = serve(flash_with((*read_segments(image), SLOT_B), FULL))
    words = ["board", "rescue", "--unchecked", str(image), "--all", "--port", chip.end.name, option]
    assert main([*words, "--json"]) == 0
    result = "nothing written" if option == "--dry-run" else "equal"
    assert json.loads(capsys.readouterr().out)["result"] == result
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "nothing was written" in told and "sector 6 (bank B)" in told.partition("keep")[0]
    chip.stop()
    assert chip.idle.flash() == flash_with((*read_segments(image), SLOT_B), FULL)
    assert chip.idle.board.hardware.flash.operations == 0
    assert chip.idle.board.hardware.rom.runs


def test_a_difference_is_an_error_when_only_compared(
    serve: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chip = serve(FULL)
    assert "differ from the image, the first at 0x08000000" in refusal(
        capsys, image, "--port", chip.end.name, "--verify-only"
    )


def test_ctrl_c_says_that_the_image_is_not_whole(
    serve: Callable[..., Served],
    image: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(neuroflight.flash.rom.rescue, "verify", stop)
    chip = serve(FULL)
    assert "stopped by Ctrl-C before the image was whole" in refusal(capsys, image, "--port", chip.end.name)


def test_one_line_says_what_was_not_written_when_it_cannot(
    tmp_path: Path, image: Path, host_program: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.bin"
    other.write_bytes(small_image(b""))
    host = tmp_path / "host.elf"
    host.write_bytes(host_program.read_bytes())
    random = tmp_path / "random.hex"
    random.write_bytes(FULL)
    huge = tmp_path / "huge.bin"
    with huge.open("wb") as file:
        file.truncate(10 << 20)
    port = ("--port", "/dev/does-not-exist")
    for arguments, said in (
        ((image, *port), "there is no such device"),
        ((image, "--port", "serial:/dev/ttyUSB9:921600"), "expected 1200 to 115200"),
        ((image, "--port", "tcp:127.0.0.1:1"), "nobody listens there"),
        ((other, *port), f"{other}: the image for bank A names no board"),
        ((host, *port), "expected one of 32 bits for ARM"),
        ((random, *port), "got no record of Intel HEX"),
        ((huge, *port), "got 10485760 bytes, expected an image of 1 to 524288"),
        ((tmp_path / "none.hex", *port), "No such file"),
    ):
        assert said in refusal(capsys, *arguments)


def test_a_peer_that_is_no_boot_loader_is_left_alone(
    image: Path, host_program: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    end = TcpEnd()  # lets it in and never answers
    try:
        assert "nobody answers" in refusal(capsys, image, "--port", end.name)
    finally:
        end.close()


# --- neuroflight board ---------------------------------------------------------------------------
@pytest.mark.slow
def test_a_chip_holds_in_the_next_run_what_was_written_through_its_rom(
    image: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chip = tmp_path / "chip.bin"
    assert main(["image", "emulate", "--chip", str(chip), "--seconds", "0.01"]) == 1
    assert "the chip is erased where its boot part should be" in capsys.readouterr().err
    board = Forked("image", "emulate", "--boot0", "--serial=tcp", "--chip", str(chip))
    try:
        told = ""
        while "Ctrl-C" not in told:
            line = board.stdout.readline()
            assert line
            told += line
        found = re.search(r"^ROM +(\S+), 115200 baud; neuroflight board rescue IMAGE", told, re.MULTILINE)
        assert found is not None
        assert chip.read_bytes() == b"\xff" * FLASH_BYTES
        assert main(["board", "rescue", "--unchecked", str(image), "--port", found[1]]) == 0
        board.send_signal(signal.SIGINT)
        board.communicate(timeout=LIMIT_S)
        assert board.returncode == 0
    finally:
        board.kill()
    assert chip.read_bytes() == flash_with((*read_segments(image), SLOT_B))
    capsys.readouterr()
    assert main(["image", "emulate", "--chip", str(chip), "--serial=tcp", "--seconds", "0.01"]) == 0
    assert "resets: none" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--chip", "a.bin", "--flash", "b.bin"], "leave one out"),
        (["--boot0", "--serial", "uart3=tcp"], "on UART1 only"),
    ],
)
def test_options_of_a_board_are_refused_when_they_exclude_each_other(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main(["image", "emulate", *arguments]) == 1
    assert said in capsys.readouterr().err


def test_an_image_whose_policy_is_not_known_to_be_fit_is_not_written(
    serve: Callable[..., Served], image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chip = serve(FULL)
    for words in (["board", "rescue", str(image)], ["flash", "--rom", str(image)]):
        assert main([*words, "--port", chip.end.name]) == 1
        err = capsys.readouterr().err
        assert "is not known to be checked" in err and "or add --unchecked" in err
        assert err.endswith("nothing was written\n")
    assert main(["board", "rescue", str(image), "--port", chip.end.name, "--dry-run"]) == 0
    assert "check  UNCHECKED" in capsys.readouterr().out
    chip.stop()
    assert chip.idle.flash() == FULL
    assert chip.idle.board.hardware.flash.operations == 0
