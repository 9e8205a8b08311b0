"""A policy that observes rotor speeds: the same bits everywhere, and what becomes of it without them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import records
from neuroflight.flash.link.messages import EscReport, motor_telemetry
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.esc import Words, rotor_words, words_speed
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.sim.replay.comparison import compare
from neuroflight.sim.replay.flight import replayable
from neuroflight.sim.replay.library import replay_on_library
from neuroflight.toolchain.contract import ESC_DAMAGED, ESC_SILENT, FallbackCause, Msp
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import build_kept
from tests.flights.rotors import observer, with_model

Flown = Callable[..., Trace]
TELLS = {"motor_telemetry": 1}
GYRO_HZ = 4000
BUSY = Scenario("busy", tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.3) for k in range(5)))
IDLE = 0.1
LOST_AT = 1.3  # s after the boot: in flight
UNWATCHED = {"plausibility_detection": 0}  # weights are random


@pytest.fixture(scope="module")
def folder() -> Path:
    """The host's build around a policy that observes rotor speeds, and has no model."""
    return build_kept("HOST", observer(), "rotors", pid_table(load_aircraft("nf1")))


@pytest.fixture(scope="module")
def modelled() -> Path:
    """Likewise around one that has a model of its aircraft."""
    return build_kept("HOST", with_model(observer()), "rotors-modelled", pid_table(load_aircraft("nf1")))


