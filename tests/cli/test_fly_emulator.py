"""`neuroflight fly --on board` as a user types it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.fly import emulator as fly_emulator
from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.fly.fly import Fly
from neuroflight.cli.fly.options import STOPPED
from neuroflight.cli.main import main
from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import TcpPort, TcpTransport
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.source_places import Places
from neuroflight.sim.board.fitted import Lines
from neuroflight.sim.flight.trace import COLUMNS, Trace, load_trace
from neuroflight.toolchain.contract import FLASH_BASE, MSP_VARIANT_BETAFLIGHT, Msp
from tests.refusal import refused
from tests.sim.board.mutants.conftest import build_mutant as build_mutant
from tests.sim.board.mutants.conftest import workshop as workshop
from tests.sim.board.mutants.mutant import Mutant

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def fly(
    board_image: Path,
    host_program: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Command:
    """Flies a tenth of a second; exit code, stdout and stderr."""
    monkeypatch.setattr(fly_ports, "built_last", lambda: board_image.parent)
    monkeypatch.setattr(fly_ports, "BUILD", host_program.parent)
    scenario = tmp_path / "short.toml"
    scenario.write_text("[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [50, 0, 0]\n")

    def run(*arguments: str, on: str = "emulator") -> tuple[int, str, str]:
        code = main(["fly", "--on", on, "--scenario", str(scenario), *arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Callable[[int], None]], list[str]]]:
    """Runs a client in a thread of its own as soon as its TCP port is told; what was told."""
    told: list[str] = []
    threads: list[threading.Thread] = []

    def expect(run: Callable[[int], None]) -> list[str]:
        def say(words: str) -> None:
            told.append(words)
            found = re.search(r":(\d+)(?![\d.])", words)
            assert found is not None
            threads.append(threading.Thread(target=run, args=(int(found[1]),)))
            threads[-1].start()

        monkeypatch.setattr(fly_emulator, "say", say)
        return told

    yield expect
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()


def test_it_tells_of_the_image_and_writes_trace_and_profile_when_all_is_well(
    fly: Command, board_image: Path, tmp_path: Path
) -> None:
    trace, profile = tmp_path / "a.npz", tmp_path / "new" / "profile"
    code, out, _ = fly("--json", "--trace", str(trace), "--profile", str(profile))
    document = json.loads(out)
    told = document["emulator"]
    assert code == 0
    assert told["sha256"] == hashlib.sha256(board_image.with_suffix(".bin").read_bytes()).hexdigest()
    assert (told["outcome"], told["stopped_s"], told["resets"]) == ("flown, disarmed", None, ["power"])
    assert [event["what"] for event in told["events"]] == ["ARMED", "DISARMED: SWITCH"]
    assert told["events"][1]["at_s"] == pytest.approx(0.1, abs=0.01)
    assert told["board_s"] == pytest.approx(0.3 + 1.05 + 0.1, abs=0.2)
    assert told["instructions"] > 9e6 and told["real_time"] > 0
    assert 0 <= told["gyro_wait_us"] < 5
    assert 0.1 < told["watchdog_margin_s"] < 0.5
    assert len(load_trace(trace).t) == 100
    tasks, functions, coverage, registers, stacks, flame = (
        (profile / name).read_text()
        for name in (
            *("tasks.txt", "functions.txt", "coverage.txt", "registers.txt", "stacks.folded", "flame.svg"),
        )
    )
    assert "gyro_edge_handler" in tasks and "tick_handler" in tasks
    assert "policy_step" in functions and "SPI1_DR" in registers
    assert sum(int(line.rsplit(" ", 1)[1]) for line in stacks.splitlines()) == told["instructions"]
    assert any(line.startswith("linear8") and "100.0%" in line for line in coverage.splitlines())
    assert "gyro_sample_handler" in flame and flame.startswith("<svg")


@pytest.mark.slow
def test_it_flies_an_icm20689_when_one_is_fitted(fly: Command, tmp_path: Path) -> None:
    traces: list[Trace] = []
    for options in (("--gyro", "icm20689", "--set", "gyro_alignment=cw90"), ()):
        path = tmp_path / f"{len(traces)}.npz"
        assert fly(*options, "--trace", str(path))[0] == 0
        traces.append(load_trace(path))
    assert traces[0].same(traces[1])


@pytest.mark.slow
def test_a_card_that_fails_costs_no_control_step(fly: Command, tmp_path: Path) -> None:
    traces: list[Trace] = []
    card = tmp_path / "card.img"
    card.write_bytes(bytes(1 << 20))
    faults = (
        "card-stall=0.2@0.01",
        "card-errors=1@0.02",
        "card-removed=0.02@0.03",
        "card-worn@0.06",
        "card-slow@0.07",
    )
    given = ("--card", str(card), *(word for fault in faults for word in ("--fault", fault)))
    for options in (given, ()):
        path = tmp_path / f"{len(traces)}.npz"
        code, out, _ = fly(*options, "--trace", str(path))
        assert code == 0
        words = " ".join(out.split())
        assert ("blocks written" in words) == bool(options)
        assert all(f"fault {fault}" in words for fault in faults) == bool(options)
        traces.append(load_trace(path))
    assert traces[0].same(traces[1])


@pytest.mark.parametrize(
    ("size", "message"), [(None, "there is no such file"), (1000, "1000 bytes, expected a multiple of 512")]
)
def test_a_card_that_is_none_is_refused_in_one_line(
    fly: Command, tmp_path: Path, size: int | None, message: str
) -> None:
    card = tmp_path / "card.img"
    if size is not None:
        card.write_bytes(bytes(size))
    code, out, err = fly("--card", str(card))
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert f"card {card}: {message}" in err


@pytest.mark.slow
def test_the_escs_name_dshot_at_another_speed_than_they_are_set_to(fly: Command) -> None:
    assert fly("--set", "motor_protocol=dshot300")[0] == 0
    assert fly("--esc", "dshot600")[0] == 0
    for options in (("--esc", "dshot600", "--set", "motor_protocol=dshot300"), ("--esc", "dshot300")):
        code, out, err = fly(*options)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert f"expected {options[1].replace('dshot', 'DShot')}, which its ESC is set to" in err


def test_it_says_what_the_firmware_did_and_returns_another_code_when_a_fault_stops_it(fly: Command) -> None:
    code, out, _ = fly("--gyro-hz", "1000", "--fault", "gyro-silent@0.05", "--fault", "brown-out@9")
    assert code == STOPPED == 3
    words = " ".join(out.split())
    assert "flight motors stopped at 0.0" in words
    assert "0.0500 s fault gyro-silent@0.05" in words
    assert "FAULT: GYRO_SILENT" in words
    assert "GYRO_BAD" in words
    assert "never came brown-out@9" in words


def test_what_the_board_does_not_forgive_is_one_line_when_the_image_does_it(
    fly: Command, board_image: Path, tmp_path: Path
) -> None:
    image = bytearray(board_image.with_suffix(".bin").read_bytes())
    image[4:8] = (0x08070001).to_bytes(4, "little")  # the boot part's reset vector: into erased flash
    for name in ("neuroflight.elf", "report.json"):
        (tmp_path / name).write_bytes((board_image.parent / name).read_bytes())
    (tmp_path / "neuroflight.bin").write_bytes(image)
    code, out, err = fly("--build", str(tmp_path))
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert err.startswith("neuroflight: ") and "0x08070000" in err


@pytest.fixture
def starving(build_mutant: Callable[[Mutant], Path], board_image: Path) -> Path:
    """A build whose image no longer feeds the watchdog once it is armed."""
    elf = build_mutant(
        Mutant(
            name="watchdog not fed in flight",
            file="src/runtime.c",
            old="if (now != runtime->fed_at) {",
            new="if (now != runtime->fed_at && !firmware_trace(runtime->firmware)->armed) {",
            message="",
        )
    )
    shipped, mutant = (
        hashlib.sha256(image.with_suffix(".bin").read_bytes()).hexdigest() for image in (board_image, elf)
    )
    report = (board_image.parent / "report.json").read_text()
    (elf.parent / "report.json").write_text(report.replace(shipped, mutant))
    return elf.parent


@pytest.fixture
def second(tmp_path: Path) -> Path:
    """A scenario of a second."""
    path = tmp_path / "second.toml"
    path.write_text("[[segment]]\nduration_s = 1.0\nsetpoint_deg_s = [50, 0, 0]\n")
    return path


@pytest.mark.slow
def test_trace_and_profile_keep_what_was_flown_when_the_flight_ends_in_an_error(
    fly: Command, starving: Path, second: Path, board_image: Path, tmp_path: Path
) -> None:
    broken, whole, profile = tmp_path / "broken.npz", tmp_path / "whole.npz", tmp_path / "profile"
    arguments = ("--scenario", str(second), "--trace")
    code, out, err = fly(*arguments, str(broken), "--profile", str(profile), "--build", str(starving))
    assert (code, out) == (1, "")
    assert "the watchdog was not fed for" in err.splitlines()[-1]
    assert fly(*arguments, str(whole))[0] == 0
    kept, complete = load_trace(broken), load_trace(whole)
    steps = len(kept.t)
    assert 300 < steps < len(complete.t) == 1000
    assert f"{broken}: {steps / 1000:.3f} of 1 s, up to the error" in err
    for name in COLUMNS:
        assert getattr(kept, name).tobytes() == getattr(complete, name)[:steps].tobytes()
    assert "policy_step" in (profile / "functions.txt").read_text()
    assert f"{profile}: tasks.txt" in err


@pytest.mark.slow
def test_the_profile_of_the_boot_is_kept_when_the_image_does_not_boot(
    fly: Command, board_image: Path, tmp_path: Path
) -> None:
    image = bytearray(board_image.with_suffix(".bin").read_bytes())
    place = next(s.address for s in Places(board_image).functions if s.name == "gyro_start")
    offset = place - FLASH_BASE
    assert 0 < offset < len(image)
    image[offset : offset + 2] = (0xDE00).to_bytes(2, "little")  # an instruction that there is not
    for name in ("neuroflight.elf", "report.json"):
        (tmp_path / name).write_bytes((board_image.parent / name).read_bytes())
    (tmp_path / "neuroflight.bin").write_bytes(image)
    profile, trace = tmp_path / "profile", tmp_path / "none.npz"
    code, out, err = fly("--build", str(tmp_path), "--profile", str(profile), "--trace", str(trace))
    assert (code, out) == (1, "")
    assert "gyro_start" in err.splitlines()[-1]
    assert "clock_start" in (profile / "functions.txt").read_text()
    assert not trace.exists(), "nothing was flown"


@pytest.mark.slow
def test_the_error_stays_the_error_when_the_trace_cannot_be_written(
    fly: Command, starving: Path, second: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("neuroflight.sim.flight.trace.save_trace", full)
    trace = tmp_path / "a.npz"
    code, _, err = fly("--scenario", str(second), "--trace", str(trace), "--build", str(starving))
    assert code == 1 and not trace.exists()
    assert [line.partition(":")[0] for line in err.splitlines()] == [
        "the trace of the flight up to its end is not kept",
        "neuroflight",
    ]
    assert "watchdog" in err.splitlines()[-1]


@pytest.mark.slow
def test_it_flies_with_settings_while_a_client_asks_over_the_serial_line_when_told_to(
    fly: Command, client: Any, tmp_path: Path
) -> None:
    heard: list[str] = []

    def ask(port: int) -> None:
        with Client(TcpTransport(TcpPort("127.0.0.1", port))) as asking:
            # Nobody answers while it boots, and its time is not the client's.
            heard.append(messages.fc_variant(asking.request(Msp.FC_VARIANT, timeout=0.3, retries=200)))

    told = client(ask)
    trace = tmp_path / "a.npz"
    settings = [f"--set={change}" for change in ("roll_rate=500", "roll_max=500", "msp_baud=921600")]
    code, _, _ = fly("--serial", "tcp", *settings, "--trace", str(trace))
    assert code == 0
    assert told[0].startswith("USART1 at tcp:127.0.0.1:") and told[0].endswith(", 921600 baud")
    assert heard == [MSP_VARIANT_BETAFLIGHT]
    # Full stick is half as fast now: the sticks for 50 deg/s ask for 25.
    assert np.rad2deg(load_trace(trace).setpoint[50]) == pytest.approx([25.0, 0.0, 0.0], abs=0.01)


@pytest.mark.slow
def test_it_flies_while_clients_ask_on_both_uarts_when_told_to(fly: Command, client: Any) -> None:
    heard: list[str] = []

    def ask(port: int) -> None:
        with Client(TcpTransport(TcpPort("127.0.0.1", port))) as asking:
            heard.append(messages.fc_variant(asking.request(Msp.FC_VARIANT, timeout=0.3, retries=200)))

    told = client(ask)
    settings = [f"--set={change}" for change in ("uart3_function=msp", "uart3_baud=921600")]
    code, _, _ = fly("--serial", "tcp", "--serial", "uart3=tcp", *settings)
    assert code == 0
    assert told[1].startswith("USART3 at tcp:127.0.0.1:") and told[1].endswith(", 921600 baud")
    assert heard == [MSP_VARIANT_BETAFLIGHT] * 2


def test_uart3_is_off_unless_it_is_set_to_msp(fly: Command) -> None:
    code, _, errors = fly("--serial", "uart3=pty")
    assert code == 1 and "--serial uart3: got a board whose UART3 is off" in errors


def test_a_flight_ends_when_it_is_interrupted_wherever_the_board_is(fly: Command, client: Any) -> None:
    before = signal.getsignal(signal.SIGINT)
    client(lambda port: os.kill(os.getpid(), signal.SIGINT))
    code, out, err = fly("--serial", "tcp")
    assert (code, out) == (130, "")
    assert err.startswith("neuroflight: interrupted")
    assert signal.getsignal(signal.SIGINT) is before


def test_two_scenarios_are_a_row_each_when_given_together(fly: Command, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text("[[segment]]\nduration_s = 0.05\nsetpoint_deg_s = [0, 0, 0]\n")
    both = ("--scenario", str(tmp_path / "short.toml"), str(other))
    code, out, err = fly(*both, on="reference")
    assert (code, err) == (0, "")
    assert [line.split()[:2] for line in out.splitlines() if "100.0 %" in line] == [
        ["short", "0.1"],
        ["other", "0.05"],
    ]
    documents = json.loads(fly(*both, "--json", on="reference")[1])
    assert [(one["scenario"], list(one["flights"])) for one in documents] == [
        ("short", ["firmware"]),
        ("other", ["firmware"]),
    ]


@pytest.mark.slow
def test_the_image_flies_what_make_emulate_flies_and_disarms_each_time(fly: Command) -> None:
    names = ["roll", "flip", "sim/scenarios/split_s.toml", "flight"]
    code, out, _ = fly("--scenario", *names)
    assert code == 0
    flown = [line.split()[0] for line in out.splitlines() if "flown, disarmed" in line]
    assert flown == ["roll", "flip", "split_s", "flight"]
    assert "sha256" in out


def test_gdb_finds_the_board_at_its_first_instruction_when_it_is_waited_for(
    client: Any, board_image: Path
) -> None:
    image = board_image.with_suffix(".bin")
    board = Board(image.read_bytes(), elf=board_image)
    start = board.engine.pc
    heard: list[bytes] = []

    def debug(port: int) -> None:
        with socket.create_connection(("127.0.0.1", port), 10) as gdb:
            gdb.sendall(b"$pf#d6")  # register 15, the program counter
            while b"#" not in b"".join(heard):
                heard.append(gdb.recv(64))
            gdb.sendall(b"+$c#63")
            while gdb.recv(64):  # until the board is gone
                pass

    told = client(debug)
    with ExitStack() as ends:
        args = Fly(gdb=0)
        run_to = fly_emulator.attached(args, board, image, ends, Lines(2, 1, 3), {})
        assert board.cycle == 0
        run_to(10_000)
        assert board.cycle >= 10_000
    board.close()
    assert str(board_image) in told[0]
    assert start.to_bytes(4, "little").hex().encode() in b"".join(heard)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--gyro", "icm20689"], "--gyro: only on the emulated board; add --on board"),
        (["--card", "a.img"], "--card: only on the emulated board; add --on board"),
        (["--esc", "dshot600"], "--esc: only on the emulated board; add --on board"),
        (["--fault", "crystal@1"], "--fault: only on the emulated board; add --on board"),
        (["--on", "betaflight", "--receiver", "crsf"], "--receiver: Betaflight takes the sticks from the"),
        (["--profile", "d"], "--profile: only on the emulated board"),
        (["--gdb", "0"], "--gdb: only on the emulated board"),
        (["--on", "emulator", "--serial", "usb"], "--serial: got 'usb', expected pty, tcp or tcp:PORT"),
        (["--on", "emulator", "--serial", "tcp:99999"], "--serial: got 'tcp:99999'"),
        (["--on", "emulator", "--gdb", "-1"], "--gdb: got -1, expected a port"),
        (["--on", "emulator", "--fault", "crystal"], "expected NAME"),
        (["--on", "emulator", "--set", "gyro_rate_hz=8000"], "has an option of its own; use --gyro-hz"),
        (["--on", "host", "--set", "receiver_protocol=crsf"], "use --receiver"),
        (["--on", "emulator", "--set", "rol_rate=3"], "setting 'rol_rate' is unknown"),
        (["--on", "emulator", "--profile", "file"], "file is a file, expected a directory"),
        (["--on", "betaflight", "--set", "roll_rate=3"], "Betaflight has settings of its own"),
        (["--on", "emulator", "--fault", "card-stall@1"], "got no card that it could happen to; add --card"),
        (
            ["--on", "emulator", "--scenario", "roll", "flip", "--card", "a.img"],
            "--card: belongs to one flight",
        ),
        (["--scenario", "roll", "flip", "--trace", "a.npz"], "--trace: belongs to one flight"),
        (["--on", "emulator", "--build", "nowhere"], "build it with `make firmware TARGET=MATEKF722`"),
    ],
)
def test_it_refuses_in_one_line_before_flying_when_an_option_cannot_be(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert message in refused(capsys, ["fly", *arguments])
