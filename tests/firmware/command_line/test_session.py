"""command_line.c on a port: sessions, lines, and the way back to MSP."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import SETTINGS, ArmingReason, Msp, Refusal
from tests.firmware.command_line.conftest import IdleFirmware

API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))
API_REPLY = b"$M>\x03\x01\x00\x01"
STX, ETX = b"\x02", b"\x03"


def test_the_greeting_says_what_configurators_wait_for_when_a_session_opens(idle: IdleFirmware) -> None:
    said = idle.open()
    assert "CLI" in said
    assert said.startswith("\r\nNeuroflight "), "the app shows what follows the first line end"
    assert said.count("\r\n") == 2
    assert said.endswith("\r\n# ")


def test_nothing_happens_when_it_is_armed(idle: IdleFirmware) -> None:
    idle.run(50, arm=2000)
    assert idle.armed
    assert idle.send(b"#") == idle.send(b"\x02version\n\x03") == idle.send(b"save\r") == b""
    assert idle.send(API).startswith(API_REPLY)
    idle.run(50, arm=2000)
    assert idle.armed


def test_nothing_arms_while_a_session_is_open(idle: IdleFirmware) -> None:
    idle.open()
    idle.run(20)
    assert idle.reasons() == (ArmingReason.CLI,)
    idle.run(200, arm=2000)
    assert not idle.armed
    idle.hang_up()
    idle.run(100, arm=2000)
    assert not idle.armed, "the switch went on while it was forbidden"
    idle.run(100)
    idle.run(100, arm=2000)
    assert idle.armed


def test_arming_stays_forbidden_until_the_last_of_two_sessions_ends(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.send(b"#", port=1).endswith(b"# ")
    idle.hang_up(port=0)
    idle.run(20)
    assert b"CLI" in idle.send(b"status\r", port=1)
    idle.hang_up(port=1)
    idle.run(20)
    assert idle.reasons() == ()


@pytest.mark.parametrize("before", ["", "se", "set gyro_rate_hz = ", "$", "$M", "x" * 200])
def test_msp_is_answered_again_when_a_request_comes(idle: IdleFirmware, before: str) -> None:
    idle.open()
    idle.send(before.encode())
    said = idle.send(API) + idle.send(API)  # half a header takes a request with it
    assert API_REPLY in said
    assert before or said.startswith(API_REPLY), "nothing of a request is echoed"
    assert idle.send(API).startswith(API_REPLY)
    idle.run(20)
    assert idle.reasons() == ()
    assert idle.open().startswith("\r\nNeuroflight"), "nothing of the line is left"
    assert idle.tell("faults")


def test_both_versions_of_a_request_end_a_session(idle: IdleFirmware) -> None:
    for version in Version:
        idle.open()
        said = idle.send(encode(Message(version, Direction.REQUEST, Msp.API_VERSION, b"")))
        assert said.startswith(b"$")


def test_a_session_ends_when_nothing_is_typed_for_five_minutes(idle: IdleFirmware) -> None:
    idle.open()
    idle.wait(299)
    assert idle.send(b"x") == b"x"
    idle.wait(299)
    idle.run(20)
    assert ArmingReason.CLI in idle.reasons()
    idle.wait(2)
    idle.run(20)
    assert ArmingReason.CLI not in idle.reasons()
    assert idle.send(b"version\r") == b""
    assert idle.send(API).startswith(API_REPLY)


def test_a_frame_ends_when_its_peer_is_silent(idle: IdleFirmware) -> None:
    assert idle.send(STX) == STX, "Betaflight begins its answer at once"
    assert idle.send(b"vers") == b""
    idle.run(1990)
    assert idle.reasons() == (ArmingReason.CLI,)
    idle.run(50)
    assert idle.reasons() == ()
    assert idle.send(b"ion\n" + ETX) == b""


# --- Lines
def test_what_is_typed_is_echoed_and_carried_out_at_its_end(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.send(b"versi") == b"versi"
    assert idle.send(b"on") == b"on"
    said = idle.send(b"\r\n").decode()
    assert said.startswith("\r\nNeuroflight ")
    assert said.endswith("\r\n# ")
    assert said.count("# ") == 1, "CR and LF are one end"
    assert idle.send(b"\n\n") == b"\r\n# \r\n# "


def test_backspace_takes_a_character_back(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.send(b"a\x08\x7f") == b"a\b \b"
    said = idle.send(b"versiom\x08n\r").decode()
    assert said.startswith("versiom\b \bn\r\nNeuroflight")


def test_control_c_drops_the_line(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.send(b"defaults\x03") == b"defaults\r\n# "
    assert idle.tell("faults")[0].startswith("boots")


@pytest.mark.parametrize(
    "line", [b"defaults" + b" " * 90, b"def\x01aults", b"\xffdefaults", b"\x1b[Adefaults", b"$M<\x02defaults"]
)
def test_nothing_of_a_line_is_carried_out_when_it_is_no_text_or_too_long(
    idle: IdleFirmware, line: bytes
) -> None:
    idle.set("msp_variant", 1, "uint32_t")
    before = idle.settings()
    idle.open()
    idle.send(line)
    idle.pause()
    said = idle.send(b"\r").decode()
    assert said.count("###ERROR") == 1
    assert "nothing of" in said
    assert idle.settings() == before
    assert idle.tell("save") == [SAVE_REFUSED]


SAVE_REFUSED = (
    "###ERROR save: nothing written, for there were errors; "
    "'save force' saves all the same, 'defaults' begins anew"
)


@pytest.mark.parametrize("line", ["#", "# a comment", "#" * 300, "   ", "# caf\xe9"])
def test_a_comment_does_nothing_however_it_looks(idle: IdleFirmware, line: str) -> None:
    idle.open()
    said = idle.send(line.encode() + b"\r")
    assert said.endswith(b"\r\n# ")
    assert b"ERROR" not in said


def test_nothing_of_a_line_is_carried_out_when_some_of_it_was_lost(idle: IdleFirmware) -> None:
    idle.open()
    idle.send(b"set craft_name = A")
    idle.lib.reference_link_lost(idle._memory, 0)
    before = idle.settings()
    said = idle.send(b"B\r").decode()
    assert "###ERROR bytes were lost" in said
    assert idle.settings() == before
    assert idle.tell("save") == [SAVE_REFUSED]


def test_a_loss_before_a_comment_is_told_too(idle: IdleFirmware) -> None:
    idle.open()
    idle.lib.reference_link_lost(idle._memory, 0)
    assert b"###ERROR" in idle.send(b"# comment\r")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(noise=st.binary(max_size=300), capacity=st.sampled_from([300, 600, 4096]))
def test_msp_is_answered_whatever_came_before(idle: IdleFirmware, noise: bytes, capacity: int) -> None:
    idle.send(noise, capacity=capacity)
    idle.lib.reference_link_reset(idle._memory, 1)
    said = b"".join(idle.send(API) for _ in range(120))  # a jumbo header may swallow as many
    assert API_REPLY in said
    assert idle.send(API).startswith(API_REPLY)
    idle.hang_up()


# --- Output
@pytest.mark.parametrize("capacity", [250, 300, 777, 4096])
def test_long_output_is_whole_however_little_room_there_is(idle: IdleFirmware, capacity: int) -> None:
    idle.open()
    whole = idle.type("dump")
    assert idle.type("dump", capacity=capacity) == whole
    assert whole.count("\r\nset ") == len(SETTINGS)


def test_bytes_wait_while_output_is_outstanding(idle: IdleFirmware) -> None:
    idle.open()
    first = idle.link(b"dump\rversion\r", capacity=300)
    assert idle.lib.reference_link_busy(idle._memory, 0)
    rest = b""
    while more := idle.link(b"", capacity=300):
        rest += more
    said = (first + rest).decode()
    assert said.index("# now 'save' keeps") < said.index("version\r\nNeuroflight")
    assert not idle.lib.reference_link_busy(idle._memory, 0)


def test_what_is_more_than_can_wait_is_told_as_lost(idle: IdleFirmware) -> None:
    idle.open()
    idle.link(b"dump\r", capacity=300)
    for _ in range(40):
        idle.link(b"set gyro_rate_hz = 2000\r", capacity=0)
    said = b""
    while more := idle.link(b""):
        said += more
    assert b"###ERROR bytes were lost" in said + idle.send(b"\r")


# --- Frames
def test_a_frame_is_answered_by_lines_in_a_frame(idle: IdleFirmware) -> None:
    said = idle.send(STX + b"version\n" + ETX)
    assert said.startswith(STX + b"Neuroflight ")
    assert said.count(STX) == said.count(ETX) == 1
    assert said.endswith(b"\r\n\x03")
    assert b"# " not in said
    idle.run(20)
    assert idle.reasons() == ()
    assert idle.send(API).startswith(API_REPLY)


def test_frames_are_answered_one_after_the_other_when_requests_of_msp_come_between(
    idle: IdleFirmware,
) -> None:
    said = idle.send(STX + b"diff all\n" + ETX + API + STX + b"mixer list\n" + ETX)
    while more := idle.send(b""):
        said += more
    diff, _, rest = said.partition(ETX)
    assert diff.startswith(STX + b"# Neuroflight 0.1.0 on ") and b"\r\ndefaults\r\n" in diff
    assert rest.startswith(API_REPLY)
    assert rest.endswith(ETX) and STX + b"no mixer to choose" in rest


def test_a_frame_of_several_lines_is_answered_by_all(idle: IdleFirmware) -> None:
    said = idle.send(STX + b"set craft_name = A\nget craft_name\n" + ETX)
    assert said.startswith(STX + b"craft_name = A (")
    assert said.count(ETX) == 1


def test_a_frame_with_half_a_line_does_nothing_but_tell(idle: IdleFirmware) -> None:
    before = idle.settings()
    said = idle.send(STX + b"set craft_name = A" + ETX)
    assert said.startswith(STX + b"###ERROR line without its end")
    assert said.endswith(ETX)
    assert idle.settings() == before


def test_an_error_in_a_frame_keeps_that_frame_from_saving(idle: IdleFirmware) -> None:
    assert SAVE_REFUSED.encode() in idle.send(STX + b"set craft_nam = A\nsave\n" + ETX)


def test_a_frame_saves_when_the_pilot_has_read_of_errors_in_another(idle: IdleFirmware) -> None:
    assert b"###ERROR" in idle.send(STX + b"set craft_nam = A\n" + ETX)
    assert b"saved" in idle.send(STX + b"save\n" + ETX)


def test_no_motor_turns_when_a_frame_asks_for_it(idle: IdleFirmware) -> None:
    assert b"###ERROR motor: only a typed session" in idle.send(STX + b"motor test on\n" + ETX)
    assert b"###ERROR motor: no motor test is open" in idle.send(STX + b"motor 1 1100 5\n" + ETX)
    assert idle.run(20) == [0] * 4


def test_a_refused_session_leaves_arming_as_it_was(idle: IdleFirmware) -> None:
    idle.run(50, arm=2000)
    idle.send(b"#")
    idle.run(50)
    idle.run(50, arm=2000)
    assert idle.armed
    assert Refusal(idle.set("msp_variant", 1, "uint32_t").payload[0]) is Refusal.ARMED
