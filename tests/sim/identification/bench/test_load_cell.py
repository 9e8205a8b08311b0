"""Load cells: masses in, a line out; what is no line is refused; the file comes back as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.identification.bench.load_cell import (
    FORCE,
    TORQUE,
    LoadCell,
    fit_load_cell,
    load,
    loads_of_masses,
    read_load_cells,
    write_load_cells,
)
from neuroflight.sim.identification.bench.sensor import CELLS
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import DynoError

MASSES = [0.0, 0.2, 0.0, 0.4, 0.0, 0.6, 0.0, 0.8, 0.0, 1.0, 0.0]


def cell(noise: float = 0.0, slope: float = -21_000.0, seed: int = 0) -> tuple[LoadCell, np.ndarray]:
    loads = loads_of_masses(MASSES)
    readings = 84_000.0 + slope * loads + noise * np.random.default_rng(seed).standard_normal(len(loads))
    return fit_load_cell(loads, readings, FORCE), readings


def test_masses_weigh_as_much_as_on_earth_when_they_hang_on_a_lever_or_not() -> None:
    assert loads_of_masses([0.2, -1.0]) == pytest.approx([0.2 * GRAVITY, -GRAVITY])
    assert loads_of_masses([0.2], 0.13) == pytest.approx([0.026 * GRAVITY])


def test_readings_give_the_load_back_when_there_is_no_noise() -> None:
    found, readings = cell()
    assert found.scale == pytest.approx(-1 / 21_000) and found.offset == pytest.approx(84_000)
    assert load(found, readings) == pytest.approx(loads_of_masses(MASSES), abs=1e-9)
    assert load(found, 84_500.0, offset=84_500.0) == 0.0
    assert found.residual_max < 1e-9 and found.hysteresis < 1e-9
    assert found.load_max == pytest.approx(GRAVITY)


def test_the_standard_error_holds_the_true_scale_when_there_is_noise() -> None:
    scores = []
    for seed in range(200):
        found, _ = cell(noise=200.0, seed=seed)
        scores.append((found.scale + 1 / 21_000) / found.scale_error)
    assert np.std(scores) == pytest.approx(1.0, abs=0.25)
    assert abs(np.mean(scores)) < 0.3


def test_hysteresis_and_residuals_show_when_the_cell_does_not_come_back() -> None:
    loads = loads_of_masses(MASSES)
    readings = 21_000.0 * loads
    readings[-1] += 2_100.0
    found = fit_load_cell(loads, readings, FORCE)
    assert found.hysteresis == pytest.approx(0.1, rel=0.02)
    assert 0.05 < found.residual_max < 0.1


@pytest.mark.parametrize(
    ("masses", "readings", "says"),
    [
        ([0.0, 1.0], [0.0, 1000.0], "2 different loads"),
        ([0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 3.0, 4.0], "none of them 0"),
        ([0.0, 0.5, 0.0, 1.0], [5.0, 5.0, 5.0, 5.0], "is this the cell that was loaded"),
        ([0.0, 0.5, 0.0, 1.0], [0.0, 7.0, -8.0, 3.0], "is this the cell that was loaded"),
        ([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], [0.0, 200.0, 400.0, 700.0, 800.0, 1000.0], "weigh that mass"),
        ([0.0, 0.5, 1.0], [0.0, float("nan"), 1000.0], "not a finite number"),
    ],
)
def test_a_calibration_is_refused_when_it_shows_no_line(
    masses: list[float], readings: list[float], says: str
) -> None:
    with pytest.raises(DynoError, match=says):
        fit_load_cell(loads_of_masses(masses), np.array(readings), FORCE)


def test_cells_come_back_to_the_bit_when_they_are_written(tmp_path: Path) -> None:
    first, _ = cell(noise=50.0)
    torque = fit_load_cell(loads_of_masses(MASSES, 0.13), 9e5 * loads_of_masses(MASSES, 0.13), TORQUE)
    cells = {"thrust_raw": first, "torque_raw": torque}
    path = tmp_path / "cells.toml"
    write_load_cells(path, cells)
    assert read_load_cells(path, CELLS) == cells
    assert "# N a count" in path.read_text()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[thrust_raw]", "[weight]"), "a cell 'weight', expected one of"),
        (('unit = "N"', 'unit = "kg"'), "thrust_raw.unit: got 'kg'"),
        (("scale = -", "scale = 0.0 # "), "thrust_raw.scale: got 0"),
        (("loads =", "lods ="), "thrust_raw.loads: missing"),
        (("[thrust_raw]", "[thrust_raw"), "not TOML"),
        (("[thrust_raw]", "x" * 70_000 + "\n[thrust_raw]"), "bytes, expected at most"),
    ],
)
def test_a_file_is_refused_when_it_is_damaged(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    path = tmp_path / "cells.toml"
    write_load_cells(path, {"thrust_raw": cell()[0]})
    before = path.read_text()
    assert change[0] in before
    path.write_text(before.replace(*change))
    with pytest.raises(DynoError, match=says):
        read_load_cells(path, CELLS)


def test_the_way_to_a_file_is_said_when_there_is_none(tmp_path: Path) -> None:
    with pytest.raises(DynoError, match="dyno calibrate"):
        read_load_cells(tmp_path / "none.toml", CELLS)
