"""The figures that we quote from Koch's dissertation, each with its place: quotes.toml, read strictly."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path

from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import StrictTable, shown

FILE = Path(__file__).with_name("quotes.toml")
FILE_BYTES_MAX = 1 << 20
LIMIT = 1e12  # of the size of a figure
COLUMNS_MAX = 20
AXES = ("roll", "pitch", "yaw")

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
    """One figure of the dissertation; what it is stands beside it in the file."""

    id: str  # TABLE/ROW/COLUMN, TABLE/PART/ROW/COLUMN or CHAPTER/NAME
    value: tuple[Printed, ...]  # one number, or three: axes, gains or coefficients
    margin: Printed | None  # half width of its 95 % confidence interval, where one is printed


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
    """Read the figures of a file. Raises QuoteError naming the key that is wrong or unknown."""
    data = read_limited(path, path.name, FILE_BYTES_MAX, QuoteError)
    try:
        document = tomllib.loads(data.decode(), parse_float=Printed)
    except ValueError as error:
        raise QuoteError(f"{path.name}: not TOML: {error}") from None
    root = StrictTable(document, path.name, QuoteError)
    root.integer("format", 1, 1)
    found: dict[str, Quote] = {}
    for place in (name for name in root.names() if name != "format"):
        table = root.table(place)
        columns = _words(table, "columns") if table.has("columns") else None
        for name in (name for name in table.names() if name != "columns"):
            if columns is None:
                cells = {name: document[place][name]}
            else:
                given = document[place][name]
                if not isinstance(given, list) or len(given) != len(columns):
                    raise table.error(name, f"got {shown(given)}, expected a list of {len(columns)} cells")
                cells = {f"{name}/{column}": cell for column, cell in zip(columns, given, strict=True)}
            for cell in cells:
                found[f"{place}/{cell}"] = _quote(f"{place}/{cell}", cells[cell], path.name)
    return Quotes(found)


def _quote(name: str, cell: object, file: str) -> Quote:
    """Read a value, a value with its margin, or three values."""
    numbers = StrictTable({name: cell}, file, QuoteError).numbers(name, 1, 3, -LIMIT, LIMIT)
    value, *more = map(_printed, numbers)
    return Quote(name, (value, *more), None) if len(more) != 1 else Quote(name, (value,), more[0])


def _printed(number: float) -> Printed:
    """Return a number of the file as printed; a whole number needs no text, TOML loses nothing of it."""
    return number if isinstance(number, Printed) else Printed(f"{number:.0f}")


def _words(table: StrictTable, key: str) -> tuple[str, ...]:
    """Split a line of names at its commas."""
    words = tuple(word.strip() for word in table.text(key).split(","))
    if not 1 <= len(words) <= COLUMNS_MAX or not all(words):
        raise table.error(
            key, f"got {table.text(key)!r}, expected 1 to {COLUMNS_MAX} names with commas between"
        )
    return words
