"""`board` status, tasks, faults and reboot: against the host program and against scripted peers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.flash.board import restart as restarting
from neuroflight.flash.board.hints import BETAFLIGHT, HINTS, betaflight_reasons
from neuroflight.flash.board.hints import FAULTS as FAULT_WORDS
from neuroflight.flash.board.restart import restart
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode, error, reply
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import (
    FAULT_FILE_BYTES,
    FAULT_REGISTERS,
    ArmingReason,
    FallbackCause,
    FaultKind,
    FlightState,
    GyroHealth,
    Msp,
    StopCause,
    Task,
)
from neuroflight.toolchain.errors import LinkError
from tests.flash.peers import Run, answering

Serve = Callable[..., str]
LayLine = Callable[..., str]


def test_each_reason_has_a_hint_when_the_contract_names_it() -> None:
    assert {reason.name for reason in ArmingReason} <= set(HINTS)
    assert all(0 < len(hint) < 100 and "\n" not in hint for hint in HINTS.values())
    assert {kind.name for kind in FaultKind} == set(FAULT_WORDS)


def test_betaflights_reasons_have_its_names_when_told_by_bits() -> None:
    assert betaflight_reasons(1 << 7 | 1 << 13 | 1 << 28, 29) == ("THROTTLE", "CLI", "ARM_SWITCH")
    assert betaflight_reasons(1 << 26, 29) == ("BIT_26",)
    assert len(BETAFLIGHT) == 25


# --- The host program ------------------------------------------------------------------------
def test_status_names_what_forbids_arming_and_how_to_lift_it(msp: Run, resting_host: str) -> None:
    out = msp.told(resting_host, "status")
    words = " ".join(out.split())
    assert "state boot armed no flies policy policy nf1, good" in words
    for reason in ("BOOT_GRACE", "GYRO_NOT_CALIBRATED", "RECEIVER_LOST", "SWITCH_NOT_CYCLED", "NOT_LEVEL"):
        assert f"{reason}: {HINTS[reason]}" in words
    told = json.loads(msp(resting_host, "status", "--json")[1])
    assert told["arming_reasons"]["NOT_LEVEL"] == HINTS["NOT_LEVEL"]
    assert (told["armed"], told["flight"]["state"], told["receiver_percent"]) == (False, "BOOT", 0)
    assert (told["battery"]["cells"], told["flight"]["boots"], told["flight"]["fault"]) == (0, 1, None)


def test_tasks_are_told_in_microseconds(msp: Run, resting_host: str) -> None:
    out = msp.told(resting_host, "tasks")
    assert [line.split()[0] for line in out.splitlines()[1:]] == [task.name.lower() for task in Task]
    told = {row["task"]: row for row in json.loads(msp(resting_host, "tasks", "--json")[1])["tasks"]}
    served = told["MSP"]
    assert served["runs"] > 0
    assert 0 < served["best_us"] <= served["mean_us"] <= served["worst_us"] < 1e6
    assert told["CONTROL"]["rate_hz"] == 1000


def test_no_fault_is_told_when_there_is_none(msp: Run, resting_host: str) -> None:
    assert msp(resting_host, "faults", "--ack") == (0, "no fault is pending; this is boot 1\n", "")
    told = json.loads(msp(resting_host, "faults", "--json")[1])
    assert told == {"boots": 1, "fault": None, "acknowledged": False, "gyro": ""}  # the host has no chip


def test_it_says_so_when_a_firmware_does_not_come_back(
    msp: Run, resting_host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host program ends when it is asked to start anew."""
    monkeypatch.setattr(restarting, "WAIT_S", 0.3)
    err = msp.refused(resting_host, "reboot")
    assert "did not answer again within 0.3 s; a firmware that is a program ends there: start it again" in err
    err = msp.refused(resting_host, "info")
    assert "nobody listens there" in err


def test_a_firmware_without_a_rom_refuses_to_enter_one(msp: Run, resting_host: str) -> None:
    err = msp.refused(resting_host, "reboot", "--rom")
    assert "refuses MSP REBOOT: this firmware or its settings have no such thing" in err
    assert msp(resting_host, "info")[0] == 0  # it goes on


def test_what_acts_tells_it_as_json_when_asked(msp: Run, resting_host: str) -> None:
    for words, told in (
        ("settings set roll_expo=0.1", {"changed": {"roll_expo": 0.1}, "stored": False, "rebooted": False}),
        ("settings save", {"stored": True}),
        ("settings defaults --yes", {"defaults": True, "stored": False}),
        ("acknowledge", {"fault": None, "refused": "NONE"}),
        ("motors stop", {"standing": True}),
    ):
        code, out, err = msp(resting_host, *words.split(), "--json")
        assert (code, json.loads(out), err) == (0, told, ""), words


# --- Scripted peers --------------------------------------------------------------------------
REGISTERS = tuple(range(0x08000000, 0x08000000 + len(FAULT_REGISTERS)))


