"""`neuroflight board rc` against the host program: its interlocks, its sources and its last words."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.cli.board.rc import Channels
from neuroflight.cli.main import main, parse
from neuroflight.flash.channels.gamepad import Gamepad, Mapping
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.msp import Decoder, Message
from neuroflight.toolchain.contract import Msp, StopCause
from neuroflight.toolchain.errors import NeuroflightError
from tests.flash.lockstep import Lockstep, lockstep
from tests.flash.virtual_pad import AXES, FULL, Pad
from tests.forked import Forked

SCRIPT = "t_s,throttle,aux1\n0,1000,1000\n0.5,1000,2000\n1,1300,\n1.5,,\n"


@pytest.fixture
def flown(host_program: Path) -> Iterator[Lockstep]:
    """A program that takes its channels over MSP."""
    with lockstep(host_program, "--set=receiver_protocol=msp", receiver=False) as one:
        yield one


@pytest.fixture
def script(tmp_path: Path) -> str:
    path = tmp_path / "hop.csv"
    path.write_text(SCRIPT)
    return str(path)


def run(flown: Lockstep, *words: str) -> int:
    args = parse(["board", "rc", "--port", flown.port, *words])
    return Channels.parsed(args).carry_out(flown.clock, flown.sleep)


def test_a_script_is_flown_and_ends_disarmed(
    flown: Lockstep, script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(flown, "--script", script, "--allow-arm", "--props-off") == 0
    out = capsys.readouterr().out
    assert out.endswith("frames taken; the board is disarmed\n") and out.count("\n") == 1
    assert max(flown.most) > 0.1 and flown.run(1) == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--script", "SCRIPT"], "at 0.5 s the arm switch is on, expected off without --allow-arm"),
        (
            ["--script", "SCRIPT", "--allow-arm"],
            "take the propellers off and give --props-off; no motor turned",
        ),
        (["--scenario", "roll"], "scenario roll: it arms, expected --allow-arm"),
        (["--scenario", "roll", "--allow-arm"], "take the propellers off and give --props-off"),
        (["--scenario", "loop", "--allow-arm", "--props-off"], "scenario 'loop': no such file"),
        (["--scenario", "sticks", "--allow-arm", "--props-off"], "its pilot flies by the twin's height"),
        (["--script", "SCRIPT", "--rate", "10"], "--rate 10, expected 20 to 150 Hz"),
        (["--gamepad", "99"], "--gamepad got 99, and no gamepad(s) are there"),
        (["--gamepad", "--axis", "throttle"], "--axis got 'throttle', expected CHANNEL=NUMBER"),
    ],
)
def test_nothing_is_sent_when_an_interlock_is_closed(
    flown: Lockstep, script: str, words: list[str], told: str
) -> None:
    with pytest.raises(NeuroflightError) as error:
        run(flown, *(script if word == "SCRIPT" else word for word in words))
    assert told in str(error.value)
    with flown.client() as client:
        reasons = messages.arming_reasons(records.safety(client.request(Msp.SAFETY)).arming_flags)
    assert "RECEIVER_LOST" in reasons  # no frame ever came
    assert flown.most == (0, 0, 0, 0)


def test_a_scenario_of_the_simulator_is_flown(host_program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # On a bench no gyro follows what the sticks ask for: that would be a crash.
    options = ("--set=receiver_protocol=msp", "--set=crash_detection=off")
    with lockstep(host_program, *options, receiver=False) as one:
        assert run(one, "--scenario", "roll", "--allow-arm", "--props-off") == 0
        assert capsys.readouterr().out.endswith("the board is disarmed\n")
        assert max(one.most) > 0.5  # a turn at 720 deg/s is asked for
        with one.client() as client:
            assert records.safety(client.request(Msp.SAFETY)).stop_cause is StopCause.SWITCH


def test_a_scenario_is_refused_when_its_switch_does_not_arm_this_board(flown: Lockstep) -> None:
    assert main(["board", "settings", "set", "--port", flown.port, "mode1=arm aux5 1700 2100"]) == 0
    with pytest.raises(NeuroflightError, match="its arm switch does not arm this board"):
        run(flown, "--scenario", "roll", "--allow-arm", "--props-off")


def test_how_to_set_the_receiver_is_said_when_it_is_another(
    booted: Lockstep, script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--script", script, "--allow-arm", "--props-off")
    with pytest.raises(NeuroflightError) as error:
        run(booted, *words)
    command = (
        f"run: neuroflight board settings set --port {booted.port} receiver_protocol=msp --save --reboot"
    )
    assert "receiver_protocol is sbus, so the board listens to its receiver" in str(error.value)
    assert str(error.value).endswith(command)
    assert capsys.readouterr().out == ""
    assert main(["board", "settings", "set", "--port", booted.port, "receiver_protocol=msp"]) == 0
    with pytest.raises(NeuroflightError, match="receiver_protocol is msp, and not flown before a restart"):
        run(booted, *words)


def test_a_gamepad_flies_and_its_unplugging_disarms(
    flown: Lockstep, capsys: pytest.CaptureFixture[str], plugged: Pad
) -> None:
    pads: list[Gamepad] = []

    def sleep(seconds: float) -> None:
        """What a hand does, by the firmware's time."""
        flown.sleep(seconds)
        if flown.samples > 2500:
            plugged.button(pads[0], 4, True)  # held: armed
        if flown.samples > 3000:
            plugged.axis(pads[0], 1, -FULL // 4)
        if 4000 < flown.samples < 4050 and any(flown.turned[-1]):
            plugged.unplug()

    class Held(Gamepad):
        def __init__(self, index: int, mapping: Mapping) -> None:
            super().__init__(index, mapping)
            pads.append(self)
            for axis in range(AXES):
                plugged.axis(self, axis, 0)

    words = ["board", "rc", "--port", flown.port, "--gamepad", str(plugged.index)]
    words += ["--allow-arm", "--props-off"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("neuroflight.flash.channels.gamepad.Gamepad", Held)
        with pytest.raises(NeuroflightError, match=r"the gamepad 'Virtual .*' is gone"):
            Channels.parsed(parse(words)).carry_out(flown.clock, sleep)
    assert capsys.readouterr().out.endswith("the board is disarmed\n")
    assert max(flown.most) > 0.2 and flown.run(1) == (0, 0, 0, 0)
    with flown.client() as client:
        assert records.safety(client.request(Msp.SAFETY)).stop_cause is StopCause.SWITCH
    assert 4.0 < flown.clock() < 4.5


@pytest.fixture
def long_script(tmp_path: Path) -> str:
    path = tmp_path / "long.csv"
    path.write_text("t_s,throttle,aux1\n0,1000,1000\n0.3,1000,2000\n0.6,1400,\n600,,\n")
    return str(path)


def test_it_disarms_at_ctrl_c(flown: Lockstep, long_script: str, capsys: pytest.CaptureFixture[str]) -> None:
    def sleep(seconds: float) -> None:
        flown.sleep(seconds)
        if max(flown.turned[-1]) > 0.1:
            signal.raise_signal(signal.SIGINT)

    words = ["--script", long_script, "--allow-arm", "--props-off", "--port", flown.port]
    assert Channels.parsed(parse(["board", "rc", *words])).carry_out(flown.clock, sleep) == 0
    assert capsys.readouterr().out.endswith("the board is disarmed\n")
    assert flown.run(1) == (0, 0, 0, 0)


def test_it_disarms_when_the_process_is_told_to_end(
    flown: Lockstep, long_script: str, pty_line: Callable[..., str]
) -> None:
    """Each frame that the process sends is 20 ms to the firmware."""
    flying, decoder = threading.Event(), Decoder()

    def down(data: bytes) -> bytes:
        asked = [event for event in decoder.feed(data) if isinstance(event, Message)]
        if any(one.command == Msp.SET_RAW_RC for one in asked) and max(flown.run(20)) > 0.1:
            flying.set()
        return data

    words = ("--script", long_script, "--allow-arm", "--props-off", "--port", pty_line(flown.port, down=down))
    process = Forked("board", "rc", *words)
    assert flying.wait(20)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=20)
    # A busy machine may send late, which is told; nothing else is.
    told = [line for line in err.splitlines() if "sending falls behind" not in line]
    assert (process.returncode, told) == (0, [])
    assert out.endswith("the board is disarmed\n")
    assert flown.run(1) == (0, 0, 0, 0)
    with flown.client() as client:
        assert records.safety(client.request(Msp.SAFETY)).stop_cause is StopCause.SWITCH


def test_one_line_says_what_is_wrong_with_the_port(
    free_tcp_port: int, script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for port, told in (
        ("/dev/does-not-exist", "there is no such device"),
        (f"tcp:127.0.0.1:{free_tcp_port}", "nobody listens there"),
    ):
        assert main(["board", "rc", "--script", script, "--port", port]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and told in err
