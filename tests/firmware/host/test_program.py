"""The host program over its real sockets: lockstep, starting and ending."""

from __future__ import annotations

import math
import os
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain import contract

WAIT_S = 5.0  # how long an answer may take before the test fails
Start = Callable[..., Any]


# --- Lockstep ---------------------------------------------------------------------------------
def test_each_state_packet_is_answered_once_when_it_is_good(start: Start) -> None:
    p = start("--gyro-hz=1000")
    for _ in range(50):
        assert p.step() == (0, 0, 0, 0)
    assert [p.last_trace()[1] for _ in range(50)] == list(range(50))
    assert p.silent()


def test_packets_are_answered_in_order_when_they_come_in_a_burst(start: Start) -> None:
    p = start("--gyro-hz=1000")
    for _ in range(40):
        p.state()
    for _ in range(40):
        p.motors()
    assert [p.last_trace()[1] for _ in range(40)] == list(range(40))
    assert p.silent()


def test_malformed_packets_are_ignored_and_told_when_the_program_ends(start: Start) -> None:
    p = start("--gyro-hz=1000")
    for size in (0, 1, 143, 145, 256, 257, 2000):
        p.send("state", b"\x55" * size)
    for size in (0, 39, 41, 300):
        p.send("receiver", b"\x55" * size)
    p.send("power", b"\x55" * 23)
    assert p.silent()
    assert p.step() == (0, 0, 0, 0)
    assert "ignored 12 packets" in p.end()


def test_a_sample_is_the_one_before_when_a_rate_is_nan(start: Start) -> None:
    p = start("--gyro-hz=1000")
    p.step((1.0, 2.0, 3.0))
    before = p.last_trace()
    for rates in ((math.nan, 0, 0), (0, math.nan, 0), (0, 0, math.nan)):
        assert p.step(rates) == (0, 0, 0, 0)
        assert p.last_trace()[5:8] == before[5:8]
    assert "3 gyro samples were NaN" in p.end()


def test_trace_tells_the_control_step_when_it_is_asked_for(start: Start) -> None:
    p = start("--gyro-hz=4000")
    steps = contract.RECEIVER_RECOVERY_MS + 10  # then the receiver is believed
    for k in range(4 * steps):
        if k % 40 == 0:
            p.sticks(throttle=1250, roll=1600)
        p.step((0.5, -0.25, 0.125))
    traces = [p.last_trace() for _ in range(steps)]
    assert p.silent(), "one trace a control step"
    magic, step, *rates, throttle, motors, flags = traces[-1][:11]
    assert (magic, step, motors, flags) == (contract.SIM_TRACE_MAGIC, steps - 1, 4, 0)
    half_count = math.radians(2000) / 32768 / 2
    asked = 70 * 0.2 + (670 - 70) * 0.2**2  # deg/s at a fifth of the stick, by the default rates
    np.testing.assert_allclose(rates[:3], [math.radians(asked), 0, 0], rtol=1e-6)
    np.testing.assert_allclose(rates[3:], [0.5, 0.25, -0.125], atol=1.01 * half_count)
    assert throttle == pytest.approx(0.25)


def test_the_newest_sticks_are_flown_when_many_packets_wait_for_a_state(start: Start) -> None:
    p = start("--gyro-hz=1000")
    for k in range(contract.RECEIVER_RECOVERY_MS + 10):
        if k % 10 == 0:
            p.sticks()
        p.step()
        p.last_trace()
    for count in (2, 5, 30):  # 30 are more than the receiver's line holds
        for us in range(1000, 1000 + count):
            p.sticks(throttle=us)
        p.step()
        assert p.last_trace()[8] == pytest.approx((count - 1) / 1000)
        p.step()
        assert p.last_trace()[8] == pytest.approx((count - 1) / 1000), "nothing older may follow"


def test_no_trace_is_sent_when_nobody_asks(start: Start) -> None:
    p = start("--gyro-hz=1000", "--trace-port=0")
    for _ in range(5):
        p.step()
    assert p.silent()