class Meddling(ReferencePort):
    """The library, with ESCs whose words are meddled with on the way."""

    def __init__(self, folder: Path, meddle: Callable[[float, Words], Words], **settings: float) -> None:
        super().__init__(folder / "libneuroflight.so", GYRO_HZ, {**TELLS, **UNWATCHED, **settings})
        self.meddle = meddle
        self.log = bytearray(self.reference.blackbox())
        self.told: list[tuple[EscReport, ...]] = []  # ten times a second
        self.causes: list[FallbackCause] = []
        self.number = 0

    def set_rotors(self, words: Words) -> None:
        super().set_rotors(self.meddle(self.number / GYRO_HZ, words))

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """As the library; asks it now and then."""
        reply = super().exchange(sample, channels_us)
        self.number += 1
        if self.number % 40 == 0:
            self.log += self.reference.blackbox()
        if self.number % (GYRO_HZ // 10) == 0:
            with self._msp() as msp:
                self.told.append(motor_telemetry(msp.request(Msp.MOTOR_TELEMETRY)))
                self.causes.append(records.safety(msp.request(Msp.SAFETY)).fallback_cause)
        return reply


def flight(port: ReferencePort, scenario: Scenario = BUSY) -> Trace:
    twin = Twin(
        load_aircraft("nf1"), rate_hz=GYRO_HZ, mount=scenario.mount, rng=np.random.default_rng((1, 1))
    )
    with closing(twin), closing(port):
        return fly(twin, port, scenario)


def test_twin_library_and_program_fly_the_same_bits_when_the_policy_sees_rotor_speeds(
    folder: Path, flown: Flown
) -> None:
    controller = PolicyController(read_policy(folder.with_name("policy.onnx")))
    in_twin = flown(ControllerPort(controller, 4, GYRO_HZ, idle=IDLE), BUSY)
    in_library = flown(ReferencePort(folder / "libneuroflight.so", GYRO_HZ, {**TELLS, **UNWATCHED}), BUSY)
    assert in_library.same(in_twin)
    assert flown(HostPort(folder / "neuroflight", GYRO_HZ, {**TELLS, **UNWATCHED}), BUSY).same(in_twin)
    assert len(np.unique(in_twin.dshot, axis=0)) > 250, "the policy must have moved"
    other = flown(
        ReferencePort(folder / "libneuroflight.so", GYRO_HZ, {**TELLS, **UNWATCHED, "motor_poles": 12}), BUSY
    )
    assert not other.same(in_twin), "and by what the ESCs tell"


def whole(seconds: float, words: Words) -> Words:
    return words


def one_wire_lost(seconds: float, words: Words) -> Words:
    """The wire of motor 2 breaks in flight: the ESC hears its commands still, and nobody hears it."""
    return np.where((np.arange(4) == 1) & (seconds > LOST_AT), ESC_SILENT, words).astype(np.uint16)


class TenthLost:
    """One answer of ten is damaged, at random."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(3)

    def __call__(self, seconds: float, words: Words) -> Words:
        return np.where(self.rng.random(4) < 0.1, ESC_DAMAGED, words).astype(np.uint16)


def test_the_pid_takes_over_when_a_wire_is_lost_and_the_policy_has_no_model(folder: Path) -> None:
    port, sound = Meddling(folder, one_wire_lost), Meddling(folder, whole)
    lost, trace = flight(port), flight(sound)
    assert set(sound.causes) == {FallbackCause.NONE}
    assert port.causes[-1] is FallbackCause.ROTORS
    assert port.told[-1][1].errors == 1.0 and max(esc.errors for esc in port.told[-1][::2]) < 0.01
    parts = np.flatnonzero((lost.dshot != trace.dshot).any(axis=1))
    assert 230 < parts[0] < 270, "some milliseconds after the wire has broken, armed at 1.05 s"
    assert (lost.dshot[parts[0] :] > 0).all(), "it flies on"


@pytest.mark.slow
def test_the_policy_flies_on_by_its_model_when_a_wire_is_lost(modelled: Path) -> None:
    port, sound = Meddling(modelled, one_wire_lost), Meddling(modelled, whole)
    lost, trace = flight(port), flight(sound)
    assert set(port.causes) == {FallbackCause.NONE}
    assert port.told[-1][1].errors == 1.0
    parts = np.flatnonzero((lost.dshot != trace.dshot).any(axis=1))
    assert 230 < parts[0] < 270
    assert np.abs(lost.motors[parts[0] :] - trace.motors[parts[0] :]).max() < 0.02, "as good as measured"


def test_nothing_falls_back_when_a_tenth_of_the_answers_is_lost(folder: Path) -> None:
    port = Meddling(folder, TenthLost())
    flight(port)
    assert set(port.causes) == {FallbackCause.NONE}
    for esc in port.told[-1]:
        assert 0.06 < esc.errors < 0.14
        assert esc.speed_rpm > 1000


@pytest.mark.parametrize("poles", [12, 16])
def test_a_wrong_number_of_poles_is_flown_with_wrong_speeds(folder: Path, poles: int) -> None:
    port = Meddling(folder, whole, motor_poles=poles)
    trace = flight(port)
    assert set(port.causes) == {FallbackCause.NONE}
    assert (trace.dshot > 0).all()


def test_a_flight_by_rotor_speeds_is_replayed_to_the_bit(folder: Path, tmp_path: Path) -> None:
    port = Meddling(folder, TenthLost(), motor1_output=2, motor2_output=1)
    flight(port)
    path = tmp_path / "rotors.bbl"
    path.write_bytes(port.log)
    log = read_log(path)
    found = replayable(log)
    assert found.incomplete == "" and len(found) > 450
    assert (found.inputs.rotors == ESC_DAMAGED).any()
    again = compare(found, replay_on_library(folder / "libneuroflight.so", found))
    assert again.equal, str(again)
    erpm = log.matrix("eRPM")
    assert erpm is not None
    words = found.inputs.rotors[:, [1, 0, 2, 3]]  # by motor
    heard = words[300] != ESC_DAMAGED
    rpm = words_speed(words[300]) * (30 / np.pi)
    assert erpm[300][heard] * (100 / 7) == pytest.approx(rpm[heard], abs=100 / 7)
    wrong = found.inputs.rotors.copy()
    wrong[200, 0] = rotor_words(np.array([1200.0]))[0]
    object.__setattr__(found.inputs, "rotors", wrong)
    assert not compare(found, replay_on_library(folder / "libneuroflight.so", found)).equal


def test_a_weak_motor_and_a_lost_wire_are_named_in_the_log(modelled: Path, tmp_path: Path) -> None:
    def worn(seconds: float, words: Words) -> Words:
        """Motor 3 turns at 0.4 of its speed, and at the end the wire of motor 2 is lost."""
        slow = np.where(np.arange(4) == 2, 0.4, 1.0) * words_speed(words)
        return one_wire_lost(seconds - 0.15, rotor_words(slow.astype(np.float64)))

    port = Meddling(modelled, worn)
    flight(port)
    path = tmp_path / "worn.bbl"
    path.write_bytes(port.log)
    told = read_log(path).slow["motorFlags"].tolist()
    assert set(told) == {0, 1 << 10, 1 << 10 | 1 << 1}
    assert told == sorted(told)


@pytest.mark.slow
def test_the_image_flies_the_hosts_bits_when_the_policy_sees_rotor_speeds(folder: Path, flown: Flown) -> None:
    board = build_kept("MATEKF722", observer(), "rotors", pid_table(load_aircraft("nf1")))
    settings = {**TELLS, **UNWATCHED}
    on_host = flown(ReferencePort(folder / "libneuroflight.so", GYRO_HZ, settings), BUSY)
    assert flown(EmulatedPort(board / "neuroflight.bin", GYRO_HZ, settings), BUSY).same(on_host)
