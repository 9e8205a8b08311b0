"""`neuroflight board`: programs that talk to the image on an idle emulated board."""

from __future__ import annotations

import json
import re
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection
from yamspy import MSPy

from neuroflight.cli.image.emulated import on_board, parse_serials
from neuroflight.cli.main import main
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.board.fitted import image_lines
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.contract import FLASH_BYTES, Msp
from neuroflight.toolchain.files import claimed_file
from tests.forked import Forked

LIMIT_S = 60.0  # of a test that hangs


class Running:
    """The command as a program of its own."""

    def __init__(self, image: Path, *options: str) -> None:
        self.process = Forked("image", "emulate", "--image", str(image), *options)
        self.told = ""
        while "Ctrl-C" not in self.told:
            line = self.process.stdout.readline()
            if not line:
                raise AssertionError(self.process.communicate()[1])
            self.told += line
        found = re.search(r"^MSP +(\S+), (\d+) baud", self.told, re.MULTILINE)
        assert found is not None
        self.port, self.baud = found[1], int(found[2])

    def interrupt(self) -> tuple[int, str, str]:
        """Ctrl-C: exit code, what it said last, and on stderr."""
        self.process.send_signal(signal.SIGINT)
        out, errors = self.process.communicate(timeout=LIMIT_S)
        code = self.process.returncode
        assert code is not None
        return code, out, errors

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


@pytest.fixture
def image(board_image: Path) -> Path:
    """What is flashed."""
    return board_image.with_suffix(".bin")


@pytest.fixture
def start(image: Path) -> Iterator[Callable[..., Running]]:
    running: list[Running] = []

    def begin(*options: str) -> Running:
        running.append(Running(image, *options))
        return running[-1]

    yield begin
    for one in running:
        one.end()


