"""`neuroflight board stream` of the host program in flight, and of peers that lose, spoil or end it."""

from __future__ import annotations

import contextlib
import csv
import fcntl
import io
import json
import os
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode, reply, request
from neuroflight.flash.monitoring import stream as streaming
from neuroflight.flash.monitoring.recording import Shape, columns, row, times
from neuroflight.flash.monitoring.stream import Sample, Stream, decode_sample
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.lockstep import (
    BOOT_SAMPLES,
    GYRO_HZ,
    LINK_SAMPLES,
    STICKS_DOWN,
    SWITCH_ON,
    THROTTLE_UP,
    Host,
)
from tests.flash.peers import Run, answering
from tests.forked import Forked

Lines = Callable[[list[bytes | None]], Any]
Serve = Callable[..., str]


# --- The host program ------------------------------------------------------------------------
def test_each_sample_is_in_the_file_when_the_host_program_streams(
    msp: Run, host: Host, tmp_path: Path
) -> None:
    host.fly(LINK_SAMPLES, THROTTLE_UP)
    out = tmp_path / "flight.csv"
    with host.flying(THROTTLE_UP):
        code, told, _ = msp(
            host.port, "stream", "--rate", "500", "--seconds", "0.5", "--out", str(out), "--json"
        )
    assert code == 0
    facts = json.loads(told)
    assert (facts["rate_hz"], facts["control_rate_hz"], facts["corrupt"]) == (500, GYRO_HZ, 0)
    rows = list(csv.DictReader(out.open()))
    assert len(rows) == facts["received"] > 1
    assert facts["received"] + facts["lost"] == int(rows[-1]["sequence"]) - int(rows[0]["sequence"]) + 1
    steps = np.array([int(row["step"]) for row in rows])
    assert (np.diff(steps) % 2 == 0).all()  # each second control step, none between two
    assert steps[-1] - steps[0] >= 0.5 * GYRO_HZ
    assert float(rows[-1]["t_s"]) == pytest.approx((steps[-1] - steps[0]) / GYRO_HZ, abs=1e-6)
    assert {row["state"] for row in rows} <= {"BOOT", "CALIBRATING", "DISARMED"}
    assert {(row["armed"], row["throttle"]) for row in rows} == {("0", rows[0]["throttle"])}
    assert float(rows[0]["throttle"]) == pytest.approx(0.8, abs=0.01)
    assert {name for name in rows[0] if name.startswith("motor")} == {f"motor{n}_dshot" for n in range(1, 5)}
    assert [name for name in rows[0] if name.startswith("ob")] == [f"observation{n}" for n in range(1, 28)]
    assert not list(tmp_path.glob(".*"))


def test_an_npz_holds_what_a_trace_holds_when_asked_for(msp: Run, host: Host, tmp_path: Path) -> None:
    host.fly(BOOT_SAMPLES, STICKS_DOWN)
    out = tmp_path / "flight.npz"
    with host.flying(SWITCH_ON):
        code, told, _ = msp(host.port, "stream", "--rate", "130", "--seconds", "0.2", "--out", str(out))
    assert code == 0
    assert f"{out}: " in told and "125 Hz (asked for 130)" in told
    with np.load(out) as archive:
        found = {name: archive[name] for name in archive.files}
    count = len(found["t"])
    assert found["received"] == count > 0
    shapes = {"setpoint": (count, 3), "gyro": (count, 3), "throttle": (count,), "dshot": (count, 4)}
    shapes |= {"observation": (count, 27), "action": (count, 4), "armed": (count,), "step": (count,)}
    assert {name: found[name].shape for name in shapes} == shapes
    assert found["rate_hz"] == 125
    assert found["armed"][-1] and found["state"][-1] == "ARMED"
    assert np.isfinite(found["observation"][-1]).all() and np.isfinite(found["action"][-1]).all()
    assert np.diff(found["t"]) == pytest.approx(np.diff(found["step"].astype(int)) / GYRO_HZ)
    assert len(str(found["policy_sha256"])) == 64


def test_lines_come_on_stdout_when_there_is_neither_file_nor_terminal(msp: Run, host: Host) -> None:
    with host.flying(THROTTLE_UP):
        code, out, err = msp(host.port, "stream", "--rate", "100", "--seconds", "0.1")
        as_json = msp(host.port, "stream", "--rate", "100", "--seconds", "0.1", "--json")[1]
    assert (code, err) == (0, "")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert len(rows) >= 2
    assert all(None not in row and None not in row.values() for row in rows)
    samples = [json.loads(line) for line in as_json.splitlines()]
    assert len(samples) >= 2
    assert len(samples[0]["gyro"]) == 3


