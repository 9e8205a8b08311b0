"""A log's figures: to the bit those of the trace of the same flight, seen by its gyro."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.commands import EDGES_DEG_S, Sticks, commands, log_sticks, trace_sticks
from neuroflight.sim.blackbox.events import words
from neuroflight.sim.blackbox.export import save_csv, save_headers
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.flight import Part, cut, log_flight, log_trace, trace_flight
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.blackbox.quality import Answer, quality, replay_obstacles
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.trace import save_trace
from neuroflight.sim.identification.recording import read_recording
from neuroflight.sim.recorded.files import load_commands
from neuroflight.toolchain.contract import FallbackCause, FlightState, Mix, StopCause
from neuroflight.toolchain.errors import TraceError
from tests.sim.blackbox.own import LEAD, log_of, trace
from tests.sim.blackbox.writer import event, slow

IDLE = 0.055
STEPS = 2500


def save(folder: Path, data: bytes, name: str = "LOG00001.BBL") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def answers(path: Path) -> dict[str, Answer]:
    return {one.name: one.answer for one in quality(read_log(path)).questions}


def as_json(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    assert main(["log", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("rate_hz", [500, 1000, 4000])
def test_samples_and_figures_equal_the_traces_to_the_bit(tmp_path: Path, rate_hz: int) -> None:
    flown = trace(STEPS, rate_hz=rate_hz)
    log = read_log(save(tmp_path, log_of(flown)))
    assert log.maker is Maker.NEUROFLIGHT and not log.notes
    assert log_trace(log).same(flown.by_gyro())
    one, other = log_flight(log), trace_flight("trace", flown, 1, IDLE)
    assert np.array_equal(
        np.hstack(_numbers(asdict(one.figures))), np.hstack(_numbers(asdict(other.figures)))
    )
    assert one.figures.response is not None or rate_hz == 4000  # a command is held for a second


def test_figures_of_a_part_equal_the_traces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flown = trace(STEPS)
    path = save(tmp_path, log_of(flown))
    save_trace(tmp_path / "flight.npz", flown)
    words = ["--from", "0.3", "--to", "2.3", "--episodes", "2", "--idle", "0.05"]
    ours = as_json(capsys, "metrics", str(path), *words)
    theirs = as_json(capsys, "metrics", str(tmp_path / "flight.npz"), *words)
    assert ours.pop("rows") == theirs.pop("rows") == 2000
    assert ours.pop("file") != theirs.pop("file")
    assert ours == theirs
    assert log_trace(read_log(path), Part(0.3, 2.3)).same(cut(flown.by_gyro(), Part(0.3, 2.3)))


def test_rounded_samples_are_near_when_the_log_holds_no_exact_ones(tmp_path: Path) -> None:
    flown = trace(STEPS)
    log = read_log(save(tmp_path, log_of(flown, exact=False)))
    told = log_trace(log)
    assert np.abs(np.rad2deg(told.gyro - flown.gyro)).max() <= 0.5 + 1e-3
    assert (told.dshot == flown.dshot).all() and np.abs(told.throttle - flown.throttle).max() <= 0.5e-3 + 1e-6
    assert answers(log.path)["figures to the bit"] is Answer.NO


def test_time_goes_by_control_steps_when_only_some_are_logged(tmp_path: Path) -> None:
    log = read_log(save(tmp_path, log_of(trace(STEPS), divider=4)))
    told = log_trace(log)
    assert told.control_rate_hz == 250 and log.stride == 4 and log.lost == 0
    assert "it holds one control step of 4 only (blackbox_divider)" in replay_obstacles(log)
    assert answers(log.path)["vibration"] is Answer.PARTLY


def test_time_is_the_logs_own_clock_in_every_command_when_rows_come_unevenly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Log rows 1 ms apart, but every sixth 7 ms, across the wrap of the clock's 32 bits."""
    apart = np.where(np.arange(STEPS + 2 * LEAD - 1) % 6 == 5, 7000, 1000)
    clock = (1 << 32) - 2_000_000 + np.concatenate(([0], np.cumsum(apart)))
    path = save(tmp_path, log_of(trace(STEPS), clock=(clock % (1 << 32)).tolist()))
    seconds = (clock - clock[0]) / 1e6
    armed = (clock[LEAD : LEAD + STEPS] - clock[LEAD]) / 1e6
    log = read_log(path)
    assert not log.notes and log.lost == 0
    assert channels(log).time().tolist() == seconds.tolist() == log.t.tolist()
    assert log_trace(log).t.tolist() == armed.tolist() == log_sticks(log).t.tolist()
    part = log_trace(log, Part(1.0, 3.0))
    assert part.t[-1] == pytest.approx(2.0, abs=0.008) and part.step_s == pytest.approx(0.001)
    assert as_json(capsys, "list", str(path))[0]["seconds"] == seconds[-1]
    assert as_json(capsys, "decode", str(path))["seconds"] == seconds[-1]
    assert as_json(capsys, "quality", str(path))["seconds"] == seconds[-1]
    assert as_json(capsys, "commands", str(path))["seconds"] == armed[-1]
    csv, npz = tmp_path / "log.csv", tmp_path / "log.npz"
    assert main(["log", "decode", str(path), "--csv", str(csv), "--npz", str(npz)]) == 0
    assert np.loadtxt(csv, delimiter=",", skiprows=1, usecols=1).tolist() == clock.tolist()
    with np.load(npz) as arrays:
        assert arrays["t"].tolist() == seconds.tolist()
        assert arrays["field/time"].tolist() == clock.tolist()
    for file, length in ((path, armed[-1]), (csv, seconds[-1])):
        flown = load_commands(file)
        assert flown.time[-1] - flown.time[0] == pytest.approx(length)


