"""A flame graph of folded stacks as one SVG: width is instructions, callees stand on their callers."""

from __future__ import annotations

import colorsys
import html
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

WIDTH, ROW, MARGIN, TITLE = 1200, 17, 10, 40  # [px]
CHARACTER = 6.6  # [px] of the font below
LEAST = 0.3  # [px]; what is narrower is left out
STYLE = (
    "text{font:11px ui-monospace,monospace;fill:#22272e;pointer-events:none}rect{stroke:#fff;stroke-width:.5}"
)


@dataclass
class _Box:
    """A function under its callers."""

    own: int = 0  # instructions
    total: int = 0  # with those of what it called
    above: dict[str, _Box] = field(default_factory=dict)


def flame_graph(stacks: Sequence[str], title: str) -> str:
    """Render stacks "caller;callee;leaf instructions" as SVG; a box shows its numbers under the pointer."""
    root = _tree(stacks)
    depth = _depth(root, root.total * LEAST / WIDTH)
    height = TITLE + ROW * depth + MARGIN
    boxes = "\n".join(_boxes("all", root, root.total, 0.0, height - MARGIN - ROW))
    width = WIDTH + 2 * MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">\n<style>{STYLE}</style>\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n'
        f'<text x="{MARGIN}" y="24">{html.escape(title)}</text>\n{boxes}\n</svg>\n'
    )


def _tree(stacks: Sequence[str]) -> _Box:
    root = _Box()
    for line in stacks:
        path, _, count = line.rpartition(" ")
        box = root
        box.total += int(count)
        for name in path.split(";"):
            box = box.above.setdefault(name, _Box())
            box.total += int(count)
        box.own += int(count)
    return root


def _depth(box: _Box, least: float) -> int:
    """Return the number of rows, without boxes of fewer instructions than `least`."""
    return 1 + max((_depth(one, least) for one in box.above.values() if one.total >= least), default=0)


def _boxes(name: str, box: _Box, whole: int, x: float, y: float) -> Iterator[str]:
    width = WIDTH * box.total / max(whole, 1)
    if width < LEAST:
        return
    share = box.total / max(whole, 1)
    hint = html.escape(f"{name}: {box.total:,} instructions, {share:.1%}; {box.own:,} of its own")
    yield (
        f'<g><title>{hint}</title><rect x="{x + MARGIN:.2f}" y="{y:.0f}" width="{width:.2f}" height="{ROW}" '
        f'rx="1.5" fill="{_colour(name)}"/>'
    )
    room = int((width - 6) / CHARACTER)
    if room >= 3:
        shown = name if len(name) <= room else f"{name[: room - 2]}.."
        yield f'<text x="{x + MARGIN + 3:.2f}" y="{y + 12:.0f}">{html.escape(shown)}</text>'
    yield "</g>"
    for callee, above in sorted(box.above.items()):
        yield from _boxes(callee, above, whole, x, y - ROW)
        x += WIDTH * above.total / max(whole, 1)


def _colour(name: str) -> str:
    """Return the colour of a function: always the same, warm and light enough for dark letters."""
    number = zlib.crc32(name.encode())
    hue, saturation, lightness = 8 + number % 47, 70 + number // 47 % 25, 66 + number // 1175 % 14
    rgb = colorsys.hls_to_rgb(hue / 360, lightness / 100, saturation / 100)
    return "#" + "".join(f"{round(255 * part):02x}" for part in rgb)
