"""Recordings of the gyro from logs and their exports: every form of one log gives the same rates."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER
from neuroflight.sim.blackbox.flight import Part
from neuroflight.sim.identification.recording import EXPLORER_LOST, Choice, read_recording
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import TraceError
from tests.sampling import examples
from tests.sim.blackbox.writer import END, PRODUCT, Column, fields, flight, header

Integers = NDArray[np.int64]
COUNT = 1200
COLUMNS = [Column(f"gyroADC[{axis}]") for axis in range(3)] + [
    Column(f"accSmooth[{axis}]") for axis in range(3)
]
BETAFLIGHT = {"Firmware type": "Cleanflight", "Firmware revision": "Betaflight 4.5.1 (77d01ba3b) STM32F7X2"}
CLEANFLIGHT = {"Firmware type": "Cleanflight", "Firmware revision": "0a1b2c3"}  # whose counts are the chip's
SCALE = {"gyro_scale": "0x3f800000", "blackbox_high_resolution": "1", "acc_1G": "2048"}


def at_rest(seed: int = 1, count: int = COUNT, spread: float = 12.0) -> Integers:
    """Return counts of gyro and accelerometer of an aircraft at rest, (N, 6)."""
    rng = np.random.default_rng(seed)
    gyro = np.rint(rng.normal(0.0, spread, (count, 3)))
    force = np.rint(rng.normal([0.0, 0.0, 2048.0], 8.0, (count, 3)))
    return np.column_stack([gyro, force]).astype(np.int64)


def log_of(
    rows: Integers,
    told: Mapping[str, object],
    start: int = 5_000_000,
    firmware: Mapping[str, object] = BETAFLIGHT,
) -> bytes:
    """Write a log of these rows, a millisecond apart."""
    lines = header({"I interval": 32, "P interval": "1/1"}) + header(dict(firmware)) + header(dict(told))
    return PRODUCT + fields(COLUMNS) + lines + flight(COLUMNS, rows.tolist(), start=start) + END


def save(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def explorer(rows: Integers, told: Mapping[str, object], gyro_scale: float) -> str:
    """Write an export like the Blackbox Explorer's: settings, quoted names, frames; NaN in empty cells.

    Form: betaflight/blackbox-log-viewer, csv-export-worker.js and flightlog_parser.js (sysConfig).
    """
    names = ["loopIteration", "time", *(column.name for column in COLUMNS), "flightModeFlags", "heading[0]"]
    lines = ['"frameIntervalI",32', '"firmwareType",3', f'"gyroScale",{gyro_scale!r}']
    lines += [
        f'"{name}",{value}' if str(value).isdigit() else f'"{name}","{value}"' for name, value in told.items()
    ]
    lines += ['"rates","70,70,70"', '"deviceUID",""', ",".join(f'"{name}"' for name in names)]
    cells = (",".join(map(str, row)) for row in rows.tolist())
    lines += [f"{k},{5_000_000 + 1000 * k},{row},NaN,0.25" for k, row in enumerate(cells)]
    return "\n".join(lines)


def decoded(rows: Integers, unit: str, factor: float) -> str:
    """Write a table like blackbox_decode's, with --unit-rotation if `unit` is not empty."""
    names = ["loopIteration", "time (us)"]
    names += [f"gyroADC[{axis}]" + (f" ({unit})" if unit else "") for axis in range(3)]
    names += [f"accSmooth[{axis}]" for axis in range(3)] + ["flightModeFlags (flags)"]
    lines = [", ".join(names)]
    for k, row in enumerate(rows.tolist()):
        gyro = [f"{value * factor:.10g}" for value in row[:3]]
        lines.append(", ".join([str(k), str(5_000_000 + 1000 * k), *gyro, *map(str, row[3:]), "ANGLE|ARM"]))
    return "\n".join(lines) + "\n"