def test_a_terminal_shows_the_newest_sample_in_a_table_that_is_drawn_over(host: Host) -> None:
    host.fly(BOOT_SAMPLES, STICKS_DOWN)
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 40, 120, 0, 0))
    words = ["board", "stream", "--port", host.port, "--rate", "100", "--seconds", "0.4"]
    command = [sys.executable, "-m", "neuroflight.cli.main", *words]
    shown = b""
    with (
        host.flying(SWITCH_ON),
        subprocess.Popen(command, stdout=theirs, env=os.environ | {"TERM": "xterm"}) as process,
    ):
        os.close(theirs)
        with contextlib.suppress(OSError):  # the terminal's end, once nobody writes to it any more
            while piece := os.read(ours, 4096):
                shown += piece
        assert process.wait(timeout=10) == 0
    os.close(ours)
    text = shown.decode()
    assert "\x1b[" in text and text.count("control step") >= 2  # drawn more than once, over itself
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    last = plain[plain.rindex("control step") :]
    assert re.search(r"state +armed, armed", last) and re.search(r"flies +policy", last)
    assert re.search(r"setpoint( +-?[0-9]+\.[0-9]){3} +deg/s roll, pitch, yaw", last)
    assert re.search(r"gyro( +-?[0-9]+\.[0-9]){3} +deg/s", last)
    motors = re.search(r"motors((?: +[0-9]+){4}) +DShot", last)
    assert motors and all(48 <= int(value) <= 2047 for value in motors[1].split())
    summary = plain.strip().splitlines()[-1]
    found = re.fullmatch(r"([0-9]+) samples, [0-9.]+ s, 100 Hz, [0-9]+ lost.*", summary)
    assert found and int(found[1]) > 10


def test_what_was_received_is_kept_when_it_is_interrupted(
    host: Host, tmp_path: Path, pty_line: Callable[..., str]
) -> None:
    """Ctrl-C, as the terminal sends it, while samples go by on a serial line."""
    out, pieces, seen = tmp_path / "flight.csv", [], threading.Event()

    def up(data: bytes) -> bytes:
        pieces.append(data)
        if b"".join(pieces).count(b"$X>\0\x41\x4e") > 20:
            seen.set()
        return data

    words = ("--port", pty_line(host.port, up=up), "--rate", "250", "--out", str(out))
    with host.flying(THROTTLE_UP):
        process = Forked("board", "stream", *words)
        assert seen.wait(20)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=20)
        assert process.returncode == 0
    assert said.startswith(f"{out}: ") and " lost" in said
    rows = list(csv.DictReader(out.open()))
    assert len(rows) > 10
    # The stream was ended: its last frame came before the reply to that.
    assert b"".join(pieces).endswith(encode(reply(request(Msp.STREAM), b"\0\0")))


def test_one_line_says_why_when_no_sample_comes(
    msp: Run, resting_host: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(streaming, "SILENCE_S", 0.2)
    out = tmp_path / "flight.csv"
    code, told, err = msp(resting_host, "stream", "--out", str(out))
    assert (code, told) == (1, "")
    assert "no sample came for 0.2 s, expected 100 a second; check that the firmware gets gyro samples" in err
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--rate", "0"], "--rate got 0, expected 1 to 500 Hz"),
        (["--rate", "501"], "--rate got 501, expected 1 to 500 Hz"),
        (["--seconds", "0"], "--seconds got 0, expected more than 0"),
        (["--seconds", "nan"], "--seconds got nan, expected more than 0"),
        (["--out", "flight.txt"], "expected a name that ends in .csv or .npz"),
    ],
)
def test_a_mistake_is_told_before_anything_is_asked_for(
    msp: Run, resting_host: str, words: list[str], told: str
) -> None:
    err = msp.refused(resting_host, "stream", *words)
    assert told in err


# --- Scripted peers --------------------------------------------------------------------------
def record(sequence: int, step: int, motors: int = 4) -> bytes:
    head = struct.pack("<HIIBB7f", sequence & 0xFFFF, step, 12_345, 3, 3, 1, 2, 3, 4, 5, 6, 0.5)
    head += struct.pack(f"<B{motors}H", motors, *range(100, 100 + motors))
    return head + struct.pack("<B2f", 2, 0.25, -0.25) + struct.pack("<Bf", 1, 0.75)


def frame(sequence: int, step: int) -> bytes:
    return encode(Message(Version.V2, Direction.REPLY, Msp.STREAM_SAMPLE, record(sequence, step)))


def begun(client: Client) -> Stream:
    """At 100 Hz, of a firmware with 1000 control steps a second."""
    stream = Stream(client, 100, 1000)
    stream.begin()
    return stream


GRANTED = encode(reply(request(Msp.STREAM), b"\x64\x00"))
ENDED = encode(reply(request(Msp.STREAM), bytes(2)))


