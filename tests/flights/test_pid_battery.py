"""The firmware's PID on a battery: it measures the pack of the twin, and its outputs follow the voltage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.analysis.metrics import FlightFigures, figures
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample

NF1 = load_aircraft("nf1")
IDLE = pid_settings(NF1).idle
COUNT, THROTTLE, RATE_HZ = 6, 0.8, 1000  # pulses of a flight
FULL_V = 16.8


class PowerPort(ReferencePort):
    """The library whose battery measures another voltage than the twin's."""

    def __init__(self, library: Path, volts: float | None, *, breaks: bool) -> None:
        """volts: measured always; None: the twin's; breaks: nothing is measured once armed."""
        super().__init__(library, RATE_HZ, {"battery_cells": 4})
        self._volts, self._breaks = volts, breaks
        self._tell()

    def set_battery(self, volts: float, amps: float) -> None:
        """What the twin's pack gives, unless another voltage is measured."""
        if self._volts is None:
            super().set_battery(volts, amps)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort."""
        reply = super().exchange(sample, channels_us)
        if self._breaks and reply.armed:
            self._volts, self._breaks = math.nan, False
            self._tell()
        return reply

    def _tell(self) -> None:
        if self._volts is not None:
            self.reference.power(self._volts, 0.0)


@cache
def flown(
    library: Path,
    rest_voltage: float | None,
    measured: float | None = None,
    *,
    breaks: bool = False,
    count: int = COUNT,
) -> Trace:
    """Pulses under the PID at a high throttle.

    rest_voltage: of a full pack, None: the bench supply; measured: voltage that the firmware sees [V], None:
    the pack's, or a full one's on the bench supply.
    """
    aircraft: Aircraft = NF1
    if rest_voltage is not None:
        assert NF1.battery is not None
        aircraft = replace(NF1, battery=replace(NF1.battery, rest_voltage=rest_voltage))
    scenario = load_scenario("pulses", 20_002, count=count).under_pid()
    segments = tuple(replace(segment, throttle=THROTTLE) for segment in scenario.segments)
    charge = None if rest_voltage is None else 1.0
    twin = Twin(aircraft, rate_hz=RATE_HZ, charge=charge, rng=np.random.default_rng(4))
    port = PowerPort(library, measured, breaks=breaks)
    with closing(port), closing(twin):
        return fly(twin, port, replace(scenario, segments=segments))


def figures_of(trace: Trace) -> FlightFigures:
    return figures(trace, COUNT, IDLE, pid_settings(NF1).mix)


@pytest.mark.slow
def test_the_pid_flies_an_empty_pack_better_when_it_measures_it(reference_library: Path) -> None:
    nominal = figures_of(flown(reference_library, None))
    unaware = figures_of(flown(reference_library, 13.2, FULL_V))
    aware = figures_of(flown(reference_library, 13.2))
    errors = [float(each.tracking.mae.mean()) for each in (nominal, unaware, aware)]
    print("MAE deg/s nominal, sagging unaware, sagging aware:", np.round(errors, 3))
    assert errors[1] > 1.1 * errors[0], "the pack must matter"
    assert errors[2] < (errors[0] + errors[1]) / 2, "more than half of what the sag costs is won back"
    assert aware.effort.change < 1.35 * nominal.effort.change


@pytest.mark.parametrize("volts", [16.05, 16.8, 17.4])
def test_the_pid_flies_the_same_bits_when_the_pack_is_full(reference_library: Path, volts: float) -> None:
    silent = flown(reference_library, None, count=2)
    told = flown(reference_library, None, volts, count=2)
    assert told.dshot.tobytes() == silent.dshot.tobytes()


@pytest.mark.slow
def test_the_pid_flies_its_own_gains_when_the_battery_is_not_measured_any_more(
    reference_library: Path,
) -> None:
    changes = [
        figures_of(flown(reference_library, None, volts, breaks=breaks)).effort.change
        for volts, breaks in ((None, False), (13.0, False), (13.0, True))
    ]
    assert changes[1] == pytest.approx(1.3 * changes[0], rel=0.03), "a voltage that is read wrong is limited"
    assert changes[2] == pytest.approx(changes[0], rel=0.03)