def test_rows_of_a_coarse_clock_lie_between_its_ticks(tmp_path: Path) -> None:
    """Log four rows each millisecond, with a clock that counts milliseconds."""
    rows = STEPS + 2 * LEAD
    clock = 5_000_000 + np.arange(rows) // 4 * 1000
    log = read_log(save(tmp_path, log_of(trace(STEPS, rate_hz=4000), clock=clock.tolist())))
    assert log.columns["time"].tolist() == clock.tolist()
    assert (log.time_us == 5_000_000 + np.arange(rows) * 250).all()
    assert log_trace(log).control_rate_hz == 4000


def test_one_line_names_what_lacks_when_a_log_has_no_figures(tmp_path: Path) -> None:
    data = log_of(trace(100), exact=False).replace(b"gyroADC[", b"gyroXYZ[")
    log = read_log(save(tmp_path, data))
    with pytest.raises(TraceError, match=r"has no gyroADC\[0\.\.2\].*; figures of a flight need them"):
        log_trace(log)
    assert answers(log.path)["tracking and step responses"] is Answer.NO
    with pytest.raises(TraceError, match=r"has no row from 9 s to its end; it is 0\.099 s long"):
        log_trace(read_log(save(tmp_path, log_of(trace(100)))), Part(9.0))
    with pytest.raises(TraceError, match="do not divide into 3 equal episodes"):
        log_flight(read_log(save(tmp_path, log_of(trace(100)))), episodes=3)


def test_quality_tells_what_reached_its_limits(tmp_path: Path) -> None:
    flown = trace(1000)
    gyro, dshot = flown.gyro.copy(), flown.dshot.copy()
    gyro[100:150, 1] = np.deg2rad(-1999)
    dshot[:, :] = 1000
    dshot[200:300, 2] = 2047
    log = read_log(save(tmp_path, log_of(replace(flown, gyro=gyro, dshot=dshot))))
    told = quality(log)
    assert told.gyro_saturated == (0.0, 0.05, 0.0) and told.motors_full == 0.1
    assert any("gyro pitch at the end of its range in 5 % of the rows" in one for one in told.warnings)
    assert any("a motor at full power in 10 % of the rows" in one for one in told.warnings)


def test_distribution_of_commands_is_the_normal_one_that_was_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(2)
    asked = rng.normal(0, 12.4, (20_000, 3))
    asked[:, 2] = 0
    sticks = Sticks(
        np.deg2rad(asked).astype(np.float32), np.full(20_000, 0.3, np.float32), np.arange(20_000) / 500
    )
    told = commands([sticks])
    assert told.samples == 20_000 and told.rate_hz == pytest.approx(500)
    assert told.axis_sigma[:2] == pytest.approx(12.4, rel=0.02) and told.axis_sigma[2] == 0
    assert told.asked[0] == pytest.approx(0.687, abs=0.01)  # a normal one's part beyond 5 / 12.4 sigma
    assert told.together.sum() == pytest.approx(1) and told.together[3] == 0
    assert (told.histogram.sum(axis=0) == 20_000).all() and len(told.histogram) == len(EDGES_DEG_S) - 1
    assert told.change_sigma[0] == pytest.approx(500 * 12.4 * np.sqrt(2), rel=0.02)
    twice = commands([sticks, sticks])
    assert twice.samples == 40_000 and twice.overall.sigma == pytest.approx(told.overall.sigma)
    path = save(tmp_path, log_of(trace(STEPS)))
    assert as_json(capsys, "commands", str(path), str(path))["samples"] == 2 * STEPS
    assert len(log_sticks(read_log(path)).t) == STEPS


