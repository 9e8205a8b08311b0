"""The aircraft in the attitudes of a flight: poses side by side as PNG, or an animated GIF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.plotting import AXIS_COLOURS, GRID, INK, MUTED, dress, save_png
from neuroflight.sim.viewing.scene import Scene
from neuroflight.sim.viewing.shapes import Kind, aircraft_faces, disc_colour, reach
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.files import replacing

AZIMUTH, ELEVATION = np.deg2rad(35.0), np.deg2rad(28.0)  # of the camera: behind, to the right, above
LIGHT = np.array([-0.35, -0.25, 0.9]) / np.linalg.norm([-0.35, -0.25, 0.9])  # to it, world axes
BODY, NOSE = to_rgb("#8a94a0"), to_rgb(INK)
DISC_OPACITY = 0.55
TITLE, BELOW = 0.35, 1.9  # [inch] above the poses; of the panel of rates
GIF_DPI = 80
PICTURE_DPI = 100
FRAME_S = 0.05  # that a frame of a GIF is shown


def draw_pose(view: Axes, aircraft: Aircraft, rotation: Array, commands: Sequence[float]) -> None:
    """Draw the aircraft in an attitude (3, 3), seen from behind, the right and above; far faces first.

    commands: of the motors, 0..1; they colour the rotor discs.
    """
    az, el = AZIMUTH, ELEVATION
    across = np.array([np.sin(az), -np.cos(az), 0.0])
    back = np.array([-np.cos(el) * np.cos(az), -np.cos(el) * np.sin(az), np.sin(el)])
    camera = np.array([across, np.cross(back, across), back])  # rows: right, up, to the reader
    polygons, colours, edges, depths = [], [], [], []
    for face in aircraft_faces(aircraft):
        world = face.corners @ rotation.T
        if face.kind is Kind.DISC:
            colour = (*disc_colour(commands[face.motor]), DISC_OPACITY)
            edge = (*to_rgb(face.edge), 1.0)
        elif face.kind is Kind.NOSE:
            colour = edge = (*NOSE, 1.0)
        else:
            normal = np.cross(world[1] - world[0], world[2] - world[0])
            normal /= max(float(np.linalg.norm(normal)), 1e-12)
            light = 0.55 + 0.45 * abs(float(normal @ LIGHT))
            red, green, blue = (light * channel for channel in BODY)
            colour = edge = (red, green, blue, 1.0)
        seen = world @ camera.T
        polygons.append(seen[:, :2])
        colours.append(colour)
        edges.append(edge)
        depths.append(float(seen[:, 2].mean()))
    order = np.argsort(depths)
    view.add_collection(
        PolyCollection(
            [polygons[k] for k in order],
            facecolors=[colours[k] for k in order],
            edgecolors=[edges[k] for k in order],
            lw=[1.0 if colours[k][3] < 1 else 0.4 for k in order],
        )
    )
    limit = reach(aircraft)
    view.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    view.axis("off")


def pose_picture(
    aircraft: Aircraft, rotation: Array, commands: Sequence[float], pixels: int
) -> NDArray[np.uint8]:
    """Return `draw_pose` as a square picture (pixels, pixels, 3), red, green, blue."""
    figure = Figure(figsize=(pixels / PICTURE_DPI, pixels / PICTURE_DPI), dpi=PICTURE_DPI)
    canvas = FigureCanvasAgg(figure)
    draw_pose(figure.add_axes((0, 0, 1, 1)), aircraft, rotation, commands)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba(), np.uint8)[:, :, :3].copy()  # type: ignore[no-untyped-call]


def save_strip(path: Path, scene: Scene, rows: list[int]) -> None:
    """Write the poses of `rows` side by side, over commanded and flown rates, as PNG."""
    save_png(path, _figure(scene, rows, 2.3))


def save_gif(
    path: Path,
    scene: Scene,
    rows: list[int],
    frame_s: float,
    progress: Callable[[float], None] = lambda done: None,
) -> None:
    """Write one frame a row of `rows`, each shown for frame_s [s], in one step."""
    frames = []
    for number, row in enumerate(rows, start=1):
        canvas = FigureCanvasAgg(_figure(scene, [row], 3.6))
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


def _figure(scene: Scene, rows: list[int], side: float) -> Figure:
    trace = scene.trace
    width, height = max(5.6, side * len(rows)), TITLE + side + BELOW
    figure = Figure(figsize=(width, height))
    for number, row in enumerate(rows):
        view = figure.add_axes((number / len(rows), BELOW / height, 1 / len(rows), side / height))
        draw_pose(view, scene.aircraft, scene.rotation[row], trace.motors[row].tolist())
        title = f"{trace.t[row]:.2f} s"
        if scene.position is not None:
            title += "\n" + ", ".join(f"{value:.1f}" for value in scene.position[row].round(1) + 0.0) + " m"
        figure.text(
            (number + 0.5) / len(rows),
            1 - 0.08 / height,
            title,
            ha="center",
            va="top",
            fontsize=10,
            color=INK,
        )
    panel = figure.add_axes((0.62 / width, 0.38 / height, 1 - 0.75 / width, 1.14 / height))
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
