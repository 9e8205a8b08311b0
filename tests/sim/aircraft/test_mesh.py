"""Solids against closed forms, and meshes that have no inside."""

import math
import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from neuroflight.sim.aircraft.mass import MeshPose
from neuroflight.sim.aircraft.mesh import BYTES_MAX, Solid, box, cylinder, equal_box, placed, read_solid

MM = 0.001


def stl(mesh: trimesh.Trimesh) -> bytes:
    data = mesh.export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def brick() -> trimesh.Trimesh:
    """100 x 40 x 20 mm, its centre at (10, 20, 30) mm."""
    mesh: trimesh.Trimesh = trimesh.creation.box((100, 40, 20))
    mesh.apply_translation((10, 20, 30))
    return mesh


def test_brick_weighs_as_its_closed_form_however_it_is_given() -> None:
    inside_out, text = brick(), brick().export(file_type="stl_ascii")
    inside_out.invert()
    assert isinstance(text, str)
    meshes = [read_solid(data, MM) for data in (stl(brick()), text.encode(), stl(inside_out))]
    x, y, z = 0.1**2, 0.04**2, 0.02**2
    for solid in [*meshes, box((0.1, 0.04, 0.02), (0.01, 0.02, 0.03))]:
        assert solid.centre == pytest.approx((0.01, 0.02, 0.03))
        expected = np.diag([y + z, z + x, x + y]) / 12
        assert np.array(solid.inertia) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_mesh_is_hollow_when_it_is_a_tube() -> None:
    solid = read_solid(stl(trimesh.creation.annulus(30, 40, 100, sections=400)), MM)
    along = (0.03**2 + 0.04**2) / 2
    assert solid.inertia[2][2] == pytest.approx(along, rel=1e-3)
    assert solid.inertia[0][0] == pytest.approx(along / 2 + 0.1**2 / 12, rel=1e-3)


def test_mesh_is_turned_about_its_own_origin_and_then_moved() -> None:
    """Roll a brick of 100 x 40 x 20 mm about (10, 20, 30) mm by 90 degrees: y goes to z, z to -y."""
    solid = placed(read_solid(stl(brick()), MM), MeshPose((90.0, 0.0, 0.0), (0.1, 0.0, 0.0)))
    x, y, z = 0.1**2, 0.02**2, 0.04**2
    assert solid.centre == pytest.approx((0.11, -0.03, 0.02))
    assert np.array(solid.inertia) == pytest.approx(np.diag([y + z, z + x, x + y]) / 12, rel=1e-6, abs=1e-12)
    low, high = solid.surface.reshape(-1, 3).min(axis=0), solid.surface.reshape(-1, 3).max(axis=0)
    assert low == pytest.approx([0.06, -0.04, 0.0]) and high == pytest.approx([0.16, -0.02, 0.04])


def test_turned_mesh_weighs_as_one_that_was_drawn_turned() -> None:
    """Compare with corners that scipy rotated before they were weighed."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        angles, offset = rng.uniform(-360.0, 360.0, 3), rng.uniform(-0.2, 0.2, 3)
        drawn = brick()
        drawn.vertices = Rotation.from_euler("xyz", angles, degrees=True).apply(drawn.vertices)
        drawn.apply_translation(1000 * offset)
        other = read_solid(stl(drawn), MM)
        x, y, z = angles.tolist()
        pose = MeshPose((x, y, z), (float(offset[0]), float(offset[1]), float(offset[2])))
        mine = placed(read_solid(stl(brick()), MM), pose)
        assert mine.centre == pytest.approx(other.centre, abs=1e-7)
        assert np.array(mine.inertia) == pytest.approx(np.array(other.inertia), abs=1e-8)


def test_cylinder_has_its_closed_form_when_made_from_radius_and_height() -> None:
    solid = cylinder(0.05, 0.2, (0.0, 0.0, 0.1))
    across = 0.05**2 / 4 + 0.2**2 / 12
    assert np.array(solid.inertia) == pytest.approx(np.diag([across, across, 0.05**2 / 2]))
    assert solid.centre == (0.0, 0.0, 0.1)


@pytest.mark.parametrize("solid", [box((0.1, 0.04, 0.02), (0.3, 0, 0)), cylinder(0.05, 0.2, (0.0, 0.1, 0.0))])
def test_surface_is_closed_and_faces_outward_when_drawn(solid: Solid) -> None:
    corners = solid.surface.reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.center_mass == pytest.approx(solid.centre, abs=1e-9)


def test_equal_box_finds_the_box_when_given_its_inertia() -> None:
    solid = box((0.1, 0.04, 0.02), (0.0, 0.0, 0.0))
    inertia = tuple(tuple(0.3 * value for value in row) for row in solid.inertia)
    size, axes = equal_box(0.3, inertia)  # type: ignore[arg-type]
    assert np.abs(axes) @ size == pytest.approx([0.1, 0.04, 0.02])


def open_box() -> bytes:
    mesh = brick()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    return stl(mesh)


def not_a_number() -> bytes:
    data = bytearray(stl(brick()))
    struct.pack_into("<f", data, 84 + 12, math.nan)
    return bytes(data)


def flat() -> bytes:
    corners = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [30, 30, 0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    return stl(trimesh.Trimesh(corners, faces, process=False))


@pytest.mark.parametrize(
    ("data", "unit", "expected"),
    [
        (b"", MM, "not an STL"),
        (b"solid but nothing more", MM, "not an STL"),
        (b"PK\x03\x04" + bytes(500), MM, "not an STL"),
        (stl(brick())[:-1], MM, "not an STL"),
        (b"solid a\nfacet normal x y z\nouter loop\nvertex 1 2\n", MM, "damaged|holds no solid"),
        (bytes(80) + struct.pack("<I", 0), MM, "damaged|holds no solid"),
        (not_a_number(), MM, "damaged|holds no solid|watertight"),
        (open_box(), MM, "not watertight.*close its holes"),
        (flat(), MM, "next to no volume"),
        (stl(brick()), 1.0, r"100 m long with mesh_unit_m = 1; .*0\.001 for a mesh in millimetres"),
        (stl(brick()), 1e-7, "1e-05 m long"),
    ],
)
def test_refuses_a_mesh_that_cannot_be_weighed_when_damaged(data: bytes, unit: float, expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as caught:
        read_solid(data, unit)
    assert "\n" not in str(caught.value)


def test_limit_leaves_room_for_real_meshes_when_counted_in_triangles() -> None:
    assert (BYTES_MAX - 84) // 50 > 500_000
