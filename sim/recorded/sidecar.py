"""Header lines of a log in the file that tools write beside the log's table."""

from __future__ import annotations

import csv
from itertools import islice
from pathlib import Path

from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.files import file_size

BYTES_MAX = 4 << 20
LINES_MAX = 2000
_PAIR = 2  # cells of a header line


def headers_beside(table: Path) -> dict[str, str]:
    """Return the header lines in NAME.headers.csv beside a table; none where there is no such file.

    `log decode --csv` and blackbox_decode --save-headers write it. Raises TraceError for one too large.
    """
    path = table.with_suffix(".headers.csv")
    if not path.is_file():
        return {}
    if file_size(path) > BYTES_MAX:
        raise TraceError(f"log {path}: {file_size(path)} bytes, expected the header lines of a log")
    values: dict[str, str] = {}
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for cells in islice(csv.reader(file, skipinitialspace=True), LINES_MAX):
            if len(cells) == _PAIR:
                values.setdefault(cells[0].strip(), cells[1].strip())
    return values
