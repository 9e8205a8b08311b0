"""`neuroflight board flash` --policy, --list and --revert with the real firmware of the host program."""

from __future__ import annotations

import json
import random
import re
import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.cli.main import main
from neuroflight.flash.board.info import read_info
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.link.msp import Decoder, Message, encode, error
from neuroflight.flash.link.policy_errors import POLICY_ERRORS, policy_error
from neuroflight.flash.link.transport import Transport, open_transport
from neuroflight.flash.policy import swap as swaps
from neuroflight.flash.policy.slots import Policies, read_policies, slot_of
from neuroflight.flash.policy.swap import Board
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import FLASH_BYTES, ArmingReason, FirmwareError, FlightState, Msp
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.policy.blob import pack, parse
from neuroflight.toolchain.policy.check_stamp import RULES, stamp_document, stamp_path, write_stamp
from tests.flash.link.test_noisy_line import FastTransport
from tests.flash.peers import HostBoard, Reply, Run, answering, host_board
from tests.flash.policy.policies import another_policy
from tests.sampling import sampled

ROOT = Path(__file__).resolve().parents[3]
Serve = Callable[..., str]
Refused = Callable[..., str]


@pytest.fixture
def board(reviving_host: HostBoard) -> HostBoard:
    """A host program as installed, its policy in slot A, which starts anew when it is told to."""
    return reviving_host


