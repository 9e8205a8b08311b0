"""What ESCs tell in a flight: each topic by motor, its file, and what an aircraft file does not give."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM, Thermal, load_aircraft
from neuroflight.sim.flight.esc_record import DIGITS, EscRecord, Range, save_topics, topic_ranges
from neuroflight.sim.physics.twin import Twin

NF1 = load_aircraft("nf1")
WARM = replace(NF1, esc=replace(NF1.esc, thermal=Thermal(0.1, 4.0, 5.0, 20.0)))


def recorded(aircraft: object = WARM, steps: int = 300) -> tuple[EscRecord, Twin]:
    """Motors 2 and 3 turn faster; to be closed."""
    assert isinstance(aircraft, type(NF1))
    twin = Twin(aircraft, charge=1.0, noise=False, rng=np.random.default_rng(1))
    record = EscRecord(twin)
    for _ in range(steps):
        twin.step(np.array([[0.3, 0.6, 0.6, 0.3]]))
        record()
    return record, twin


def test_each_topic_is_what_the_twin_tells_of_that_motor() -> None:
    record, twin = recorded()
    topics, told, drawn = record.topics, twin.telemetry, twin.draw
    twin.close()
    assert tuple(topics) == tuple(DIGITS)
    assert all(values.shape == (300, 4) for values in topics.values())
    last = {name: values[-1] for name, values in topics.items()}
    assert last["speed_rpm"] * RPM == pytest.approx(told.speed[0])
    assert np.array_equal(last["force_n"], told.force[0])
    assert np.array_equal(last["torque_n_m"], told.torque[0])
    assert np.array_equal(last["temperature_c"], told.temperature[0])
    assert (last["voltage_v"] == told.voltage[0]).all()
    electronics = 6.21 / drawn.voltage[0]
    assert last["current_a"].sum() == pytest.approx(drawn.current[0] - electronics, rel=1e-3)
    for name in ("speed_rpm", "current_a", "force_n", "torque_n_m", "temperature_c"):
        assert last[name][1] > last[name][0], name


def test_a_topic_is_none_and_its_cells_are_empty_when_the_file_does_not_give_it(tmp_path: Path) -> None:
    record, twin = recorded(NF1, 3)
    twin.close()
    ranges = topic_ranges(record.topics)
    assert ranges["temperature_c"] is None
    assert all(ranges[name] is not None for name in DIGITS if name != "temperature_c")
    save_topics(tmp_path / "esc.csv", record.topics, 1000)
    with (tmp_path / "esc.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["time_s"] for row in rows] == ["0.000000", "0.001000", "0.002000"]
    assert len(rows[0]) == 1 + 6 * 4 and rows[2]["temperature_c_4"] == ""
    assert float(rows[2]["force_n_2"]) == pytest.approx(record.topics["force_n"][2, 1], abs=1e-5)


def test_a_range_is_over_the_flight_and_all_motors() -> None:
    values = np.array([[1.0, 2.0], [3.0, 6.0]])
    assert topic_ranges({"force_n": values})["force_n"] == Range(1.0, 3.0, 6.0)
    assert topic_ranges({"force_n": np.zeros((0, 4))})["force_n"] is None
