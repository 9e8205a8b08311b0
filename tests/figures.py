"""Writes the figures that pages quote: `python -m tests.figures`, after what they are of has changed.

In a page a figure stands between `<!-- NAME -->` and `<!-- / -->`; FIGURES says how each is made. Counts are
those of this checkout's compiler, with COMPILER behind it; times are stored, for they are never twice the
same: in tests/durations.toml, and in the training.json of a shipped policy.
"""

from __future__ import annotations

import io
import json
import re
import tempfile
import textwrap
import tomllib
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

from neuroflight.cli.main import main as neuroflight
from neuroflight.toolchain.cortex_m7.arm_policy import compiler_version
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ
from neuroflight.toolchain.files import write_text_if_changed
from neuroflight.toolchain.image.elf import read_image
from tests.bench import compiler, emx
from tests.conftest import BUILD, ROOT, SHIPPED, build_shipped

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), ROOT / "training/policies/README.md")
DURATIONS = ROOT / "tests" / "durations.toml"
COMPILER = "arm-none-eabi-gcc 12.2"  # another one makes some instructions more or less
MARKED = re.compile(r"(?<=<!-- )([\w -]+) -->(.*?)(?=<!-- / -->)", re.DOTALL)
FEW = 12  # observations: all take one route, which tests/toolchain/cortex_m7 proves with many


def ours(name: str) -> str:
    """Return instructions, their variation, cycles and time of a network of the bench, compiled by us."""
    bar = next(bar for bar in compiler.BARS if name == bar.name)
    with tempfile.TemporaryDirectory() as folder:
        return _cells(compiler.our_row(bar, FEW, Path(folder), "-O2"), 1)


def theirs(name: str) -> str:
    """Return the same for emx-onnx-cgen's code, rounded to hundreds, over the bench's observations."""
    bar = next(bar for bar in compiler.BARS if name == f"{bar.name} emx")
    if reason := emx.fetch():
        raise RuntimeError(reason)
    with tempfile.TemporaryDirectory() as folder:
        return _cells(compiler.their_row(bar, Path(folder), "-O2"), 100)


def _cells(row: compiler.Row, step: int) -> str:
    assert row.cycles is not None, row.no_cycles_reason
    (fewest, most), cycles = row.instructions, row.cycles

    def span(low: float, high: float, unit: float = step) -> str:
        ends = [f"{round(value / unit) * unit:,}" for value in (low, high)]
        return ends[0] if ends[0] == ends[1] else " to ".join(ends)

    time = span(cycles[0] / CORE_HZ * 1e6, cycles[1] / CORE_HZ * 1e6, 1)
    return f"{span(fewest, most)} | {100 * (most / fewest - 1):.0f} % | {span(*cycles)} | {time} µs"


def timing(_: str) -> str:
    """Return what `neuroflight policy time` prints of the shipped policy."""
    return _printed("policy", "time", str(SHIPPED))


def flight(_: str) -> str:
    """Return what `make fly` prints of the shipped policy's flight."""
    build_shipped("HOST", SHIPPED)
    return _printed("fly", "--on", "host", "--scenario", "flight", "--count", "10", "--seed", "1")


def _printed(*words: str) -> str:
    with redirect_stdout(io.StringIO()) as told:
        neuroflight(words)
    lines = (line.rstrip() for line in told.getvalue().splitlines())
    lines = (textwrap.fill(line, 80) if len(line) > 80 else line for line in lines)
    return "\n```\n" + "\n".join(lines) + "\n```\n"


def trained(name: str) -> str:
    """Return steps and time of the training of a shipped policy."""
    name = name.removeprefix("trained ")
    run = json.loads((ROOT / "training/policies" / name / "training.json").read_text())
    kept = tomllib.loads(DURATIONS.read_text())["trained"]
    steps, seconds = f"{run['steps'] / 1e6:.3g} M control steps", f"{run['seconds']:.0f} s"
    return f"{steps} in {seconds} on {kept['cores']} cores ({kept[name]})"


def swap(_: str) -> str:
    """Return how many bytes are sent for the shipped policy, and for the image around it."""
    build_shipped("MATEKF722", SHIPPED)
    image = read_image(BUILD / "MATEKF722" / "neuroflight.elf")
    blob = next(section for section in image.sections if section.name == ".policy")
    tens = round(image.symbols["image_bytes"] / 1e4) * 10  # every feature moves the last digit
    return f"{blob.size / 1e3:.0f} kB instead of an image's {tens}"


def reproduced(_: str) -> str:
    """Return how long all rows of `neuroflight reproduce` took."""
    kept = tomllib.loads(DURATIONS.read_text())["reproduce"]
    processor, passed = (round(kept[each] / 60) for each in ("processor_seconds", "seconds"))
    busy = f"{passed} minutes on {kept['cores']} busy cores, {kept['date']}"
    return f"{processor} minutes of processor time ({busy})"


NETWORKS = [bar.name for bar in compiler.BARS]
FIGURES: dict[str, Callable[[str], str]] = {
    **dict.fromkeys(NETWORKS, ours),
    **{f"{name} emx": theirs for name in NETWORKS},
    "timing": timing,
    "flight": flight,
    **{f"trained {name}": trained for name in ("nf1", "hexa", "any")},
    "swap": swap,
    "reproduce": reproduced,
}


def figures(page: Path) -> list[tuple[str, str]]:
    """Return name and text of each figure that a page quotes."""
    return MARKED.findall(page.read_text())


def main() -> None:
    """Write the figures into the pages anew."""
    if not compiler_version().startswith(COMPILER):
        raise SystemExit(f"the counts are those of {COMPILER}, this is {compiler_version()}")
    made = {name: make(name) for name, make in FIGURES.items()}
    for page in PAGES:
        write_text_if_changed(
            page, MARKED.sub(lambda found: f"{found[1]} -->{made[found[1]]}", page.read_text())
        )


if __name__ == "__main__":
    main()