def test_every_form_of_a_high_resolution_log_gives_the_same_noise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = at_rest()
    log = save(tmp_path / "LOG.BBL", log_of(rows, SCALE))
    outputs = ["--csv", str(tmp_path / "mine.csv"), "--npz", str(tmp_path / "mine.npz")]
    assert main(["log", "decode", str(log), *outputs]) == 0
    seen = explorer(
        rows, {**BETAFLIGHT, "acc_1G": 2048, "blackbox_high_resolution": 1}, math.radians(1.0) * 1e-6
    )
    save(tmp_path / "explorer.csv", seen.encode())
    save(tmp_path / "raw.csv", decoded(rows, "", 1.0).encode())
    right = rows[:, :3].std(axis=0) / 10.0
    for name in ("LOG.BBL", "mine.csv", "mine.npz", "explorer.csv", "raw.csv"):
        more = ["--gyro-unit", "0.1"] if name == "raw.csv" else []
        capsys.readouterr()
        assert main(["aircraft", "noise", str(tmp_path / name), "--json", *more]) == 0, name
        document = json.loads(capsys.readouterr().out)
        assert document["samples"] == COUNT
        assert document["gyro_deg_s"]["sigma"] == pytest.approx(right.tolist(), rel=1e-3), name
        assert document["accelerometer_m_s2"]["sigma"] == pytest.approx([8.0 * GRAVITY / 2048] * 3, rel=0.1)


