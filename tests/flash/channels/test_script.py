"""Scripts of channels, from files."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.channels.layout import NAMES, REST
from neuroflight.flash.channels.script import FILE_BYTES_MAX, check_script, parse_script, read_script
from neuroflight.flash.channels.source import Instead
from neuroflight.toolchain.errors import LinkError
from tests.flash.channels.test_layout import layout

CSV = b"""t_s, throttle, roll, aux1
# at rest first
0,,,
1.5, , , 2000

2, 1200, 1400,
3, , ,
"""
TOML = b"""
[[frame]]
t_s = 0
[[frame]]
t_s = 1.5
aux1 = 2000
[[frame]]
t_s = 2
throttle = 1200
roll = 1400
[[frame]]
t_s = 3.0
"""


@pytest.mark.parametrize(("data", "suffix"), [(CSV, ".csv"), (TOML, ".toml")])
def test_a_value_holds_until_a_later_row_names_another(data: bytes, suffix: str) -> None:
    script = parse_script(data, "it", suffix)
    assert script.at(0.0) == script.at(1.499) == REST

    def told(elapsed_s: float) -> dict[str, int]:
        channels = script.at(elapsed_s)
        assert not isinstance(channels, Instead)
        pairs = zip(NAMES, channels, REST, strict=True)
        return {name: us for name, us, rest in pairs if us != rest}

    assert told(1.5) == {"aux1": 2000}
    assert told(2.999) == {"aux1": 2000, "throttle": 1200, "roll": 1400}
    assert script.at(3.0) is script.at(99.0) is Instead.END


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the first line lacks t_s"),
        ("t_s\n0\n", "1 rows, expected 2 to 100000: the last one is the end"),
        ("t_s,roll\n0,1500\n1\n", "line 3 has 1 values, expected 2 as the first line"),
        ("t_s,rol\n0,1500\n1,1500\n", "the first line names 'rol', expected t_s, roll, pitch"),
        ("t_s,roll,roll\n0,1,1\n", "the first line names roll twice"),
        ("t_s,roll\n1,1500\n2,1500\n", "line 2 begins at 1 s, expected 0"),
        ("t_s,roll\n0,1500\n0,1500\n", "line 3 is at 0 s, expected later than 0 s"),
        ("t_s,roll\n0,1500\n1e9,1500\n", "line 3 is at 1e+09 s, expected later than 0 s and at most 3600 s"),
        ("t_s,roll\n0,1500\nnan,1500\n", "line 3 has no time t_s"),
        ("t_s,roll\n0,1500\n,1500\n", "line 3 has no time t_s"),
        ("t_s,roll\n0,2251\n1,\n", "line 2, roll: got 2251 us, expected 750 to 2250"),
        ("t_s,roll\n0,1500.5\n1,\n", "line 2, roll: got 1500.5, expected whole microseconds"),
        ("t_s,roll\n0,inf\n1,\n", "line 2, roll: got inf, expected whole microseconds"),
        ("t_s,roll\n0,much\n1,\n", "line 2 has 'much', expected a number"),
        ('t_s,roll\n0,"1500\n', "unexpected end of data"),
    ],
)
def test_one_line_names_the_row_when_a_csv_is_none(text: str, told: str) -> None:
    with pytest.raises(LinkError) as error:
        parse_script(text.encode(), "it.csv", ".csv")
    assert told in str(error.value) and str(error.value).startswith("script it.csv: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("frame = 3", "expected tables [[frame]]"),
        ("[[row]]\nt_s = 0", "unknown key row, expected [[frame]] alone"),
        ("[[frame]]\nroll = 1500", "frame 1 lacks t_s"),
        ("[[frame]]\nt_s = 0\nroll = true\n[[frame]]\nt_s = 1", "frame 1, roll: got True"),
        ("[[frame]]\nt_s = 0\nroll = 'x'\n[[frame]]\nt_s = 1", "frame 1, roll: got 'x'"),
        ("[[frame]]\nt_s = true\n[[frame]]\nt_s = 1", "frame 1 has no time"),
        ("[[frame", "Expected"),
    ],
)
def test_one_line_names_the_frame_when_a_toml_is_none(text: str, told: str) -> None:
    with pytest.raises(LinkError) as error:
        parse_script(text.encode(), "it.toml", ".toml")
    assert told in str(error.value) and "\n" not in str(error.value)


def test_a_file_is_refused_when_it_is_no_script(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="No such file or directory; check its name"):
        read_script(tmp_path / "none.csv")
    large = tmp_path / "large.csv"
    large.write_bytes(b"t_s\n" * FILE_BYTES_MAX)
    with pytest.raises(LinkError, match="4194304 bytes, expected at most 1048576"):
        read_script(large)
    binary = tmp_path / "image.csv"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(LinkError, match=r"script .*image\.csv: .*decode"):
        read_script(binary)
    with pytest.raises(LinkError, match=r"ends in \.csv or \.toml"):
        parse_script(b"", "it.txt", ".txt")


def test_a_script_is_refused_when_it_begins_otherwise_than_at_rest_or_arms_without_leave() -> None:
    board = layout()
    for begin, told in (("1500,1000", "its first row has throttle"), ("1000,2000", "has the arm switch on")):
        script = parse_script(f"t_s,throttle,aux1\n0,{begin}\n1,,\n".encode(), "it", ".csv")
        with pytest.raises(LinkError, match=told):
            check_script(script, board, may_arm=True)
    arming = parse_script(CSV, "it", ".csv")
    check_script(arming, board, may_arm=True)
    with pytest.raises(LinkError, match=r"at 1.5 s the arm switch is on, expected off without --allow-arm"):
        check_script(arming, board, may_arm=False)
