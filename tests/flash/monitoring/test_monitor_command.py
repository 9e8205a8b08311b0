"""`neuroflight board monitor`: one frame as text, JSON, and the live screen in a terminal."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from neuroflight.cli.board.monitor_view import OLD, view
from neuroflight.cli.main import main
from neuroflight.flash.board.hints import HINTS
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.monitoring.watch import Sight, Watch
from tests.flash.lockstep import Lockstep, lockstep

DRAWN_S = 60.0  # until what a screen of 20 Hz has to show is there, on a busy machine


def drawn(sight: Sight, width: int, height: int) -> list[str]:
    """The rows of a terminal of that size."""
    console = Console(width=width, height=height, file=io.StringIO(), record=True, force_terminal=True)
    console.print(view(sight, "/dev/ttyUSB0", 5.0, width, height), height=height)
    return console.export_text().splitlines()


@pytest.fixture
def sight(resting_host: str) -> Sight:
    """Of a firmware that a lot keeps from arming."""
    with Watch(lambda: open_transport(resting_host)) as watch:
        return watch.look()


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40), (200, 60)])
def test_every_panel_fits_the_terminal(sight: Sight, width: int, height: int) -> None:
    rows = drawn(sight, width, height)
    assert len(rows) == height and all(len(row) <= width for row in rows)
    text = "\n".join(rows)
    for word in ("state", "attitude and supply", "channels", "motors", "processor", "q ends"):
        assert word in text
    for word in ("boot", "nf1, good", "roll", "1 rear right", "4 front left", "control", "storage", "fault"):
        assert word in text
    assert "boot grace: " in text and ("more; see `board status`" in text or "battery unknown: " in text)
    assert ("aux12" in text) == (height >= 40)
    if width >= 200:
        assert "…" not in text


def test_more_reasons_are_told_in_whole_where_there_is_room(sight: Sight) -> None:
    text = "\n".join(drawn(sight, 200, 60))
    for name in ("GYRO_NOT_CALIBRATED", "SWITCH_NOT_CYCLED"):
        assert f"{name.lower().replace('_', ' ')}: {HINTS[name]}" in text


def test_what_is_old_is_said_to_be_when_nobody_answers(sight: Sight) -> None:
    lost = replace(sight, problem="/dev/ttyUSB0: the line is gone", silent_s=3.4)
    rows = drawn(lost, 80, 24)
    assert rows[-1].startswith("NO ANSWER for 3 s q ends; /dev/ttyUSB0: the line is gone")
    text = "\n".join(rows)
    assert all(f"{title} (old)" in text for title in ("state", "channels", "motors", "processor"))
    console = Console(width=80, height=24, file=io.StringIO(), record=True, force_terminal=True)
    console.print(view(lost, "/dev/ttyUSB0", 5.0, 80, 24), height=24)
    inside = console.export_text(styles=True).splitlines()[2:9]
    blue, grey = "34", re.findall(r"\x1b\[([\d;]+)m", OLD.render("x"))
    assert {code for row in inside for code in re.findall(r"\x1b\[([\d;]+)m", row)} <= {blue, *grey}


def test_names_that_a_board_tells_are_no_markup(sight: Sight) -> None:
    assert sight.snapshot is not None and sight.info is not None
    overview = sight.snapshot.overview
    assert overview.flight is not None
    flight = replace(overview.flight, policy="[/red]")
    snapshot = replace(sight.snapshot, overview=replace(overview, flight=flight))
    rows = drawn(replace(sight, snapshot=snapshot, info=replace(sight.info, name="[bold]")), 80, 24)
    assert "[bold]" in rows[0] and "[/red], good" in "\n".join(rows)


def test_one_frame_is_text_when_asked_for_once(resting_host: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "monitor", "--port", resting_host, "--once"]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and "…" not in out
    assert f"boot grace: {HINTS['BOOT_GRACE']}" in out and "aux12" in out and "4 front left" in out


def test_one_document_is_json_when_asked_for(resting_host: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "monitor", "--port", resting_host, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["overview"]["arming_reasons"]["NOT_LEVEL"] == HINTS["NOT_LEVEL"]
    assert told["info"]["board"]["target"] == "HOST" and told["channels_us"]["throttle"] == 1000
    assert told["motors_us"] == [1000] * 4 and told["link"]["corrupt"] == 0
    assert {row["task"] for row in told["tasks"]} >= {"CONTROL", "MSP"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--port", "/dev/does-not-exist"], "there is no such device"),
        (["--port", "tcp:127.0.0.1:1"], "nobody listens there"),
        (["--port", "tcp:127.0.0.1:1", "--rate", "0"], "--rate 0, expected 0.1 to 20 Hz"),
        (["--port", "tcp:127.0.0.1:1", "--rate", "nan"], "--rate nan"),
    ],
)
def test_one_line_says_what_is_wrong(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "monitor", *words, "--once"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and told in err


def test_one_line_says_so_when_the_device_is_someone_elses(
    tcp_server: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    port = tcp_server(lambda data: b"$GPGGA,123519,4807.038,N,01131.000,E,1,08\r\n")
    assert main(["board", "monitor", "--port", port, "--once"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "bytes that are no MSP" in err


def test_it_says_so_when_there_is_no_terminal(resting_host: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "monitor", "--port", resting_host]) == 1
    assert capsys.readouterr().err == "neuroflight: stdout is no terminal; give --once or --json\n"


class Screen:
    """The command in a terminal of its own; what it draws is read as it comes."""

    def __init__(self, port: str) -> None:
        self.ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
        words = ["board", "monitor", "--port", port, "--rate", "20"]
        command = [sys.executable, "-m", "neuroflight.cli.main", *words]
        env = os.environ | {"TERM": "xterm-256color", "COLUMNS": "", "LINES": ""}
        self.before = termios.tcgetattr(theirs)
        self.process = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, env=env, start_new_session=True
        )
        self.theirs = theirs

    def until(self, words: str) -> str:
        """Read until `words` have been drawn anew. Fails where the process ends first, and after DRAWN_S."""
        fresh, read = "", b""
        late = time.monotonic() + DRAWN_S
        while words not in fresh:
            assert time.monotonic() < late, fresh[-2000:]
            if select.select([self.ours], [], [], 1.0)[0]:
                read += os.read(self.ours, 65536)
            fresh = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", read.decode(errors="ignore"))
        return fresh

    def end(self, how: Callable[[], object]) -> tuple[int, str]:
        """Exit code and stderr; the terminal is as it was before."""
        how()
        with contextlib.ExitStack() as undo:
            drain = threading.Thread(target=self._drain, daemon=True)
            drain.start()
            _, err = self.process.communicate(timeout=20)
            after = termios.tcgetattr(self.theirs)
            undo.callback(os.close, self.theirs)
        assert after[3] == self.before[3], "echo and line mode are back"
        return self.process.returncode, err.decode()

    def _drain(self) -> None:
        with contextlib.suppress(OSError):
            while os.read(self.ours, 65536):
                pass


@contextmanager
def screen(port: str) -> Iterator[Screen]:
    one = Screen(port)
    try:
        yield one
    finally:
        if one.process.poll() is None:
            one.process.kill()
            one.process.communicate()


def test_the_screen_follows_the_firmware_until_ctrl_c(booted: Lockstep) -> None:
    with screen(booted.port) as one:
        one.until("disarmed")
        booted.sticks = {"arm": 2000}
        booted.run(20)
        one.until("armed  on the ground, policy flies")
        assert one.end(lambda: one.process.send_signal(signal.SIGINT)) == (0, "")


def test_the_screen_waits_for_a_firmware_that_is_gone_and_goes_on_when_it_is_back_until_q(
    host_program: Path, free_tcp_port: int, tmp_path: Path
) -> None:
    options: tuple[Any, ...] = (f"--settings={tmp_path / 'flash.bin'}", f"--msp-port={free_tcp_port}")
    with contextlib.ExitStack() as undo:
        with lockstep(host_program, *options) as first:
            one = undo.enter_context(screen(first.port))
            one.until("boot 1")
        one.until("NO ANSWER")
        with lockstep(host_program, *options):
            one.until("boot 2")
            assert "1 restarts, 1 reconnects" in one.until("reconnects")
            assert one.end(lambda: os.write(one.ours, b"q")) == (0, "")
