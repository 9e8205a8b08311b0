"""ESC telemetry's rounding."""

import numpy as np

from neuroflight.sim.aircraft.model import EscTelemetry
from neuroflight.sim.physics.esc import telemetry

SPEED, VOLTAGE, CURRENT = np.array([[1234.5, 2000.4]]), np.array([[16.78]]), np.array([[12.34, 0.049]])
FORCE, TORQUE = np.array([[1.4281, 3.7495]]), np.array([[0.012339, 0.032396]])
HEAT = np.array([[20.0, 61.25]])


def test_report_is_exact_when_no_steps_are_given() -> None:
    report = telemetry(SPEED, VOLTAGE, CURRENT, FORCE, TORQUE, HEAT, EscTelemetry())
    assert report.speed.tolist() == SPEED.tolist()
    assert report.voltage.tolist() == VOLTAGE.tolist()
    assert report.current.tolist() == CURRENT.tolist()


def test_report_is_rounded_to_its_steps_when_they_are_given() -> None:
    steps = EscTelemetry(speed_step=10.0, voltage_step=0.25, current_step=0.1)
    report = telemetry(SPEED, VOLTAGE, CURRENT, FORCE, TORQUE, HEAT, steps)
    assert report.speed.tolist() == [[1230.0, 2000.0]]
    assert report.voltage.tolist() == [[16.75]]
    assert np.allclose(report.current, [[12.3, 0.0]], rtol=0, atol=1e-12)
    assert (report.force is FORCE) and (report.torque is TORQUE) and (report.temperature is HEAT)


def test_report_rounds_to_even_when_half_way() -> None:
    halves = np.array([0.5, 1.5, 2.5, -0.5])
    report = telemetry(halves, halves, halves, FORCE, TORQUE, HEAT, EscTelemetry(1.0, 1.0, 1.0))
    assert report.speed.tolist() == report.voltage.tolist() == report.current.tolist() == [0.0, 2.0, 2.0, 0.0]
