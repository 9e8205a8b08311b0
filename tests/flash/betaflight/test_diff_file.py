"""Files of Betaflight's command line: whose they are, and which lines count."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.betaflight.diff_file import FILE_BYTES_MAX, read_diff
from neuroflight.toolchain.errors import LinkError

HEADER = "# Betaflight / MATEKF722 (MKF7) 4.0.0 Mar  8 2019 / 11:37:03 (52c4e96c8) MSP API: 1.41\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "diff.txt"


@pytest.mark.parametrize(
    ("header", "release", "version", "board"),
    [
        (HEADER, "4.0.0", (4, 0), "MATEKF722"),
        ("# BetaFlight/SPRACINGF3 3.0.1 Sep 26 2016 / 17:03:03 (abcdef0)\n", "3.0.1", (3, 0), "SPRACINGF3"),
        (
            "# Betaflight / OMNIBUS (OMNI) 3.2.5 Feb  4 2018 / 00:00:00 (0) MSP API: 1.36\n",
            "3.2.5",
            (3, 2),
            "OMNIBUS",
        ),
        (
            "# Betaflight / STM32F7X2 (S7X2) 4.3.0-RC1 Jan 1 2022 / 00:00:00 (0)\nboard_name matekf722\n",
            "4.3.0-RC1",
            (4, 3),
            "MATEKF722",
        ),
        (
            "# Betaflight / STM32F745 (S745) 2025.12.1 Jan 1 2026 / 00:00:00 (0)\n",
            "2025.12.1",
            (2025, 12),
            "STM32F745",
        ),
        ("# Betaflight / MATEKF722 4.5\n", "4.5", (4, 5), "MATEKF722"),
    ],
)
def test_who_wrote_it_is_read_whatever_the_version(
    file: Path, header: str, release: str, version: tuple[int, int], board: str
) -> None:
    file.write_text(header)
    diff = read_diff(file)
    assert (diff.release, diff.version, diff.board) == (release, version, board)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_lines_are_the_same_whoever_saved_them(file: Path, newline: str, encoding: str) -> None:
    text = (
        f"# diff all\n{HEADER}\n  map TAER1234  \n# comment\n#\nname Flügel # 1\nset small_angle=180 # any\n"
    )
    file.write_bytes(text.replace("\n", newline).encode(encoding))
    lines = read_diff(file).lines
    assert [(line.number, line.text) for line in lines] == [
        (4, "map TAER1234"),
        (7, "name Flügel # 1"),
        (8, "set small_angle=180"),
    ]
    assert lines[2].assigned == ("small_angle", "180")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no line `# Betaflight / BOARD VERSION` in it"),
        (b"set roll_srate = 75\n", "give --betaflight VERSION such as 4.5"),
        (b"# INAV/MATEKF405 7.1.0 Apr 21 2024 / 13:25:29 (03a5c1922)\n", ":1: written by INAV 7.1.0, whose"),
        (
            b"# version\n# EmuFlight / MATEKF411 (MK41) 0.3.1 May 19 2020 / 04:45:55\n",
            ":2: written by EmuFlight 0.3.1",
        ),
        (b"# Cleanflight / CC3D (CC3D) 2.5.0 Jul 1 2018 / 00:00:00\n", ":1: written by Cleanflight 2.5.0"),
        (b"# Rotorflight / STM32F7X2 (S7X2) 4.3.0\n", "written by Rotorflight 4.3.0"),
        (b"# OtherFork / BOARD (ABCD) 1.0 Jul 1 2018 / 00:00:00\n", "written by OtherFork 1.0"),
        (
            b"# diff of MATEKF722 0.1.0: neuroflight board settings restore --port PORT FILE\n",
            ":1: settings of Neuroflight",
        ),
        (b"# Neuroflight 0.1.0 on HOST\n", "`neuroflight board settings restore` takes them"),
        ((HEADER + HEADER.replace("4.0.0", "4.1.0")).encode(), ":2: a second one, of Betaflight 4.1.0"),
        (HEADER.encode() + b"\0\1\2", ":2: a zero byte"),
        (
            HEADER.encode() + b"\n# map TAER1234\n# set small_angle = 180\nsmall_angle set to 180\n",
            "2 lines have `# `",
        ),
        (b"#" * (FILE_BYTES_MAX + 1), "bytes at most"),
    ],
)
def test_one_line_says_why_a_file_is_not_taken(file: Path, data: bytes, words: str) -> None:
    file.write_bytes(data)
    with pytest.raises(LinkError) as caught:
        read_diff(file)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_that_betaflight_prints_as_comments_are_no_prompts(file: Path) -> None:
    """`diff all showdefaults` has `#set` for what is at its default; headings are comments, too."""
    file.write_text(
        f"{HEADER}\n# map\nmap AETR1234\n# feature\n#set small_angle = 25\nset\xa0yaw_expo\xa0= 3\n"
    )
    assert [line.text for line in read_diff(file).lines] == ["map AETR1234", "set yaw_expo = 3"]


def test_the_version_can_be_told_where_the_file_does_not(file: Path) -> None:
    file.write_text("rateprofile 0\nset roll_srate = 75\n")
    assert read_diff(file, "4.2").version == (4, 2)
    with pytest.raises(LinkError, match="--betaflight got 'newest'"):
        read_diff(file, "newest")
    file.write_text(HEADER)
    with pytest.raises(LinkError, match=r"Betaflight 4\.0\.0 by its own words; leave out --betaflight 4\.2"):
        read_diff(file, "4.2")


def test_a_line_is_shown_without_what_a_terminal_would_obey(file: Path) -> None:
    file.write_text(f"{HEADER}board_name \x1b[31mX\nname \x1b[2J{'x' * 200}\n")
    diff = read_diff(file)
    assert diff.board == "\N{REPLACEMENT CHARACTER}[31MX"
    assert diff.lines[1].shown == "name \N{REPLACEMENT CHARACTER}[2J" + "x" * 61 + "..."
