"""How fast firmwares fly on their ports, in multiples of real time, and which parts take the time.

Each is flown by `fly` in the NF1's twin with nothing but a clock before and after, the best of several; then
once more with a stopwatch at every border between the parts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, load_scenario
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.betaflight.build import build_betaflight
from neuroflight.sim.ports.betaflight.port import BetaflightPort, aircraft_settings
from neuroflight.sim.ports.betaflight.process import BetaflightProcess
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort, twin_settings
from tests.bench.board import Stopwatch

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "training" / "policies" / "nf1" / "policy.onnx"
AIRCRAFT = load_aircraft("nf1")
SCENARIO, SEED, COUNT = "pulses", 1, 1
ROUNDS = 3
TWIN, LOOP, PORT, FIRMWARE = PARTS = ("twin", "loop", "port", "firmware, and the way to it")


@dataclass(frozen=True)
class Subject:
    """A firmware behind its port."""

    name: str
    gyro_rate_hz: int
    bar: float  # of real time
    open: Callable[[], FirmwarePort]


@dataclass(frozen=True)
class Row:
    """A flight, from boot to disarming."""

    name: str
    bar: float
    factor: float  # of real time
    sample_us: float
    shares: dict[str, float]  # by part; together 1


class _Timed:
    """A C library one of whose functions is timed."""

    def __init__(self, library: Any, name: str, timed: Callable[[Callable[..., Any]], Any]) -> None:
        self._library = library
        setattr(self, name, timed(getattr(library, name)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name)


def measure(report: Callable[[str], None]) -> list[Row]:
    """Build, and fly each; `report` hears of the progress."""
    from neuroflight.toolchain.image.build import build

    with tempfile.TemporaryDirectory() as folder:
        build("HOST", POLICY, ROOT, Path(folder), pid_table(AIRCRAFT))
        rows = []
        for subject in _subjects(Path(folder) / "HOST", report):
            report(f"flights: {subject.name}")
            rows.append(_row(subject))
        return rows


def _subjects(products: Path, report: Callable[[str], None]) -> Iterator[Subject]:
    settings = twin_settings(AIRCRAFT)
    library, host = products / "libneuroflight.so", products / "neuroflight"
    yield Subject("library, 4 kHz", 4000, 10.0, lambda: ReferencePort(library, 4000, settings))
    yield Subject("host over UDP, 4 kHz", 4000, 8.0, lambda: HostPort(host, 4000, settings))
    yield Subject("host over UDP, 1 kHz", 1000, 20.0, lambda: HostPort(host, 1000, settings))
    betaflight = build_betaflight(ROOT / "build" / "BETAFLIGHT", report)
    lines = aircraft_settings(AIRCRAFT)
    yield Subject("Betaflight, 4 kHz", 4000, 3.0, lambda: BetaflightPort(betaflight, 4000, lines))


def _row(subject: Subject) -> Row:
    scenario = load_scenario(SCENARIO, seed=SEED, count=COUNT)
    wall_s = min(_flight(subject, scenario) for _ in range(ROUNDS))
    spent, samples = _shares(subject, scenario)
    total = sum(spent.values())
    shares = {part: spent[part] / total for part in PARTS}
    flown_s = samples / subject.gyro_rate_hz
    return Row(subject.name, subject.bar, flown_s / wall_s, 1e6 * wall_s / samples, shares)


def _twin(subject: Subject, scenario: Scenario) -> Twin:
    rng = np.random.default_rng((SEED, 1))
    return Twin(AIRCRAFT, rate_hz=subject.gyro_rate_hz, mount=scenario.mount, rng=rng)


def _flight(subject: Subject, scenario: Scenario) -> float:
    """Seconds of a flight."""
    with closing(subject.open()) as port, closing(_twin(subject, scenario)) as twin:
        began = time.perf_counter()
        fly(twin, port, scenario)
        return time.perf_counter() - began


def _shares(subject: Subject, scenario: Scenario) -> tuple[dict[str, float], int]:
    """Seconds by part, and the samples flown."""
    watch = Stopwatch(LOOP)
    watch.spent = dict.fromkeys(PARTS, 0.0)
    firmware = partial(watch.of, FIRMWARE)
    samples = 0

    def count(function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*arguments: Any) -> Any:
            nonlocal samples
            samples += 1
            return function(*arguments)

        return counted

    with ExitStack() as stack:
        port = stack.enter_context(closing(subject.open()))
        for name in ("step", "measure"):
            timed = watch.of(TWIN, getattr(Twin, name))
            stack.enter_context(mock.patch.object(Twin, name, timed))
        if isinstance(port, ReferencePort):
            sampler = port.reference.sampler
            port.reference.sampler = lambda values: firmware(sampler(values))  # type: ignore[method-assign, assignment]
        elif isinstance(port, HostPort):
            port._lib = _Timed(port._lib, "link_exchange", firmware)
        else:
            for name in ("run", "send_state", "servo_packets"):
                timed = firmware(getattr(BetaflightProcess, name))
                stack.enter_context(mock.patch.object(BetaflightProcess, name, timed))
        exchange = count(watch.of(PORT, port.exchange))
        stack.enter_context(mock.patch.object(port, "exchange", exchange))
        twin = stack.enter_context(closing(_twin(subject, scenario)))
        watch.stop()
        watch.spent.update(dict.fromkeys(PARTS, 0.0))
        fly(twin, port, scenario)
        watch.stop()
    return watch.spent, samples


def print_table(rows: list[Row], line: Callable[[str], None] = print) -> None:
    """For people."""
    line(f"{'flights':22}{'real time':>11}{'bar':>7}{'us a sample':>13}  of it")
    for row in rows:
        met = "" if row.factor >= row.bar else ", missed"
        parts = ", ".join(f"{share:.0%} {part}" for part, share in row.shares.items())
        line(f"{row.name:22}{row.factor:>10.1f}x{row.bar:>6g}x{row.sample_us:>13.1f}  {parts}{met}")


def document(rows: list[Row]) -> list[dict[str, Any]]:
    """For programs."""
    return [
        {
            "name": row.name,
            "real_time_factor": round(row.factor, 2),
            "bar": row.bar,
            "us_a_sample": round(row.sample_us, 2),
            "shares": {part: round(share, 4) for part, share in row.shares.items()},
        }
        for row in rows
    ]
