"""`aircraft check` detects a propeller's mesh that is not flat, and the line it suggests turns it flat."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from neuroflight.sim.aircraft.mass import rotation_angles, rotation_matrix
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.design.airworthiness import Level, examine
from tests.sampling import examples, sampled

RADIUS = 0.063  # [m], of a propeller of 5 inches
SECTIONS = 12  # along a blade


def propeller(blades: int, *, hub: float = 0.006, pitch: float = 0.109) -> trimesh.Trimesh:
    """Return blades with a constant pitch around a hub, in metres, z along the shaft.

    Each blade is made of plates 10 mm deep and 1.2 mm thick whose angle falls with the radius as
    pitch / (2 pi r) does; the hub is a cylinder.
    """
    solids, length = [trimesh.creation.cylinder(0.008, hub)], (RADIUS - 0.008) / SECTIONS
    for blade, k in itertools.product(range(blades), range(SECTIONS)):
        plate, r = trimesh.creation.box((length, 0.010, 0.0012)), 0.008 + (k + 0.5) * length
        plate.vertices = plate.vertices @ rotation_matrix((math.atan2(pitch, 2 * math.pi * r), 0.0, 0.0)).T
        plate.vertices[:, 0] += r
        plate.vertices = plate.vertices @ rotation_matrix((0.0, 0.0, 2 * math.pi * blade / blades)).T
        solids.append(plate)
    mesh = trimesh.util.concatenate(solids)
    assert isinstance(mesh, trimesh.Trimesh) and mesh.is_watertight
    return mesh


def aircraft_of(folder: Path, mesh: trimesh.Trimesh, lines: str = "") -> Path:
    """Write the NF1 with this mesh as its propellers."""
    data = mesh.export(file_type="stl")
    assert isinstance(data, bytes)
    (folder / "prop.stl").write_bytes(data)
    text = (FOLDER / "nf1.toml").read_text()
    part = re.search(r"\[propeller_part\]\n(?:.+\n)*", text)
    assert part is not None
    own = f'[propeller_part]\nmass_kg = 0.004\nmesh = "prop.stl"\nmesh_unit_m = 1\n{lines}'
    path = folder / "own.toml"
    path.write_text(text.replace(part[0], own))
    return path


def warnings(path: Path) -> list[str]:
    """Return the warnings of `aircraft check` about the propeller's part."""
    _, verdicts = examine(load_aircraft(str(path)))
    return [one.message for one in verdicts if one.level is Level.WARNING and "propeller_part" in one.message]


FLAT = itertools.product((2, 3, 4, 5), (0.003, 0.012), (0.06, 0.109, 0.127))  # blades, hub and pitch [m]
EDGES = [(2, 0.003, 0.127), (3, 0.012, 0.109), (4, 0.003, 0.06), (5, 0.012, 0.127)]


@pytest.mark.parametrize("shape", sampled(FLAT, *EDGES))
def test_a_propeller_that_lies_flat_is_no_matter(tmp_path: Path, shape: tuple[int, float, float]) -> None:
    blades, hub, pitch = shape
    assert warnings(aircraft_of(tmp_path, propeller(blades, hub=hub, pitch=pitch))) == []


@pytest.mark.parametrize("blades", [2, 3, 4])
@pytest.mark.parametrize(
    ("drawn", "mend"),
    [((90.0, 0.0, 0.0), "[90, 0, 0]"), ((0.0, 90.0, 0.0), "[0, -90, 0]"), ((-90.0, 0.0, 30.0), None)],
)
def test_an_upright_propeller_is_seen_and_its_mend_lays_it_flat(
    tmp_path: Path, blades: int, drawn: tuple[float, float, float], mend: str | None
) -> None:
    mesh = propeller(blades)
    flat = load_aircraft(str(aircraft_of(tmp_path, mesh))).parts[-1].inertia
    turn = np.eye(4)
    turn[:3, :3] = rotation_matrix(tuple(np.deg2rad(drawn).tolist()))
    mesh.apply_transform(turn)
    (message,) = warnings(aircraft_of(tmp_path, mesh))
    assert "stands upright: its thin axis is 90 deg off z" in message
    line = message.rpartition("turn it by ")[2]
    if mend is not None:
        assert line == f"mesh_rotation_deg = {mend}"
    path = aircraft_of(tmp_path, mesh, line + "\n")
    assert warnings(path) == []
    mended = np.array(load_aircraft(str(path)).parts[-1].inertia)
    assert mended[2, 2] == pytest.approx(flat[2][2], rel=1e-3)


def test_a_mend_takes_up_the_rotation_that_a_file_has(tmp_path: Path) -> None:
    """Draw random poses: the suggested line lays the propeller flat, whatever rotation the file has."""
    rng = np.random.default_rng(2)
    mesh = propeller(3)
    for _ in range(examples(40)):
        angles = ", ".join(f"{angle:.1f}" for angle in rng.uniform(-180.0, 180.0, 3))
        told = warnings(aircraft_of(tmp_path, mesh, f"mesh_rotation_deg = [{angles}]\n"))
        if told:
            line = told[0].rpartition("turn it by ")[2]
            assert warnings(aircraft_of(tmp_path, mesh, line + "\n")) == []


def test_a_propeller_beside_its_hub_is_moved(tmp_path: Path) -> None:
    mesh = propeller(3)
    mesh.apply_translation((0.07, -0.02, 0.004))
    (message,) = warnings(aircraft_of(tmp_path, mesh))
    assert "73 mm off its hub's axis; move it by mesh_offset_m = [-0.07, 0.02, 0]" in message
    line = message.rpartition("move it by ")[2]
    assert warnings(aircraft_of(tmp_path, mesh, line + "\n")) == []


def test_moments_and_boxes_in_the_wrong_order_are_seen(tmp_path: Path) -> None:
    text = (FOLDER / "nf1.toml").read_text()
    part = re.search(r"\[propeller_part\]\n(?:.+\n)*", text)
    assert part is not None
    path = tmp_path / "own.toml"
    for lines, message in (
        ("centre_of_mass_m = [0, 0, 0]\ninertia_kg_m2 = [3.4e-6, 1.7e-6, 1.7e-6]", "greatest moment about x"),
        (
            "box_m = [0.12, 0.002, 0.012]",
            "thin axis is 90 deg off z, where rotors thrust; check the order of box_m",
        ),
    ):
        path.write_text(text.replace(part[0], f"[propeller_part]\nmass_kg = 0.004\n{lines}\n"))
        (told,) = warnings(path)
        assert message in told


def test_angles_give_back_the_matrix_they_are_of() -> None:
    rng = np.random.default_rng(3)
    right = [-math.pi, -math.pi / 2, 0.0, math.pi / 2, math.pi]
    for number in range(examples(800)):
        angles = rng.choice(right, 3) if number % 2 else rng.uniform(-7.0, 7.0, 3)
        turn = rotation_matrix((float(angles[0]), float(angles[1]), float(angles[2])))
        assert rotation_matrix(rotation_angles(turn)) == pytest.approx(turn, abs=1e-7)
