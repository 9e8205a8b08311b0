"""A flight's trace flown again as recorded commands."""

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import save_trace
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.recorded.files import load_flight
from neuroflight.toolchain.errors import ScenarioError
from tests.flights.conftest import Flown

# Changes that come faster than SBUS can send them, and throttle from the first segment on.
SCENARIO = Scenario(
    "busy",
    tuple(
        Segment(0.0017 * (1 + k % 7), (300 * (-1) ** k, 11.0 * k % 400, -7.0 * k), 0.2 + 0.001 * k)
        for k in range(100)
    ),
)


def test_the_setpoints_of_a_trace_come_back_when_it_is_flown_again(
    flown: Flown, reference_library: Path, tmp_path: Path
) -> None:
    first = flown(ReferencePort(reference_library, 4000), SCENARIO)
    assert len(np.unique(first.setpoint, axis=0)) > 60
    path = tmp_path / "first.npz"
    save_trace(path, first)
    scenario, words = load_flight(str(path), seed=1, count=1)
    assert words == ()
    again = flown(ReferencePort(reference_library, 4000), scenario)
    assert again.same(first)  # setpoint, throttle, and with them all that follows


@pytest.mark.parametrize("rate", [1210.0, -1001.0])
def test_a_flight_does_not_end_when_a_command_is_beyond_full_stick(
    rate: float, flown: Flown, reference_library: Path, tmp_path: Path
) -> None:
    path = tmp_path / "fast.npz"
    np.savez(path, t=[0.0, 0.02], setpoint_deg_s=np.array([[0, 0, 0], [rate, 0, 0]]))
    with pytest.raises(ScenarioError, match=r"expected at most 1000; .* or fly full stick by --cut-rates"):
        load_flight(str(path), seed=1, count=1)
    scenario, [words] = load_flight(str(path), seed=1, count=1, cut=True)
    trace = flown(ReferencePort(reference_library, 4000), scenario)
    assert np.rad2deg(trace.setpoint[-1, 0]) == pytest.approx(np.sign(rate) * 1000.0)
    assert "more than full stick" in words
