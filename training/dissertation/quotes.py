"""The figures that we quote from Koch's dissertation, each with its place: quotes.toml, read strictly."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

from neuroflight.sim.strict_toml import StrictTable, shown
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import file_size

FILE = Path(__file__).with_name("quotes.toml")
FILE_BYTES_MAX = 1 << 20
LIMIT = 1e12  # of the size of a figure
TABLES_MAX, FIGURES_MAX, COLUMNS_MAX = 100, 1000, 20
AXES = ("roll", "pitch", "yaw")
SHOWN = {"yes": True, "no": False}

Axes = tuple[float, float, float]  # roll, pitch, yaw


class Printed(float):
    """A number as it is printed, with the zeros at its end."""

    __slots__ = ("text",)
    text: str

    def __new__(cls, text: str) -> Printed:
        """Parse a number from its text, which is kept."""
        number = super().__new__(cls, text)
        number.text = text.replace("_", "")
        return number

    @property
    def decimals(self) -> int:
        """Number of printed decimals; negative if the number is rounded to tens, hundreds and so on."""
        exponent = Decimal(self.text).as_tuple().exponent
        assert isinstance(exponent, int)
        return -exponent


class QuoteError(NeuroflightError):
    """A file of quotes that is damaged, or an id that it does not have."""


@dataclass(frozen=True)
class Quote:
    """One figure of the dissertation."""

    id: str  # TABLE/ROW/COLUMN, TABLE/PART/ROW/COLUMN or CHAPTER/NAME
    place: str  # "Table 3.9", or the chapter and section
    label: str  # of the place in the LaTeX source
    what: str
    value: tuple[Printed, ...]  # one number, or three: axes, gains or coefficients
    margin: Printed | None  # half width of its 95 % confidence interval, where one is printed
    unit: str  # "-" for none
    printed: bool  # False: only defined in the source


class Quotes:
    """All figures by id."""

    def __init__(self, quotes: Mapping[str, Quote]) -> None:
        self._quotes = quotes

    def __len__(self) -> int:
        return len(self._quotes)

    def __iter__(self) -> Iterator[Quote]:
        return iter(self._quotes.values())

    def __contains__(self, name: str) -> bool:
        return name in self._quotes

    def __getitem__(self, name: str) -> Quote:
        """Return the quote of an id. Raises QuoteError naming the nearest ids where there is none."""
        if name not in self._quotes:
            beside = [known for known in self._quotes if known.startswith(name.rpartition("/")[0] + "/")]
            known = ", ".join(beside[:8]) or ", ".join(sorted({each.split("/")[0] for each in self._quotes}))
            raise QuoteError(f"{FILE.name}: no quote {name!r}, expected one of: {known}")
        return self._quotes[name]

    def number(self, name: str) -> float:
        """Return the value of a single number. Raises QuoteError for a triple or an unknown id."""
        quote = self[name]
        if len(quote.value) != 1:
            raise QuoteError(f"{FILE.name}: {name}: got {len(quote.value)} numbers, expected one")
        return quote.value[0]

    def axes(self, name: str) -> Axes:
        """Return roll, pitch and yaw: of a triple, or of the row of a table that has these columns."""
        if name not in self._quotes:
            roll, pitch, yaw = (self.number(f"{name}/{axis}") for axis in AXES)
            return roll, pitch, yaw
        if len(self._quotes[name].value) != 3:
            raise QuoteError(f"{FILE.name}: {name}: got one number, expected three")
        first, second, third = self._quotes[name].value
        return first, second, third


@cache
def quotes() -> Quotes:
    """Return the shipped figures. Raises QuoteError if their file is damaged."""
    return read_quotes(FILE)


def read_quotes(path: Path) -> Quotes:
    """Read the figures of a file. Raises QuoteError naming the key that is wrong, unknown or there twice."""
    if file_size(path) > FILE_BYTES_MAX:
        raise QuoteError(f"{path.name}: {file_size(path)} bytes, expected at most {FILE_BYTES_MAX}")
    try:
        document = tomllib.loads(path.read_text(), parse_float=Printed)
    except (OSError, ValueError) as error:
        raise QuoteError(f"{path.name}: not TOML: {error}") from None
    root = StrictTable(document, path.name, QuoteError)
    root.integer("format", 1, 1)
    found: dict[str, Quote] = {}
    tables = root.tables("table", 1, TABLES_MAX)
    for table, raw in zip(tables, document["table"], strict=True):
        _add(found, _cells(table, raw, path.name), table)
    for text in root.tables("text", 1, TABLES_MAX):
        _add(found, _figures(text), text)
    root.finish()
    return Quotes(found)


def _add(found: dict[str, Quote], more: Iterator[Quote], where: StrictTable) -> None:
    for quote in more:
        if quote.id in found:
            raise where.error(quote.id, "there twice; ids are unique")
        found[quote.id] = quote


def _cells(table: StrictTable, raw: Mapping[str, Any], file: str) -> Iterator[Quote]:
    """Yield the cells of a [[table]]; raw: the same table before its values were checked."""
    number, label, title = (table.text(key) for key in ("number", "label", "title"))
    start = f"{number}/{table.text('part')}" if table.has("part") else number
    columns = _words(table, "columns")
    rows = table.table("rows")
    names = rows.names()
    unit = table.text("unit", "-")
    of_columns, of_rows = (
        _units(table, key, unit, n) for key, n in (("column_units", columns), ("row_units", names))
    )
    for row, name in enumerate(names):
        cells = raw["rows"][name]
        if not isinstance(cells, list) or len(cells) != len(columns):
            raise rows.error(name, f"got {shown(cells)}, expected a list of {len(columns)} cells")
        for column, (head, cell) in enumerate(zip(columns, cells, strict=True)):
            one = StrictTable({head: cell}, file, QuoteError, f"{start}/{name}/")
            value, *margin = (_printed(number) for number in one.numbers(head, 1, 2, -LIMIT, LIMIT))
            yield Quote(
                id=f"{start}/{name}/{head}",
                place=f"Table {number}",
                label=label,
                what=f"{title}: {name}" + (f", {head}" if len(columns) > 1 else ""),
                value=(value,),
                margin=margin[0] if margin else None,
                unit=of_columns[column] if table.has("column_units") else of_rows[row],
                printed=True,
            )
    table.finish()


def _figures(text: StrictTable) -> Iterator[Quote]:
    """Yield the figures of a [[text]]."""
    chapter, section, label = text.integer("chapter", 1, 6), text.text("section"), text.text("label")
    figures = text.table("figures")
    for name in figures.names():
        figure = figures.table(name)
        value = tuple(_printed(number) for number in figure.numbers("value", 1, 3, -LIMIT, LIMIT))
        if len(value) == 2:
            raise figure.error("value", "got 2 numbers, expected one or three")
        margin = _printed(figure.number("margin", 0.0, LIMIT)) if figure.has("margin") else None
        yield Quote(
            id=f"{chapter}/{name}",
            place=f"Chapter {chapter}, {section}",
            label=label,
            what=figure.text("what"),
            value=value,
            margin=margin,
            unit=figure.text("unit"),
            printed=figure.choice("shown", SHOWN, "yes"),
        )
        figure.finish()
    text.finish()


def _printed(number: float) -> Printed:
    """Return a number of the file as printed; a whole number needs no text, TOML loses nothing of it."""
    return number if isinstance(number, Printed) else Printed(f"{number:.0f}")


def _units(table: StrictTable, key: str, unit: str, expected: tuple[str, ...]) -> tuple[str, ...]:
    """Return the units of a table's columns or rows; where it does not name them, `unit` for each."""
    if not table.has(key):
        return (unit,) * len(expected)
    units = _words(table, key)
    if len(units) != len(expected):
        raise table.error(key, f"got {len(units)} units, expected {len(expected)}")
    return units


def _words(table: StrictTable, key: str) -> tuple[str, ...]:
    """Split a line of names at its commas."""
    words = tuple(word.strip() for word in table.text(key).split(","))
    if not 1 <= len(words) <= COLUMNS_MAX or not all(words):
        raise table.error(
            key, f"got {table.text(key)!r}, expected 1 to {COLUMNS_MAX} names with commas between"
        )
    return words
