"""`neuroflight board flash`: against the host program, a board in memory, and whatever is no board for it."""

from __future__ import annotations

import errno
import json
import os
import random
import re
import shutil
import signal
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from neuroflight.cli.main import main
from neuroflight.flash.image import update
from neuroflight.flash.image.files import Policy, read_images
from neuroflight.flash.image.messages import image_write
from neuroflight.flash.link.msp import Decoder, Message, encode
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.contract import FLASH_BANK_B, FLASH_BASE, IMAGE_LAYOUT, IMAGE_TAIL_BYTES
from neuroflight.toolchain.image.stamp import stamp
from neuroflight.toolchain.policy.check_stamp import RULES, stamp_document
from tests.flash.conftest import TcpServer
from tests.flash.conftest import reviving_host as reviving_host
from tests.flash.image.board_model import BoardModel, Fate, Setting, board_with
from tests.flash.image.conftest import board_images as board_images
from tests.flash.image.conftest import board_policy as board_policy
from tests.flash.image.conftest import host_file as host_file
from tests.flash.image.conftest import host_images as host_images
from tests.flash.image.conftest import policy_of_build, stamped
from tests.flash.peers import HostBoard

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., tuple[int, str, str]]
BANK_B = FLASH_BANK_B.address - FLASH_BASE


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a backup without a name goes."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def flash(capsys: pytest.CaptureFixture[str]) -> Run:
    """Give it an image, a port and more words behind `flash`: exit code, stdout, stderr."""

    def run(image: Path, port: str, *words: str) -> tuple[int, str, str]:
        code = main(["board", "flash", str(image), "--port", port, "--unchecked", *words])
        output = capsys.readouterr()
        assert output.err.count("\n") == (code != 0)
        return code, " ".join(output.out.split()), output.err

    return run


class ServedBoard:
    """A board in memory behind a TCP port; half a second passes with each request."""

    def __init__(self, board: BoardModel) -> None:
        self.board = board
        self._decoder = Decoder()
        self._server = TcpServer(self._answer)
        self.port = self._server.port

    def _answer(self, data: bytes) -> bytes:
        replies = b""
        for event in self._decoder.feed(data):
            if isinstance(event, Message):
                replies += encode(self.board.answer(event))
            busy = self.board.answers_from - self.board.now  # erasing, starting: here over at once
            self.board.advance(0.5 + max(0.0, busy))
        return replies

    def close(self) -> None:
        self._server.close()


@pytest.fixture
def serve(board_images: list[bytes], board_policy: Policy) -> Iterator[Callable[..., ServedBoard]]:
    """Serve a board that runs an older build."""
    served: list[ServedBoard] = []

    def start(**facts: Any) -> ServedBoard:
        old, policy = stamped(board_images[0], build=b"oldbuild"), policy_of_build(board_policy, b"oldbuild")
        served.append(ServedBoard(board_with(old, policy.data, **facts)))
        return served[-1]

    yield start
    for one in served:
        one.close()


@pytest.fixture
def nfi(board_image: Path) -> Path:
    """Both banks' images of a build."""
    return board_image.with_suffix(".nfi")


# --- The whole flow -------------------------------------------------------------------------------------
def test_the_image_is_written_switched_to_and_seen_to_run(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path, board_images: list[bytes], tmp_path: Path
) -> None:
    served = serve()
    code, out, _ = flash(nfi, served.port)
    assert code == 0
    assert "plan bank B: erase sector 6, write" in out
    assert "policy the image's own (aircraft nf1, sha256" in out and "erase slot B, write 24,8" in out
    assert "settings: all as they were done: the new image runs and has proven itself" in out
    assert served.board.running == 1 and served.board.banks[1].data == board_images[1]
    (backup,) = tmp_path.glob("neuroflight-settings-*.txt")
    assert backup.read_text().splitlines()[1:] == ["set deadband_us = 7", "set roll_expo = 1.0"]

    code, out, _ = flash(nfi, served.port)
    assert code == 0 and out.endswith(
        "the board runs this build already; --force writes it again: nothing was written"
    )
    assert served.board.erased == 1
    assert "came with the image that runs" in flash(nfi, served.port, "--force", "--keep-policy")[2]
    assert flash(nfi, served.port, "--force", "--no-backup")[0] == 0
    assert served.board.erased == 2 and served.board.running == 0
    assert len(list(tmp_path.glob("neuroflight-settings-*.txt"))) == 1


