"""Files of settings: what is read, and what is refused with the number of its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.settings.files import FILE_BYTES_MAX, Line, read_file
from neuroflight.toolchain.errors import LinkError, NeuroflightError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "settings.txt"


def test_settings_are_read_when_a_copy_of_a_command_line_surrounds_them(file: Path) -> None:
    file.write_bytes(
        b"# diff all\r\n\r\ndefaults nosave\r\nset rates_style = betaflight\r\n"
        b"  SET craft_name=my quad\r\nset mode2 = none\r\nsave\r\n# end"
    )
    assert read_file(file) == {
        "rates_style": Line(4, 1.0),
        "craft_name": Line(5, "my quad"),
        "mode2": Line(6, 0.0),
    }


@pytest.mark.parametrize(
    ("text", "number", "words"),
    [
        (b"set roll_expo = 0.1\nset roll_exp = 1\n", 2, "setting 'roll_exp' is unknown"),
        (b"\n\nset roll_expo = much", 3, "setting roll_expo got 'much', expected a number"),
        (b"roll_expo = 1", 1, "got 'roll_expo = 1', expected set NAME = VALUE"),
        (b"set roll_expo = 1", 1, "roll_expo got '1', expected 1.0 for all of it, or 0.01 for a percent"),
        (b"set roll_expo", 1, "expected set NAME = VALUE"),
        (b"set", 1, "expected set NAME = VALUE"),
        (b"import os", 1, "got 'import os', expected set NAME = VALUE"),
        (b"motor 0 2000", 1, "got 'motor 0 2000', expected set NAME = VALUE"),
        (b"# " + b"x" * 100 + b"\n" + b"y" * 1000, 2, "y...', expected set NAME = VALUE"),
        (b"set roll_expo = 0\n\nset roll_expo = 1.0", 3, "roll_expo is set in line 1 already"),
        (b"set craft_name = Fl\xfcgel", 1, "byte 0xFC, expected ASCII"),
        (b"# \xff", 1, "byte 0xFF, expected ASCII"),
        (b"set craft_name = a\0b", 1, "expected at most 16 characters of ASCII"),
    ],
)
def test_a_file_is_refused_with_the_number_of_the_line_when_it_holds_something_else(
    file: Path, text: bytes, number: int, words: str
) -> None:
    file.write_bytes(text)
    with pytest.raises(LinkError) as caught:
        read_file(file)
    assert str(caught.value).startswith(f"{file}:{number}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_is_refused_when_it_is_too_large_to_be_settings(file: Path) -> None:
    file.write_bytes(b"#" * (FILE_BYTES_MAX + 1))
    with pytest.raises(LinkError, match="65537 bytes, expected settings, 65536 bytes at most"):
        read_file(file)


def test_what_has_no_end_is_refused_when_named() -> None:
    with pytest.raises((OSError, NeuroflightError), match="pipe or a device"):
        read_file(Path("/dev/zero"))
