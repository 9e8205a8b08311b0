"""The aircraft in the attitudes of a flight: poses side by side as PNG, or an animated GIF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from sim.aircraft.mesh import box, equal_box
from sim.aircraft.model import Aircraft
from sim.design.drawing import SPIN_COLOURS, is_propeller, part_surface, propeller_radius
from sim.flight.trace import Trace
from sim.plotting import AXIS_COLOURS, GRID, INK, MUTED, dress, save_png
from toolchain.contract import AXES
from toolchain.files import replacing

Array = NDArray[np.float64]
AZIMUTH, ELEVATION = np.deg2rad(35.0), np.deg2rad(28.0)  # of the camera: behind, to the right, above
LIGHT = np.array([-0.35, -0.25, 0.9]) / np.linalg.norm([-0.35, -0.25, 0.9])  # to it, world axes
BODY, NOSE = to_rgb("#8a94a0"), to_rgb("#22272e")
DISC_CORNERS = 32
GIF_DPI = 80
FRAME_S = 0.05  # that a frame of a GIF is shown


def aircraft_faces(aircraft: Aircraft) -> list[tuple[Array, tuple[float, float, float], float]]:
    """Polygons (K, 3) [m] about the centre of mass, body axes, with colour (RGB) and opacity.

    Parts of which only mass and inertia are known are the boxes of their inertia; an arrow points forward.
    """
    centre = aircraft.mass_properties.centre
    faces: list[tuple[Array, tuple[float, float, float], float]] = []
    for part in aircraft.parts:
        if is_propeller(part):
            continue
        surface, true = part_surface(part)
        if not true and not part.name.startswith("motor "):
            size, axes = equal_box(part.mass, part.inertia)
            about = box((size[0], size[1], size[2]), (0.0, 0.0, 0.0)).surface
            assert about is not None
            surface = about @ axes.T + np.array(part.centre) + np.array(part.position)
        faces += [(triangle - centre, BODY, 1.0) for triangle in surface]
    radius = propeller_radius(aircraft)
    angle = 2 * np.pi * np.arange(DISC_CORNERS) / DISC_CORNERS
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    for rotor in aircraft.rotors:
        hub = np.array(rotor.position) - centre
        faces.append((hub + ring, to_rgb(SPIN_COLOURS[rotor.spin]), 0.35))
        arm = np.array([hub, 0 * hub])
        side = 0.06 * radius * np.array([-hub[1], hub[0], 0.0]) / max(float(np.hypot(*hub[:2])), 1e-9)
        faces.append((np.array([arm[0] + side, arm[0] - side, arm[1] - side, arm[1] + side]), BODY, 1.0))
    tip = aircraft.rotor_positions[:, 0].max() - centre[0] + 0.6 * radius
    base, half = 0.6 * tip, 0.25 * radius
    faces.append((np.array([[tip, 0.0, 0.0], [base, half, 0.0], [base, -half, 0.0]]), NOSE, 1.0))
    return faces


def draw_pose(view: Axes, aircraft: Aircraft, rotation: Array) -> None:
    """Draw the aircraft in an attitude (3, 3), seen from behind, the right and above; far faces first."""
    az, el = AZIMUTH, ELEVATION
    across = np.array([np.sin(az), -np.cos(az), 0.0])
    back = np.array([-np.cos(el) * np.cos(az), -np.cos(el) * np.sin(az), np.sin(el)])
    camera = np.array([across, np.cross(back, across), back])  # rows: right, up, to the reader
    polygons, colours, depths = [], [], []
    for corners, colour, opacity in aircraft_faces(aircraft):
        world = corners @ rotation.T
        normal = np.cross(world[1] - world[0], world[2] - world[0])
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        light = 0.55 + 0.45 * abs(float(normal @ LIGHT)) if opacity == 1.0 else 1.0
        seen = world @ camera.T
        polygons.append(seen[:, :2])
        colours.append((*(light * channel for channel in colour), opacity))
        depths.append(float(seen[:, 2].mean()))
    order = np.argsort(depths)
    view.add_collection(
        PolyCollection(
            [polygons[k] for k in order],
            facecolors=[colours[k] for k in order],
            edgecolors=[colours[k] for k in order],
            lw=0.4,
        )
    )
    reach = float(np.linalg.norm(aircraft.rotor_positions, axis=1).max()) + propeller_radius(aircraft)
    view.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    view.axis("off")


def save_strip(path: Path, aircraft: Aircraft, trace: Trace, rotation: Array, rows: list[int]) -> None:
    """Write the poses of `rows` side by side, over commanded and flown rates, as PNG."""
    save_png(path, _figure(aircraft, trace, rotation, rows, 2.3))


def save_gif(
    path: Path,
    aircraft: Aircraft,
    trace: Trace,
    rotation: Array,
    rows: list[int],
    frame_s: float,
    progress: Callable[[float], None] = lambda done: None,
) -> None:
    """Write one frame a row of `rows`, each shown for frame_s [s], in one step."""
    frames = []
    for number, row in enumerate(rows, start=1):
        canvas = FigureCanvasAgg(_figure(aircraft, trace, rotation, [row], 4.2))
        canvas.figure.set_dpi(GIF_DPI)
        canvas.draw()  # type: ignore[no-untyped-call]
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3]).quantize(64))  # type: ignore[no-untyped-call]
        progress(number / len(rows))
    with replacing(path) as aside:
        frames[0].save(
            aside,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 * frame_s),
            loop=0,
        )


def _figure(aircraft: Aircraft, trace: Trace, rotation: Array, rows: list[int], side: float) -> Figure:
    width = max(4.2, side * len(rows))
    figure = Figure(figsize=(width, side + 1.9))
    split = 1.9 / (side + 1.9)
    for number, row in enumerate(rows):
        view = figure.add_axes((number / len(rows), split, 1 / len(rows), 0.93 - split))
        draw_pose(view, aircraft, rotation[row])
        view.set_title(f"{trace.t[row]:.2f} s", fontsize=10, color=INK)
    panel = figure.add_axes((0.62 / width, 0.2 * split, 1 - 0.75 / width, 0.6 * split))
    dress(panel, "")
    every = max(1, len(trace.t) // 4000)
    for axis, name in enumerate(AXES):
        colour = AXIS_COLOURS[axis]
        flown, wanted = (np.rad2deg(each[::every, axis]) for each in (trace.rate, trace.setpoint))
        panel.plot(trace.t[::every], wanted, color=colour, lw=0.9, ls="--")
        panel.plot(trace.t[::every], flown, color=colour, lw=1.2, label=name)
    for row in rows:
        panel.axvline(float(trace.t[row]), color=MUTED, lw=0.8)
    panel.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, frameon=False, fontsize=8)
    panel.set_title("deg/s (dashed: commanded), over s", loc="left", fontsize=8, color=MUTED)
    panel.tick_params(labelsize=7)
    panel.grid(color=GRID, lw=0.5)
    return figure