@pytest.mark.slow
def test_settings_are_there_in_the_next_run_when_flash_is_kept(
    start: Callable[..., Running], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flash = tmp_path / "flash.bin"
    board = start("--serial=tcp", f"--flash={flash}")
    assert main(["board", "info", "--port", board.port]) == 0
    assert "MATEKF722" in capsys.readouterr().out
    with Client(open_transport(board.port)) as client:
        settings = Settings(client)
        settings.set("msp_baud", 921_600)
        settings.save()
        assert client.request(Msp.REBOOT, timeout=20.0) == b""
    code, out, errors = board.interrupt()
    assert (code, errors) == (0, "")
    assert re.fullmatch(r"\n\d+\.\d s on the board, resets: (none|software)\n", out)
    assert flash.stat().st_size == FLASH_BYTES

    board = start("--serial=tcp", f"--flash={flash}", "--baud=921600")
    assert board.baud == 921_600
    with Client(open_transport(board.port)) as client:
        assert Settings(client).get("msp_baud") == 921_600
        client.request(Msp.REBOOT)
        assert Settings(client).get("msp_baud") == 921_600, "the line stays"
    assert board.interrupt()[1].endswith("resets: software\n")


def test_yamspy_reads_who_and_how_it_is_when_it_opens_the_pseudo_terminal(
    start: Callable[..., Running],
) -> None:
    board = start()
    peer = MSPy(device="", logfilename=None, loglevel="WARNING")
    with serial.Serial(board.port, 115_200, timeout=5) as line:
        peer.conn = line
        peer.basic_info()
    assert peer.CONFIG["apiVersion"] == "1.47.0"
    assert peer.CONFIG["flightControllerIdentifier"] == "BTFL"
    assert peer.CONFIG["boardIdentifier"] == "S7X2"


def test_it_says_so_when_both_ends_run_at_different_speeds(start: Callable[..., Running]) -> None:
    board = start("--baud=921600", "--serial=tcp")
    host, port = board.port.split(":")[1:]
    with socket.create_connection((host, int(port)), LIMIT_S) as program:
        program.sendall(b"$M<\x00\x01\x01" * 10)
        words = board.process.stderr.readline()
    assert words.startswith("the board's line runs at 115139 baud, this end at 921600: ")
    assert board.interrupt()[0] == 0


@pytest.mark.slow
def test_uart3_is_a_second_port_when_it_was_set_so_and_refused_before(
    start: Callable[..., Running], image: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    flash = tmp_path / "flash.bin"
    options = ("--serial=tcp", "--serial=uart3=tcp", f"--flash={flash}")
    assert main(["image", "emulate", "--image", str(image), *options]) == 1
    errors = capfd.readouterr().err
    assert errors.startswith("neuroflight: --serial uart3: got a board whose UART3 is off, expected")
    assert errors.count("\n") == 1
    board = start(options[0], options[2])
    with Client(open_transport(board.port)) as client:
        settings = Settings(client)
        settings.set("uart3_function", 1)
        settings.set("uart3_baud", 921_600)
        settings.save()
    assert board.interrupt()[0] == 0
    board = start(*options)
    found = re.search(r"^UART3 +(\S+), 921600 baud", board.told, re.MULTILINE)
    assert found is not None
    with Client(open_transport(board.port)) as first, Client(open_transport(found[1])) as second:
        for _ in range(3):
            assert first.request(Msp.FC_VARIANT) == second.request(Msp.FC_VARIANT) == b"BTFL"
    assert board.interrupt()[0] == 0


def ask(debugger: socket.socket, packet: str) -> str:
    """GDB's remote protocol: a packet and the packet that comes back."""
    debugger.sendall(b"$%s#%02x" % (packet.encode(), sum(packet.encode()) % 256))
    data = b""
    while not re.search(rb"#..$", data):
        data += debugger.recv(4096)
    debugger.sendall(b"+")
    found = re.search(rb"\$(.*)#..$", data, re.DOTALL)
    assert found is not None
    return found[1].decode()


def test_a_debugger_stops_and_steps_the_firmware_when_it_comes(
    start: Callable[..., Running], board_symbols: dict[str, int]
) -> None:
    board = start("--gdb=0", "--serial=tcp")
    found = re.search(r"^gdb +127\.0\.0\.1:(\d+)", board.told, re.MULTILINE)
    assert found is not None
    place = board_symbols["background_step"] & ~1
    with socket.create_connection(("127.0.0.1", int(found[1])), LIMIT_S) as debugger:
        assert ask(debugger, f"Z0,{place:x},2") == "OK"
        assert ask(debugger, "c") == "S05"
        assert int.from_bytes(bytes.fromhex(ask(debugger, "pf")), "little") == place
        assert ask(debugger, "s") == "S05"
        assert int.from_bytes(bytes.fromhex(ask(debugger, "pf")), "little") in (place + 2, place + 4)
        assert ask(debugger, f"z0,{place:x},2") == "OK"
        assert ask(debugger, "D") == "OK"
    with Client(open_transport(board.port)) as client:
        assert client.request(Msp.FC_VARIANT) == b"BTFL"
    assert board.interrupt()[0] == 0


@pytest.fixture
def board_symbols(board_image: Path) -> dict[str, int]:
    """Addresses of the image's functions."""
    with board_image.open("rb") as file:
        table = ELFFile(file).get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        return {symbol.name: symbol["st_value"] for symbol in table.iter_symbols()}


def test_it_ends_when_interrupted_while_a_debugger_holds_the_firmware(start: Callable[..., Running]) -> None:
    board = start("--gdb=0")
    found = re.search(r"^gdb +127\.0\.0\.1:(\d+)", board.told, re.MULTILINE)
    assert found is not None
    with socket.create_connection(("127.0.0.1", int(found[1])), LIMIT_S) as debugger:
        assert ask(debugger, "?") == "S05"
        assert board.interrupt()[::2] == (0, "")


def test_it_ends_with_one_line_when_the_image_does_what_no_board_forgives(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / "zeros.bin"
    image.write_bytes(bytes(4096))
    assert main(["image", "emulate", "--image", str(image), "--serial=tcp", "--seconds=0.1"]) == 1
    errors = capfd.readouterr().err
    assert errors.startswith("neuroflight: ")
    assert errors.count("\n") == 1


def test_it_ends_by_itself_when_its_time_is_over(image: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["image", "emulate", "--image", str(image), "--seconds=0.05"]) == 0
    out, errors = capfd.readouterr()
    assert re.search(r"^MSP +/dev/", out, re.MULTILINE)
    assert re.search(r"^0\.\d s on the board, resets: none\n\Z", out, re.MULTILINE)
    assert errors == ""


def test_its_ports_and_its_end_are_lines_of_json_when_asked_for(
    image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["image", "emulate", "--image", str(image), "--seconds=0.01", "--serial=tcp", "--gdb=0", "--json"]
    assert main([*words, "--usb=0"]) == 0
    begun, ended = map(json.loads, capsys.readouterr().out.splitlines())
    assert begun["image"] == str(image) and begun["gdb"] > 0 and begun["usb"] > 0
    assert list(begun["ports"]) == ["msp"] and begun["ports"]["msp"]["port"].startswith("tcp:127.0.0.1:")
    assert ended["seconds"] >= 0.01 and ended["resets"] == []


def test_its_usb_connector_is_a_usbip_server_when_a_cable_is_plugged(
    start: Callable[..., Running], image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = start("--serial=tcp", "--usb=localhost:0")
    found = re.search(r"^USB +127\.0\.0\.1:(\d+), USB/IP", board.told, re.MULTILINE)
    assert found is not None
    with socket.create_connection(("127.0.0.1", int(found[1])), LIMIT_S) as program:
        program.sendall(b"\x01\x11\x80\x05\0\0\0\0")  # OP_REQ_DEVLIST
        told = b""
        while len(told) < 324:
            told += program.recv(4096)
    assert told[:12] == b"\x01\x11\x00\x05\0\0\0\0\0\0\0\x01"
    assert told[12 + 300 : 12 + 304] == b"\x04\x83\x57\x40"  # 0483:5740
    assert main(["image", "emulate", "--image", str(image), "--serial=tcp", f"--usb={found[1]}"]) == 1
    assert f"USB/IP port {found[1]}: " in capsys.readouterr().err
    assert board.interrupt()[0] == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--usb=0.0.0.0:3240"], "--usb: got '0.0.0.0:3240', expected a port of 0 to 65535"),
        (["--usb=70000"], "--usb: got '70000', expected a port of 0 to 65535"),
        (["--serial=udp"], "--serial: got 'udp', expected pty, tcp or tcp:PORT"),
        (["--serial=uart2=pty"], "--serial: got uart2, expected a serial port of MATEKF722: uart1 (msp) and"),
        (["--serial=uart9=pty"], "--serial: got 'uart9=pty', expected pty, tcp or tcp:PORT, for another"),
        (["--serial=pty", "--serial=tcp"], "--serial: got msp twice, expected each UART once"),
        (["--serial=pty", "--serial=uart1=tcp"], "--serial: uart1 is given twice on MATEKF722"),
        (["--serial=tcp:70000"], "--serial: got 'tcp:70000', expected pty, tcp or tcp:PORT"),
        (["--baud=0"], "--baud 0, expected 1 to 10000000"),
        (["--gdb=-1"], "--gdb -1, expected 0 to 65535"),
        (["--volts=99"], "--volts 99, expected 0 to 36 V"),
        (["--seconds=0"], "--seconds 0, expected a number above 0"),
        (["--image=nowhere.bin"], "nowhere.bin: No such file or directory; build it with `make firmware"),
        (["--image=large.bin"], "large.bin: 524289 bytes, expected an image of 1 to 524288; build it with"),
        (
            ["--flash=photo.jpg"],
            "photo.jpg: 5 bytes, expected the 524288 of a flash that this command has kept",
        ),
        (["--card=nowhere.img"], "card nowhere.img: there is no such file; make one with"),
        (["--card=photo.jpg"], "card photo.jpg: 5 bytes, expected a multiple of 512"),
        (["--card=no"], "card no: Is a directory; name an image that can be written"),
        (["--flash=zeros.bin"], "--flash zeros.bin: sector 7 is all zeros"),
        (["--flash=no/photo.jpg/flash.bin"], "--flash no/photo.jpg/flash.bin: "),
    ],
)
def test_it_says_what_is_wrong_when_the_user_errs(
    image: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "no").mkdir()
    (tmp_path / "zeros.bin").write_bytes(b"\xff" * (FLASH_BYTES - 0x20000) + bytes(0x20000))
    (tmp_path / "large.bin").write_bytes(bytes(FLASH_BYTES + 1))
    for name in ("photo.jpg", "no/photo.jpg"):
        (tmp_path / name).write_bytes(b"photo")
    given = [] if options[0].startswith("--image") else ["--image", str(image)]
    assert (
        main(
            ["image", "emulate", *given, *options, *([] if "seconds" in options[0] else ["--seconds=0.001"])]
        )
        == 1
    )
    errors = capsys.readouterr().err
    assert words in errors
    assert errors.count("\n") == 1
    assert (tmp_path / "photo.jpg").read_bytes() == b"photo"


def test_a_second_board_is_refused_when_the_first_keeps_the_same_flash(
    image: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flash = tmp_path / "flash.bin"
    words = ["image", "emulate", "--image", str(image), f"--flash={flash}", "--seconds=0.001"]
    with claimed_file(flash, "board"):
        assert main(words) == 1
    errors = capsys.readouterr().err
    assert errors.startswith(f"neuroflight: {flash} is in use by another board; wait for its end")
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    assert main(words) == 0
    assert [item.name for item in tmp_path.iterdir()] == ["flash.bin"]


@pytest.mark.parametrize(
    ("board", "texts", "purposes"),
    [
        ("MATEKF722", ("tcp", "uart3=pty"), ["msp", "second"]),
        ("STELLARF7V2", ("uart3=tcp", "tcp"), ["msp", "second"]),
        ("STELLARF7V2", ("uart2=tcp",), ["msp"]),
    ],
)
def test_serial_ports_are_those_of_the_images_board(
    board: str, texts: tuple[str, ...], purposes: list[str]
) -> None:
    lines = image_lines(b"", find_board(board))
    assert list(on_board(parse_serials(texts), lines, board)) == purposes


def test_a_board_without_a_uart_for_msp_is_reached_by_usb_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chip = tmp_path / "chip.bin"
    chip.write_bytes(b"\1" + b"\xff" * (FLASH_BYTES - 1))
    words = ["image", "emulate", "--chip", str(chip), "--board", "NBD_INFINITYAIO"]
    assert main(words) == 1
    assert "NBD_INFINITYAIO has no UART for MSP, only USB; add --usb" in capsys.readouterr().err
    assert main([*words, "--serial", "tcp"]) == 1
    assert "--serial: got msp, expected a serial port of NBD_INFINITYAIO" in capsys.readouterr().err