@pytest.fixture(scope="module")
def other(shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy of the shipped one's architecture."""
    return another_policy(shipped_policy, tmp_path_factory.mktemp("policy") / "other.onnx")


@pytest.fixture(scope="module")
def third(shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """And one more."""
    return another_policy(shipped_policy, tmp_path_factory.mktemp("policy") / "third.onnx", seed=2)


@pytest.fixture
def run(board: HostBoard, capsys: pytest.CaptureFixture[str]) -> Run:
    """Give it words behind `board policy`: exit code, stdout, stderr. `port`: another than the board's."""

    def call(*words: object, port: str | None = None) -> tuple[int, str, str]:
        unchecked = ["--unchecked"] if words[0] == "swap" else []
        code = main(["board", "policy", *map(str, words), *unchecked, "--port", port or board.port])
        output = capsys.readouterr()
        assert output.err.count("\n") <= 1
        assert (code == 0) == (output.err == "")
        return code, " ".join(output.out.split()), output.err

    return Run(call)


@pytest.fixture
def unwritten(run: Run, board: HostBoard) -> Refused:
    """Give it words behind `swap`: the line that refuses it, with flash as it was."""

    def refused(*words: object) -> str:
        before = board.flash.read_bytes()
        err = run.refused("swap", *words)
        assert "nothing was written" in err and board.flash.read_bytes() == before
        return err

    return refused


def slots(board: HostBoard) -> Policies:
    with Client(open_transport(board.port)) as client:
        return read_policies(client)


@cache
def sha(path: Path) -> str:
    return candidate_of(path).sha256


def flown(board: HostBoard) -> tuple[PolicySource, int, str, bool]:
    info = slots(board).info
    return info.source, info.sequence, info.sha256, info.good


# --- The swap, and back ---------------------------------------------------------------------------
def test_the_board_flies_each_policy_and_goes_back_one_by_one_when_asked(
    run: Run, board: HostBoard, other: Path, third: Path, shipped_policy: Path
) -> None:
    out = run.told("swap", other)
    assert "flown now the policy in slot A (number 0, aircraft nf1" in out
    assert "plan erase slot B, write 2" in out
    assert "the board flies other.onnx from slot B: its self-test passed there" in out
    assert flown(board) == (PolicySource.SLOT_B, 1, sha(other), True)
    assert board.starts == 2
    listed = {row["source"]: row for row in json.loads(run("list", "--json")[1])}
    assert [listed[name]["flown"] for name in ("SLOT_A", "SLOT_B")] == [False, True]
    assert listed["SLOT_A"]["sha256"] == sha(shipped_policy)
    assert listed["SLOT_A"]["network"] == "27-56-56-4 tanh"
    assert [row["next"] for row in listed.values()] == [False, True]

    out = run.told("revert")
    assert "afterwards the policy in slot A (number 0, aircraft nf1" in out
    assert flown(board) == (PolicySource.SLOT_A, 0, sha(shipped_policy), True)
    err = run.refused("revert")
    assert "has no other good one" in err and "nothing was changed" in err
    assert "empty" in run("list")[1]

    assert run("swap", other)[0] == run("swap", third)[0] == 0
    assert flown(board) == (PolicySource.SLOT_A, 2, sha(third), True)
    assert run("revert")[0] == 0
    assert flown(board) == (PolicySource.SLOT_B, 1, sha(other), True)


def test_the_pid_alone_flies_when_no_slot_holds_a_policy(
    host_program: Path, tmp_path: Path, shipped_policy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "erased.bin").write_bytes(b"\xff" * FLASH_BYTES)
    with host_board(host_program, tmp_path / "erased.bin") as board:
        assert flown(board) == (PolicySource.NONE, 0, "00" * 32, False)
        with Client(open_transport(board.port)) as client:
            info = read_info(client)
        assert "POLICY_BAD" in info.arming_reasons and info.name == "none"
        assert main(["board", "policy", "revert", "--port", board.port]) == 1
        assert "the board flies no policy; nothing was changed" in capsys.readouterr().err
        assert main(["board", "policy", "list", "--port", board.port]) == 0
        assert capsys.readouterr().out.count("empty") == 2
        assert (
            main(["board", "policy", "swap", str(shipped_policy), "--port", board.port, "--unchecked"]) == 0
        )
        assert flown(board) == (PolicySource.SLOT_A, 1, sha(shipped_policy), True)


def test_the_list_names_networks_of_known_files(
    run: Run, board: HostBoard, other: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run("swap", other)[0] == 0
    (row,) = [row for row in json.loads(run("list", "--json")[1]) if row["source"] == "SLOT_B"]
    assert (row["network"], row["state"]) == (None, "good")
    monkeypatch.chdir(other.parent)
    out = run("list")[1]
    assert re.search(rf"slot B flown 1 nf1 {sha(other)[:12]} 27-56-56-4 tanh good", out)
    assert re.search(r"slot A 0 nf1 \w+ 27-56-56-4 tanh good", out)


def test_nothing_is_written_when_it_is_flown_already_or_only_planned(
    run: Run, board: HostBoard, other: Path, shipped_policy: Path
) -> None:
    before = board.flash.read_bytes()
    out = run.told("swap", shipped_policy)
    assert "the board flies policy.onnx already" in out and "nothing was written" in out
    assert "a plan only (--dry-run): nothing was written" in run("swap", other, "--dry-run")[1]
    document = json.loads(run("swap", other, "--dry-run", "--json")[1])
    assert (document["slot"], document["written"], document["flown"]) == ("slot B", None, False)
    assert document["bytes"] == candidate_of(other).size
    assert board.flash.read_bytes() == before
    assert run("swap", shipped_policy, "--force")[0] == 0
    assert flown(board) == (PolicySource.SLOT_B, 1, sha(shipped_policy), True)
    written = board.flash.read_bytes()
    assert "nothing was changed" in run("revert", "--dry-run")[1]
    assert board.flash.read_bytes() == written


def test_a_policy_waits_for_the_next_start_when_none_is_wanted_now(
    run: Run, board: HostBoard, other: Path, third: Path
) -> None:
    assert (
        "stands in slot B; the board flies it from its next start on" in run("swap", other, "--no-reboot")[1]
    )
    assert (flown(board)[0], board.starts) == (PolicySource.SLOT_A, 1)
    assert "good, flown from the next start on" in run("list")[1]
    out = run("swap", other)[1]
    assert "nothing to write: slot B holds it and waits for a start" in out
    assert flown(board)[:2] == (PolicySource.SLOT_B, 1)

    run("swap", third, "--no-reboot")
    err = run.refused("revert")
    assert "is flown from the next start on in place of the one" in err
    run("swap", third)
    assert "is given up; the board flies the policy in slot B" in run("revert", "--no-reboot")[1]
    assert "given up; flown until the next start" in run("list")[1]
    for words in (("swap", third), ("revert",)):
        err = run.refused(*words)
        assert "was given up and is flown until the next start" in err
    assert main(["board", "reboot", "--port", board.port]) == 0
    assert flown(board)[:3] == (PolicySource.SLOT_B, 1, sha(other))


# --- Files and policies that are refused ------------------------------------------------------------
def broken(kind: str, policy: Path, folder: Path) -> Path:
    data, path = policy.read_bytes(), folder / "broken.onnx"
    if kind == "huge":
        with path.open("wb") as file:
            file.truncate(10 << 20)
    elif kind == "random":
        path.write_bytes(random.Random(5).randbytes(20_000))
    elif kind == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "directory":
        path.mkdir()
    return path


@pytest.mark.parametrize("kind", ["truncated", "random", "huge", "empty", "missing", "directory"])
def test_one_line_says_that_nothing_was_written_when_the_file_is_none(
    unwritten: Refused, other: Path, tmp_path: Path, kind: str
) -> None:
    assert "broken.onnx" in unwritten(broken(kind, other, tmp_path))


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ({"neuroflight.control_rate_hz": "500"}, "control rate [Hz] 500, the image 1000"),
        (
            {"neuroflight.filters": '[{"kind": "lowpass1", "cutoff_hz": 90}]'},
            "gyro filters",
        ),
        (
            {
                "neuroflight.observation": "rate_error,rate,rate_error_integral,rate~20Hz,rate~60Hz,"
                "previous_motors,rotor_estimate,throttle,rate_estimate"
            },
            "weights and motors as the image's, but other layers or observed terms (rate_error,",
        ),
    ],
)
def test_one_line_names_the_difference_when_the_image_cannot_fly_it(
    unwritten: Refused, shipped_policy: Path, tmp_path: Path, metadata: dict[str, str], words: str
) -> None:
    policy = another_policy(shipped_policy, tmp_path / "wrong.onnx", metadata=metadata)
    err = unwritten(policy)
    assert words in err
    assert f"make firmware TARGET=HOST POLICY={policy}" in err


def test_one_line_names_both_networks_when_the_architecture_is_another(unwritten: Refused) -> None:
    err = unwritten(ROOT / "training" / "policies" / "hexa" / "policy.onnx")
    for words in (" does not fit the image that runs (27-56-56-4 tanh): ", "motors 6, the image 4"):
        assert words in err


def test_a_policy_of_another_aircraft_is_flown_only_when_that_is_meant(
    unwritten: Refused, run: Run, board: HostBoard, shipped_policy: Path, tmp_path: Path
) -> None:
    metadata = {"neuroflight.aircraft": "other", "neuroflight.idle": "0.1"}
    policy = another_policy(shipped_policy, tmp_path / "alien.onnx", metadata=metadata)
    err = unwritten(policy)
    assert "trained for the aircraft 'other'" in err and "is for 'nf1'; nothing was written" in err
    assert "idle 0.1 of full throttle, until now 0.055" in run.told("swap", policy, "--other-aircraft")
    assert flown(board)[2:] == (sha(policy), True)
    err = run.refused("revert")
    assert "is for the aircraft 'nf1'" in err and "nothing was changed" in err
    assert run("revert", "--other-aircraft")[0] == 0
    assert flown(board)[0] is PolicySource.SLOT_A


def test_a_policy_of_another_aircraft_of_that_name_is_flown_only_when_that_is_meant(
    unwritten: Refused, run: Run, board: HostBoard, shipped_policy: Path, tmp_path: Path
) -> None:
    metadata = {"neuroflight.aircraft_sha256": "ab" * 32}
    policy = another_policy(shipped_policy, tmp_path / "alien.onnx", metadata=metadata)
    err = unwritten(policy)
    digest = load_aircraft("nf1").sha256[:12]
    assert f"'nf1' (abababababab), the policy that the board flies is for 'nf1' ({digest})" in err
    assert "aircraft nf1, digest abababababab" in run.told("swap", policy, "--other-aircraft", "--dry-run")


# --- Boards that are refused ------------------------------------------------------------------------
Replies = dict[int, Reply]


def state(of: FlightState) -> Replies:
    return {Msp.SAFETY: lambda payload: bytes([of]) + payload[1:]}


def under_test(payload: bytes) -> bytes:
    (flags,) = struct.unpack_from("<I", payload, 4)
    return payload[:4] + struct.pack("<I", flags | 1 << ArmingReason.MOTOR_TEST) + payload[8:]


REFUSED: dict[str, tuple[Replies, str]] = {
    "armed": (state(FlightState.ARMED), "the board is in state armed"),
    "failsafe": (state(FlightState.FAILSAFE_HOLD), "the board is in state failsafe hold"),
    "crashed": (state(FlightState.CRASHED), "the board is in state crashed"),
    "motor-test": ({Msp.SAFETY: under_test}, "a motor test is open"),
    "battery": (
        {Msp.BATTERY_STATE: struct.pack("<BHBHhBH", 4, 0, 130, 0, 0, 2, 1304)},
        "the battery is low, 13.04 V of 4 cells",
    ),
    "another make": ({Msp.IDENTITY: None}, "a firmware of another make answers (BTFL)"),
    "older": ({Msp.POLICY_SLOT_INFO: None}, "it does not know it: bring it and this tool to the same"),
}


@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("words", [("swap",), ("revert",)], ids=lambda words: words[0])
def test_nothing_is_sent_that_writes_when_the_board_is_not_ready(
    run: Run, board: HostBoard, tcp_server: Serve, other: Path, kind: str, words: tuple[str, ...]
) -> None:
    changed, told = REFUSED[kind]
    asked: list[tuple[int, bytes]] = []
    port = tcp_server(answering(changed, asked, board.port))
    err = run.refused(*words, *([other] if words == ("swap",) else []), port=port)
    assert told in err
    assert ("nothing was written" if words == ("swap",) else "nothing was changed") in err or kind == "older"
    writing = {Msp.POLICY_SLOT_BEGIN, Msp.POLICY_SLOT_WRITE, Msp.POLICY_SLOT_END, Msp.POLICY_SLOT_REVERT}
    assert asked and not (writing | {Msp.REBOOT}) & {command for command, _ in asked}


def test_one_line_says_so_when_nobody_is_there(run: Run, other: Path, free_tcp_port: int) -> None:
    err = run.refused("swap", other, port=f"tcp:127.0.0.1:{free_tcp_port}")
    assert "nothing was written" in err
    err = run.refused("swap", other, port="/dev/there-is-none")
    assert "nothing was written" in err


def test_the_refusal_is_told_when_the_motors_are_armed_meanwhile(
    run: Run, board: HostBoard, tcp_server: Serve, other: Path
) -> None:
    """The firmware itself refuses what comes after the check."""
    count = 0

    def refusing(data: bytes) -> bytes:
        nonlocal count
        (message,) = (event for event in Decoder().feed(data) if isinstance(event, Message))
        count += message.command == Msp.POLICY_SLOT_WRITE
        if message.command == Msp.POLICY_SLOT_WRITE and count == 20:
            return encode(replace(error(message), payload=struct.pack("<Bh", 1, 0)))
        return through(data)

    through = answering({}, through=board.port)
    code, _, err = run("swap", other, port=tcp_server(refusing))
    assert code == 1
    assert "the motors are armed or under test" in err and "other.onnx was not written" in err
    assert count == 20, "it is not tried again"
    assert flown(board)[0] is PolicySource.SLOT_A


# --- A policy that the board does not fly after all ----------------------------------------------------
def test_the_board_flies_the_old_one_and_says_why_when_the_new_one_fails_its_selftest(
    board: HostBoard, other: Path, third: Path
) -> None:
    good, candidate = candidate_of(third), candidate_of(other)
    blob = parse(candidate.blob(0))
    wrong = np.clip(blob.selftest_action + np.float32(1e-6), 0, 1).astype(np.float32)
    bad = replace(
        candidate, blob=lambda sequence: pack(replace(blob, sequence=sequence, selftest_action=wrong))
    )
    line = Board(lambda: open_transport(board.port))
    client, place = swaps.write(Client(line.reopen()), good, line, lambda done, total: None)
    swaps.start(client, good, place, line).close()
    client, place = swaps.write(Client(line.reopen()), bad, line, lambda done, total: None)
    assert place.source is PolicySource.SLOT_A
    with pytest.raises(
        LinkError, match=r"flies the policy in slot B .* and not other.onnx: the one in slot A fails"
    ):
        swaps.start(client, bad, place, line)
    assert flown(board) == (PolicySource.SLOT_B, 1, good.sha256, True)


def test_it_is_told_as_refused_when_the_blob_is_none_for_the_image(board: HostBoard, other: Path) -> None:
    candidate = candidate_of(other)
    blob = parse(candidate.blob(0))
    alien = replace(candidate, blob=lambda n: pack(replace(blob, sequence=n, architecture_hash=1)))
    line = Board(lambda: open_transport(board.port))
    with pytest.raises(
        LinkError,
        match=r"of another architecture than this image's policy \(error -13\); other.onnx was not",
    ):
        swaps.write(Client(line.reopen()), alien, line, lambda done, total: None)
    assert flown(board)[0] is PolicySource.SLOT_A


# --- Lines that fail ----------------------------------------------------------------------------------
def test_the_swap_starts_over_when_the_line_is_lost(
    run: Run, board: HostBoard, tcp_server: Serve, other: Path
) -> None:
    seen, lost = 0, [3, 30]  # blocks that are not answered

    def answer(data: bytes) -> bytes:
        nonlocal seen
        (message,) = (event for event in Decoder().feed(data) if isinstance(event, Message))
        seen += message.command == Msp.POLICY_SLOT_WRITE
        if seen in lost:
            lost.remove(seen)
            return b"HANG UP"
        return through(data)

    through = answering({}, through=board.port)
    port = tcp_server(answer)
    code, out, _ = run("swap", other, "--no-reboot", port=port)
    assert (code, lost) == (0, [])
    assert "stands in slot B" in out
    assert slots(board).after_start().sha256 == sha(other)  # type: ignore[union-attr]


def test_one_line_says_what_it_means_for_the_board_when_ctrl_c_stops_it(
    board: HostBoard, other: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    words = ["board", "policy", "swap", str(other), "--port", board.port, "--unchecked"]
    monkeypatch.setattr(swaps, "_write_blocks", stop)
    with pytest.raises(SystemExit, match="130"):
        main(words)
    assert "the board goes on with the policy that it flew, unless all was" in capsys.readouterr().err
    assert slots(board).after_start() == slots(board).flown
    monkeypatch.undo()
    monkeypatch.setattr(swaps, "start", stop)
    with pytest.raises(SystemExit, match="130"):
        main(words)
    assert "other.onnx stands in slot B and is flown from the next start on" in capsys.readouterr().err
    assert slots(board).after_start().sha256 == sha(other)  # type: ignore[union-attr]


def test_it_is_told_what_flies_when_the_line_is_lost_for_good(
    run: Run, board: HostBoard, tcp_server: Serve, other: Path
) -> None:
    def answer(data: bytes) -> bytes:
        (message,) = (event for event in Decoder().feed(data) if isinstance(event, Message))
        return b"HANG UP" if message.command == Msp.POLICY_SLOT_WRITE else through(data)

    through = answering({}, through=board.port)
    code, _, err = run("swap", other, port=tcp_server(answer))
    assert code == 1
    assert "other.onnx was not written: the board goes on with the policy that it flew" in err
    assert flown(board)[0] is PolicySource.SLOT_A


class Timed:
    """A line to a firmware whose time passes as a test wants it: no wait takes long."""

    def __init__(self, port: str) -> None:
        self._inner = open_transport(port)
        self.name, self.close = self._inner.name, self._inner.close
        self.now, self.writes = 0.0, 0

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def read(self, timeout: float) -> bytes:
        self.now += 0.001
        return self._inner.read(timeout)

    def write(self, data: bytes) -> None:
        self.writes += 1
        self._inner.write(data)


class Stalling(Timed):
    """Carries nothing for 10 s from a request on: no requests, or only no replies; then all of it."""

    def __init__(self, port: str, at: int, *, requests: bool) -> None:
        super().__init__(port)
        self.at, self.requests, self.until = at, requests, 0.0
        self.held: list[bytes] = []

    def read(self, timeout: float) -> bytes:
        if self.now < self.until:
            self.now = min(self.until, self.now + timeout)
            return b""
        for data in self.held:
            super().write(data)
        self.held = []
        return super().read(timeout)

    def write(self, data: bytes) -> None:
        if self.at == self.writes + len(self.held):
            self.at, self.until = -1, self.now + STALL_S
        if self.requests and self.now < self.until:
            self.held.append(data)
        else:
            super().write(data)


STALL_S = 10.0
BLOCKS = 49  # of the shipped policy's blob, about: a request each, between the beginning and the end


@pytest.mark.parametrize("requests", [True, False], ids=["both ways", "replies"])
@pytest.mark.parametrize("at", [0, 1, 20, BLOCKS + 2])
def test_the_swap_goes_on_when_the_line_stalls_for_ten_seconds(
    board: HostBoard, other: Path, at: int, requests: bool
) -> None:
    candidate, line = candidate_of(other), Stalling(board.port, at, requests=requests)
    client, place = swaps.write(
        Client(line, line.clock),
        candidate,
        Board(lambda: line, line.clock, line.sleep),
        lambda done, total: None,
    )
    client.close()
    assert line.at == -1 and line.now > STALL_S
    assert (place.source, slots(board).after_start()) == (PolicySource.SLOT_B, place)


class Pulled(Timed):
    """A cable that is pulled before a request."""

    def __init__(self, port: str, at: int) -> None:
        super().__init__(port)
        self.at = at

    def write(self, data: bytes) -> None:
        if self.writes == self.at:
            raise LinkError(f"{self.name}: gone")
        super().write(data)


def test_the_swap_is_whole_when_the_cable_was_pulled_at_twenty_moments_before(
    board: HostBoard, other: Path, shipped_policy: Path
) -> None:
    candidate, rng = candidate_of(other), random.Random(3)

    def gone() -> Transport:
        raise LinkError("no such device")

    for at in sorted(rng.sample(range(BLOCKS), 20)):
        line = Pulled(board.port, at)
        with pytest.raises(LinkError, match=r"gone; other.onnx was not written: the board goes on"):
            swaps.write(
                Client(line, line.clock),
                candidate,
                Board(gone, line.clock, line.sleep),
                lambda done, total: None,
            )
        after = slots(board).after_start()
        assert after is not None and after.sha256 == sha(shipped_policy)
    plain = Board(lambda: open_transport(board.port))
    client, place = swaps.write(Client(plain.reopen()), candidate, plain, lambda done, total: None)
    swaps.start(client, candidate, place, plain).close()
    assert flown(board)[2:] == (candidate.sha256, True)


class Noise:
    """What a bad line does to pieces on their way: corrupts, drops, doubles, swaps, holds them back."""

    def __init__(self, seed: int, rate: float) -> None:
        self.rng, self.rate = random.Random(seed), rate
        self.held: list[bytes] = []
        self.done = 0

    def __call__(self, data: bytes) -> bytes:
        before, self.held = b"".join(self.held), []
        if self.rng.random() >= self.rate:
            return before + data
        self.done += 1
        kind = self.rng.randrange(5)
        if kind == 0:  # some bytes; their number, at first, stays: see test_noisy_line.SIZES
            damaged = bytearray(data)
            for _ in range(self.rng.randrange(1, 4)):
                damaged[self.rng.choice([at for at in range(len(data)) if at not in (3, 6, 7)])] ^= (
                    self.rng.randrange(1, 256)
                )
            return before + bytes(damaged)
        if kind == 1:
            return before
        if kind == 2:
            return before + data + data
        if kind == 3:
            return data + before
        self.held = [data]
        return before


@pytest.mark.parametrize("seed", sampled(range(40), 1, 2))
def test_the_board_flies_the_whole_policy_or_the_old_one_when_the_line_is_bad(
    board: HostBoard, pty_line: Callable[..., str], other: Path, shipped_policy: Path, seed: int
) -> None:
    candidate = candidate_of(other)
    rate = (0.05, 0.15, 0.4)[seed % 3]
    down, up = Noise(seed, rate), Noise(100 + seed, rate / 2)
    device = pty_line(board.port, down=down, up=up)

    def reopen() -> Transport:
        return FastTransport(device)

    line = reopen()
    client = Client(line, line.clock)  # type: ignore[attr-defined]
    told = "written"
    try:
        swaps.write(client, candidate, Board(reopen), lambda done, total: None)
    except LinkError as failure:
        told = str(failure)
    else:
        assert slots(board).after_start().sha256 == candidate.sha256  # type: ignore[union-attr]
    after = slots(board).after_start()
    assert after is not None
    assert after.sha256 in (candidate.sha256, sha(shipped_policy))
    assert down.done + up.done > 0
    print(f"{down.done} changes on the way down, {up.done} up: {told}")


# --- Words and orders -------------------------------------------------------------------------------
def test_each_error_of_a_policy_has_words_when_the_firmware_has_a_number_for_it() -> None:
    of_policies = {e for e in FirmwareError if e.name.startswith("ERR_BLOB_") or e.name == "ERR_POLICY"}
    assert set(POLICY_ERRORS) == of_policies
    assert policy_error(-99) == "error -99, which this tool does not know"


SLOT_REPLY = struct.pack("<bB4If", -10, 0, 7, 1, 2, 1000, 0.25) + b"\x03nf1" + bytes(range(32)) + b"itsbuild"


def test_a_place_is_read_field_by_field_when_told() -> None:
    place = slot_of(PolicySource.SLOT_B, SLOT_REPLY)
    assert (place.found, place.flown, place.sequence, place.control_rate_hz) == (-10, False, 7, 1000)
    assert (place.architecture_hash, place.filters_hash, place.idle) == (1, 2, 0.25)
    assert (place.aircraft, place.sha256) == ("nf1", bytes(range(32)).hex())
    assert not place.good and place.build == b"itsbuild".hex()
    assert policy_error(place.found) == "damaged: its checksum does not hold"
    for size in range(len(SLOT_REPLY)):
        with pytest.raises(LinkError, match="MSP POLICY_SLOT_INFO reply has"):
            slot_of(PolicySource.SLOT_B, SLOT_REPLY[:size])


def test_a_swap_takes_seconds_by_its_line_when_planned() -> None:
    over_usb = swaps.seconds(27_000, PolicySource.SLOT_B, None, start=False)
    slow = swaps.seconds(27_000, PolicySource.SLOT_B, 115_200, start=False)
    assert slow - over_usb == pytest.approx(27_000 * 10 / 115_200)
    assert swaps.seconds(27_000, PolicySource.SLOT_A, None, start=True) > over_usb - 0.45


# --- No policy that was not found fit to fly ----------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"fit": False}, "is NOT fit to fly"),
        ({"policy_sha256": "b" * 64}, "was changed after its check"),
        ({"aircraft_sha256": "b" * 64}, "was checked for another aircraft"),
        (None, "was not checked"),
    ],
)
def test_a_policy_that_is_not_known_to_be_fit_is_not_written(
    board: HostBoard,
    other: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: dict[str, object] | None,
    said: str,
) -> None:
    before = slots(board).slots
    policy = Path(shutil.copy(other, tmp_path / "policy.onnx"))
    if words is not None:
        write_stamp(policy, stamp_of(policy, **words))
    assert main(["board", "policy", "swap", str(policy), "--port", board.port]) == 1
    err = capsys.readouterr().err
    assert said in err and f"neuroflight policy check {policy}" in err and "or add --unchecked" in err
    assert err.count("\n") == 1 and err.endswith("nothing was written\n")
    assert slots(board).slots == before