def test_a_sample_is_read_field_by_field_when_it_comes() -> None:
    assert decode_sample(record(7, 99)) == Sample(
        *(7, 99, 12_345, "ARMED", True, True, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5),
        *((100, 101, 102, 103), (0.25, -0.25), (0.75,)),
    )
    shape = Shape(4, 3, 1)
    assert len(columns(shape)) == 7 + 6 + 1 + 4 + 3 + 1
    cells = row(decode_sample(record(7, 99)), 0.5, shape)
    assert dict(zip(columns(shape), cells, strict=True))["observation3"] == ""
    assert (cells[0], cells[-1]) == ("0.500000", "0.75")


@pytest.mark.parametrize("length", [0, 5, 42, 43, 50, 60, len(record(0, 0)) - 1])
def test_a_sample_that_is_cut_short_is_refused_in_one_line(length: int) -> None:
    with pytest.raises(LinkError, match=f"a streamed sample has {length} bytes and another layout") as caught:
        decode_sample(record(0, 0)[:length])
    assert "\n" not in str(caught.value)


def test_gaps_are_counted_by_the_sequence_when_it_wraps(scripted_line: Lines) -> None:
    numbers = [65_533, 65_534, 2, 3, 7]  # 65535, 0, 1 lost, then 4, 5, 6
    steps = [2**32 - 20 + 10 * (n + (65_536 if n < 10 else 0) - 65_533) for n in numbers]
    frames = [frame(n, step % 2**32) for n, step in zip(numbers, steps, strict=True)]
    line = scripted_line([GRANTED, *frames])
    stream = begun(Client(line, clock=line.clock))
    payloads = list(stream.payloads(seconds=0.1))
    assert len(payloads) == stream.received == 5
    assert stream.lost == 6
    assert stream.flown_s == pytest.approx(0.1)
    seconds = times([decode_sample(payload) for payload in payloads], 1000)
    assert seconds.tolist() == pytest.approx([0, 0.01, 0.05, 0.06, 0.1])


def test_samples_are_taken_when_the_reply_comes_behind_some_of_them(scripted_line: Lines) -> None:
    line = scripted_line([frame(0, 0) + frame(1, 10) + GRANTED[:4], GRANTED[4:] + frame(2, 20)])
    stream = begun(Client(line, clock=line.clock))
    assert [decode_sample(p).sequence for p in stream.payloads(0.02)] == [0, 1, 2]


def test_a_damaged_sample_is_a_lost_one(scripted_line: Lines) -> None:
    damaged = bytearray(frame(1, 10))
    damaged[30] ^= 0x40
    line = scripted_line([GRANTED, frame(0, 0) + bytes(damaged) + frame(2, 20)])
    client = Client(line, clock=line.clock)
    stream = begun(client)
    assert [decode_sample(p).sequence for p in stream.payloads(0.02)] == [0, 2]
    assert (stream.lost, client.corrupt) == (1, 1)


@pytest.mark.parametrize("late", [b"", GRANTED], ids=["in order", "its beginning cut short"])
def test_the_stream_is_ended_when_it_is_stopped(scripted_line: Lines, late: bytes) -> None:
    line = scripted_line([GRANTED, frame(0, 0) + (late or ENDED), ENDED])
    begun(Client(line, clock=line.clock)).stop()
    events = Decoder().feed(b"".join(line.written))
    asked = [event for event in events if isinstance(event, Message)]
    assert [(one.command, one.payload) for one in asked] == [
        (Msp.STREAM, b"\x64\x00"),
        *[(Msp.STREAM, b"\x00\x00")] * (2 if late else 1),
    ]


def test_what_came_is_kept_when_the_line_dies(
    msp: Run, tcp_server: Serve, tmp_path: Path, host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The peer streams three samples and hangs up."""
    out, through = tmp_path / "flight.csv", answering({}, through=host.port)
    told = [GRANTED + frame(0, 0) + frame(1, 10) + frame(2, 20), b"HANG UP"]

    def answer(data: bytes) -> bytes:
        (asked,) = (event for event in Decoder().feed(data) if isinstance(event, Message))
        return told.pop(0) if asked.command == Msp.STREAM else through(data)

    monkeypatch.setattr(streaming, "SILENCE_S", 0.2)
    code, _, err = msp(tcp_server(answer), "stream", "--out", str(out))
    assert code == 1
    assert "no sample came for 0.2 s" in err
    assert len(list(csv.DictReader(out.open()))) == 3


def test_one_line_says_so_when_the_firmware_has_no_stream(msp: Run, tcp_server: Serve) -> None:
    err = msp.refused(tcp_server(answering({Msp.API_VERSION: b"\x00\x01\x2e"})), "stream")
    assert "the firmware refuses MSP POLICY_INFO" in err