def test_an_image_for_another_aircraft_than_the_boards_is_written_only_when_that_is_meant(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path, tmp_path: Path
) -> None:
    digest = load_aircraft("nf1").sha256[:12]
    served = serve(aircraft=b"mine")
    code, out, err = flash(nfi, served.port)
    assert code == 1 and served.board.erased == 0
    told = f"aircraft nf1, digest {digest}; until now the board flew ANOTHER: mine"
    assert told in out
    assert "the board flies the aircraft 'mine', the image is for 'nf1'" in err
    assert "give --other-aircraft if that is meant; nothing was written" in err
    code, out, _ = flash(nfi, served.port, "--other-aircraft", "--no-backup")
    assert code == 0 and told in out and served.board.erased == 1


@pytest.mark.parametrize(
    ("pid", "words"),
    [
        (None, "PID NONE: where the policy must not fly on, the motors stop"),
        ("own", "PID of aircraft mine, digest abababababab: the policy's own"),
        ("other", "PID of aircraft mine, digest abababababab: NOT the one that the policy was trained on"),
        ("moved", "PID not known: the report.json of its build does not lie beside the image"),
    ],
)
def test_the_plan_tells_the_pid_of_the_image(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path, tmp_path: Path, pid: str | None, words: str
) -> None:
    served = serve()
    image, report = tmp_path / nfi.name, json.loads(nfi.with_name("report.json").read_text())
    shutil.copy(nfi, image)
    if pid is None:
        report["pid"] = None
    known = {"name": "mine", "sha256": "ab" * 32, "file": "/somewhere/mine.toml", "own": pid == "own"}
    if pid != "moved":
        image.with_name("report.json").write_text(json.dumps(report | {"aircraft": known}))
    out = flash(image, served.port, "--dry-run")[1]
    assert words in out
    assert f"aircraft nf1, digest {load_aircraft('nf1').sha256[:12]} PID" in out
    facts = json.loads(flash(image, served.port, "--dry-run", "--json")[1])["aircraft"]
    assert (facts["name"], facts["board"], facts["other"]) == ("nf1", "nf1", False)


def test_json_tells_board_image_plan_and_result(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path, tmp_path: Path
) -> None:
    served = serve()
    told = json.loads(flash(nfi, served.port, "--json", "--dry-run")[1])
    assert told["result"] == "dry run" and told["plan"]["bank"] == 1 and not told["plan"]["same_build"]
    assert served.board.erased == 0
    report = json.loads(nfi.with_name("report.json").read_text())["images"][1]
    assert (told["image"]["sha256"], told["image"]["build"]) == (report["sha256"], report["build"])
    served.board.of_new_image = {"deadband_us": Setting(0)}
    code, out, _ = flash(nfi, served.port, "--json", "--backup", str(tmp_path / "kept.txt"))
    told = json.loads(out)
    assert code == 0 and told["result"] == "kept" and told["backup"] == str(tmp_path / "kept.txt")
    assert told["settings"][0] == "put back as they were: deadband_us"
    told = json.loads(flash(nfi, served.port, "--json")[1])
    assert told["result"] == "same build"


