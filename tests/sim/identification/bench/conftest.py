"""The lockstep rig, and its load cells as they would be calibrated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Propulsion, load_aircraft
from neuroflight.sim.identification.bench.load_cell import LoadCell, fit_load_cell, loads_of_masses
from tests.sim.identification.bench.rig import Rig, SensorKind

MASSES_KG = [0.0, 0.2, 0.0, 0.4, 0.0, 0.8, 0.0, 1.0]
LEVER_M = 0.13


@pytest.fixture(scope="session")
def nf1_propulsion() -> Propulsion:
    return load_aircraft("nf1").propulsion


@pytest.fixture
def make_rig(host_program: Path, nf1_propulsion: Propulsion) -> Iterator[Callable[..., Rig]]:
    """Build rigs: give the kind of sensor, which motor stands on it."""
    with ExitStack() as rigs:

        def make(kind: SensorKind | None = None, motor: int = 0) -> Rig:
            return rigs.enter_context(Rig(host_program, nf1_propulsion, kind, motor))

        yield make


def rig_cells(kind: SensorKind) -> dict[str, LoadCell]:
    """Calibrations of the rig's cells, without an error."""
    forces, torques = loads_of_masses(MASSES_KG), loads_of_masses(MASSES_KG, LEVER_M)
    turns = {"torque_left_raw": kind.torque_counts, "torque_right_raw": -kind.torque_counts}
    cells = {"thrust_raw": fit_load_cell(forces, kind.thrust_zero + kind.thrust_counts * forces, "N")}
    for name, counts in turns.items():
        cells[name] = fit_load_cell(torques, np.asarray(kind.torque_zero + counts * torques), "N m")
    return {name: cell for name, cell in cells.items() if name in kind.columns}


@pytest.fixture
def cells_of() -> Callable[[SensorKind], dict[str, LoadCell]]:
    """`rig_cells`."""
    return rig_cells
