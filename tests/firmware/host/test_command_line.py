"""The command line over TCP at the host program: a peer types, hangs up, pastes."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import SETTINGS, Msp
from tests.firmware.command_line.test_settings import legal

Start = Callable[..., Any]
WAIT_S = 5.0
LAST_WORDS_S = 0.05  # between a restart's last reply and the end of the connection
API_REQUEST, API_REPLY = b"$M<\x00\x01\x01", b"$M>\x03\x01\x00\x01\x2f\x2c"


def read_until(peer: socket.socket, end: bytes) -> str:
    said = b""
    while not said.endswith(end):
        more = peer.recv(4096)
        assert more, said
        said += more
    return said.decode()


def typed(peer: socket.socket, line: str, end: str = "\r\n# ") -> str:
    """What a line is answered."""
    peer.sendall(line.encode() + b"\r")
    return read_until(peer, end.encode()).removeprefix(line + "\r\n").removesuffix(end)


def opened(p: Any) -> socket.socket:
    peer: socket.socket = p.connect()
    peer.sendall(b"#")
    assert "CLI" in read_until(peer, b"\r\n# ")
    return peer


def settings_of(p: Any) -> list[float | str]:
    with Client(open_transport(f"tcp:127.0.0.1:{p.ports['msp']}")) as client:
        asked = [client.request(Msp.SETTING_GET, requests.setting_index(i)) for i in range(len(SETTINGS))]
    return [requests.setting_value(told) for told in asked]


def shuffle(p: Any, seed: int) -> None:
    """40 settings to legal values."""
    rng = random.Random(seed)
    chosen = rng.sample(
        [index for index, setting in enumerate(SETTINGS) if setting.name != "rates_style"], 40
    )
    with Client(open_transport(f"tcp:127.0.0.1:{p.ports['msp']}")) as client:
        for index in chosen:
            setting = SETTINGS[index]
            value = legal(setting, rng, betaflight=False)
            client.request(Msp.SETTING_SET, requests.setting_set(index, value, kind=setting.kind))


def test_a_pasted_listing_gives_identical_settings_there_and_back(start: Start) -> None:
    changed, other = start(), start()
    shuffle(changed, seed=7)
    before, wanted = settings_of(other), settings_of(changed)
    assert wanted != before
    with opened(changed) as here, opened(other) as there:
        text, back = typed(here, "diff all"), typed(there, "diff all")
        there.sendall(text.encode() + b"\r\n# end of it\r")
        assert "ERROR" not in read_until(there, b"# end of it\r\n# ")
        assert settings_of(other) == wanted
        assert typed(there, "diff all") == text
        there.sendall(back.encode() + b"\r\n# end of it\r")
        read_until(there, b"# end of it\r\n# ")
        assert settings_of(other) == before


def test_msp_is_answered_when_a_peer_hung_up_in_the_command_line(start: Start) -> None:
    p = start()
    with opened(p) as peer:
        peer.sendall(b"set craft_na")
    for _ in range(2):
        with p.connect() as peer:
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY


def test_the_other_peer_is_served_while_one_types(start: Start) -> None:
    p = start()
    with opened(p) as peer, p.connect() as other:
        peer.sendall(b"vers")
        assert peer.recv(100) == b"vers"
        other.sendall(API_REQUEST)
        assert other.recv(100) == API_REPLY
        peer.sendall(b"ion\r")
        assert "Neuroflight 0.1.0 on HOST" in read_until(peer, b"\r\n# ")


def test_a_paste_far_larger_than_any_buffer_is_carried_out_whole(start: Start) -> None:
    p = start()
    with opened(p) as peer:
        peer.sendall(b"dump\r" * 20 + b"set craft_name = LAST\r# done\r")
        said = read_until(peer, b"# done\r\n# ")
        assert said.count("set gyro_rate_hz = 4000") == 20
        assert "ERROR" not in said
        assert typed(peer, "diff") == "set craft_name = LAST"


def test_what_is_saved_is_there_after_the_restart(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    p = start(option)
    with opened(p) as peer:
        typed(peer, "set motor_protocol = dshot300")
        assert typed(peer, "save", end="Rebooting\r\n") == "saved\r\n"
        assert p.process.wait(WAIT_S) == 0
    with opened(start(option)) as peer:
        assert typed(peer, "diff") == "set motor_protocol = dshot300"


def test_exit_ends_the_program_and_stores_nothing(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    p = start(option)
    with opened(p) as peer:
        typed(peer, "set motor_protocol = dshot300")
        typed(peer, "exit", end="Rebooting\r\n")
        assert p.process.wait(WAIT_S) == 0
    with opened(start(option)) as peer:
        assert typed(peer, "diff") == "# ", "nothing but the prompt"


def test_the_connection_outlives_the_last_word_when_the_program_starts_anew(start: Start) -> None:
    program = start()
    with opened(program) as peer:
        begun = time.monotonic()
        peer.sendall(b"save\r")
        assert "Rebooting\r\n" in read_until(peer, b"Rebooting\r\n")
        while peer.recv(100):
            pass
        assert time.monotonic() - begun >= LAST_WORDS_S
    assert program.process.wait(WAIT_S) == 0
