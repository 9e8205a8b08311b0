from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.flight.trace import COLUMNS, Trace, load_trace, save_trace
from neuroflight.toolchain.errors import TraceError


def make_trace(steps: int = 50, motors: int = 4) -> Trace:
    rng = np.random.default_rng(5)
    dshot = rng.integers(48, 2048, (steps, motors)).astype(np.uint16)
    return Trace(
        t=np.arange(steps) / 1000,
        setpoint=rng.normal(size=(steps, 3)).astype(np.float32),
        rate=rng.normal(size=(steps, 3)),
        gyro=rng.normal(size=(steps, 3)).astype(np.float32),
        motors=(dshot - 48.0) / 1999,
        dshot=dshot,
        throttle=rng.uniform(size=steps).astype(np.float32),
    )


def test_a_trace_comes_back_bit_for_bit_when_saved_and_loaded(tmp_path: Path) -> None:
    trace = make_trace()
    save_trace(tmp_path / "a.npz", trace)
    assert load_trace(tmp_path / "a.npz").same(trace)
    assert trace.control_rate_hz == 1000


def test_two_files_hold_the_same_bytes_when_the_traces_are_equal(tmp_path: Path) -> None:
    save_trace(tmp_path / "a.npz", make_trace())
    save_trace(tmp_path / "b.npz", make_trace())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_same_is_false_when_one_bit_differs() -> None:
    trace = make_trace()
    rate = trace.rate.copy()
    rate[7, 1] = np.nextafter(rate[7, 1], 9)
    assert not trace.same(dataclasses.replace(trace, rate=rate))
    assert not trace.same(make_trace(steps=49))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate": np.zeros((49, 3))}, "rate is float64 \\(49, 3\\), expected float64 \\(50, 3\\)"),
        ({"gyro": np.zeros((50, 3))}, "gyro is float64"),
        ({"motors": np.zeros((50, 3))}, "motors is"),
        ({"dshot": np.full((50, 4), 2048, np.uint16)}, "dshot has 2048"),
        ({"dshot": np.zeros((50, 9), np.uint16)}, "9 motors"),
        ({"rate": np.full((50, 3), np.nan)}, "rate has a value that is not finite"),
        ({"t": np.zeros(50)}, "t does not rise"),
        ({"t": np.zeros(0)}, "t is empty"),
    ],
)
def test_a_trace_is_refused_when_an_array_does_not_fit(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(TraceError, match=message):
        dataclasses.replace(make_trace(), **changes)


def test_loading_is_refused_when_the_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="no such file"):
        load_trace(tmp_path / "a.npz")


def test_loading_is_refused_when_the_file_is_cut_anywhere(tmp_path: Path) -> None:
    save_trace(tmp_path / "a.npz", make_trace())
    whole = (tmp_path / "a.npz").read_bytes()
    for length in range(0, len(whole), 97):
        (tmp_path / "a.npz").write_bytes(whole[:length])
        with pytest.raises(TraceError, match=r"damaged or no .npz file"):
            load_trace(tmp_path / "a.npz")


def test_loading_is_refused_when_a_byte_of_an_array_is_flipped(tmp_path: Path) -> None:
    save_trace(tmp_path / "a.npz", make_trace())
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[data.index(make_trace().dshot.tobytes())] ^= 1
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(TraceError, match="damaged"):
        load_trace(tmp_path / "a.npz")


def test_loading_is_refused_when_arrays_are_missing_or_foreign(tmp_path: Path) -> None:
    arrays = {name: getattr(make_trace(), name) for name in COLUMNS}
    del arrays["gyro"]
    np.savez(tmp_path / "a.npz", **arrays, extra=np.zeros(3))
    with pytest.raises(TraceError, match=r"extra.npy, gyro.npy"):
        load_trace(tmp_path / "a.npz")


def test_loading_runs_no_pickle_when_an_array_is_one(tmp_path: Path) -> None:
    arrays = {name: getattr(make_trace(), name) for name in COLUMNS}
    np.savez(tmp_path / "a.npz", **arrays | {"rate": np.array([print, None], object)})
    with pytest.raises(TraceError, match="damaged"):
        load_trace(tmp_path / "a.npz")


def test_loading_is_refused_when_the_arrays_would_not_fit_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_trace(tmp_path / "a.npz", make_trace())
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        size = sum(member.file_size for member in archive.infolist())
    monkeypatch.setattr("neuroflight.sim.flight.trace.BYTES_MAX", size - 1)
    with pytest.raises(TraceError, match=f"expected at most {size - 1}"):
        load_trace(tmp_path / "a.npz")
