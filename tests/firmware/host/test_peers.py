"""msp_tcp.c alone: which peer is which port, when one is reset, what waits for a peer that is not reading."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cffi import FFI

from neuroflight.toolchain import contract

FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
MUCH = 16 << 20  # bytes: more than a connection holds
TURNS_MAX = 100_000
WAIT_MS = 5000  # how long an event may take before the test fails


class Peers:
    """The listening end, whose turns a test takes."""

    def __init__(self, library: Path) -> None:
        ffi = FFI()
        ffi.cdef(
            "unsigned peers_open(void); int peers_turn(int); void peers_say(size_t);"
            "const char *peers_notes(void); void peers_close(void);"
        )
        self._ffi, self._lib = ffi, ffi.dlopen(str(library))
        self.port = self._lib.peers_open()
        assert self.port

    def turn(self) -> list[str]:
        """What happened in the next turn that something is ready for."""
        assert self._lib.peers_turn(WAIT_MS) > 0
        return self.notes()

    def notes(self) -> list[str]:
        return bytes(self._ffi.string(self._lib.peers_notes())).decode().splitlines()

    @property
    def rests(self) -> bool:
        """Whether nothing is ready."""
        return bool(self._lib.peers_turn(0) == 0)

    def settle(self) -> list[str]:
        """What happens until nothing is ready."""
        seen: list[str] = []
        for _ in range(TURNS_MAX):
            if self.rests:
                return seen
            seen += self.notes()
        raise AssertionError("something is ready for ever")

    def say(self, count: int) -> None:
        self._lib.peers_say(count)

    def call(self) -> socket.socket:
        """A client, which has been seen or is about to be."""
        return socket.create_connection(("127.0.0.1", self.port), WAIT_MS / 1000)

    def close(self) -> None:
        self._lib.peers_close()


@pytest.fixture(scope="module")
def library(scripted_build: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """peers.c with msp_tcp.c."""
    made = tmp_path_factory.mktemp("peers") / "peers.so"
    includes = [f"-I{path}" for path in (FIRMWARE, FIRMWARE / "src", scripted_build.parent / "generated")]
    sources = [str(Path(__file__).with_name("peers.c")), str(FIRMWARE / "hal" / "host" / "msp_tcp.c")]
    flags = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]
    subprocess.run(["gcc", *flags, *includes, *sources, "-o", str(made)], check=True)
    return made


@pytest.fixture
def peers(library: Path) -> Iterator[Any]:
    made = Peers(library)
    yield made
    made.close()


def test_a_port_is_reset_at_once_when_its_peer_hangs_up(peers: Any) -> None:
    first, second = peers.call(), peers.call()
    assert (peers.turn(), peers.turn()) == (["reset 0"], ["reset 1"])
    first.close()
    assert peers.turn() == ["reset 0"]
    second.sendall(b"here")
    assert peers.turn() == ["heard 1 here"]
    third = peers.call()
    assert peers.turn() == ["reset 0"]
    third.sendall(b"new")
    assert peers.turn() == ["heard 0 new"]
    assert (third.recv(9), second.recv(9)) == (b"n", b"h")
    second.close()
    assert peers.turn() == ["reset 1"]
    third.close()
    assert peers.turn() == ["reset 0"]


def test_what_a_peer_sent_is_heard_before_its_port_is_reset_when_it_hangs_up(peers: Any) -> None:
    peer = peers.call()
    peers.turn()
    peer.sendall(b"bye")
    peer.close()
    assert peers.turn() == ["heard 0 bye"]
    assert peers.turn() == ["reset 0"]


def test_a_port_is_reset_when_its_peer_is_cut_off_while_words_wait_for_it(peers: Any) -> None:
    peer = peers.call()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")  # its end is a reset
    peers.turn()
    peers.say(MUCH)
    assert peers.settle() == []
    peer.close()
    assert peers.turn() == ["reset 0"]
    assert peers.rests


def test_a_fourth_caller_is_hung_up_and_no_port_reset_when_three_are_there(peers: Any) -> None:
    callers = [peers.call() for _ in range(contract.MSP_PORT_COUNT)]
    for _ in callers:
        peers.turn()
    with peers.call() as fourth:
        assert peers.turn() == []
        assert fourth.recv(9) == b""
    for caller in callers:
        caller.close()


def test_a_peer_that_does_not_read_holds_up_nobody_and_loses_nothing_when_it_reads_at_last(
    peers: Any,
) -> None:
    deaf, other = peers.call(), peers.call()
    peers.turn(), peers.turn()
    peers.say(MUCH)
    deaf.sendall(b"request")
    heard = peers.settle()  # no turns are taken for it in vain
    other.sendall(b"mine")
    heard += peers.turn()
    assert "heard 1 mine" in heard
    assert other.recv(9) == b"m"
    told = b""
    while len(told) <= MUCH:
        told += deaf.recv(1 << 20)
        heard += peers.settle()
    assert heard.count("heard 0 request") == 1
    assert (told.count(b"u"), told.count(b"r")) == (MUCH, 1)
    deaf.close()
    other.close()