def test_a_policy_that_a_check_found_fit_is_written_until_its_stamp_is_edited(
    board: HostBoard, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = Path(shutil.copy(other, tmp_path / "policy.onnx"))
    write_stamp(policy, stamp_of(policy))
    path = stamp_path(policy)
    good = path.read_text()
    path.write_text(good.replace('"drift": 1.5', '"drift": 1.0'))
    assert path.read_text() != good
    assert main(["board", "policy", "swap", str(policy), "--port", board.port]) == 1
    assert "it was changed after the check" in capsys.readouterr().err
    path.write_text(good)
    assert main(["board", "policy", "swap", str(policy), "--port", board.port]) == 0
    assert f"check fit to fly nf1, by rules {RULES}" in " ".join(capsys.readouterr().out.split())
    assert flown(board) == (PolicySource.SLOT_B, 1, sha(policy), True)


def stamp_of(policy: Path, **words: object) -> dict[str, object]:
    """What a check that finds a policy fit for its own aircraft says, with other words."""
    facts = {"aircraft": "nf1", "aircraft_sha256": load_aircraft("nf1").sha256, "fit": True}
    facts |= {"policy_sha256": sha(policy), "figures": {"drift": 1.5}}
    return stamp_document(**{**facts, **words})  # type: ignore[arg-type]
