"""The common style of all plots: colours, layout and title of a figure, style of a panel, PNG output."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from mpl_toolkits.mplot3d import Axes3D

from neuroflight.toolchain.files import write_bytes

DPI = 130
INK, GRID = "#22272e", "#d8dde3"
MUTED, SHADE = "#57606a", "#eef1f4"
# Okabe and Ito's palette: told apart in every kind of colour vision.
AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")
FLIGHT_COLOURS = ("#0072b2", "#e69f00", "#cc79a7", "#009e73")
MOTOR_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#000000")


def line_colour(number: int) -> str:
    """Return the colour of a line by its number, from 0."""
    return MOTOR_COLOURS[number % len(MOTOR_COLOURS)]


def titled_figure(size: tuple[float, float], title: str, pad: tuple[float, float] = (0.08, 0.08)) -> Figure:
    """Create an empty figure with its title at the upper left; size, pad (vertical, horizontal) [inch]."""
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(h_pad=pad[0], w_pad=pad[1]))
    figure.suptitle(title, x=0.01, ha="left", fontsize=15, fontweight="bold", color=INK)
    return figure


def dress(panel: Axes, name: str, across: str = "", up: str = "") -> None:
    """Set title, labels of the axes across and up, grid and spines of a panel as in all plots."""
    if across:
        panel.set_xlabel(across, color=INK)
    if up:
        panel.set_ylabel(up, color=INK)
    panel.set_title(name, loc="left", fontsize=11, fontweight="bold", color=INK, pad=4)
    panel.grid(color=GRID, lw=0.6)
    panel.set_axisbelow(True)
    panel.tick_params(colors=INK, labelsize=9)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(GRID)


def dress_cube(panel: Axes3D, reach: float) -> None:
    """Style a panel of roll, pitch and yaw rates, each from -reach to reach [deg/s]."""
    for axis, name in ((panel.xaxis, "roll"), (panel.yaxis, "pitch"), (panel.zaxis, "yaw")):
        axis.set_label_text(f"{name}, deg/s", color=INK, fontsize=9)
        axis.set_major_locator(MaxNLocator(5, symmetric=True))
        axis.set_pane_color((1.0, 1.0, 1.0, 1.0))
        axis._axinfo["grid"].update(color=GRID, linewidth=0.6)  # mplot3d has no public setter
    panel.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    panel.tick_params(colors=INK, labelsize=8, pad=0)
    panel.patch.set_visible(False)  # or it hides the labels of the panel to its left
    panel.set_box_aspect(None, zoom=0.9)


def legend_above(panel: Axes) -> Legend:
    """Add a legend in one row above the panel, at the right, beside its title."""
    handles, labels = panel.get_legend_handles_labels()
    return panel.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, 0.99),
        ncols=max(1, len(labels)),
        frameon=False,
        fontsize=9,
        borderaxespad=0.2,
        handlelength=1.6,
    )


def log_numbers(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times powers of ten, with plain numbers."""
    axis.set_major_locator(LogLocator(base=10, subs=(1, 2, 5)))
    axis.set_minor_locator(NullLocator())
    plain_numbers(axis)


def plain_numbers(axis: Axis) -> None:
    """Label the ticks of a logarithmic axis 0.5 or 20 instead of powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def png(figure: Figure) -> bytes:
    """Encode the figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def save_png(path: Path, figure: Figure) -> None:
    """Write the figure as PNG."""
    write_bytes(path, png(figure))
