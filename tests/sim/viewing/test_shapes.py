"""The aircraft as polygons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.mesh import box
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.viewing.shapes import TRIANGLES_MAX, Kind, aircraft_faces, disc_colour

NF1 = load_aircraft("nf1")


def test_a_frame_of_known_inertia_is_thin_and_has_arms_to_its_motors() -> None:
    body = [face.corners for face in aircraft_faces(NF1) if face.kind is Kind.BODY]
    for hub in NF1.rotor_positions:
        near = [corners for corners in body if np.hypot(*(corners[:, :2] - hub[:2]).T).min() < 0.02]
        bars = [corners for corners in near if np.ptp(corners[:, :2], axis=0).max() > 0.06]
        assert bars and max(float(np.ptp(bar[:, 2])) for bar in bars) < 0.006
    wide = [corners for corners in body if np.ptp(corners[:, 0]) > 0.09]
    assert all(np.ptp(corners[:, 2]) < 0.006 for corners in wide)  # the slab of equal inertia is 35 mm high


def test_discs_name_their_motors_and_the_arrow_points_forward() -> None:
    faces = aircraft_faces(NF1)
    discs = {face.motor: face.corners.mean(axis=0) for face in faces if face.kind is Kind.DISC}
    assert np.array([discs[motor] for motor in range(4)]) == pytest.approx(NF1.rotor_positions)
    arrow = np.concatenate([face.corners for face in faces if face.kind is Kind.NOSE])
    assert arrow[arrow[:, 0].argmax(), 1] == pytest.approx(0.0) and np.ptp(arrow[:, 1]) > 0.02
    assert disc_colour(0.0) != disc_colour(0.5) != disc_colour(1.0) == disc_colour(7.0)


def test_a_fine_mesh_is_drawn_coarser_and_keeps_its_size() -> None:
    surface = box((0.08, 0.06, 0.04), (0.0, 0.0, 0.0)).surface
    for _ in range(5):  # each triangle into four
        a, b, c = surface.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        surface = np.concatenate([np.stack(part, axis=1) for part in parts])
    assert len(surface) > 8 * TRIANGLES_MAX
    battery = replace(NF1.parts[1], surface=surface)
    faces = aircraft_faces(replace(NF1, parts=(battery,)))
    drawn = np.array([f.corners for f in faces if f.kind is Kind.BODY and len(f.corners) == 3][:-48])
    assert 100 < len(drawn) <= TRIANGLES_MAX
    assert sorted(np.ptp(drawn.reshape(-1, 3), axis=0)) == pytest.approx([0.04, 0.06, 0.08], abs=0.011)
