"""Drawing of an aircraft from above and from behind, to one scale.

Solids and meshes are drawn as they are; a part of which only the inertia is known, as the box (a motor: the
cylinder) that has this inertia, dashed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle, Wedge
from matplotlib.path import Path as Curve
from matplotlib.ticker import MaxNLocator
from scipy.spatial import ConvexHull

from neuroflight.sim.aircraft.mass import Part, rotation_matrix
from neuroflight.sim.aircraft.mesh import cylinder, equal_box
from neuroflight.sim.aircraft.model import RPM, Aircraft, Rotor
from neuroflight.sim.arrays import Array
from neuroflight.sim.design.figures import AircraftFigures
from neuroflight.sim.plotting import GRID, INK, save_png

MM = 1000.0  # drawn in millimetres
WIDTH, COLUMN, MARGIN = 6.4, 2.75, 0.8  # [inch]: of a view, of the figures beside it, at left and below
SPIN_COLOURS = {1: "#0072b2", -1: "#d55e00"}
SPIN_NAMES = {1: "counter-clockwise", -1: "clockwise"}
SOLID, ESTIMATE, THRUST = "#8a94a0", "#6b7682", "#009e73"
UNKNOWN_RADIUS = 0.35  # of the distance to the next hub, where the propeller's diameter is not given
DARK, PALE = (0.26, 0.30, 0.35), (0.80, 0.83, 0.87)  # RGB of solids in the shadow and in the light
LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])  # across, up the page, to the reader
FROM_ABOVE, FROM_BEHIND = (1, 0, 2), (1, 2, 0)  # axes across the page, up it, and towards the reader


def draw_aircraft(aircraft: Aircraft, figures: AircraftFigures) -> Figure:
    """Draw the aircraft from above (x up the page, y to the left) and from behind, with its figures."""
    radius = propeller_radius(aircraft)
    points = _outline_points(aircraft, radius)
    low, high = MM * points.min(axis=0), MM * points.max(axis=0)
    across = 2 * 1.08 * max(abs(low[1]), abs(high[1]))
    scale = WIDTH / across  # inches a millimetre
    along_pad, up_pad = 0.125 * across, 0.055 * across
    tall = (high[0] - low[0] + 2 * along_pad) * scale
    flat = (high[2] - low[2] + 2 * up_pad) * scale
    title, gap = 1.05, 0.62
    size = (MARGIN + WIDTH + COLUMN, title + tall + gap + flat + MARGIN)
    figure = Figure(figsize=size)

    def place(left: float, bottom: float, width: float, height: float) -> Axes:
        return figure.add_axes((left / size[0], bottom / size[1], width / size[0], height / size[1]))

    above = place(MARGIN, MARGIN + flat + gap, WIDTH, tall)
    behind = place(MARGIN, MARGIN, WIDTH, flat)
    for view, axis, pad in ((above, 0, along_pad), (behind, 2, up_pad)):
        view.set_xlim(across / 2, -across / 2)
        view.set_ylim(low[axis] - pad, high[axis] + pad)
        _dress(view)
    for view, name, up in ((above, "from above", "x forward, mm"), (behind, "from behind", "z up, mm")):
        view.set_title(name, loc="left", fontsize=11, fontweight="bold", color=INK, pad=4)
        view.set_ylabel(up, color=INK)
    behind.set_xlabel("y left, mm", color=INK)

    _draw_parts(above, aircraft.parts, FROM_ABOVE)
    _draw_parts(behind, aircraft.parts, FROM_BEHIND)
    for number, rotor in enumerate(aircraft.rotors, start=1):
        _draw_rotor(above, number, rotor, MM * radius, aircraft.propulsion.propeller_diameter is not None)
    _draw_rotors_behind(behind, aircraft.rotors, MM * radius, across)
    if aircraft.body is not None:
        _draw_ground(behind, aircraft, across)
    for view, (i, j, _) in ((above, FROM_ABOVE), (behind, FROM_BEHIND)):
        thrust, mass = MM * np.array(aircraft.centre_of_thrust), MM * figures.centre
        _draw_centre_of_thrust(view, thrust[i], thrust[j], 0.017 * across)
        _draw_centre_of_mass(view, mass[i], mass[j], 0.013 * across)
    _draw_compass(above, across)
    _draw_scale_bar(above, across)

    left = MARGIN / size[0]
    figure.text(left, 1 - 0.42 / size[1], aircraft.name, fontsize=17, fontweight="bold", color=INK)
    figure.text(left, 1 - 0.63 / size[1], aircraft.description, fontsize=10, color=ESTIMATE)
    column = (MARGIN + WIDTH + 0.3) / size[0]
    top = 1 - (title + 0.1) / size[1]
    bottom = _write_figures(figure, column, top, 0.2 / size[1], aircraft, figures)
    figure.legend(
        handles=_legend(aircraft),
        loc="upper left",
        bbox_to_anchor=(column - 0.004, bottom - 0.1 / size[1]),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        handlelength=1.6,
        borderpad=0,
        borderaxespad=0,
        labelspacing=0.7,
    )
    return figure


def save_drawing(path: Path, aircraft: Aircraft, figures: AircraftFigures) -> None:
    """Write the drawing as PNG."""
    save_png(path, draw_aircraft(aircraft, figures))


def propeller_radius(aircraft: Aircraft) -> float:
    """Return the radius of a propeller as it is drawn [m]."""
    diameter = aircraft.propulsion.propeller_diameter
    if diameter is not None:
        return diameter / 2
    hubs = aircraft.rotor_positions
    apart = np.linalg.norm(hubs[:, None, :2] - hubs[None, :, :2], axis=2)
    return UNKNOWN_RADIUS * float(apart[apart > 1e-3].min(initial=1.0))


def _outline_points(aircraft: Aircraft, radius: float) -> Array:
    """Return points (K, 3) [m] that the views must contain."""
    hubs = np.array([rotor.position for rotor in aircraft.rotors])
    reach = np.array([[radius, radius, 0.0]])
    points = [hubs - reach, hubs + reach, aircraft.mass_properties.centre[None]]
    points += [part_surface(part)[0].reshape(-1, 3) for part in aircraft.parts if not is_propeller(part)]
    if aircraft.body is not None:
        centre, half = np.array(aircraft.body.centre), np.array(aircraft.body.size) / 2
        points.append(np.array([[0.0, 0.0, centre[2] - half[2]]]))
    return np.concatenate(points)


def is_propeller(part: Part) -> bool:
    """Return True if a part sits on a rotor, where its disc is drawn instead."""
    return part.name.startswith("propeller ") and part.surface is None


def part_surface(part: Part) -> tuple[Array, bool]:
    """Return triangles (K, 3, 3) [m] of a part in the body frame, and True if they are its true shape."""
    if part.surface is not None:
        own, true = part.surface, True
    else:
        own, true = _equal_solid(part), False
    placed: Array = own @ rotation_matrix(part.rotation).T + np.array(part.position)
    return placed, true


def _equal_solid(part: Part) -> Array:
    centre = np.array(part.centre)
    if part.name.startswith("motor "):
        across, along = part.inertia[0][0] / part.mass, part.inertia[2][2] / part.mass
        height = np.sqrt(max(12 * (across - along / 2), 1e-8))
        return cylinder(float(np.sqrt(2 * along)), float(height), part.centre).surface
    size, axes = equal_box(part.mass, part.inertia)
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    corners = centre + (signs * size / 2) @ axes.T
    box: Array = corners[np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)])]  # two faces hold all corners
    return box


def _draw_parts(view: Axes, parts: Sequence[Part], axes: tuple[int, int, int]) -> None:
    surfaces = [part_surface(part) for part in parts if not is_propeller(part)]
    true = [surface for surface, known in surfaces if known]
    if true:
        _draw_solid(view, MM * np.concatenate(true)[:, :, axes], axes)
    for surface, known in surfaces:
        if not known:
            hull = _hull(MM * surface.reshape(-1, 3)[:, axes[:2]])
            view.add_patch(Polygon(hull, facecolor=SOLID, alpha=0.16, lw=0, zorder=2.2))
            view.add_patch(Polygon(hull, fill=False, edgecolor=ESTIMATE, lw=0.8, ls=(0, (3, 2)), zorder=2.3))


def _draw_solid(view: Axes, triangles: Array, axes: tuple[int, int, int]) -> None:
    """Draw triangles (K, 3, 3) [mm], corners on page axes: far ones first, near and lit ones lighter."""
    reader = 1.0 if axes == FROM_ABOVE else -1.0  # on the page's third axis: at high z, or behind at low x
    depth = reader * triangles[:, :, 2].mean(axis=1)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals *= -1.0 if axes == FROM_ABOVE else 1.0  # y, x, z is a left-handed order of axes, y, z, x is not
    normals[:, 2] *= reader
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    facing = normals[:, 2] > 1e-6
    order = np.argsort(depth[facing])
    near = depth[facing][order]
    near = (near - near[0]) / max(float(np.ptp(near)), 1e-9)
    light = np.clip(normals[facing][order] @ LIGHT, 0.0, 1.0)
    shade = (0.42 + 0.36 * light + 0.22 * near)[:, None]
    colours = np.array(DARK) + shade * (np.array(PALE) - np.array(DARK))
    view.add_collection(
        PolyCollection(
            list(triangles[facing][order][:, :, :2]),
            facecolors=colours.tolist(),
            edgecolors=colours.tolist(),
            lw=0.5,
            zorder=2,
        )
    )


def _draw_rotor(view: Axes, number: int, rotor: Rotor, radius: float, known: bool) -> None:
    x, y, _ = (MM * value for value in rotor.position)
    colour = SPIN_COLOURS[rotor.spin]
    style = "-" if known else (0, (4, 3))
    view.add_patch(Circle((y, x), radius, facecolor=colour, alpha=0.10, lw=0, zorder=3))
    view.add_patch(Circle((y, x), radius, fill=False, edgecolor=colour, lw=1.2, ls=style, zorder=3.1))
    # An open circle with a head; angles from x towards y, which is counter-clockwise seen from above.
    angles = np.deg2rad(np.linspace(30, 330, 60))[:: rotor.spin]
    arc = np.column_stack([y + 0.72 * radius * np.sin(angles), x + 0.72 * radius * np.cos(angles)])
    view.add_patch(
        FancyArrowPatch(
            path=Curve(arc),
            arrowstyle="-|>",
            mutation_scale=15,
            color=colour,
            lw=1.8,
            zorder=3.2,
            capstyle="round",
        )
    )
    box = {"boxstyle": "circle,pad=0.28", "facecolor": "white", "edgecolor": colour, "lw": 1.2}
    _write(
        view, y, x, str(number), 14, "center_baseline", fontweight="bold", color=colour, zorder=5, bbox=box
    )


def _draw_rotors_behind(view: Axes, rotors: Sequence[Rotor], radius: float, across: float) -> None:
    hubs: dict[tuple[float, float], list[int]] = {}
    for number, rotor in enumerate(rotors, start=1):
        hubs.setdefault((round(rotor.position[1], 2), round(rotor.position[2], 2)), []).append(number)
        _, y, z = (MM * value for value in rotor.position)
        colour = SPIN_COLOURS[rotor.spin]
        view.plot(
            [y - radius, y + radius],
            [z, z],
            color=colour,
            lw=2.2,
            alpha=0.55,
            solid_capstyle="round",
            zorder=3,
        )
    for numbers in hubs.values():
        first = rotors[numbers[0] - 1].position
        text, (_, y, z) = " ".join(map(str, numbers)), (MM * value for value in first)
        _write(view, y, z + 0.012 * across, text, 10, "bottom", fontweight="bold", zorder=5)


def _draw_ground(view: Axes, aircraft: Aircraft, across: float) -> None:
    """Draw the box that touches the ground, and the ground."""
    assert aircraft.body is not None
    (_, width, height), (_, y, z) = aircraft.body.size, aircraft.body.centre
    low = MM * (z - height / 2)
    view.add_patch(
        Rectangle(
            (MM * (y - width / 2), low),
            MM * width,
            MM * height,
            fill=False,
            edgecolor=INK,
            lw=0.8,
            ls=(0, (1, 2)),
            zorder=2.5,
        )
    )
    view.plot([-across / 2, across / 2], [low, low], color=INK, lw=1.0, zorder=2.4)


def _draw_centre_of_mass(view: Axes, across: float, up: float, radius: float) -> None:
    for start in (0, 90, 180, 270):
        colour = INK if start % 180 == 0 else "white"
        view.add_patch(Wedge((across, up), radius, start, start + 90, facecolor=colour, lw=0, zorder=6))
    view.add_patch(Circle((across, up), radius, fill=False, edgecolor=INK, lw=1.1, zorder=6.1))


def _draw_centre_of_thrust(view: Axes, across: float, up: float, radius: float) -> None:
    view.add_patch(Circle((across, up), radius, fill=False, edgecolor=THRUST, lw=1.8, zorder=5.8))
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        view.plot(
            [across + radius * dx, across + 1.7 * radius * dx],
            [up + radius * dy, up + 1.7 * radius * dy],
            color=THRUST,
            lw=1.8,
            zorder=5.8,
        )


def _draw_compass(view: Axes, across: float) -> None:
    """Draw the body axes in the lower left corner."""
    length = 0.07 * across
    y, x = view.get_xlim()[0] - 0.11 * across, view.get_ylim()[0] + 0.03 * across
    for dy, dx, name in ((0, 1, "x"), (1, 0, "y")):
        tip = (y + dy * length, x + dx * length)
        view.add_patch(
            FancyArrowPatch(
                (y, x), tip, arrowstyle="-|>", mutation_scale=11, color=INK, lw=1.3, shrinkA=0, shrinkB=0
            )
        )
        at = y + dy * 1.22 * length, x + dx * 1.22 * length
        _write(view, *at, name, 10, "center", fontstyle="italic")


def _draw_scale_bar(view: Axes, across: float) -> None:
    """Draw a scale bar in the lower right corner, a round length of up to a fifth of the view."""
    power = 10 ** np.floor(np.log10(across / 5))
    length = max(step * power for step in (1, 2, 5) if step * power <= across / 5)
    right, low = view.get_xlim()[1] + 0.035 * across, view.get_ylim()[0] + 0.035 * across
    view.plot([right, right + length], [low, low], color=INK, lw=2.5, solid_capstyle="butt")
    _write(view, right + length / 2, low + 0.012 * across, f"{length:g} mm", 9, "bottom")


def _write_figures(
    figure: Figure, left: float, top: float, step: float, aircraft: Aircraft, figures: AircraftFigures
) -> float:
    """Write the column of figures; return its lower end."""
    centre = ", ".join(f"{value:.0f}" for value in np.rint(MM * figures.centre) + 0.0)
    moments = " / ".join(f"{1e3 * value:.3g}" for value in figures.principal_moments)
    rows = [
        ("mass", f"{figures.mass:.3g} kg"),
        ("wheelbase", f"{MM * figures.wheelbase:.0f} mm"),
        ("centre of mass", f"{centre} mm"),
        ("principal moments", f"{moments} g m²"),
        ("thrust to weight", f"{figures.thrust_to_weight:.2f}"),
    ]
    if figures.hover is not None:
        rows += [
            ("hover throttle", f"{100 * figures.hover.throttle.mean():.0f} %"),
            ("hover speed", f"{figures.hover.speed.mean() / RPM:,.0f} rpm"),
        ]
    if figures.endurance is not None:
        rows.append(("hover current", f"{figures.endurance.current:.1f} A"))
        rows.append(("hover time", f"{figures.endurance.seconds / 60:.0f} min"))
    for label, value in rows:
        figure.text(left, top, label, fontsize=9, color=ESTIMATE, va="center")
        figure.text(left, top - 0.85 * step, value, fontsize=11, color=INK, va="center")
        top -= 2.15 * step
    return top


def _legend(aircraft: Aircraft) -> list[Line2D]:
    handles = [
        _ring("white", SPIN_COLOURS[spin], SPIN_NAMES[spin])
        for spin in sorted({rotor.spin for rotor in aircraft.rotors})
    ]
    handles.append(_ring(INK, INK, "centre of mass"))
    handles[-1].set_fillstyle("left")
    handles.append(_ring("white", THRUST, "centre of thrust"))
    if any(part.surface is None and not is_propeller(part) for part in aircraft.parts):
        handles.append(Line2D([], [], color=ESTIMATE, lw=1, ls=(0, (3, 2)), label="solid of equal inertia"))
    if aircraft.body is not None:
        handles.append(Line2D([], [], color=INK, lw=1, ls=(0, (1, 2)), label="body: drag, ground"))
    if aircraft.propulsion.propeller_diameter is None:
        handles.append(Line2D([], [], color="none", label="(propeller diameter not given)"))
    return handles


def _ring(face: str, edge: str, label: str) -> Line2D:
    return Line2D(
        [],
        [],
        color="none",
        marker="o",
        markersize=10,
        markeredgewidth=1.3,
        markerfacecolor=face,
        markeredgecolor=edge,
        label=label,
    )


def _dress(view: Axes) -> None:
    view.set_aspect("equal")
    view.yaxis.set_label_coords(-0.085, 0.5)
    view.grid(color=GRID, lw=0.5)
    view.set_axisbelow(True)
    view.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    view.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10], min_n_ticks=2))
    view.tick_params(colors=INK, labelsize=9)
    for spine in view.spines.values():
        spine.set_color(GRID)


def _write(view: Axes, across: float, up: float, text: str, size: float, va: str, **style: object) -> None:
    """Write a text, centred across."""
    view.text(across, up, text, fontsize=size, ha="center", va=va, **{"color": INK, **style})  # type: ignore[arg-type]


def _hull(points: Array) -> Array:
    """Compute the convex hull (H, 2) of points (K, 2); a flat part's may lie on a line (QJ)."""
    hull: Array = points[ConvexHull(points, qhull_options="QJ").vertices]
    return hull