def test_histogram_has_the_counts_of_the_normal_distribution_that_was_drawn() -> None:
    rng = np.random.default_rng(3)
    asked = np.rint(
        rng.normal((-20.0, 0.0, 5.0), (30.0, 12.4, 0.0), (50_000, 3))
    )  # whole deg/s, as logs count
    rows = len(asked)
    sticks = Sticks(np.deg2rad(asked).astype(np.float32), np.zeros(rows, np.float32), np.arange(rows) / 500.0)
    told = commands([sticks])
    signed = told.signed
    assert told.overall.mean == pytest.approx(-5.0, abs=0.1)
    assert told.mean == pytest.approx([-20.0, 0.0, 5.0], abs=0.3)
    assert (signed.counts.sum(axis=1) == rows).all() and signed.counts[2, 15] == rows  # 4.5 to 5.5 deg/s
    assert np.array_equal(signed.edges_deg_s, -signed.edges_deg_s[:, ::-1])  # a middle bin about 0
    # Five standard deviations of a count that follows the normal distribution.
    near = np.abs(signed.counts - signed.normal)[:2]
    assert (near <= 5 * np.sqrt(signed.normal[:2] + 1)).all()
    assert np.array_equal(signed.normal[2], signed.counts[2])  # a constant has no width


def test_a_histogram_of_no_command_lies_in_the_middle_bin() -> None:
    told = commands([Sticks(np.zeros((9, 3), np.float32), np.zeros(9, np.float32), np.arange(9.0))])
    assert told.signed.counts[:, 10].tolist() == [9, 9, 9] and told.signed.counts.sum() == 27
    assert (told.overall.mean, told.overall.sigma) == (0.0, 0.0)