@pytest.mark.parametrize(
    ("fate", "result"),
    [(Fate.CRASHES, "went back"), (Fate.POLICY_BAD, "policy bad"), (Fate.UNPROVEN, "unproven")],
)
def test_the_exit_code_is_1_when_the_new_image_is_no_good(
    flash: Run,
    serve: Callable[..., ServedBoard],
    nfi: Path,
    fate: Fate,
    result: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("neuroflight.flash.image.trial.WAIT_S", 1.0)
    served = serve(fate=fate)
    code, out, err = flash(nfi, served.port, "--json", "--no-backup")
    assert code == 1 and json.loads(out)["result"] == result
    assert err.startswith(f"neuroflight: {served.port}: the ")


def test_the_tool_says_that_the_board_went_back_when_the_host_program_cannot_run_it(
    flash: Run, reviving_host: HostBoard, host_file: Path, host_images: list[bytes], tmp_path: Path
) -> None:
    """It stands for bank A, whatever is switched to."""
    before = (tmp_path / "flash.bin").read_bytes()
    code, _, err = flash(host_file, reviving_host.port, "--no-backup")
    assert code == 1 and reviving_host.starts == 2
    assert "the board went back to bank A, version 0.1.0: the new image was not started" in err
    after = (tmp_path / "flash.bin").read_bytes()
    assert after[BANK_B:].startswith(host_images[1])
    slot_b = BANK_B + FLASH_BANK_B.size
    # All but bank B, slot B, the fault log, and bank A's marks: the old image gets a number before the new
    # one does.
    kept = [(0x0, 0xC000), (0x10000, BANK_B - IMAGE_TAIL_BYTES)]
    assert all(after[start:end] == before[start:end] for start, end in kept)
    policy = read_images(host_file).policy
    assert policy is not None and after[slot_b:].startswith(policy.blob(1))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_is_stopped_and_goes_on_where_it_was(
    flash: Run,
    reviving_host: HostBoard,
    host_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
) -> None:
    offsets: list[int] = []

    def write(offset: int, data: bytes) -> bytes:
        offsets.append(offset)
        if len(offsets) == 100:
            os.kill(os.getpid(), number)
        return image_write(offset, data)

    monkeypatch.setattr(update, "image_write", write)
    code, _, err = flash(host_file, reviving_host.port, "--no-backup")
    assert code == 128 + number
    by = "Ctrl-C" if number == signal.SIGINT else "SIGTERM"
    assert err.startswith(f"neuroflight: stopped by {by}: bank B has 5") and "goes on from there" in err
    stopped_at = offsets[-1]
    assert flash(host_file, reviving_host.port, "--no-backup")[0] == 1
    assert stopped_at <= offsets[100] <= stopped_at + 508


def test_the_board_is_left_running_when_no_reboot_is_asked_for(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path
) -> None:
    served = serve()
    code, out, _ = flash(nfi, served.port, "--no-reboot", "--no-backup")
    assert code == 0 and "the next boot starts the new image" in out
    assert served.board.running == 0 and served.board.banks[1].numbered and served.board.boots == 5


@pytest.mark.parametrize(
    "words", [["board", "flash", "--all"], ["flash", "--list"], ["flash", "--rom", "--force"]]
)
def test_what_does_not_go_together_is_refused(
    words: list[str], nfi: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--port", "/dev/ttyUSB99", str(nfi)])
    assert ended.value.code == 2 and "unrecognized arguments" in capsys.readouterr().err


def test_the_rom_takes_no_nfi(nfi: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["flash", "--port", "/dev/ttyUSB99", "--rom"]
    assert main([*words, str(nfi)]) == 1
    assert "expected an image: .elf, .hex or .bin" in capsys.readouterr().err
    assert main([*words, str(nfi.with_suffix(".hex")), "--verify-only"]) == 1
    assert "there is no such device" in capsys.readouterr().err


# --- Refusals: nothing is written -----------------------------------------------------------------------
@pytest.fixture
def refused(flash: Run, reviving_host: HostBoard, tmp_path: Path) -> Callable[..., str]:
    """Flash that onto the host program: the one line, its flash being as it was."""

    def run(image: Path, port: str = "") -> str:
        before = (tmp_path / "flash.bin").read_bytes()
        code, out, err = flash(image, port or reviving_host.port)
        assert code == 1 and out == "" and err.endswith("; nothing was written\n")
        assert (tmp_path / "flash.bin").read_bytes() == before
        assert not list(tmp_path.glob("neuroflight-settings-*"))
        return err

    return run


def test_an_image_or_elf_of_another_board_is_refused(
    refused: Callable[..., str], nfi: Path, board_image: Path, tmp_path: Path
) -> None:
    assert "it is built for the board MATEKF722, and " in refused(nfi)
    elf = Path(shutil.copy(board_image, tmp_path / "other.elf"))
    content = elf.read_bytes()
    names = re.finditer(b"MATEKF722\0", content)
    (at,) = [name.start() for name in names if content[name.start() - 28 :].startswith(b"NFIM")]
    elf.write_bytes(content[:at] + b"MAMBAF722".ljust(24, b"\0") + content[at + 24 :])
    assert "it is damaged" in refused(elf)
    stamp(board_image, pack(allocate(find_board("MAMBAF722"))), elf)
    assert "it is built for the board MAMBAF722, and " in refused(elf)


@pytest.mark.parametrize("suffix", [".nfi", ".elf", ".hex", ".bin"])
def test_a_file_is_refused_when_it_is_damaged(
    refused: Callable[..., str], board_image: Path, suffix: str, tmp_path: Path
) -> None:
    whole = board_image.with_suffix(suffix).read_bytes()
    path = tmp_path / f"image{suffix}"
    for content in (whole[:90_000], random.Random(1).randbytes(90_000), bytes(10 << 20), b""):
        path.write_bytes(content)
        refused(path)


def test_a_file_is_refused_when_it_is_of_an_older_layout_or_not_there(
    refused: Callable[..., str], host_images: list[bytes], board_policy: Policy, tmp_path: Path
) -> None:
    older = [stamped(image, layout=struct.pack("<H", 0)) for image in host_images]
    (tmp_path / "older.nfi").write_bytes(b"".join(older))
    assert f"its layout is 0, older than {IMAGE_LAYOUT}" in refused(tmp_path / "older.nfi")
    assert "No such file" in refused(tmp_path / "missing.nfi")
    (tmp_path / "a.nfi").write_bytes(host_images[0] + board_policy.data)
    assert "it holds the image for bank A alone and the board needs that for bank B" in refused(
        tmp_path / "a.nfi"
    )


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"armed": True}, "the motors are armed"),
        ({"battery_level": 2}, "the battery is low"),
        ({"firmware": "other"}, "Betaflight 0.1.0 on MATEKF722, expected Neuroflight"),
        ({"has_images": False}, "it is of an older layout"),
    ],
)
def test_a_board_is_refused_when_it_is_not_ready(
    flash: Run, serve: Callable[..., ServedBoard], nfi: Path, facts: dict[str, Any], words: str
) -> None:
    served = serve(**facts)
    code, _, err = flash(nfi, served.port)
    assert code == 1 and words in err and err.endswith("; nothing was written\n")
    assert served.board.erased == 0 and not served.board.header


