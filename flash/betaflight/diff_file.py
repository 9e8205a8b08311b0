"""Read the lines of a file that Betaflight's `diff` or `dump` printed, and who wrote it; none is executed."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from pathlib import Path

from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import file_size

FILE_BYTES_MAX = 1 << 20  # a dump of 4.5 has 60 kB
SHOWN = 70  # characters of a line in an error or a listing
UNPRINTABLE = "\N{REPLACEMENT CHARACTER}"
COMMENT = "#"
WITH_TEXT = frozenset({"name", "display_name"})  # commands whose text may contain #
TEXT_SETTINGS = ("name", "craft_name", "pilot_name", "display_name")

_DATE = r"\s+[A-Z][a-z]{2}\s+\d{1,2}\s+\d{4}\s*/"
_HEADER = re.compile(
    r"#\s*(?P<firmware>[A-Za-z][\w-]*)\s*/\s*(?P<target>\S+)\s+(?:\(\w*\)\s+)?"
    r"(?P<release>(?P<major>\d+)\.(?P<minor>\d+)\S*)(?P<date>" + _DATE + ")?"
)
_OURS = re.compile(r"#\s*(?:(?:diff|dump) of \S+ [\d.]+: neuroflight|Neuroflight [\d.]+ on )")
_PROMPTED = re.compile(r"#\s+(?:set\s+\w+\s*=|aux\s+\d|map\s+\w{4}|feature\s+-?\w)", re.IGNORECASE)
_RELEASE = re.compile(r"(\d{1,4})\.(\d{1,4})(?:\.\d{1,4})?")
BETAFLIGHT = "betaflight"
RELATIVES = frozenset(  # firmwares derived from Betaflight, whose files look alike
    {
        "inav",
        "emuflight",
        "cleanflight",
        "baseflight",
        "rotorflight",
        "butterflight",
        "heliflight3d",
        "indiflight",
    }
)
_ENCODINGS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True)
class Line:
    """A line of a file that is neither empty nor a comment."""

    number: int  # from 1
    text: str

    @property
    def words(self) -> list[str]:
        """Its words in lower case."""
        return self.text.lower().split()

    @property
    def assigned(self) -> tuple[str, str] | None:
        """NAME and VALUE of a line `set NAME = VALUE`; None: it is another one."""
        head, *rest = self.text.split(maxsplit=1)
        name, equals, value = rest[0].partition("=") if rest else ("", "", "")
        return (name.strip().lower(), value.strip()) if head.lower() == "set" and equals else None

    @property
    def shown(self) -> str:
        """The text, shortened for a listing."""
        return self.text if len(self.text) <= SHOWN else f"{self.text[:SHOWN]}..."


@dataclass(frozen=True)
class Diff:
    """The content of a file."""

    path: Path
    release: str  # as it is written, 4.1.1
    version: tuple[int, int]  # its first two numbers
    board: str  # in capitals; "" if the file does not name it
    lines: tuple[Line, ...]


def read_diff(path: Path, release: str | None = None, assumed: str | None = None) -> Diff:
    """Read the file `path`. Raises LinkError, one line, if it is not a file of Betaflight's.

    release: the version of Betaflight that wrote it, for a file that does not name it; assumed: likewise,
    where it is not known that a file names none.
    """
    texts = [text.strip() for text in re.split(r"\r\n|\n|\r", _read(path))]
    target, told = _written_by(path, texts)
    if told is not None and release is not None:
        raise LinkError(
            f"{path}: it is of Betaflight {told} by its own words; leave out --betaflight {release}"
        )
    release = told or release or assumed
    if release is None:
        raise LinkError(
            f"{path}: no line `# Betaflight / BOARD VERSION` in it, on which units and defaults depend; is "
            "it a diff or dump? If Betaflight printed it, give --betaflight VERSION such as 4.5"
        )
    number = _RELEASE.match(release)
    if number is None:
        raise LinkError(f"--betaflight got {release[:SHOWN]!r}, expected a version such as 4.5 or 2025.12")
    lines = tuple(
        Line(at, _without_comment(text))
        for at, text in enumerate(texts, start=1)
        if text and not text.startswith(COMMENT)
    )
    prompted = [(at, text) for at, text in enumerate(texts, start=1) if _PROMPTED.match(text)]
    if len(prompted) > sum(line.assigned is not None for line in lines):
        first, text = prompted[0]
        raise LinkError(
            f"{path}:{first}: {text[:SHOWN]!r}, expected no prompt; {len(prompted)} lines have `# ` before "
            "them, as comments have: take it away, or save what `diff all` printed"
        )
    named = [line.text.split()[1] for line in lines if line.words[0] == "board_name" and len(line.words) > 1]
    version = (int(number[1]), int(number[2]))
    return Diff(path, release, version, (named[-1] if named else target).upper(), lines)


def _read(path: Path) -> str:
    size = file_size(path)
    if size > FILE_BYTES_MAX:
        raise LinkError(f"{path}: {size} bytes, expected a diff or dump, {FILE_BYTES_MAX} bytes at most")
    with path.open("rb") as file:
        data = file.read(FILE_BYTES_MAX + 1)
    encoding = next((name for mark, name in _ENCODINGS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # names may have been written in an old encoding
    if "\0" in text:
        number = text.count(chr(10), 0, text.index(chr(0))) + 1
        raise LinkError(f"{path}:{number}: a zero byte, expected text")
    text = text.replace("\N{NO-BREAK SPACE}", " ")  # copied from a page in a browser
    # Parts of the file are printed, so they must not hold escape codes that a terminal would obey.
    return "".join(c if c.isprintable() or c in "\n\r\t" else UNPRINTABLE for c in text)


def _written_by(path: Path, texts: list[str]) -> tuple[str, str | None]:
    """Return target and version from the comments in the file; "" and None where none names them."""
    target, release = "", None
    for number, text in enumerate(texts, start=1):
        if _OURS.match(text):
            raise LinkError(
                f"{path}:{number}: settings of Neuroflight itself: `neuroflight board settings restore` "
                "takes them"
            )
        header = _HEADER.match(text)
        if header is None:
            continue
        firmware = header["firmware"]
        if firmware.lower() != BETAFLIGHT:
            if header["date"] or firmware.lower() in RELATIVES:
                raise LinkError(
                    f"{path}:{number}: written by {firmware} {header['release'][:SHOWN]}, whose settings "
                    "mean other things than Betaflight's; only Betaflight's diff or dump can be imported"
                )
            continue
        if release is not None and (target, release) != (header["target"], header["release"]):
            raise LinkError(
                f"{path}:{number}: a second one, of Betaflight {header['release'][:SHOWN]} on "
                f"{header['target'][:SHOWN]}, behind that of {release} on {target}; keep one of them"
            )
        target, release = header["target"][:SHOWN], header["release"][:SHOWN]
    return target, release


def _without_comment(text: str) -> str:
    """Return `text` without a comment at its end. Names and other free text are kept whole."""
    line = Line(0, text)
    if line.words[0] in WITH_TEXT or (line.assigned is not None and line.assigned[0] in TEXT_SETTINGS):
        return text
    return text.partition(f" {COMMENT}")[0].strip()
