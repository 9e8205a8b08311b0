"""Boards among this computer's devices: which port a command takes, and what it says where it cannot choose.

USB devices are folders here, as Linux' sysfs has them (its Documentation/ABI/stable/sysfs-bus-usb).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from neuroflight.cli.board.dfu import find_rescue_port
from neuroflight.cli.main import main
from neuroflight.cli.options import PORT_VARIABLE, find_port
from neuroflight.flash.link.transport import line_baud
from neuroflight.flash.rom import dfu_board
from neuroflight.flash.usb import devices
from neuroflight.toolchain.errors import LinkError

Plug = Callable[..., Path]


@pytest.fixture
def plug(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plug:
    """A computer with nothing on its USB; it plugs a serial port in and returns its device."""
    ports: list[ListPortInfo] = []
    links = tmp_path / "by-id"
    links.mkdir()
    monkeypatch.setattr(list_ports, "comports", lambda: list(ports))
    monkeypatch.setattr(devices, "LINKS", links)
    monkeypatch.setattr(devices, "DEVICES", tmp_path / "devices")
    monkeypatch.setattr(devices, "NODES", tmp_path / "nodes")
    monkeypatch.delenv(PORT_VARIABLE, raising=False)

    def add(
        name: str, ids: tuple[int, int] | None, maker: str = "", product: str = "", link: str = ""
    ) -> Path:
        device = tmp_path / name
        device.touch()
        info = ListPortInfo(str(device))
        if ids is not None:
            info.vid, info.pid = ids
            info.manufacturer, info.product, info.serial_number = maker, product, "3457AF01"
            info.apply_usb_info()
        ports.append(info)
        if link:
            (links / link).symlink_to(device)
        return device

    return add


def usb(folder: Path, ids: str, number: int, **texts: str) -> Path:
    """Make a USB device as sysfs has it, and its node; return the node."""
    vendor, product = ids.split(":")
    place = folder / "devices" / f"1-{number}"
    place.mkdir(parents=True)
    facts = {"idVendor": vendor, "idProduct": product, "busnum": "1", "devnum": str(number), **texts}
    for name, text in facts.items():
        (place / name).write_text(f"{text}\n")
    (folder / "devices" / f"1-{number}:1.0").mkdir()  # its interface, which has none of these
    node = folder / "nodes" / "001" / f"{number:03}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return node


def test_the_only_board_is_taken_by_the_link_that_outlasts_a_restart(plug: Plug, tmp_path: Path) -> None:
    plug("ttyS0", None)
    plug("ttyUSB0", (0x0403, 0x6001), "FTDI", "FT232R USB UART", "usb-FTDI")
    plug("ttyACM0", (0x0483, 0x5740), "Betaflight", "Betaflight STM32F7x2", "usb-Betaflight")
    plug("ttyACM1", (0x0483, 0x5740), "Neuroflight", "MATEKF722", "usb-Neuroflight_MATEKF722_3457AF01-if00")
    assert find_port() == str(tmp_path / "by-id" / "usb-Neuroflight_MATEKF722_3457AF01-if00")


def test_a_board_without_a_link_is_taken_by_its_name(plug: Plug) -> None:
    board = plug("ttyACM0", (0x0483, 0x5740), "Neuroflight", "MATEKF722")
    assert find_port() == str(board)


def test_several_boards_are_named_and_none_is_taken(plug: Plug) -> None:
    plug("ttyUSB0", (0x0403, 0x6001), "FTDI")
    one = plug("ttyACM0", (0x0483, 0x5740), "Neuroflight", "MATEKF722")
    two = plug("ttyACM1", (0x0483, 0x5740), "Neuroflight", "MATEKF722")
    with pytest.raises(LinkError, match=f"got several: {one}, {two}; name one with --port"):
        find_port()


def test_without_a_board_the_only_adapter_is_taken(plug: Plug) -> None:
    plug("ttyS0", None)
    adapter = plug("ttyUSB0", (0x0403, 0x6001), "FTDI")
    assert find_port() == str(adapter)


def test_betaflight_and_an_adapter_are_several(plug: Plug) -> None:
    plug("ttyUSB0", (0x0403, 0x6001), "FTDI")
    plug("ttyACM0", (0x0483, 0x5740), "Betaflight", "Betaflight STM32F7x2")
    with pytest.raises(LinkError, match=r"got several: .*ttyACM0, .*ttyUSB0;"):
        find_port()


def test_a_rescue_without_a_board_tells_of_the_button(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dfu_board, "dfu_places", tuple)
    with pytest.raises(LinkError, match=r"no USB serial device is there; .*hold BOOT while you plug it in"):
        find_rescue_port()


@pytest.mark.parametrize(
    ("ids", "maker", "hint"),
    [
        (
            "0483:df11",
            "STMicroelectronics",
            "waits in the boot loader of its ROM: `neuroflight board rescue`",
        ),
        ("0483:5720", "Neuroflight", "shows its card as a disk: eject that and plug the board in anew"),
        ("0483:5720", "Somebody", ""),
        ("046d:c52b", "Logitech", ""),
    ],
)
def test_a_board_that_is_no_serial_port_is_told(
    plug: Plug, tmp_path: Path, ids: str, maker: str, hint: str
) -> None:
    usb(tmp_path, ids, 7, manufacturer=maker)
    with pytest.raises(LinkError, match="no USB serial device is there") as refused:
        find_port()
    assert (hint in str(refused.value)) and ("a board" in str(refused.value)) == bool(hint)


def test_the_doctor_finds_boards_and_mends_their_permissions(
    plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    board = plug("ttyACM0", (0x0483, 0x5740), "Neuroflight", "MATEKF722")
    loader = usb(tmp_path, "0483:df11", 7, manufacturer="STMicroelectronics")
    disk = usb(tmp_path, "0483:5720", 8, manufacturer="Neuroflight")
    assert main(["doctor"]) == 0
    told = capsys.readouterr().out
    assert f"+ {board}: a board with Neuroflight, MATEKF722" in told
    assert f"+ {loader}: in the boot loader of its ROM" in told and f"+ {disk}: shows its card" in told

    closed = {str(board), str(loader)}
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) not in closed)
    assert main(["doctor"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    mend = "neuroflight doctor --udev | sudo tee /etc/udev/rules.d/45-neuroflight.rules"
    assert f"- {board}: this user may not open it: {mend}" in told
    assert f"- {loader}: in the boot loader of its ROM; this user may not open it: {mend}" in told


def test_usb_has_no_baud_rate(tmp_path: Path) -> None:
    link = tmp_path / "usb-Neuroflight_MATEKF722-if00"
    link.symlink_to("/dev/ttyACM7")
    assert [line_baud(text) for text in (str(link), "/dev/ttyACM0", "tcp:127.0.0.1:5761")] == [None] * 3
    assert line_baud("serial:/dev/ttyUSB0:921600") == 921600


def test_the_rules_name_each_state_of_a_board(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--udev"]) == 0
    rules = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("#")]
    products = [rule.split('idProduct}=="')[1][:4] for rule in rules]
    assert products == ["5740", "5720", "df11"] and all('TAG+="uaccess"' in rule for rule in rules)
    assert [rule.startswith('SUBSYSTEM=="tty"') for rule in rules] == [True, False, False]