def test_a_port_is_refused_when_no_board_of_ours_answers_there(
    refused: Callable[..., str],
    host_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    tcp_server: Callable[..., str],
    free_tcp_port: int,
) -> None:
    assert "nobody listens there" in refused(host_file, f"tcp:127.0.0.1:{free_tcp_port}")
    assert "there is no such device" in refused(host_file, "/dev/ttyUSB99")
    assert "is of no known form" in refused(host_file, "usb")
    assert "the other end closed the connection" in refused(host_file, tcp_server(lambda data: b"HANG UP"))
    garbage = tcp_server(lambda data: b"$GPGGA,092750.000,5321.6802,N\r\n")
    assert "bytes that are no MSP" in refused(host_file, garbage)
    for number, words in (
        (errno.EACCES, "permission denied"),
        (errno.EBUSY, "close the other program that has it open"),
    ):

        def fail(*_: object, number: int = number, **__: object) -> None:
            raise serial.SerialException(number, os.strerror(number))

        monkeypatch.setattr(serial, "Serial", fail)
        assert words in refused(host_file, "/dev/ttyUSB0")


def test_it_says_what_is_written_when_the_port_is_unplugged_meanwhile(
    flash: Run, reviving_host: HostBoard, host_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 0

    def write(offset: int, data: bytes) -> bytes:
        nonlocal count
        count += 1
        if count == 50:
            threading.Thread(target=reviving_host.interrupt).start()
        return image_write(offset, data)

    monkeypatch.setattr(update, "image_write", write)
    code, _, err = flash(host_file, reviving_host.port, "--no-backup")
    assert code == 1
    assert "bank B has " in err and "bank A was not written and stays" in err


# --- No policy that was not found fit to fly ------------------------------------------------------------
def checked_build(nfi: Path, folder: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a build's images whose report holds the stamp that a check gives, after an edit of it."""
    image = Path(shutil.copy(nfi, folder / nfi.name))
    report = json.loads(nfi.with_name("report.json").read_text())
    report["check"] = stamp_document(
        policy_sha256=report["policy"]["sha256"],
        aircraft="nf1",
        aircraft_sha256="a" * 64,
        fit=True,
        figures={"bars": [{"seen": 1.0}]},
    )
    edit(report)
    image.with_name("report.json").write_text(json.dumps(report))
    return image


def resealed(report: dict[str, Any], **words: Any) -> None:
    """Give a report the stamp of another check."""
    check = {key: value for key, value in report["check"].items() if key not in ("format", "rules", "seal")}
    figures = {"bars": check.pop("bars")}
    report["check"] = stamp_document(**{**check, **words}, figures=figures)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda report: report.update(check=None), "was not checked"),
        (lambda report: report.pop("check"), "is not told of"),
        (lambda report: resealed(report, fit=False), "is NOT fit to fly nf1"),
        (lambda report: resealed(report, policy_sha256="b" * 64), "was changed after its check"),
        (lambda report: report["check"].update(fit=True, rules=0), "it was changed after the check"),
        (lambda report: report["check"]["bars"][0].update(seen=0.5), "it was changed after the check"),
        (lambda report: report.update(check="fit"), "another format"),
    ],
)
def test_an_image_whose_policy_is_not_known_to_be_fit_is_not_written(
    serve: Callable[..., ServedBoard],
    nfi: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    edit: Callable[[dict[str, Any]], object],
    words: str,
) -> None:
    served = serve()
    image = checked_build(nfi, tmp_path, edit)
    assert main(["board", "flash", str(image), "--port", served.port, "--force"]) == 1
    err = capsys.readouterr().err
    assert words in err and "neuroflight policy check" in err and "or add --unchecked" in err
    assert err.count("\n") == 1 and err.endswith("nothing was written\n")
    assert served.board.erased == 0 and served.board.running == 0
    assert not list(tmp_path.glob("neuroflight-settings-*.txt"))
    assert main(["board", "flash", str(image), "--port", served.port, "--dry-run"]) == 0
    assert "UNCHECKED" in capsys.readouterr().out and served.board.erased == 0


def test_an_image_without_its_report_is_not_written(
    serve: Callable[..., ServedBoard], nfi: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    served = serve()
    image = Path(shutil.copy(nfi, tmp_path / nfi.name))
    assert main(["board", "flash", str(image), "--port", served.port]) == 1
    assert "is not known to be checked: cannot read" in capsys.readouterr().err
    assert served.board.erased == 0


def test_an_image_whose_policy_a_check_found_fit_is_written(
    serve: Callable[..., ServedBoard], nfi: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    served = serve()
    image = checked_build(nfi, tmp_path, lambda report: None)
    assert main(["board", "flash", str(image), "--port", served.port, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["check"] == f"fit to fly nf1, by rules {RULES}"
    assert served.board.running == 1


@pytest.mark.parametrize("word", ["firmware", "flash"])
def test_make_adds_no_unchecked_of_its_own(word: str) -> None:
    words = ["make", "-n", "-C", str(ROOT), word, "PORT=tcp:localhost:1", "POLICY=another.onnx"]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert ' build --target "MATEKF722"' in told and "unchecked" not in told
