"""Logs of the sensor to recordings: clocks, signs, and what cannot be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.identification.bench.drive import Log
from neuroflight.sim.identification.bench.load_cell import FORCE, TORQUE, LoadCell
from neuroflight.sim.identification.bench.quantities import Rig, check_rig
from neuroflight.sim.identification.bench.reduction import reduce_log
from neuroflight.sim.identification.bench.sensor import parse_layout
from neuroflight.toolchain.errors import DynoError

CELL = LoadCell(FORCE, 0.001, 100.0, 0.0, 0.0, 0.0, 0.0, 10.0, 5)


def rig_of(*names: str, **cells: LoadCell) -> Rig:
    return Rig(parse_layout(names), cells, 2, 0.02)


def log_of(time: np.ndarray, *columns: np.ndarray, late: float = 0.0) -> Log:
    rng = np.random.default_rng(0)
    commands = np.arange(0.0, time[-1], 0.02)
    return Log(
        command_time=commands,
        throttle=np.where(commands < 1.0, 0.0, 0.5),
        arrival=time + rng.exponential(late, len(time)) if late else time,
        values=np.stack(columns, axis=1),
        zeros={},
    )


def test_the_command_in_force_stands_beside_each_row_when_lines_come_late() -> None:
    sent = np.arange(0.0, 5.0, 0.005)
    rpm = np.where(sent < 1.0, 0.0, 9000.0)
    one = np.ones_like(sent)
    rig = rig_of("time_ms", "rpm", "thrust_n", "torque_n_m")
    recording, clock = reduce_log(log_of(sent, 7e3 + 1000 * sent, rpm, one, one, late=0.02), rig)
    jump = recording.time[np.argmax(recording.throttle > 0)]
    assert jump == pytest.approx(1.0, abs=0.006) and clock.late > 0.01
    assert recording.speed.max() == pytest.approx(9000 * RPM)


@pytest.mark.parametrize("sign", [1, -1])
def test_thrust_and_torque_are_above_zero_however_the_cells_are_mounted(sign: int) -> None:
    time = np.arange(0.0, 5.0, 0.01)
    rpm = np.where(time < 1.0, 0.0, 9000.0)
    raw = 100.0 + sign * np.where(rpm > 0, 3000.0, 0.0)
    rig = rig_of("rpm", "thrust_raw", "torque_n_m", thrust_raw=CELL)
    recording, _ = reduce_log(log_of(time, rpm, raw, -sign * rpm), rig)
    assert recording.thrust.max() == pytest.approx(3.0) and recording.thrust.min() == 0.0
    assert recording.torque.min() == 0.0 and recording.torque.max() == 9000.0


def test_lines_without_a_clock_are_refused_when_some_are_lost() -> None:
    time = np.delete(np.arange(0.0, 5.0, 0.01), slice(200, 230))
    one = np.ones_like(time)
    with pytest.raises(DynoError, match="let it send time_us"):
        reduce_log(log_of(time, one, one, one), rig_of("rpm", "thrust_n", "torque_n_m"))


def test_a_log_is_refused_when_it_has_hardly_any_rows() -> None:
    time = np.arange(0.0, 0.4, 0.01)
    with pytest.raises(DynoError, match="40 readings, expected at least 50"):
        reduce_log(log_of(time, time, time, time), rig_of("rpm", "thrust_n", "torque_n_m"))


def test_a_cell_is_refused_when_it_was_calibrated_as_the_other_kind() -> None:
    names = ("rpm", "thrust_raw", "torque_raw")
    check_rig(rig_of(*names, thrust_raw=CELL, torque_raw=replace(CELL, unit=TORQUE)))
    with pytest.raises(DynoError, match="expected N m; give the length of the lever"):
        check_rig(rig_of(*names, thrust_raw=CELL, torque_raw=CELL))
    with pytest.raises(DynoError, match="for which there is no load cell"):
        check_rig(rig_of(*names, thrust_raw=CELL))
