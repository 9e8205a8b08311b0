"""A flight as one HTML page that plays it: nothing is loaded from elsewhere, the data stand inside."""

from __future__ import annotations

import html
import json
from pathlib import Path

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.design.drawing import SPIN_COLOURS
from neuroflight.sim.physics.rotation import quaternion
from neuroflight.sim.plotting import AXIS_COLOURS, MOTOR_COLOURS
from neuroflight.sim.viewing.scene import Scene
from neuroflight.sim.viewing.shapes import BELOW, FULL_COLOUR, IDLE_COLOUR, aircraft_faces, reach
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.files import write_text
from neuroflight.toolchain.rendering.jinja import render

FRAME_S = 0.02  # between two poses of a page
FRAMES_MAX = 30_000  # ten minutes, 4 MB
SPEEDS = (0.05, 0.1, 0.25, 0.5, 1, 2, 5)  # to choose from in the page


def page_times(scene: Scene) -> Array:
    """Return the times [s] of the poses of a page."""
    begin, end = float(scene.trace.t[0]), float(scene.trace.t[-1])
    return np.arange(begin, end + 1e-9, FRAME_S)


def save_page(path: Path, scene: Scene, speed: float) -> None:
    """Write the page, which begins to play at `speed` times real time."""
    note = f"{scene.aircraft.name}; {scene.source}; {round(1 / FRAME_S)} poses a second"
    data = json.dumps(page_data(scene), separators=(",", ":")).replace("<", "\\u003c")
    motors = scene.aircraft.motor_count
    text = render(
        "flight_view.html.j2",
        title=html.escape(scene.title),
        note=html.escape(note),
        data=data,
        speeds=sorted({*SPEEDS, speed}),
        chosen=speed,
        idle=IDLE_COLOUR,
        full=FULL_COLOUR,
        spins=(SPIN_COLOURS[-1], SPIN_COLOURS[1]),
        axes=list(zip(AXES, AXIS_COLOURS, strict=True)),
        motors=MOTOR_COLOURS[:motors],
    )
    write_text(path, text)


def page_data(scene: Scene) -> dict[str, object]:
    """Return the data that the page's script draws: flat lists, one row after the other.

    attitude: quaternions w, x, y, z in 1e-4. place: [mm], or null. wanted, flown: rates in 0.1 deg/s.
    motors: in 1e-3. faces: corners in 0.1 mm about the centre of mass. Frames are FRAME_S apart.
    """
    trace, aircraft = scene.trace, scene.aircraft
    rows = scene.rows(page_times(scene))
    turns = np.array([quaternion(scene.rotation[row]) for row in rows])
    size = reach(aircraft)
    floor, place = -BELOW * size, None
    if scene.position is not None:
        floor += float(scene.position[:, 2].min())
        place = _whole(1e3 * scene.position[rows])
    faces = []
    for face in aircraft_faces(aircraft):
        item: dict[str, object] = {"kind": face.kind.value, "at": _whole(1e4 * face.corners)}
        faces.append(item | ({"motor": face.motor, "edge": face.edge} if face.motor >= 0 else {}))
    return {
        "start": round(float(trace.t[0]), 4),
        "step": FRAME_S,
        "frames": len(rows),
        "count": aircraft.motor_count,
        "reach": size,
        "floor": floor,
        "idle": IDLE_COLOUR,
        "full": FULL_COLOUR,
        "axis_colours": AXIS_COLOURS,
        "motor_colours": MOTOR_COLOURS[: aircraft.motor_count],
        "hubs": np.round(aircraft.rotor_positions, 4).tolist(),
        "faces": faces,
        "attitude": _whole(1e4 * turns),
        "place": place,
        "wanted": _whole(10 * np.rad2deg(trace.setpoint[rows])),
        "flown": _whole(10 * np.rad2deg(trace.rate[rows])),
        "motors": _whole(1e3 * trace.motors[rows]),
    }


def _whole(values: Array) -> list[int]:
    whole: list[int] = np.rint(values).astype(np.int64).ravel().tolist()
    return whole
