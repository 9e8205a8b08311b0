"""The same firmware on every port: the same bits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace, load_trace, save_trace
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.policy.model import read_policy
from tests.sampling import sampled

Flown = Callable[..., Trace]
BUSY = Scenario(
    "busy",
    tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(8)),
)
# Too short and too low to be taken for a flight.
TOUCHED = Scenario("touched", (Segment(0.3), Segment(0.1, (30.0, -40.0, 20.0), 0.05), Segment(0.2)))


def test_a_host_flight_repeats_bit_for_bit_when_flown_twice(
    host_program: Path, flown: Flown, tmp_path: Path
) -> None:
    for name in ("a.npz", "b.npz"):
        save_trace(tmp_path / name, flown(HostPort(host_program), BUSY))
    assert load_trace(tmp_path / "a.npz").same(load_trace(tmp_path / "b.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_flights_differ_when_the_seed_differs(reference_library: Path, flown: Flown) -> None:
    flights = [flown(ReferencePort(reference_library), BUSY, seed) for seed in (1, 2)]
    assert not flights[0].same(flights[1])


@pytest.mark.parametrize("gyro_rate_hz", [1000, 4000, 8000])
def test_library_and_host_program_fly_the_same_bits_when_the_scenario_is_busy(
    host_program: Path, reference_library: Path, flown: Flown, gyro_rate_hz: int
) -> None:
    over_sockets = flown(HostPort(host_program, gyro_rate_hz), BUSY)
    assert flown(ReferencePort(reference_library, gyro_rate_hz), BUSY).same(over_sockets)


@pytest.mark.parametrize("port", ["host", "library"])
def test_crsf_flies_the_same_bits_as_sbus_on_the_host(
    host_program: Path, reference_library: Path, flown: Flown, port: str
) -> None:
    crsf = {"receiver_protocol": 1}
    by_crsf = (
        HostPort(host_program, settings=crsf)
        if port == "host"
        else ReferencePort(reference_library, settings=crsf)
    )
    assert flown(by_crsf, BUSY).same(flown(ReferencePort(reference_library), BUSY))


@pytest.mark.slow
@pytest.mark.parametrize("standing", sampled([False, True], True), ids=["in the air", "on the ground"])
def test_the_toolchains_interpreter_flies_the_compiled_policys_bits_when_behind_the_port(
    shipped_policy: Path, reference_library: Path, flown: Flown, standing: bool
) -> None:
    policy = read_policy(shipped_policy)
    in_python = ControllerPort(
        PolicyController(policy, standing=standing),
        policy.action_count,
        idle=policy.idle,
        mix=policy.mix,
        gyro_filters=policy.gyro_filters,
    )
    scenario = TOUCHED if standing else Scenario("busy", BUSY.segments[2:6])
    firmware = ReferencePort(reference_library, settings={"ground_detection": int(standing)})
    assert flown(in_python, scenario).same(flown(firmware, scenario))