def test_commands_of_a_trace_are_those_of_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flown = trace(STEPS)
    log, path = save(tmp_path, log_of(flown)), tmp_path / "flight.npz"
    save_trace(path, flown)
    told = as_json(capsys, "commands", str(log), "--from", "0.5")
    plot = tmp_path / "commands.png"
    traced = as_json(capsys, "commands", str(path), "--from", "0.5", "--plot", str(plot))
    assert (told.pop("files"), told.pop("plot")) == ([str(log)], None)
    assert (traced.pop("files"), traced.pop("plot")) == ([str(path)], str(plot))
    assert told.pop("seconds") == pytest.approx(traced.pop("seconds"))
    assert told == traced and told["overall"]["sigma"] == told["sigma"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(TraceError, match="trace has no row from 99 s to its end"):
        trace_sticks(flown, Part(99.0))
    assert main(["log", "commands", str(path), "--plot", str(tmp_path / "commands.svg")]) != 0
    assert "expected a name that ends in .png" in capsys.readouterr().err


def test_csv_is_a_recording_of_the_gyro_for_the_twin(tmp_path: Path) -> None:
    log = read_log(save(tmp_path, log_of(trace(STEPS))))
    save_csv(tmp_path / "log.csv", log)
    save_headers(tmp_path / "log.csv", log)
    recording = read_recording(tmp_path / "log.csv")
    gyro = channels(log).gyro
    assert gyro is not None and recording.rate_hz == pytest.approx(1000) and recording.gaps == 0
    assert np.abs(np.rad2deg(recording.gyro - gyro)).max() <= 0.5 + 1e-3  # gyroADC counts whole deg/s


def test_events_are_told_in_words(tmp_path: Path) -> None:
    state, pid = FlightState.ARMED << 17, 1 << 16
    fallback = FallbackCause.POLICY_OUTPUT << 24
    parts = (
        event(30, 1 | state, FlightState.DISARMED << 17),
        event(30, 1 | state | pid | fallback, 1 | state),
        event(15, 1),
    )
    data = log_of(trace(100)).replace(event(15, 4), b"".join(parts))
    log = read_log(save(tmp_path, data))
    assert [words(log, one) for one in log.events] == [
        "arming",
        "armed",
        "the PID flies, because of policy output",
        "disarming: failsafe",
        "end",
    ]
    # The same flags are other modes where another firmware wrote them.
    log = read_log(save(tmp_path, data.replace(b"H nf_version", b"H xx_version")))
    assert words(log, log.events[1]) == "armed"


def test_events_are_the_same_when_the_flags_are_in_slow_frames_alone(tmp_path: Path) -> None:
    """Firmwares since MSP API 1.47 tell nfFlags there, and the ecosystem's modes alone in the event."""
    armed, crashed = FlightState.ARMED << 1, FlightState.CRASHED << 1 | StopCause.CRASH << 4
    falls_back = armed | 1 | FallbackCause.POLICY_OUTPUT << 8
    parts = (
        *(event(30, 1, 0), slow([1, armed]), slow([1, falls_back]), slow([1, falls_back])),
        *(event(30, 0, 1), event(15, 5), slow([0, falls_back & 0xF01 | crashed])),
    )
    data = log_of(trace(100), own_flags=True).replace(event(15, 4), b"".join(parts))
    log = read_log(save(tmp_path, data))
    assert [words(log, one) for one in log.events] == [
        "arming",
        "armed",
        "the PID flies, because of policy output",
        "crashed, stopped by crash",
        "disarming: crash",
        "end",
    ]


def test_our_log_is_told_from_betaflights_when_its_version_is_lost(tmp_path: Path) -> None:
    """Tell our log, which names Betaflight for other tools, from Betaflight's by the lines it lacks."""
    version = b"H nf_version:0.1.0\n"
    data = log_of(trace(100))
    data = data.replace(version, version + b"H Firmware revision:Betaflight 2025.12.0 (Neuroflight) SITL\n")
    assert not read_log(save(tmp_path, data)).notes
    log = read_log(save(tmp_path, data.replace(version, b"")))
    assert log.notes == ("header lines are lost: nf_version: our log is taken for Betaflight's",)


def test_idle_is_that_of_the_controller_that_flew(tmp_path: Path) -> None:
    data = log_of(trace(100)).replace(b"flightModeFlags", b"nfFlags")
    assert channels(read_log(save(tmp_path, data))).idle == 0.06
    assert channels(read_log(save(tmp_path, log_of(trace(100))))).idle == IDLE
    assert channels(read_log(save(tmp_path, log_of(trace(100), nf_idle="nan,")))).idle is None


def test_mix_is_that_of_the_controller_that_flew(tmp_path: Path) -> None:
    def mix(data: bytes) -> Mix | None:
        return channels(read_log(save(tmp_path, data))).mix

    assert mix(log_of(trace(100))) is Mix.ATTITUDE_FIRST  # of a log from before there were two
    assert mix(log_of(trace(100), nf_mix="centred,attitude-first")) is Mix.CENTRED
    assert mix(log_of(trace(100), nf_mix="sideways,centred")) is None
    data = log_of(trace(100), nf_mix="attitude-first,centred").replace(b"flightModeFlags", b"nfFlags")
    assert mix(data) is Mix.CENTRED  # the PID flies


def test_effort_is_the_motors_when_the_mix_is_centred(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = trace(STEPS)
    log = read_log(save(tmp_path, log_of(flown, nf_mix="centred,centred")))
    u = ((flown.motors - IDLE) / (1 - IDLE)).clip(0, 1)
    assert log_flight(log).figures.effort.output == pytest.approx(u.mean(), rel=1e-9)
    assert (
        log_flight(log, mix=Mix.ATTITUDE_FIRST).figures.effort
        == log_flight(read_log(save(tmp_path, log_of(flown), "LOG00002.BBL"))).figures.effort
    )
    save_trace(tmp_path / "flight.npz", flown)
    words = ["metrics", str(tmp_path / "flight.npz"), "--idle", str(IDLE), "--mix", "centred"]
    assert as_json(capsys, *words)["effort"]["output"] == pytest.approx(u.mean(), rel=1e-9)


def test_list_tells_each_file_of_a_cards_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = log_of(trace(STEPS), nf_aircraft="nf1")
    save(tmp_path, data + bytes(5000), "LOG00001.BBL")
    save(tmp_path, data + data, "log00002.bfl")
    save(tmp_path, bytes(100_000), "LOG00003.BBL")
    save(tmp_path, b"notes of a pilot", "README.TXT")
    save(tmp_path, b"\x12\x34" * 500, "LOG00004.BBL")
    save(tmp_path, b"\xff" * (2 << 20) + data, "LOG00005.BBL")  # of a chip whose first sectors are erased
    rows = as_json(capsys, "list", str(tmp_path))
    assert [(row["file"], row["log"]) for row in rows] == [
        ("LOG00001.BBL", 1),
        ("LOG00003.BBL", None),
        ("LOG00004.BBL", None),
        ("LOG00005.BBL", 1),
        ("log00002.bfl", 1),
        ("log00002.bfl", 2),
    ]
    assert rows[0]["seconds"] == pytest.approx((STEPS + 2 * LEAD - 1) / 1000)
    assert rows[0]["firmware"] == "Neuroflight 0.1.0" and rows[0]["craft"] == "nf1"
    assert rows[1]["note"] == "empty: a log to come" and rows[2]["note"].startswith("holds no log")
    assert main(["log", "list", str(tmp_path)]) == 0


def test_tables_are_printed_without_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(save(tmp_path, log_of(trace(STEPS))))
    for action, said in (
        ("metrics", "against the gyro"),
        ("commands", "sigma"),
        ("quality", "replay"),
        ("decode", "setpointFloat[3]"),
    ):
        assert main(["log", action, path]) == 0
        assert said in capsys.readouterr().out


def _numbers(value: object) -> list[np.ndarray]:
    """All numbers in nested dictionaries, in order."""
    if isinstance(value, dict):
        return [array for one in value.values() for array in _numbers(one)]
    return [] if value is None else [np.ravel(np.asarray(value, np.float64))]
