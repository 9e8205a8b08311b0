"""Reading gyro recordings: units and axes, and one line for each file that is none."""

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.arrays import Array
from neuroflight.sim.flight.trace import save_trace
from neuroflight.sim.identification import recording
from neuroflight.sim.identification.recording import SAMPLES_MIN, Choice, read_recording
from neuroflight.toolchain.errors import TraceError
from tests.sim.flight.test_trace import make_trace

OURS = "t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
BLACKBOX = "loopIteration, time (us), gyroADC[0], gyroADC[1], gyroADC[2], flags (flags)"
COUNT = SAMPLES_MIN


def ours(time: Array, extra: str = "") -> str:
    rows = [f"{t:.6f},{i % 7},{-(i % 5)},{i % 3}.5{extra}" for i, t in enumerate(time)]
    return "\n".join(rows) + "\n"


def write(folder: Path, text: str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def blackbox(interval: float = 500) -> str:
    rows = (
        f"{i}, {12_345 + interval * i}, {i % 7:3d}, {-(i % 5):3d}, {i % 3:3d}, ANGLE_MODE|ARM"
        for i in range(COUNT)
    )
    return "\n".join(rows) + "\n"


def test_table_of_ours_is_read_in_si_when_its_columns_are_in_any_order(tmp_path: Path) -> None:
    text = "note,gyro_z_deg_s,gyro_x_deg_s,t_s,gyro_y_deg_s\n"
    text += "".join(f"a,{i},180,{i / 500},-90\n" for i in range(COUNT))
    seen = read_recording(write(tmp_path, text))
    assert seen.rate_hz == pytest.approx(500.0)
    assert seen.gyro[3] == pytest.approx([np.pi, -np.pi / 2, np.deg2rad(3.0)])
    assert seen.acceleration is None
    assert seen.gaps == 0


def test_acceleration_is_read_as_it_is_when_the_table_is_ours(tmp_path: Path) -> None:
    text = f"{OURS},acc_x_m_s2,acc_y_m_s2,acc_z_m_s2\n" + ours(np.arange(COUNT) / 1000, ",0.5,-0.25,9.75")
    seen = read_recording(write(tmp_path, text))
    assert seen.acceleration is not None
    assert seen.acceleration[-1].tolist() == [0.5, -0.25, 9.75]


def test_blackbox_counts_are_scaled_and_keep_their_signs_when_their_unit_is_given(tmp_path: Path) -> None:
    seen = read_recording(write(tmp_path, f"{BLACKBOX}\n{blackbox()}"), Choice(unit_deg_s=0.1))
    assert seen.rate_hz == pytest.approx(2000.0)
    assert np.rad2deg(seen.gyro[4]) == pytest.approx([0.4, -0.4, 0.1])


def test_blackbox_units_are_converted_when_the_decoder_wrote_them(tmp_path: Path) -> None:
    heading = BLACKBOX.replace("(us)", "(ms)")
    for axis in range(3):
        heading = heading.replace(f"gyroADC[{axis}]", f"gyroADC[{axis}] (rad/s)")
    seen = read_recording(write(tmp_path, f"{heading}\n{blackbox(0.25)}"))
    assert seen.rate_hz == pytest.approx(4000.0)
    assert seen.gyro[4] == pytest.approx([4.0, -4.0, 1.0])


def test_blackbox_acceleration_is_one_g_when_the_aircraft_rests(tmp_path: Path) -> None:
    heading = f"{BLACKBOX}, accSmooth[0], accSmooth[1], accSmooth[2]"
    rows = blackbox().replace("ANGLE_MODE|ARM", "X, 0, 0, 2048")
    seen = read_recording(write(tmp_path, f"{heading}\n{rows}"), Choice(unit_deg_s=1.0))
    assert seen.acceleration is not None
    assert seen.acceleration[0] == pytest.approx([0.0, 0.0, 9.80665])
    off = read_recording(
        write(tmp_path, f"{heading}\n{rows.replace('X, 0, 0, 2048', 'X, 0, 0, 0')}"), Choice(unit_deg_s=1.0)
    )
    assert off.acceleration is None


def test_trace_gives_its_gyro_when_read(tmp_path: Path) -> None:
    trace = make_trace(COUNT)
    save_trace(tmp_path / "flight.npz", trace)
    seen = read_recording(tmp_path / "flight.npz")
    assert seen.rate_hz == pytest.approx(1000.0)
    assert seen.gyro.tolist() == trace.gyro.tolist()


def test_gaps_are_counted_and_left_out_of_the_rate_when_samples_are_lost(tmp_path: Path) -> None:
    time = np.delete(np.arange(2 * COUNT) / 1000, [300, 301, 302, 900])
    seen = read_recording(write(tmp_path, f"{OURS}\n{ours(time)}"))
    assert seen.gaps == 2
    assert seen.rate_hz == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "columns are none; expected t_s"),
        (OURS, "0 samples, expected at least 1000"),
        (f"{OURS}\n{ours(np.arange(COUNT - 1) / 1000)}", "999 samples"),
        (f"{OURS}\n{ours(np.arange(COUNT) / 1000)}1.5,nan,0,0\n", "gyro_x_deg_s of sample 1001 is nan"),
        (f"{OURS}\n{ours(np.arange(COUNT) / 1000)}1.5,0,zero,0\n", "'zero'"),
        (f"{OURS}\n{ours(np.arange(COUNT) / 1000)}1.5,0\n", "damaged or no table"),
        (f"{OURS}\n{ours(np.arange(COUNT) / 1000)}0.5,0,0,0\n", "does not rise at sample 1001"),
        (f"{OURS}\n{ours(np.arange(float(COUNT)))}", "check the unit of the time"),
        (f"{OURS}\n{ours(np.arange(COUNT) / 1e6)}", "check the unit of the time"),
        (f"t,x,y,z\n{ours(np.arange(COUNT) / 1000)}", "columns are t, x, y, z; expected t_s"),
        (f"{BLACKBOX.replace('(us)', '(h)')}\n{blackbox()}", "expected t_s"),
        ("\0\1\2" * 5000, "columns are"),
        (f"{BLACKBOX}\n{blackbox()}", "give the log itself (.BBL), or --gyro-unit, deg/s"),
    ],
)
def test_log_is_refused_in_one_line_when_it_is_no_record(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(TraceError) as caught:
        read_recording(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("log.dat", b"", "expected a blackbox log"),
        ("log.csv", b"\xff\xfe\xfa", "damaged or no table"),
        ("log.npz", b"PK\3\4", "damaged or no .npz"),
        ("log.bbl", b"H nothing", "holds no log"),
        ("log.csv", None, "no such file"),
        ("log.npz", None, "no such file"),
    ],
)
def test_log_is_refused_when_it_is_of_another_kind(
    tmp_path: Path, name: str, data: bytes | None, message: str
) -> None:
    path = tmp_path / name
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(TraceError, match=message):
        read_recording(path)


def test_log_is_refused_before_it_is_read_when_it_is_too_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "BYTES_MAX", 100)
    with pytest.raises(TraceError, match="bytes, expected at most 100; cut"):
        read_recording(write(tmp_path, f"{OURS}\n{ours(np.arange(COUNT) / 1000)}"))


def test_unit_is_refused_when_the_columns_name_theirs(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="leave it out"):
        read_recording(write(tmp_path, f"{OURS}\n{ours(np.arange(COUNT) / 1000)}"), Choice(unit_deg_s=0.1))
