"""orangebox 0.5.0 as published and unchanged: pip refuses to install its wheel, but Python imports it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.files import locked
from tests.conftest import BUILD

VERSION = "0.5.0"
SHA256 = "a13d003a1caf13d84a422de1ca36fa0ad682e41a195ee207354c08fa5f451761"
WHEEL = f"orangebox-{VERSION}-py3-none-any.whl"
LIMIT_S = 600.0
DECODE = """
import sys
from pathlib import Path
import numpy as np
import orangebox
from orangebox import Parser
assert orangebox.__version__ == sys.argv[4], orangebox.__version__
parser = Parser.load(sys.argv[1], int(sys.argv[3]))
frames = list(parser.frames())
stats = parser._ctx.stats
rows = np.array([[0 if value == "" else value for value in frame.data] for frame in frames], np.int64)
events = np.array([f"{event.type.name} {event.data}" for event in parser.events], str)
told = {"rows": rows, "names": parser.field_names, "events": events, "invalid": stats["invalid"]}
with Path(sys.argv[2]).open("wb") as file:
    np.savez(file, **told)
"""


def published() -> Path:
    """The wheel, fetched once."""
    folder = BUILD / "ORANGEBOX"
    with locked(folder):
        if not (folder / WHEEL).is_file():
            wanted = folder / "requirements.txt"
            wanted.write_text(f"orangebox=={VERSION} --hash=sha256:{SHA256}\n")
            options = ["--no-deps", "--only-binary", "orangebox", "--disable-pip-version-check"]
            pip = [sys.executable, "-m", "pip", "--quiet", "download", *options, "--dest", str(folder)]
            subprocess.run([*pip, "-r", str(wanted)], check=True, timeout=LIMIT_S)
    return folder / WHEEL


def decoded(path: Path, folder: Path, number: int = 1) -> dict[str, NDArray[np.generic]]:
    """What it decodes of a log: rows (N, F), names (F,), events as text, the number of invalid frames.

    It must end without an error. folder: for what it writes.
    """
    out = folder / "orangebox.npz"
    script = f"import sys; sys.path.insert(0, {str(published())!r})\n{DECODE}"
    words = [sys.executable, "-c", script, str(path), str(out), str(number), VERSION]
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr[-1000:]
    with np.load(out, allow_pickle=False) as arrays:
        return dict(arrays)