def fault(kind: FaultKind, file: str = "", line: int = 0) -> bytes:
    """A reply to FAULTS: of boot 12, found by boot 11."""
    record = struct.pack(f"<I{len(REGISTERS)}II", kind, *REGISTERS, line)
    record += file.encode().ljust(FAULT_FILE_BYTES, b"\0") + struct.pack("<I", 4321)
    return struct.pack("<I?I", 12, True, 11) + record


API = {int(Msp.API_VERSION): b"\x00\x01\x2e"}


def test_a_fault_is_told_in_words_when_one_is_pending(msp: Run, tcp_server: Serve) -> None:
    asked: list[tuple[int, bytes]] = []
    record = fault(FaultKind.ASSERT, "src/control/mixer.c", 77)
    port = tcp_server(answering(API | {Msp.FAULTS: record, Msp.SAFETY: safety()}, asked))
    out = msp.told(port, "faults")
    words = " ".join(out.split())
    assert "fault ASSERT: a check in the firmware failed" in words
    assert "found by boot 11; this is boot 12" in words
    assert "after 4321 control steps" in words
    assert "at src/control/mixer.c:77" in words
    assert "r0 08000000, r1 08000001" in words and "pc 08000006" in words
    assert (Msp.FAULTS, struct.pack("<I", 11)) not in asked
    told = json.loads(msp(port, "faults", "--ack", "--json")[1])
    assert (told["acknowledged"], told["fault"]["kind"], told["fault"]["line"]) == (True, "ASSERT", 77)
    assert asked[-1] == (Msp.FAULTS, struct.pack("<I", 11))


def test_the_faults_own_boot_is_acknowledged_once_when_asked_to(msp: Run, tcp_server: Serve) -> None:
    asked: list[tuple[int, bytes]] = []
    told = API | {Msp.FAULTS: fault(FaultKind.HARD), Msp.SAFETY: safety()}
    out = msp.told(tcp_server(answering(told, asked)), "faults", "--ack")
    assert out.endswith("acknowledged: the fault that boot 11 found\n")
    assert [payload for command, payload in asked if command == Msp.FAULTS] == [b"", struct.pack("<I", 11)]


def safety(**values: Any) -> bytes:
    told = {
        "state": FlightState.DISARMED,
        "stop": StopCause.CRASH,
        "fallback": FallbackCause.OSCILLATION,
        "refused": FallbackCause.OSCILLATION,
        "reasons": 1 << ArmingReason.POLICY_REFUSED,
    } | values
    return struct.pack(
        "<4BI3?BhfB",
        *(told["state"], told["stop"], told["fallback"], GyroHealth.GOOD, told["reasons"]),
        *(True, True, True, 97, 2534, 0.05, told["refused"]),
    )


def test_causes_are_told_in_words_when_there_were_any(msp: Run, tcp_server: Serve, resting_host: str) -> None:
    port = tcp_server(answering({Msp.SAFETY: safety()}, through=resting_host))
    out = msp.told(port, "status")
    words = " ".join(out.split())
    assert "state disarmed" in words and "flies PID" in words
    assert f"POLICY_REFUSED: {HINTS['POLICY_REFUSED']}" in words
    assert "motors stopped last crash PID took over last oscillation policy refused oscillation" in words
    assert "gyro good, 25.3 deg C" in words and "receiver 97 %" in words


def test_rotors_are_told_when_their_escs_answer(msp: Run, tcp_server: Serve, resting_host: str) -> None:
    rows = ((7210, 0, 0, 0, 0), (7180, 150, 31, 1575, 420), (0, 10_000, 0, 0, 0))
    telemetry = b"\x03" + b"".join(struct.pack("<IHBHHH", *row, 0) for row in rows)
    port = tcp_server(answering({Msp.MOTOR_TELEMETRY: telemetry}, through=resting_host))
    words = " ".join(msp.told(port, "status").split())
    lost = "7,180 rpm (31 deg C, 15.75 V, 4.2 A, 1.5 % of its answers lost)"
    assert f"rotors 7,210 rpm, {lost}, silent" in words
    quiet = tcp_server(answering({Msp.MOTOR_TELEMETRY: b"\x04" + bytes(52)}, through=resting_host))
    assert "rotors" not in msp.told(quiet, "status")


STATUS_EX = bytes.fromhex("f401 0000 2100 01000000 00 0a00 03 00 00 1d 80200010 00 2900")
BETAFLIGHT_PEER: dict[int, bytes] = {
    Msp.API_VERSION: b"\x00\x01\x2f",
    Msp.STATUS_EX: STATUS_EX,
    Msp.BATTERY_STATE: struct.pack("<BHBHhBH", 4, 1500, 160, 12, 345, 0, 1603),
    Msp.ATTITUDE: struct.pack("<3h", 105, -52, 271),
    Msp.ANALOG: struct.pack("<BHHhH", 160, 12, 1023, 345, 1603),
}


def test_status_tells_what_there_is_when_the_firmware_is_of_another_make(msp: Run, tcp_server: Serve) -> None:
    out = msp.told(tcp_server(answering(BETAFLIGHT_PEER)), "status")
    words = " ".join(out.split())
    assert "armed yes arming held by THROTTLE CLI ARM_SWITCH battery 16.03 V, 4 cells, good" in words
    assert "receiver 100 % attitude roll 10.5, pitch -5.2, heading 271 deg" in words
    told = json.loads(msp(tcp_server(answering(BETAFLIGHT_PEER)), "status", "--json")[1])
    assert told["flight"] is None