def fly(p: Any, samples: int) -> bytes:
    """Boot, arm and fly random rates and sticks of a fixed seed; all that came back, as bytes."""
    rng = np.random.default_rng(21)
    got = b""
    for k in range(samples):
        flying = k >= 4200
        if k % 40 == 0:
            throttle = int(rng.integers(1000, 2000)) if k >= 4400 else 1000
            p.sticks(arm=2000 if flying else 1000, throttle=throttle, roll=int(rng.integers(1000, 2001)))
        got += struct.pack("<4f", *p.step(rng.normal(0, 2 if flying else 0.01, 3).tolist()))
        if k % 4 == 0:
            got += p.trace.recv(100)
    return got


def test_two_flights_are_the_same_bytes_when_their_packets_are(start: Start, host_program: Path) -> None:
    first, second = (fly(start(build=host_program.parent), 6000) for _ in range(2))
    assert first == second
    last = np.frombuffer(first[-16 * 3 :], "<f4")
    assert last.max() > 0, "it must have flown"


def test_pulse_widths_go_out_on_the_servo_port_when_motors_are_six(
    start: Start, hexacopter_build: Path
) -> None:
    p = start("--gyro-hz=1000", build=hexacopter_build)
    widths: list[float] = []
    for k in range(1200):
        p.sticks(arm=2000 if k >= 1100 else 1000, throttle=1500 if k >= 1150 else 1000)
        p.state()
        count, *widths = struct.unpack(contract.SIM_SERVO_FORMAT, p.servo.recv(100))
        assert count == 6
        assert widths[:6] == [1000] * 6 or k >= 1150
    np.testing.assert_allclose(widths, [1500] * 6 + [0] * 10, atol=0.3)
    assert not select.select([p.motor], [], [], 0)[0]


# --- Starting and ending ----------------------------------------------------------------------
def run(build: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(build / "neuroflight"), *options], capture_output=True, text=True, timeout=WAIT_S
    )


def test_help_names_every_option_when_asked(scripted_build: Path) -> None:
    done = run(scripted_build, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    for name in ("state", "receiver", "motor", "servo", "power", "trace", "msp"):
        assert f"--{name}-port" in done.stdout
    assert "--gyro-hz" in done.stdout and "--with-parent" in done.stdout


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--state-port=70000"], "--state-port got '70000'"),
        (["--msp-port=x"], "--msp-port got 'x'"),
        (["--msp-port="], "--msp-port got ''"),
        (["--motor-port=-1"], "--motor-port got '-1'"),
        (["--gyro-hz=1500", "--state-port=0", "--receiver-port=0", "--power-port=0", "--msp-port=0"], "1500"),
        (["--nonsense"], "--nonsense"),
        (["word"], "word"),
        (["--help", "word"], ""),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_1_when_given(
    scripted_build: Path, options: list[str], expected: str
) -> None:
    done = run(scripted_build, *options)
    if not expected:
        assert done.returncode == 0
        return
    assert (done.returncode, done.stdout) == (1, "")
    assert expected in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["state", "receiver", "power", "msp"])
def test_a_busy_port_is_one_line_and_exit_1_when_another_program_holds_it(
    start: Start, scripted_build: Path, name: str
) -> None:
    port = start().ports[name]
    free = [f"--{other}-port=0" for other in ("state", "receiver", "power", "msp") if other != name]
    done = run(scripted_build, f"--{name}-port={port}", *free)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert str(port) in done.stderr and f"--{name}-port" in done.stderr and "in use" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_0_when_it_is_told_to(start: Start, number: signal.Signals) -> None:
    p = start()
    assert p.end(number) == ""


def test_it_ends_when_its_parent_dies(scripted_build: Path) -> None:
    command = [str(scripted_build / "neuroflight"), "--with-parent"]
    command += [f"--{name}-port=0" for name in ("state", "receiver", "power", "msp")]
    parent_code = (
        "import subprocess, sys; p = subprocess.Popen(sys.argv[1:], stdout=subprocess.PIPE); "
        "p.stdout.readline(); print(p.pid, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", parent_code, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as parent:
        assert parent.stdout is not None
        child = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    try:
        assert select.select([child], [], [], WAIT_S)[0], "the child is still alive"
    finally:
        os.close(child)
