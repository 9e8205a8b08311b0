"""Logs of the firmware's blackbox, replayed; and those that cannot be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Sample
from neuroflight.sim.replay.comparison import compare
from neuroflight.sim.replay.emulator import replay_on_board
from neuroflight.sim.replay.flight import replayable
from neuroflight.sim.replay.host import replay_on_host
from neuroflight.sim.replay.inputs import Flight
from neuroflight.sim.replay.library import replay_on_library
from neuroflight.toolchain.contract import DSHOT_STOP, FallbackCause, FlightState, LogEdge, LogGroup
from neuroflight.toolchain.errors import TraceError
from tests.sampling import sampled
from tests.sim.replay.logs import LoggingPort, logged

LATE, ON_TIME, NO_NUMBER, SILENT = 6000, 6012, 7003, 8001


def troubled(port: ReferencePort, number: int, sample: Sample) -> None:
    """Missed deadlines, so that the PID takes over; a sample that is none; at last a silence, which stops."""
    if number in (LATE, ON_TIME):
        port.reference.power(16.0, 0.0, 2000.0 if number == LATE else 0.0)
    if number == NO_NUMBER:
        sample.gyro[:] = np.nan
    if number == SILENT:
        port.reference.silent()


@pytest.fixture(scope="session")
def calm_log(reference_library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return logged(reference_library, load_scenario("roll", 1), tmp_path_factory.mktemp("logs") / "calm.bbl")


@pytest.fixture(scope="session")
def troubled_log(reference_library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "troubled.bbl"
    return logged(reference_library, load_scenario("roll", 1), path, meddle=troubled)


def test_a_log_is_replayed_to_the_bit_when_the_flight_was_in_trouble(
    troubled_log: Path, reference_library: Path, host_program: Path
) -> None:
    flight = replayable(read_log(troubled_log))
    inputs = flight.inputs
    assert (inputs.flags & LogEdge.MISSED).any() and inputs.invalid.any() and inputs.silences.sum() == 1
    assert 500 < (flight.answers.dshot != DSHOT_STOP).any(axis=1).sum() < 1200 and not flight.incomplete
    for found in (
        compare(flight, replay_on_library(reference_library, flight)),
        compare(flight, replay_on_host(host_program, flight)),
    ):
        assert found.equal and found.exact == ("gyro", "setpoint", "throttle"), str(found)


@pytest.mark.slow
def test_a_log_of_the_library_is_replayed_to_the_bit_on_the_board(
    troubled_log: Path, board_image: Path
) -> None:
    flight = replayable(read_log(troubled_log))
    found = compare(flight, replay_on_board(board_image.with_suffix(".bin"), flight))
    assert found.equal, str(found)


def test_the_command_says_how_much_is_equal_and_what_replay_costs(
    calm_log: Path, reference_library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    build = str(reference_library.parent)
    assert main(["log", "replay", str(calm_log), "--build", build]) == 0
    assert "control steps, " in (said := capsys.readouterr().out) and "values, equal" in said
    assert main(["log", "replay", str(calm_log), "--build", build, "--on", "host", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["equal"] and told["different"] == 0 and told["steps"] > 1500
    assert 0 < told["bytes_per_second"]["replay"] < told["bytes_per_second"]["all"]


@pytest.mark.parametrize("seed", sampled(range(12), 0, 5, 8))
def test_a_flipped_bit_of_the_frames_is_found_at_its_step(
    seed: int, calm_log: Path, reference_library: Path, tmp_path: Path
) -> None:
    """Where a decoder reads something else, there the replay ends or differs; motors need not answer."""
    data = bytearray(calm_log.read_bytes())
    whole = replayable(read_log(calm_log))
    rng = np.random.default_rng(seed)
    at = int(rng.integers(len(data) // 3, 2 * len(data) // 3))
    data[at] ^= 1 << int(rng.integers(8))
    path = tmp_path / "changed.bbl"
    path.write_bytes(data)
    changed = replayable(read_log(path))
    first = next((k for k in range(len(changed)) if differs(whole, changed, k)), len(changed))
    found = compare(changed, replay_on_library(reference_library, changed))
    if found.first is not None:  # of what the controller had
        assert first == found.first.step
    else:
        assert first == len(changed)  # nothing wrong was replayed
        assert changed.incomplete or len(changed) == len(whole)


def differs(one: Flight, other: Flight, row: int) -> bool:
    """Return True if inputs or answers of a row are others."""
    came = [flight.inputs.receiver[row, : flight.inputs.received[row]].tobytes() for flight in (one, other)]
    if came[0] != came[1]:
        return True
    parts: list[tuple[object, object, str]] = [
        (one.inputs, other.inputs, name) for name in ("step", "counts", "accel", "flags", "gain")
    ]
    parts += [(one.answers, other.answers, name) for name in ("dshot", "gyro", "setpoint")]
    return any(getattr(a, name)[row].tobytes() != getattr(b, name)[row].tobytes() for a, b, name in parts)


def test_a_flipped_bit_of_a_sample_that_nothing_looks_at_is_told_with_its_step(
    calm_log: Path,
) -> None:
    log = read_log(calm_log)
    log.columns["gyroRaw[4]"][800] ^= 1  # the second of four samples; no filter is set
    flight = replayable(log)
    assert len(flight) == 800 and flight.damaged
    assert "replayed up to control step 800, 0.800 s: a bit of it is wrong in this file" in flight.incomplete


def test_a_log_is_refused_in_a_line_when_it_lacks_what_a_replay_needs(
    reference_library: Path, tmp_path: Path
) -> None:
    cases: dict[str, tuple[dict[str, float], str]] = {
        "divided": (
            {"blackbox_divider": 4},
            "it has one control step of 4, expected each; .*blackbox_divider = 1",
        ),
        "masked": ({"blackbox_disabled_mask": 1 << LogGroup.REPLAY}, "the group REPLAY; .*bit 17 is off"),
    }
    for name, (settings, words) in cases.items():
        path = logged(
            reference_library, load_scenario("roll", 1), tmp_path / f"{name}.bbl", settings=settings
        )
        with pytest.raises(TraceError, match=words):
            replayable(read_log(path))


def test_a_log_with_a_damaged_state_is_refused(calm_log: Path, tmp_path: Path) -> None:
    data = bytearray(calm_log.read_bytes())
    at = data.index(b"H nf_state_005:") + 40
    data[at] = ord("0") if data[at] != ord("0") else ord("1")
    path = tmp_path / "damaged.bbl"
    path.write_bytes(data)
    with pytest.raises(TraceError, match=r"the state in its header is damaged \(CRC-32"):
        replayable(read_log(path))
    path.write_bytes(calm_log.read_bytes().replace(b"H nf_state_005:", b"H nf_stale_005:"))
    with pytest.raises(TraceError, match="lines of the state in its header are missing"):
        replayable(read_log(path))


def test_another_policy_than_the_one_that_flew_is_refused(
    calm_log: Path, reference_library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = calm_log.read_bytes()
    at = data.index(b"H nf_policy:")
    end = data.index(b"\n", at)
    path = tmp_path / "other.bbl"
    path.write_bytes(data[: end - 64] + b"0" * 64 + data[end:])
    assert main(["log", "replay", str(path), "--build", str(reference_library.parent)]) == 1
    said = capsys.readouterr().err
    assert "policy 0000000000000000.. flew" in said and said.count("\n") == 1


class Story:
    """A minute: the policy flies, then the PID; the receiver is gone for a while; at last the gyro."""

    def __call__(self, port: LoggingPort, number: int, sample: Sample) -> None:
        """Before gyro sample `number`, at 4 kHz."""
        if number in (80_000, 80_012):
            port.reference.power(16.0, 0.0, 2000.0 if number == 80_000 else 0.0)
        port.deaf = 120_000 <= number < 121_200  # 300 ms
        if number % 50_000 == 49_999:
            sample.gyro[:] = np.nan
        if number == 236_001:
            port.reference.silent()


@pytest.mark.slow
def test_a_minute_with_fallback_failsafe_and_fault_is_equal_on_each_machine(
    reference_library: Path, host_program: Path, board_image: Path, tmp_path: Path
) -> None:
    path = logged(reference_library, load_scenario("pulses", 1, 14), tmp_path / "minute.bbl", meddle=Story())
    log = read_log(path)
    flight = replayable(log)
    modes = log.held("nfFlags")
    assert modes is not None
    states = set(((modes >> 1) & 7).tolist())
    assert FlightState.FAILSAFE_HOLD in states and FlightState.FAULT in states
    assert {0, 1} <= set((modes & 1).tolist()) and FallbackCause.DEADLINE in (modes >> 8 & 15)
    assert len(flight) > 57_000 and not flight.incomplete and flight.inputs.invalid.sum() >= 3
    for answers in (
        replay_on_library(reference_library, flight),
        replay_on_host(host_program, flight),
        replay_on_board(board_image.with_suffix(".bin"), flight),
    ):
        found = compare(flight, answers)
        assert found.equal, str(found)
