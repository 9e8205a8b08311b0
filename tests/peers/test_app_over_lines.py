"""What the Betaflight app asks as it connects and opens each tab, of the image on the emulated board: the
same over UART1 and over USB."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuroflight.toolchain.contract import Msp
from tests.firmware.host.app import App
from tests.firmware.host.test_app_tabs import CONNECTED, HANDSHAKE, REFUSED, TABS
from tests.peers.conftest import board_port
from tests.sampling import sampled

ON_THE_CHIP = {12300: 11}  # bytes of what names the processor


@pytest.fixture(params=sampled(["uart", "usb"], "uart"))
def app(request: pytest.FixtureRequest, board_image: Path, tmp_path: Path) -> Iterator[App]:
    """The app's requests on that line."""
    with board_port(board_image.with_suffix(".bin"), request.param, tmp_path) as (port, _):
        one = App(port)
        with contextlib.closing(one.client):
            yield one


def test_the_app_connects_opens_every_tab_and_keeps_arming_locked(app: App) -> None:
    for command, size in (HANDSHAKE | CONNECTED).items():
        assert len(app.ask(command)) == size, command
    assert app.ask(2) == b"BTFL" and app.get(4)["board_name"].startswith("Neuroflight ")
    assert app.ask(99, b"\1\0") == b""
    assert app.ask(Msp.STATUS_EX)[6:] and app.refused(88)
    for tab, asked in TABS.items():
        for command, wanted in asked.items():
            if wanted is None:
                assert app.refused(command), (tab, command)
            else:
                assert len(app.ask(command)) == ON_THE_CHIP.get(command, wanted), (tab, command)
    for command in REFUSED:
        assert app.refused(command), command
