"""Betaflight beside policies and PIDs: copies of an armed one, on the same commands and noise."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.control import sticks
from neuroflight.sim.physics.imu import counts
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.betaflight.build import build_betaflight
from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight, BetaflightFleet
from neuroflight.sim.ports.betaflight.port import IDLE, dshot_of_widths, state_packet, wire_rates
from neuroflight.sim.ports.port import Sample
from neuroflight.sim.ports.simulator_link import STATE
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import LinkError
from neuroflight.training.evaluation.betaflight import BetaflightSpec
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import scores
from neuroflight.training.evaluation.thrust import at_rest
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.task import PulseTask, Setpoints
from tests.sampling import sampled

FOLDER = Path(__file__).resolve().parents[2] / "build" / "tests" / "BETAFLIGHT"
NF1, HEXA = load_aircraft("nf1"), load_aircraft("hexa")
SHORT_S = 0.3


@dataclass(frozen=True)
class SameTurn:
    """The same command for every aircraft, after a rest."""

    name: ClassVar[str] = "same"
    duration_s: float = SHORT_S

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        setpoints = np.zeros((count, round(self.duration_s * rate_hz), 3), np.float32)
        setpoints[:, setpoints.shape[1] // 3 :] = np.deg2rad([150.0, -80.0, 60.0])
        return setpoints


@pytest.fixture(scope="module")
def armed() -> Iterator[ArmedBetaflight]:
    """An armed one at rest, for all tests of this file."""
    with ArmedBetaflight(build_betaflight(FOLDER, print), NF1) as armed:
        yield armed


def group(armed: ArmedBetaflight) -> list[int]:
    """Processes of its group: itself and its copies."""
    own = os.getpgid(armed.process.pid)
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_name = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(after_name[2]) == own and after_name[0] != "Z":
            found.append(int(path.parent.name))
    return found


def test_an_episode_is_the_same_to_the_bit_when_flown_first_or_tenth_or_alone(
    armed: ArmedBetaflight,
) -> None:
    ten, again, alone = (
        Conditions(NF1, SameTurn(), count, 1, noise=False).fly(BetaflightSpec(armed), 0.3)
        for count in (10, 10, 1)
    )
    for name in ("rate", "motors", "output", "lift"):
        rows = getattr(ten, name)
        assert (rows == rows[:1]).all(), name
        assert np.array_equal(rows, getattr(again, name)), name
        assert np.array_equal(rows[:1], getattr(alone, name)), name
    assert ten.motors is not None
    assert ten.motors.min() >= IDLE - 3e-4
    end = np.rad2deg(ten.rate[0, -20:].mean(axis=0))
    assert end == pytest.approx([150.0, -80.0, 60.0], abs=12.0)


@pytest.mark.slow
def test_a_hexacopter_turns_as_commanded() -> None:
    with ArmedBetaflight(build_betaflight(FOLDER, print), HEXA) as armed:
        flown = Conditions(HEXA, SameTurn(1.5), 2, 1, noise=False).fly(BetaflightSpec(armed), 0.4)
    end = np.rad2deg(flown.rate[:, -200:].mean(axis=1))
    assert end == pytest.approx(np.tile([150.0, -80.0, 60.0], (2, 1)), abs=12.0)
    assert flown.motors is not None
    assert flown.motors.shape[2] == 6
    assert (np.ptp(flown.motors, axis=1) > 0.02).all()  # the fifth and the sixth, too


def test_noise_and_commands_are_those_of_the_seed(armed: ArmedBetaflight) -> None:
    flown = [
        Conditions(NF1, SameTurn(0.1), 2, seed).fly(BetaflightSpec(armed), 0.2).motors for seed in (1, 1, 2)
    ]
    assert flown[0] is not None
    assert np.array_equal(flown[0], flown[1])  # type: ignore[arg-type]
    assert not np.array_equal(flown[0], flown[2])  # type: ignore[arg-type]
    assert not np.array_equal(flown[0][0], flown[0][1])


@pytest.mark.parametrize("aircraft", sampled([NF1, HEXA], HEXA), ids=["nf1", "hexa"])
def test_a_copy_answers_as_the_original_goes_on_when_both_see_the_same(aircraft: Aircraft) -> None:
    with (
        ArmedBetaflight(build_betaflight(FOLDER, print), aircraft) as own,
        closing(Twin(aircraft, 1, rate_hz=own.gyro_rate_hz, rng=np.random.default_rng(5))) as twin,
        BetaflightFleet((own,), twin.live) as fleet,
    ):
        frame = sticks.channels(np.array([[90.0, -40.0, 20.0]]), np.array([0.3]), armed=True)
        for k in range(400):
            live = twin.live
            state = [live.gyro, live.rotation, live.velocity, live.position, live.accelerometer]
            gyro, rotation, velocity, position, force = (values[0] for values in state)
            sample = Sample(k / own.gyro_rate_hz, gyro, rotation, velocity, position, force)
            heard = frame if k == 40 else None
            motors = fleet.exchange(counts(live.gyro), heard)
            reply = own.port.exchange(sample, None if heard is None else heard[0].tolist())
            assert motors[0] == pytest.approx((reply.dshot.astype(float) - 48) / 1999, abs=1e-12), k
            twin.step(motors)
    assert np.ptp(motors) > 0.005  # it has begun to turn


@pytest.mark.slow
def test_thrust_at_rest_is_what_betaflight_is_known_to_give(armed: ArmedBetaflight) -> None:
    conditions = Conditions(NF1, SameTurn(), 1, 1, gyro_rate_hz=armed.gyro_rate_hz)
    closed, hover = at_rest(BetaflightSpec(armed), conditions, [0.0, 0.27])
    assert 0.04 < float(closed.thrust.value) < 0.08
    assert 0.95 < float(hover.thrust.value) < 1.08


def test_copies_end_with_their_fleet_and_a_lost_one_is_told(armed: ArmedBetaflight) -> None:
    assert len(group(armed)) == 1
    with (
        closing(Twin(NF1, 3, rate_hz=4000, rng=np.random.default_rng(5))) as twin,
        BetaflightFleet((armed,), twin.live) as fleet,
    ):
        copies = sorted(set(group(armed)) - {armed.process.pid})
        assert len(copies) == 3
        fleet.exchange(counts(twin.live.gyro), None)
        os.kill(copies[-1], signal.SIGKILL)
        with pytest.raises(LinkError, match=r"Betaflight: copy [123] is gone"):
            for _ in range(2000):
                fleet.exchange(counts(twin.live.gyro), None)
    deadline = time.monotonic() + 10.0
    while len(group(armed)) > 1 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(group(armed)) == 1


def test_packets_of_many_are_those_of_one() -> None:
    raw = np.array([[0, 1, -1], [32767, -32767, 40], [-7, 300, 0]], np.int16)
    still = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY]))
    for row, rates in zip(raw, wire_rates(raw), strict=True):
        assert rates.tolist() == list(STATE.unpack(state_packet(0.0, row, still))[1:4])
    widths = np.array([1000.0, 1055.0, 1500.3, 2000.0], np.float32)
    assert dshot_of_widths(widths).tolist() == [0, 158, 1048, 2047]


def test_compare_adds_betaflight_to_its_table_and_data(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["compare", "pid", "--on", "betaflight", "--build", str(FOLDER), "--episodes", "2", "--json"]
    assert main([*arguments, "--task", "episodic", "--seed", "3", "--throttle", "0.3"]) == 0
    document = json.loads(capsys.readouterr().out)
    pid, betaflight = document["comparison"]
    assert betaflight["controller"] == "betaflight"
    assert betaflight["idle"] == IDLE
    assert set(betaflight["means"]) == set(pid["means"])
    assert set(betaflight["difference"]) >= {"mae", "mse", "motor_change"}
    assert document["gyro_rate_hz"] == 4000
    assert document["sticks"] is True


@pytest.mark.slow
def test_betaflight_flies_the_same_flights_with_a_memory_that_goes_on(armed: ArmedBetaflight) -> None:
    task = FlightTask(pulses=2, idle_s=0.1, command_s=0.3, rest_s=0.2, hover_s=10.0)
    flown = Conditions(NF1, task, 1, 3, noise=False, gyro_rate_hz=4000, sticks=True)
    spec = BetaflightSpec(armed)
    flights = flown.fly(spec, 0.3)
    pid = flown.fly(load_controller("pid:flying", NF1), 0.3)
    assert np.array_equal(flights.setpoint, pid.setpoint)
    found = scores(flights).holding
    assert found is not None
    assert found.mae.shape == (1, 2, 3)
    assert np.abs(found.drift).max() < 5.0  # [deg]
    # The second command alone, by a Betaflight that has just armed, is flown otherwise.
    pulses = PulseTask(idle_s=0.1, command_s=0.3, rest_s=0.2)
    fresh = replace(flown, task=pulses, episodes=2).fly(spec, 0.3)
    assert np.array_equal(fresh.setpoint[1], flights.setpoint[0, 600:1200])
    assert not np.array_equal(fresh.motors[1], flights.motors[0, 600:1200])  # type: ignore[index]


@pytest.mark.slow
def test_equal_thrust_is_found_for_betaflight_too(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "compare",
        "betaflight",
        "pid",
        "--build",
        str(FOLDER),
        "--task",
        "pulse",
        "--episodes",
        "4",
        "--seed",
        "3",
    ]
    assert main([*arguments, "--thrust", "0", "1", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    closed, hover, two = document["equal_thrust"]
    assert closed["controllers"][0]["throttle"] == closed["controllers"][1]["throttle"] == 0.0
    for level in (hover, two):
        for each in level["controllers"]:
            assert each["thrust_at_rest"]["value"] == pytest.approx(level["thrust"], rel=0.02)
            assert each["reached"] is True
    assert 0.26 < hover["controllers"][0]["throttle"] < 0.28
    assert len(document["transparency"]) == 2