@pytest.mark.parametrize(
    ("told", "words", "message"),
    [
        (
            {"acc_1G": 2048},
            [],
            "nothing tells what a count of gyroADC is; give the log itself (.BBL), or --gyro",
        ),
        (SCALE, ["--gyro-unit", "1"], "its header tells the gyro's scale; leave --gyro-unit out"),
        (SCALE, ["--log", "2"], "--log 2, but it holds 1 log"),
    ],
)
def test_a_scale_is_told_once_and_never_guessed(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    told: dict[str, object],
    words: list[str],
    message: str,
) -> None:
    log = save(tmp_path / "LOG.BFL", log_of(at_rest(), told, firmware=CLEANFLIGHT))
    assert main(["aircraft", "noise", str(log), *words]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert main(["log", "decode", str(log), "--csv", str(tmp_path / "a.csv")]) == 0
    (tmp_path / "a.headers.csv").unlink()
    with pytest.raises(TraceError, match="nothing tells what a count"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("fine", [0, 1])
def test_rates_of_blackbox_decode_are_tenths_when_the_header_beside_says_so(
    tmp_path: Path, fine: int
) -> None:
    """Its --unit-rotation passes over blackbox_high_resolution; --save-headers keeps that line."""
    rows = at_rest()
    path = save(tmp_path / "a.csv", decoded(rows, "deg/s", 1.0).encode())
    save(tmp_path / "a.headers.csv", f"fieldname,fieldvalue\nblackbox_high_resolution,{fine}\n".encode())
    seen = read_recording(path)
    assert seen.gyro == pytest.approx(np.deg2rad(rows[:, :3] / (10.0 if fine else 1.0)), abs=1e-6)
    assert any("taken as tenths" in note for note in seen.notes) == bool(fine)


def test_a_scale_that_the_explorer_did_not_find_is_asked_for(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", explorer(at_rest(), CLEANFLIGHT, EXPLORER_LOST).encode())
    with pytest.raises(TraceError, match="nothing tells what a count"):
        read_recording(path)
    seen = read_recording(path, Choice(unit_deg_s=0.5))
    assert seen.gyro == pytest.approx(np.deg2rad(0.5 * at_rest()[:, :3]), abs=1e-6)


def test_a_log_of_a_file_and_a_part_of_it_are_chosen(tmp_path: Path) -> None:
    first, second = at_rest(1), at_rest(2, 3000)
    both = save(tmp_path / "LOGS.BBL", log_of(first, SCALE) + log_of(second, SCALE))
    assert len(read_recording(tmp_path / "LOGS.BBL:1").gyro) == COUNT
    assert len(read_recording(both, Choice(number=1)).gyro) == COUNT
    last = read_recording(both)
    assert len(last.gyro) == 3000 and "number 2 is taken" in last.notes[0]
    part = read_recording(both, Choice(part=Part(1.0, 2.5)))
    assert len(part.gyro) == 1500
    assert part.gyro == pytest.approx(np.deg2rad(second[1000:2500, :3] / 10.0), abs=1e-6)


def test_a_flight_is_told_with_the_part_in_which_it_is_at_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = at_rest(3, 6000)
    rows[2500:, 0] += np.rint(900 * np.sin(np.arange(3500) / 200.0)).astype(np.int64)
    log = save(tmp_path / "FLIGHT.BBL", log_of(rows, SCALE))
    own = tmp_path / "own.toml"
    own.write_bytes(before := (FOLDER / "nf1.toml").read_bytes())
    assert main(["aircraft", "noise", str(log), "--write", str(own)]) == 1
    error = capsys.readouterr().err
    assert "the aircraft moved" in error and "--from 0.0 --to 2.5" in error
    assert own.read_bytes() == before
    assert main(["aircraft", "noise", str(log), "--from", "0", "--to", "2.5", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert not document["moved"]
    assert document["gyro_deg_s"]["sigma"] == pytest.approx(
        (rows[:2500, :3].std(axis=0) / 10).tolist(), rel=1e-3
    )


def test_a_swing_in_a_log_tells_the_moment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inertia, stiffness, count = 1.1e-3, 0.03, 12_000
    time, turn = np.arange(count) / 1000.0, math.sqrt(0.03 / 1.1e-3)
    rows = at_rest(4, count, 3.0)
    rows[:, 1] += np.rint(10 * 4.0 * turn * np.exp(-0.02 * time) * np.sin(turn * time)).astype(np.int64)
    log = save(tmp_path / "PITCH.BBL", log_of(rows, SCALE))
    assert main(["aircraft", "inertia", str(log), "--stiffness", str(stiffness), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["axes"]["pitch"]
    assert found["inertia_kg_m2"] == pytest.approx(inertia, rel=1e-3)
    assert found["amplitude_deg"] == pytest.approx(4.0, rel=0.02)


@settings(
    max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_every_scale_in_every_form_is_that_of_the_log(tmp_path: Path, data: st.DataObject) -> None:
    draw = data.draw
    scale = draw(st.floats(0.01, 2.0).map(np.float32).map(float))
    fine = draw(st.sampled_from([0, 1]))
    text = draw(st.sampled_from([f"0x{struct.unpack('<I', struct.pack('<f', scale))[0]:x}", repr(scale)]))
    rows = at_rest(draw(st.integers(0, 9)), spread=draw(st.floats(2.0, 200.0)))
    right = np.deg2rad(rows[:, :3] * scale / (10.0 if fine else 1.0))
    one_g = draw(st.sampled_from([512, 2048, 4096]))
    told: dict[str, object] = {
        draw(st.sampled_from(["gyro_scale", "gyro.scale"])): text,
        "blackbox_high_resolution": fine,
        "acc_1G": one_g,
    }
    form = draw(st.sampled_from(["log", "explorer", "deg/s", "rad/s", "unit"]))
    choice = Choice()
    path = tmp_path / ("a.bbl" if form == "log" else "a.csv")
    if form == "log":
        path.write_bytes(log_of(rows, told, start=draw(st.integers(0, 2**31))))
    elif form == "explorer":
        path.write_text(
            explorer(rows, {**BETAFLIGHT, **dict(list(told.items())[1:])}, math.radians(scale) * 1e-6)
        )
    elif form == "unit":
        path.write_text(decoded(rows, "", 1.0))
        choice = Choice(unit_deg_s=scale / (10.0 if fine else 1.0))
    else:
        factor = scale / (10.0 if fine else 1.0) * (1.0 if form == "deg/s" else math.pi / 180)
        path.write_text(decoded(rows, form, factor))
    seen = read_recording(path, choice)
    assert seen.rate_hz == pytest.approx(1000.0)
    assert np.abs(seen.gyro - right).max() <= 1e-6 * np.abs(right).max()
    if form in ("log", "explorer"):
        assert seen.acceleration == pytest.approx(rows[:, 3:] * GRAVITY / one_g)
