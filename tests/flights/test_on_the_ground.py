"""An armed aircraft on the ground: idle, checks of the sticks, take-off of a wrongly wired one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import FallbackCause as Fallback
from neuroflight.toolchain.contract import Msp, StopCause
from tests.flights.test_plausibility import mirrored, swapped
from tests.flights.weights import Change, ChangedPort
from tests.flights.wiring import drifting
from tests.sampling import sampled

GYRO_RATE_HZ = 4000
BOTH = pytest.mark.parametrize("pid", [False, True], ids=["policy", "pid"])
IDLE = 0.055  # of the shipped policy and of the PID beside it
BAND = 0.06  # [motor fraction], that motors of a standing aircraft leave it by under 1 deg/s of drift


@dataclass(frozen=True)
class Stood:
    """A flight that began on the ground."""

    trace: Trace
    safety: records.Safety
    turned_deg: NDArray[np.float64]  # from where it stood, at each control step
    height_m: NDArray[np.float64]  # above that

    @property
    def stopped_s(self) -> float:
        """When the motors stood still first; the end if they never did."""
        return float(np.append(self.trace.t[(self.trace.dshot == 0).all(axis=1)], self.trace.t[-1])[0])


Stand = Callable[..., Stood]


@pytest.fixture
def stand(reference_library: Path) -> Stand:
    """Flies an NF1 from the ground.

    thrust: share of it that the propellers give, 0: they are off; drift_deg_s: of the gyro since it was
    calibrated; change: of the policy's weights; wired: rotor of each output.
    """

    def run(
        segments: tuple[Segment, ...],
        *,
        thrust: float = 1.0,
        drift_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
        change: Change | None = None,
        wired: tuple[int, ...] | None = None,
        aircraft: Aircraft | None = None,
    ) -> Stood:
        inner = ReferencePort(reference_library, GYRO_RATE_HZ, {"ground_detection": 1})
        drifts = drifting(inner, drift_deg_s)
        port = drifts if change is None else ChangedPort(drifts, change, 0, hidden=True)
        rng = np.random.default_rng((1, 1))
        used = load_aircraft("nf1") if aircraft is None else aircraft
        twin = Twin(used, rate_hz=GYRO_RATE_HZ, mount=Mount.FREE, ground=True, rng=rng)
        twin.weaken(np.full(used.motor_count, thrust))
        up, height = [], []

        def watch() -> None:
            up.append(twin.live.rotation[0].copy())
            height.append(float(twin.live.position[0, 2]))

        with closing(twin), closing(port):
            trace = fly(twin, port, Scenario("ground", segments, Mount.FREE), motor_order=wired, watch=watch)
            safety = records.safety(Client(inner.reference).request(Msp.SAFETY))
        turns = (np.einsum("nij,ij->n", np.array(up), up[0]) - 1) / 2
        return Stood(trace, safety, np.rad2deg(np.arccos(turns.clip(-1, 1))), np.array(height) - height[0])

    return run


# --- Idle -------------------------------------------------------------------------------------
@BOTH
@pytest.mark.parametrize(
    "drift_deg_s",
    sampled([(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, -1.0)], (1.0, 1.0, 1.0)),
    ids=str,
)
def test_an_armed_aircraft_that_nobody_touches_idles_and_does_not_turn(
    stand: Stand, pid: bool, drift_deg_s: tuple[float, float, float]
) -> None:
    stood = stand((Segment(10.0, pid=pid),), drift_deg_s=drift_deg_s)
    motors = stood.trace.motors
    print(f"motors {motors.min():.3f} to {motors.max():.3f}, turned {stood.turned_deg.max():.2f} deg")
    assert motors.min() > IDLE - 0.001
    assert motors.max() < IDLE + BAND
    assert motors[6000:].mean(axis=0) == pytest.approx(motors[1000:4000].mean(axis=0), abs=0.0025), "creeps"
    assert stood.turned_deg.max() < 0.5
    assert not stood.safety.airborne


@BOTH
def test_the_integral_works_in_the_air_as_soon_as_it_has_taken_off(stand: Stand, pid: bool) -> None:
    """A drift of the gyro that the integral answers: what is seen of the rates is on average the setpoint."""
    rises = (Segment(1.0, pid=pid), Segment(1.5, throttle=0.4, pid=pid))
    stood = stand(rises, drift_deg_s=(1.0, 1.0, 1.0))
    assert stood.height_m[-1] > 2.0
    late = slice(1800, 2500)
    assert np.abs(np.rad2deg(stood.trace.gyro[late].mean(axis=0))).max() < 0.6


# --- Sticks -----------------------------------------------------------------------------------
@BOTH
@pytest.mark.parametrize("rate_deg_s", sampled([220.0, -1000.0], -1000.0))
@pytest.mark.parametrize("axis", range(3))
def test_a_check_of_the_sticks_without_propellers_stops_and_refuses_nothing(
    stand: Stand, pid: bool, rate_deg_s: float, axis: int
) -> None:
    rates = [0.0] * 3
    rates[axis] = rate_deg_s
    check = Segment(1.5, (rates[0], rates[1], rates[2]), 0.06, pid=pid)
    stood = stand((Segment(0.5, pid=pid), check, Segment(0.5, pid=pid)), thrust=0.0)
    assert (stood.trace.dshot > 0).all()
    assert np.ptp(stood.trace.motors[600:1900], axis=1).min() > 0.15, "the controller answers"
    assert (stood.safety.stop_cause, stood.safety.refused_cause) == (StopCause.SWITCH, Fallback.NONE)
    assert stood.trace.motors[-1].max() < IDLE + BAND, "and keeps nothing of it"


# --- Take-off ---------------------------------------------------------------------------------
@BOTH
@pytest.mark.parametrize("throttle", sampled([0.3, 0.5], 0.5))
@pytest.mark.parametrize("waits_s", sampled([1.0, 5.0], 1.0))
@pytest.mark.parametrize(
    "wired", sampled([(1, 0, 2, 3), (0, 2, 1, 3), (3, 1, 2, 0)], (1, 0, 2, 3), (3, 1, 2, 0)), ids=str
)
def test_the_motors_stop_when_a_wrongly_wired_aircraft_takes_off(
    stand: Stand, pid: bool, throttle: float, waits_s: float, wired: tuple[int, ...]
) -> None:
    """However long it has stood with the throttle a little raised: most are told as a runaway, after 0.3 s.

    The others lie on their backs before they turn so fast: no response, then a crash, after 0.65 s.
    """
    waits, lifts = Segment(waits_s, throttle=0.07, pid=pid), Segment(1.0, throttle=throttle, pid=pid)
    stood = stand((waits, lifts), wired=wired)
    print(f"stopped after {stood.stopped_s - waits_s:.3f} s")
    assert stood.safety.stop_cause in (StopCause.RUNAWAY, StopCause.CRASH)
    assert stood.stopped_s < waits_s + (0.35 if stood.safety.stop_cause == StopCause.RUNAWAY else 0.7)


@pytest.mark.parametrize("throttle", sampled([0.3, 0.5], 0.3))
@pytest.mark.parametrize(
    "change", [mirrored(0), mirrored(1), mirrored(2), swapped(0, 1)], ids=["roll", "pitch", "yaw", "swap 1 2"]
)
def test_the_pid_takes_over_when_a_wrong_policy_takes_off(
    stand: Stand, change: Change, throttle: float
) -> None:
    stood = stand((Segment(1.0), Segment(1.0, throttle=throttle)), change=change)
    assert stood.safety.fallback_cause == Fallback.WRONG_WAY
    assert (stood.trace.dshot > 0).all()
    assert stood.turned_deg.max() < 60
    assert stood.height_m[-1] > 1.0
