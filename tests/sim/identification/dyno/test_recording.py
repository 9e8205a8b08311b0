"""Logs of a dynamometer: read as they were written; an error is one line that says how to correct them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.identification.dyno import recording as dyno_data
from neuroflight.sim.identification.dyno.recording import Recording, read_recordings, write_recording
from neuroflight.toolchain.errors import DynoError

HEADING = "time_s,throttle,rpm,thrust_n,torque_n_m"


def rows(count: int = 100, first: float = 0.0) -> list[str]:
    return [f"{first + 0.01 * k:.3f},0.5,{10000 + k},2.5,0.02" for k in range(count)]


def write(path: Path, lines: list[str], heading: str = HEADING) -> Path:
    path.write_text("\n".join([heading, *lines]) + "\n")
    return path


def test_recording_comes_back_when_written_and_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.001, 0.003, 200))
    recording = Recording(time, rng.random(200), 2000 * rng.random(200), rng.random(200), rng.random(200))
    write_recording(tmp_path / "a.csv", recording)
    back = read_recordings([tmp_path / "a.csv"])
    assert back.starts == (0,)
    assert back.time == pytest.approx(recording.time, abs=1e-6)
    assert back.throttle == pytest.approx(recording.throttle, abs=1e-5)
    assert back.speed == pytest.approx(recording.speed, abs=0.01)
    assert back.thrust == pytest.approx(recording.thrust, abs=1e-5)
    assert back.torque == pytest.approx(recording.torque, abs=1e-6)


def test_columns_are_found_by_name_when_in_another_order_with_others_between(tmp_path: Path) -> None:
    lines = ["# bench 3", "volts,torque_n_m,thrust_n,RPM,throttle,time_s"]
    lines += [f"16.1,0.02,2.5,6000,0.5,{0.01 * k:.2f}" for k in range(60)]
    (tmp_path / "a.csv").write_text("\ufeff" + "\r\n".join(lines))
    recording = read_recordings([tmp_path / "a.csv"])
    assert recording.speed == pytest.approx(np.full(60, 6000 * RPM))
    assert recording.thrust[0] == 2.5 and recording.torque[0] == 0.02 and recording.throttle[0] == 0.5
    assert recording.time[-1] == pytest.approx(0.59)


def test_runs_stand_one_after_the_other_when_there_are_files_and_pauses(tmp_path: Path) -> None:
    first = write(tmp_path / "a.csv", [*rows(60), *rows(70, first=5.0)])
    second = write(tmp_path / "b.csv", rows(80))
    recording = read_recordings([first, second])
    assert recording.starts == (0, 60, 130)
    assert (np.diff(recording.time) > 0).all()
    assert recording.time[130] - recording.time[129] == pytest.approx(dyno_data.PAUSE_S)
    assert len(recording.time) == 210


@pytest.mark.parametrize(
    ("heading", "lines", "message"),
    [
        ("time_s,throttle,rpm,thrust_n", rows(), "no column torque_n_m"),
        ("0.0,0.5,1000,2.5,0.02", rows(), "no column time_s"),
        (f"{HEADING},rpm", rows(), "column rpm stands twice"),
        (HEADING, [*rows(), "1.0,0.5,nan,2.5,0.02"], "line 102: rpm is 'nan', expected a number"),
        (HEADING, [*rows(), "1.0,0.5,1000,,0.02"], "line 102: thrust_n is '', expected a number"),
        (HEADING, [*rows(), "1.0,0.5,1000"], "line 102: thrust_n is ''"),
        (HEADING, [*rows(), "1.0,0.5,1000,inf,0.02"], "line 102: thrust_n is 'inf'"),
        (HEADING, [*rows(), "0.5,0.5,1000,2.5,0.02"], "line 102: time_s is 0.5 after 0.99"),
        (HEADING, [*rows(), "0.99,0.5,1000,2.5,0.02"], "expected it to rise"),
        (HEADING, [row.replace("0.5,", "50,") for row in rows()], "is it in percent? divide it by 100"),
        (HEADING, [row.replace("0.5,", "1500,") for row in rows()], "is it in microseconds?"),
        (HEADING, [row.replace("0.5,", "-0.2,") for row in rows()], "throttle reaches from -0.2 to -0.2"),
        (HEADING, [f"{0.01 * k:.2f},0.5,1e11,2.5,0.02" for k in range(60)], "rpm is 1e+11 in the upper half"),
        (HEADING, rows(49), "49 rows, expected at least 50"),
        ("", [], "0 rows, expected at least 50"),
        (HEADING, [*rows(), '"' + "9" * 200_000], "line 102: not CSV"),
    ],
)
def test_log_is_refused_in_one_line_when_damaged(
    tmp_path: Path, heading: str, lines: list[str], message: str
) -> None:
    path = write(tmp_path / "bench.csv", lines, heading)
    with pytest.raises(DynoError) as caught:
        read_recordings([path])
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_log_is_refused_when_it_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\x89PNG\r\n\xff\xfe" * 50)
    with pytest.raises(DynoError, match="not a text file"):
        read_recordings([tmp_path / "a.csv"])


def test_log_is_refused_when_missing_or_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DynoError, match="no such file"):
        read_recordings([tmp_path / "a.csv"])
    path = write(tmp_path / "a.csv", rows(100))
    monkeypatch.setattr(dyno_data, "ROWS_MAX", 99)
    with pytest.raises(DynoError, match="more than 99 rows"):
        read_recordings([path])
    monkeypatch.setattr(dyno_data, "FILE_BYTES_MAX", 1000)
    with pytest.raises(DynoError, match="expected at most 1000"):
        read_recordings([path])