def test_one_line_names_the_versions_when_the_api_is_another(msp: Run, tcp_server: Serve) -> None:
    err = msp.refused(tcp_server(answering({Msp.API_VERSION: b"\x00\x02\x00"})), "status")
    assert "speaks MSP 0.2.0, expected 0.1.x" in err


# --- Starting anew ---------------------------------------------------------------------------
class Restarting:
    """A peer that answers `silent` polls of the old start after REBOOT, then as a new one."""

    def __init__(self, still: int, boots: int = 7) -> None:
        self.still, self.boots, self.rebooting = still, boots, False
        self.reboots = 0
        self._decoder = Decoder()

    def __call__(self, data: bytes) -> bytes:
        return b"".join(
            encode(self._answer(event)) for event in self._decoder.feed(data) if isinstance(event, Message)
        )

    def _answer(self, asked: Message) -> Message:
        if asked.command == Msp.REBOOT:
            self.rebooting, self.reboots = True, self.reboots + 1
        elif asked.command == Msp.FAULTS:
            if self.rebooting and self.still == 0:
                self.boots, self.rebooting = self.boots + 1, False
            self.still -= self.rebooting
            return reply(asked, struct.pack("<I?", self.boots, False))
        return reply(asked, b"\x00\x01\x2e")


@pytest.mark.parametrize("still", [0, 3])
def test_it_is_back_only_when_its_boots_have_counted_on(tcp_server: Serve, still: int) -> None:
    firmware = Restarting(still)
    port = tcp_server(firmware)
    with restart(Client(open_transport(port)), lambda: open_transport(port)) as client:
        assert client.name == port
    assert (firmware.boots, firmware.reboots) == (8, 1)


def test_the_line_is_opened_again_when_it_went_with_the_firmware(tcp_server: Serve) -> None:
    firmware = Restarting(0)
    hung_up: list[bool] = []
    opened: list[Any] = []

    def answer(data: bytes) -> bytes:
        if firmware.rebooting and not hung_up:
            hung_up.append(True)
            return b"HANG UP"
        return firmware(data)

    port = tcp_server(answer)

    def reopen() -> Any:
        opened.append(open_transport(port))
        return opened[-1]

    with restart(Client(open_transport(port)), reopen, sleep=lambda _: None):
        assert len(opened) == 1
    assert firmware.reboots == 1


class Foreign:
    """A firmware of another make: answers `still` requests after REBOOT, passes over one, then answers."""

    def __init__(self, still: int) -> None:
        self.still, self.silent, self.rebooting = still, 1, False
        self.answered_anew = 0
        self._decoder = Decoder()

    def __call__(self, data: bytes) -> bytes:
        asked = [event for event in self._decoder.feed(data) if isinstance(event, Message)]
        return b"".join(self._answer(one) for one in asked)

    def _answer(self, asked: Message) -> bytes:
        if asked.command == Msp.IDENTITY:
            return encode(error(asked))
        if self.rebooting and self.still == 0 and self.silent > 0:
            self.silent -= 1
            return b""
        if self.rebooting and self.still == 0:
            self.answered_anew += 1
        elif self.rebooting:
            self.still -= 1
        self.rebooting |= asked.command == Msp.REBOOT
        return encode(reply(asked, b"\x00\x01\x2f"))


@pytest.mark.parametrize("still", [0, 3])
def test_it_is_back_only_after_its_silence_when_it_is_of_another_make(tcp_server: Serve, still: int) -> None:
    firmware = Foreign(still)
    port = tcp_server(firmware)
    with restart(Client(open_transport(port)), lambda: open_transport(port), sleep=lambda _: None):
        assert (firmware.still, firmware.silent) == (0, 0)
        assert firmware.answered_anew > 0


def test_one_line_says_so_when_a_firmware_of_another_make_goes_on_answering(
    tcp_server: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(restarting, "GOING_S", 0.2)
    port = tcp_server(Foreign(10**6))
    with pytest.raises(LinkError, match=r"answers without a break for 0\.2 s; it did not start anew"):
        restart(Client(open_transport(port)), lambda: open_transport(port), sleep=lambda _: None)


def test_nothing_is_waited_for_when_the_firmware_refuses_to_start_anew(tcp_server: Serve) -> None:
    port = tcp_server(answering(API | {Msp.POLICY_INFO: b"", Msp.FAULTS: struct.pack("<I?", 7, False)}))
    with pytest.raises(LinkError, match="refuses MSP REBOOT"):
        restart(Client(open_transport(port)), lambda: open_transport(port))


def test_the_command_says_that_it_is_back(msp: Run, tcp_server: Serve) -> None:
    port = tcp_server(Restarting(1))
    assert msp(port, "reboot") == (0, f"{port}: the firmware has started anew and answers\n", "")
    assert json.loads(msp(port, "reboot", "--json")[1]) == {"started": "firmware"}
