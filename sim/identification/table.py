"""Tables of numbers in text files, as measuring programs and spreadsheets write them.

Encoding, separator, decimal mark and the line that names the columns, above which there may be others, are
found from the file itself. Nothing in a file is executed.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import read_limited

Failure = type[NeuroflightError]

# Between cells; two blanks: of headings that have single ones in them.
MARKS = ("\t", ";", ",", "|", "  ", " ")
LINES_BEFORE_MAX = 200  # above the heading
COMMENTS = ("#", "//")  # at the begin of a line below the heading
FOREIGN_MAX = 0.05  # a file that is not UTF-8 is no text if more of its characters are beyond ASCII
MISSING = frozenset(("", "nan", "-nan", "n/a", "na", "#n/a", "-", "--", "null", "none"))
_THOUSANDS = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+") for mark in ".,"}


@dataclass(frozen=True)
class Table:
    """Cells below a heading."""

    heading: tuple[str, ...]  # of all columns, as they are written
    names: tuple[str, ...]  # of those that are kept
    rows: list[list[str]]  # each as long as `names`
    lines: list[int]  # of the file, on which each row stands, from 1


def read_text(path: Path, bytes_max: int, failure: Failure) -> str:
    """Decode a text file: UTF-8 or UTF-16 by their marks, else UTF-8, else Windows' western code page.

    Raises `failure` on a file that is missing, too large or no text.
    """
    if not path.is_file():
        raise failure(f"{path}: no such file")
    data = read_limited(path, str(path), bytes_max, failure, "; log slower or cut it")
    utf_16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = data.decode("utf-16" if utf_16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        text = data.decode("cp1252", errors="replace")
        if utf_16 or sum(not character.isascii() for character in text) > FOREIGN_MAX * len(text):
            raise failure(f"{path}: not a text file ({error.reason} at byte {error.start})") from error
    if "\0" in text:
        raise failure(f"{path}: not a text file (a byte 0 at character {text.index(chr(0))})")
    return text


def find_table(
    text: str,
    score: Callable[[Sequence[str]], int],
    enough: int,
    keep: Callable[[str], bool],
    rows_max: int,
    where: str,
    failure: Failure,
) -> Table | None:
    """Find the heading, by how many of its cells `score` knows, and split the rows below it.

    The mark between cells is the one that shows most known cells, at least `enough`, in the first lines; None
    where no line has so many. Columns whose names `keep` refuses are left out. Cells that a row lacks are
    empty, and those beyond the heading are passed over where none of them is read. Raises `failure`, naming
    `where`, on another row that is too long, on too many rows, and on cells that are no CSV.
    """
    lines = text.splitlines()
    best, heading, mark = enough - 1, -1, ""
    for number, line in enumerate(lines[:LINES_BEFORE_MAX]):
        for candidate in MARKS:
            if candidate.strip() and candidate not in line:
                continue
            try:
                found = score(split(line, candidate))
            except csv.Error:
                continue
            if found > best:
                best, heading, mark = found, number, candidate
    if heading < 0:
        return None
    names = split(lines[heading], mark)
    while names and not names[-1]:
        names.pop()  # a mark at the end of the line
    kept = [at for at, name in enumerate(names) if keep(name)]
    rows: list[list[str]] = []
    places: list[int] = []
    for number, line in enumerate(lines[heading + 1 :], heading + 2):
        if not line.strip() or line.lstrip().startswith(COMMENTS):
            continue
        if len(rows) == rows_max:
            raise failure(f"{where}: more than {rows_max} rows; log slower or cut it")
        try:
            cells = split(line, " " if mark == "  " else mark)
        except csv.Error as error:
            raise failure(f"{where}: line {number}: not CSV: {error}") from error
        if not any(cells):
            continue
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()
        if len(cells) > len(names) and not _runs_on(cells, kept, len(names)):
            raise failure(
                f"{where}: line {number}: {len(cells)} columns, expected {len(names)} as in the heading"
            )
        rows.append([cells[at] if at < len(cells) else "" for at in kept])
        places.append(number)
    return Table(tuple(names), tuple(names[at] for at in kept), rows, places)


def _runs_on(cells: Sequence[str], kept: Sequence[int], count: int) -> bool:
    """Return True if a row longer than the heading can be read: its extra cells come after those in use.

    Programs append a message, which may hold commas, or columns that a script added later. One of the cells
    in use must have a decimal point: with decimal commas the row would have been split inside its numbers.
    """
    return kept[-1] < count - 1 and any("." in cells[at] for at in kept)


def split(line: str, mark: str) -> list[str]:
    """Split a line into cells, without the blanks and quotes around them."""
    if mark == " ":
        return [cell.strip('"') for cell in line.split()]
    if mark == "  ":
        return [cell.strip().strip('"') for cell in re.split(r"\s{2,}|\t", line.strip())]
    (cells,) = csv.reader([line], delimiter=mark, skipinitialspace=True)
    return [cell.strip() for cell in cells]


def numbers(table: Table, columns: Sequence[int], where: str, failure: Failure) -> Array:
    """Return the numbers of some columns, (rows, columns); NaN for an empty cell or one that means "none".

    Raises `failure`, naming `where`, on a cell that is no number, and where it cannot be told whether a mark
    stands before decimals or between thousands.
    """
    cells = [[row[column] for column in columns] for row in table.rows]
    decimal = _decimal_mark([cell for row in cells for cell in row], where, failure)
    other = "." if decimal == "," else ","
    values = np.full((len(cells), len(columns)), np.nan)
    for row, texts in enumerate(cells):
        for column, text in enumerate(texts):
            if text.lower() in MISSING:
                continue
            try:
                value = float(_plain(text).replace(other, "").replace(decimal, "."))
            except ValueError:
                value = np.inf
            if not abs(value) < 1e12:
                raise failure(
                    f"{where}: line {table.lines[row]}: {table.names[columns[column]]} is {text[:40]!r}, "
                    "expected a number; leave out rows without one"
                )
            values[row, column] = value
    return values


def is_number(cell: str) -> bool:
    """Return True if `numbers` would read the cell as a number, with any decimal or thousands marks."""
    return bool(re.fullmatch(r"[+-]?[\d.,]+(e[+-]?\d+)?", _plain(cell).lower()))


def _plain(cell: str) -> str:
    """Return a number's cell without blanks and percent sign."""
    cell = re.sub(r"[ \N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}]", "", cell).removesuffix("%")
    return cell.replace("\N{MINUS SIGN}", "-")


def _decimal_mark(cells: Sequence[str], where: str, failure: Failure) -> str:
    """Find the decimal mark from numbers that have both marks, or one that cannot separate thousands."""
    cells = [_plain(cell) for cell in cells]
    with_comma = [cell for cell in cells if "," in cell]
    if not with_comma:
        return "."
    for cell in with_comma:
        if "." in cell:
            return "," if cell.rindex(",") > cell.rindex(".") else "."
    thousands = [cell for cell in with_comma if _THOUSANDS[","].fullmatch(cell)]
    points = [cell for cell in cells if "." in cell]
    if len(thousands) < len(with_comma):  # 0,5 or 12,34: decimals
        odd = next((cell for cell in points if not _THOUSANDS["."].fullmatch(cell)), None)
        if odd is not None:
            raise failure(
                f"{where}: numbers with a decimal comma and with a point, "
                f"{next(c for c in with_comma if c not in thousands)!r} and {odd!r}; expected one of them"
            )
        return ","
    if any(not _THOUSANDS["."].fullmatch(cell) for cell in points):
        return "."
    raise failure(
        f"{where}: is {thousands[0]!r} a number of thousands or has it a decimal comma? Nothing in the file "
        "tells; write numbers without marks between thousands"
    )
