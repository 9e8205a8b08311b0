"""The mode CHIRP in flights of the shipped policy: sweeps are flown, and watched as any other flight."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import AXES, FallbackCause, Mode, ModeRange, StopCause
from tests.flights.test_plausibility import last_layer, mirrored, unchanged
from tests.flights.weights import Change, ChangedPort, Weights

GYRO_RATE_HZ = 4000
SWEEP_S, STILL_S, AT_S = 2.0, 0.3, 1.0
BOX_CHIRP = 6  # bit of flightModeFlags, as Betaflight numbers its boxes
# The scenario's switch of the PID, AUX 2, is the chirp's.
SETTINGS = {"mode2": ModeRange(Mode.CHIRP, 2, 1700, 2100).packed, "chirp_s": SWEEP_S, "chirp_start_hz": 2.0}
Fly = Callable[..., tuple[Trace, ChangedPort]]


def thrice_as_much(weights: Weights) -> None:
    """A gain error of 200 %; half of it alone is no oscillation at hover."""
    last_layer(weights)[:] *= 3


@pytest.fixture
def fly_chirps(reference_library: Path) -> Fly:
    """Flies sweeps of an amplitude [deg/s] one after another, with a policy that is changed in flight."""

    def run(amplitude: float, sweeps: int = 3, change: Change = unchanged) -> tuple[Trace, ChangedPort]:
        still = Segment(STILL_S, throttle=0.3)
        sweep = Segment(SWEEP_S + 0.1, throttle=0.3, pid=True)
        settings = {**SETTINGS, "chirp_amplitude": amplitude}
        inner = ReferencePort(reference_library, GYRO_RATE_HZ, settings)
        port = ChangedPort(inner, change, round(AT_S * GYRO_RATE_HZ), hidden=True)
        twin = Twin(load_aircraft("nf1"), rate_hz=GYRO_RATE_HZ, rng=np.random.default_rng((1, 1)))
        with closing(twin), closing(port):
            return fly(twin, port, Scenario("chirps", (still, *(sweep, still) * sweeps))), port

    return run


@pytest.mark.parametrize("amplitude", [100.0, 200.0])
def test_the_loops_response_shows_on_each_axis_when_it_is_swept(fly_chirps: Fly, amplitude: float) -> None:
    trace, port = fly_chirps(amplitude)
    safety = port.safety()
    assert (safety.stop_cause, safety.fallback_cause) == (StopCause.SWITCH, FallbackCause.NONE)
    for axis, begin_s in enumerate(STILL_S + k * (SWEEP_S + 0.1 + STILL_S) for k in range(len(AXES))):
        part = slice(round(1000 * begin_s), round(1000 * (begin_s + SWEEP_S + 0.1)))
        asked, flown = (np.rad2deg(array[part].astype(float)) for array in (trace.setpoint, trace.rate))
        others = [other for other in range(3) if other != axis]
        assert not asked[:, others].any()
        assert 0.8 * amplitude < np.abs(asked[:, axis]).max() < amplitude
        spectra = [np.fft.rfft(each[:, axis]) for each in (asked, flown)]
        hz = np.fft.rfftfreq(len(asked), 1e-3)
        bands = (hz > 2) & (hz < 4), (hz > 70) & (hz < 95)  # the sweep ends at 100 Hz
        powers = [[np.square(np.abs(each))[band].sum() for each in spectra] for band in bands]
        slow, fast = (np.sqrt(flown_power / asked_power) for asked_power, flown_power in powers)
        assert 0.85 < slow < 1.15, "it follows slow sines"
        assert fast < (slow if axis == 2 else 0.3), "and fast ones less; yaw turns by the rotors' own inertia"


@pytest.mark.parametrize(
    ("amplitude", "change", "cause"),
    [
        (100.0, thrice_as_much, FallbackCause.OSCILLATION),
        (300.0, mirrored(0), FallbackCause.WRONG_WAY),
        (300.0, mirrored(1), FallbackCause.WRONG_WAY),
    ],
    ids=["gain", "mirrored", "another axis mirrored"],
)
def test_a_policy_that_turns_bad_is_told_when_it_is_swept(
    fly_chirps: Fly, amplitude: float, change: Change, cause: FallbackCause
) -> None:
    trace, port = fly_chirps(amplitude, 1, change)
    assert port.safety().fallback_cause == cause
    late = round(1000 * (STILL_S + SWEEP_S)) - 100
    assert not trace.setpoint[late:].any(), "the sweep ended with the policy"


def test_the_log_tells_the_sweep_as_the_ecosystems_analysis_looks_for_it(
    reference_library: Path, tmp_path: Path
) -> None:
    still, sweep = Segment(STILL_S, throttle=0.3), Segment(SWEEP_S + 0.1, throttle=0.3, pid=True)
    port = ReferencePort(reference_library, GYRO_RATE_HZ, {**SETTINGS, "chirp_amplitude": 100.0})
    path = tmp_path / "chirp.bbl"

    def logged() -> bool:
        with path.open("ab") as file:
            file.write(port.reference.blackbox())
        return path.read_bytes().endswith(b"End of log\0")

    twin = Twin(load_aircraft("nf1"), rate_hz=GYRO_RATE_HZ, rng=np.random.default_rng((1, 1)))
    with closing(twin), closing(port):
        fly(twin, port, Scenario("chirp", (still, sweep, still)), logged=logged)
    log = read_log(path)
    flags, axis = log.held("flightModeFlags"), log.columns["debug[1]"]
    assert flags is not None
    on = (np.asarray(flags) >> BOX_CHIRP & 1).astype(bool)
    swept = axis == 0  # roll, the first; -1 while nothing is swept
    assert swept.sum() == round(1000 * SWEEP_S) and (axis[~swept] == -1).all()
    assert on[swept].all() and on.sum() == pytest.approx(1000 * (SWEEP_S + 0.1), abs=20)
    added, setpoint = log.columns["debug[3]"], log.columns["setpoint[0]"]
    assert np.abs(added).max() > 80 and np.abs(added - setpoint).max() <= 1, "deg/s, as gyroADC is"
    tenths_of_hz = log.columns["debug[2]"][swept]
    assert tenths_of_hz[0] == 20 and (np.diff(tenths_of_hz) >= 0).all() and tenths_of_hz[-1] > 200
