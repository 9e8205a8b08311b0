"""command_line.c on a port: sessions, lines, and the way back to MSP."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import SETTINGS, ArmingReason, Msp, Refusal
from tests.firmware.command_line.conftest import Desk

API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))
API_REPLY = b"$M>\x03\x01\x00\x01"
STX, ETX = b"\x02", b"\x03"


def test_the_greeting_says_what_configurators_wait_for_when_a_session_opens(desk: Desk) -> None:
    said = desk.open()
    assert "CLI" in said
    assert said.startswith("\r\nNeuroflight "), "the app shows what follows the first line end"
    assert said.count("\r\n") == 2
    assert said.endswith("\r\n# ")


def test_nothing_happens_when_it_is_armed(desk: Desk) -> None:
    desk.run(50, arm=2000)
    assert desk.armed
    assert desk.send(b"#") == desk.send(b"\x02version\n\x03") == desk.send(b"save\r") == b""
    assert desk.send(API).startswith(API_REPLY)
    desk.run(50, arm=2000)
    assert desk.armed


def test_nothing_arms_while_a_session_is_open(desk: Desk) -> None:
    desk.open()
    desk.run(20)
    assert desk.reasons() == (ArmingReason.CLI,)
    desk.run(200, arm=2000)
    assert not desk.armed
    desk.hang_up()
    desk.run(100, arm=2000)
    assert not desk.armed, "the switch went on while it was forbidden"
    desk.run(100)
    desk.run(100, arm=2000)
    assert desk.armed


def test_arming_stays_forbidden_until_the_last_of_two_sessions_ends(desk: Desk) -> None:
    desk.open()
    assert desk.send(b"#", port=1).endswith(b"# ")
    desk.hang_up(port=0)
    desk.run(20)
    assert b"CLI" in desk.send(b"status\r", port=1)
    desk.hang_up(port=1)
    desk.run(20)
    assert desk.reasons() == ()


@pytest.mark.parametrize("before", ["", "se", "set gyro_rate_hz = ", "$", "$M", "x" * 200])
def test_msp_is_answered_again_when_a_request_comes(desk: Desk, before: str) -> None:
    desk.open()
    desk.send(before.encode())
    said = desk.send(API) + desk.send(API)  # half a header takes a request with it
    assert API_REPLY in said
    assert before or said.startswith(API_REPLY), "nothing of a request is echoed"
    assert desk.send(API).startswith(API_REPLY)
    desk.run(20)
    assert desk.reasons() == ()
    assert desk.open().startswith("\r\nNeuroflight"), "nothing of the line is left"
    assert desk.tell("faults")


def test_both_versions_of_a_request_end_a_session(desk: Desk) -> None:
    for version in Version:
        desk.open()
        said = desk.send(encode(Message(version, Direction.REQUEST, Msp.API_VERSION, b"")))
        assert said.startswith(b"$")


def test_a_session_ends_when_nothing_is_typed_for_five_minutes(desk: Desk) -> None:
    desk.open()
    desk.wait(299)
    assert desk.send(b"x") == b"x"
    desk.wait(299)
    desk.run(20)
    assert ArmingReason.CLI in desk.reasons()
    desk.wait(2)
    desk.run(20)
    assert ArmingReason.CLI not in desk.reasons()
    assert desk.send(b"version\r") == b""
    assert desk.send(API).startswith(API_REPLY)


def test_a_frame_ends_when_its_peer_is_silent(desk: Desk) -> None:
    assert desk.send(STX) == STX, "Betaflight begins its answer at once"
    assert desk.send(b"vers") == b""
    desk.run(1990)
    assert desk.reasons() == (ArmingReason.CLI,)
    desk.run(50)
    assert desk.reasons() == ()
    assert desk.send(b"ion\n" + ETX) == b""


# --- Lines
def test_what_is_typed_is_echoed_and_carried_out_at_its_end(desk: Desk) -> None:
    desk.open()
    assert desk.send(b"versi") == b"versi"
    assert desk.send(b"on") == b"on"
    said = desk.send(b"\r\n").decode()
    assert said.startswith("\r\nNeuroflight ")
    assert said.endswith("\r\n# ")
    assert said.count("# ") == 1, "CR and LF are one end"
    assert desk.send(b"\n\n") == b"\r\n# \r\n# "


def test_backspace_takes_a_character_back(desk: Desk) -> None:
    desk.open()
    assert desk.send(b"a\x08\x7f") == b"a\b \b"
    said = desk.send(b"versiom\x08n\r").decode()
    assert said.startswith("versiom\b \bn\r\nNeuroflight")


def test_control_c_drops_the_line(desk: Desk) -> None:
    desk.open()
    assert desk.send(b"defaults\x03") == b"defaults\r\n# "
    assert desk.tell("faults")[0].startswith("boots")


@pytest.mark.parametrize(
    "line", [b"defaults" + b" " * 90, b"def\x01aults", b"\xffdefaults", b"\x1b[Adefaults", b"$M<\x02defaults"]
)
def test_nothing_of_a_line_is_carried_out_when_it_is_no_text_or_too_long(desk: Desk, line: bytes) -> None:
    desk.set("msp_variant", 1, "uint32_t")
    before = desk.settings()
    desk.open()
    desk.send(line)
    desk.pause()
    said = desk.send(b"\r").decode()
    assert said.count("###ERROR") == 1
    assert "nothing of" in said
    assert desk.settings() == before
    assert desk.tell("save") == [SAVE_REFUSED]


SAVE_REFUSED = (
    "###ERROR save: nothing written, for there were errors; "
    "'save force' saves all the same, 'defaults' begins anew"
)


@pytest.mark.parametrize("line", ["#", "# a comment", "#" * 300, "   ", "# caf\xe9"])
def test_a_comment_does_nothing_however_it_looks(desk: Desk, line: str) -> None:
    desk.open()
    said = desk.send(line.encode() + b"\r")
    assert said.endswith(b"\r\n# ")
    assert b"ERROR" not in said


def test_nothing_of_a_line_is_carried_out_when_some_of_it_was_lost(desk: Desk) -> None:
    desk.open()
    desk.send(b"set craft_name = A")
    desk.lib.reference_link_lost(desk._memory, 0)
    before = desk.settings()
    said = desk.send(b"B\r").decode()
    assert "###ERROR bytes were lost" in said
    assert desk.settings() == before
    assert desk.tell("save") == [SAVE_REFUSED]


def test_a_loss_before_a_comment_is_told_too(desk: Desk) -> None:
    desk.open()
    desk.lib.reference_link_lost(desk._memory, 0)
    assert b"###ERROR" in desk.send(b"# comment\r")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(noise=st.binary(max_size=300), capacity=st.sampled_from([300, 600, 4096]))
def test_msp_is_answered_whatever_came_before(desk: Desk, noise: bytes, capacity: int) -> None:
    desk.send(noise, capacity=capacity)
    desk.lib.reference_link_reset(desk._memory, 1)
    said = b"".join(desk.send(API) for _ in range(120))  # a jumbo header may swallow as many
    assert API_REPLY in said
    assert desk.send(API).startswith(API_REPLY)
    desk.hang_up()


# --- Output
@pytest.mark.parametrize("capacity", [250, 300, 777, 4096])
def test_long_output_is_whole_however_little_room_there_is(desk: Desk, capacity: int) -> None:
    desk.open()
    whole = desk.type("dump")
    assert desk.type("dump", capacity=capacity) == whole
    assert whole.count("\r\nset ") == len(SETTINGS)


def test_bytes_wait_while_output_is_outstanding(desk: Desk) -> None:
    desk.open()
    first = desk.link(b"dump\rversion\r", capacity=300)
    assert desk.lib.reference_link_busy(desk._memory, 0)
    rest = b""
    while more := desk.link(b"", capacity=300):
        rest += more
    said = (first + rest).decode()
    assert said.index("# now 'save' keeps") < said.index("version\r\nNeuroflight")
    assert not desk.lib.reference_link_busy(desk._memory, 0)


def test_what_is_more_than_can_wait_is_told_as_lost(desk: Desk) -> None:
    desk.open()
    desk.link(b"dump\r", capacity=300)
    for _ in range(40):
        desk.link(b"set gyro_rate_hz = 2000\r", capacity=0)
    said = b""
    while more := desk.link(b""):
        said += more
    assert b"###ERROR bytes were lost" in said + desk.send(b"\r")


# --- Frames
def test_a_frame_is_answered_by_lines_in_a_frame(desk: Desk) -> None:
    said = desk.send(STX + b"version\n" + ETX)
    assert said.startswith(STX + b"Neuroflight ")
    assert said.count(STX) == said.count(ETX) == 1
    assert said.endswith(b"\r\n\x03")
    assert b"# " not in said
    desk.run(20)
    assert desk.reasons() == ()
    assert desk.send(API).startswith(API_REPLY)


def test_frames_are_answered_one_after_the_other_when_requests_of_msp_come_between(desk: Desk) -> None:
    said = desk.send(STX + b"diff all\n" + ETX + API + STX + b"mixer list\n" + ETX)
    while more := desk.send(b""):
        said += more
    diff, _, rest = said.partition(ETX)
    assert diff.startswith(STX + b"# Neuroflight 0.1.0 on ") and b"\r\ndefaults\r\n" in diff
    assert rest.startswith(API_REPLY)
    assert rest.endswith(ETX) and STX + b"no mixer to choose" in rest


def test_a_frame_of_several_lines_is_answered_by_all(desk: Desk) -> None:
    said = desk.send(STX + b"set craft_name = A\nget craft_name\n" + ETX)
    assert said.startswith(STX + b"craft_name = A (")
    assert said.count(ETX) == 1


def test_a_frame_with_half_a_line_does_nothing_but_tell(desk: Desk) -> None:
    before = desk.settings()
    said = desk.send(STX + b"set craft_name = A" + ETX)
    assert said.startswith(STX + b"###ERROR line without its end")
    assert said.endswith(ETX)
    assert desk.settings() == before


def test_an_error_in_a_frame_keeps_that_frame_from_saving(desk: Desk) -> None:
    assert SAVE_REFUSED.encode() in desk.send(STX + b"set craft_nam = A\nsave\n" + ETX)


def test_a_frame_saves_when_the_pilot_has_read_of_errors_in_another(desk: Desk) -> None:
    assert b"###ERROR" in desk.send(STX + b"set craft_nam = A\n" + ETX)
    assert b"saved" in desk.send(STX + b"save\n" + ETX)


def test_no_motor_turns_when_a_frame_asks_for_it(desk: Desk) -> None:
    assert b"###ERROR motor: only a typed session" in desk.send(STX + b"motor test on\n" + ETX)
    assert b"###ERROR motor: no motor test is open" in desk.send(STX + b"motor 1 1100 5\n" + ETX)
    assert desk.run(20) == [0] * 4


def test_a_refused_session_leaves_arming_as_it_was(desk: Desk) -> None:
    desk.run(50, arm=2000)
    desk.send(b"#")
    desk.run(50)
    desk.run(50, arm=2000)
    assert desk.armed
    assert Refusal(desk.set("msp_variant", 1, "uint32_t").payload[0]) is Refusal.ARMED
