"""One flight each on library, host program and emulated board: its log, decoded by others, is its trace."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.main import main
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.flight.trace import load_trace
from neuroflight.sim.physics.imu import counts
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.sim.replay.flight import replayable
from neuroflight.toolchain.contract import FallbackCause, FlightState
from tests.peers.orangebox_peer import decoded
from tests.sampling import sampled

pytest.importorskip("orangebox")

CHIP = np.array([-1, -1, 1])  # the chip is mounted CW180: its axes from the body's
PORTS = {"reference": ReferencePort, "host": HostPort, "emulator": EmulatedPort}
MINUTE = 14  # commands of `pulses`, 4.5 s each
STORY = """[[segment]]
duration_s = 0.2
setpoint_deg_s = [100, -50, 30]
throttle = 0.3
[[segment]]
duration_s = 0.2
setpoint_deg_s = [-100, 0, 0]
throttle = 0.3
controller = "pid"
[[segment]]
duration_s = 0.3
setpoint_deg_s = [0, 0, 0]
throttle = 0.2
receiver = "lost"
[[segment]]
duration_s = 0.2
setpoint_deg_s = [50, 0, 0]
throttle = 0.2
"""
TROUBLE = (
    "--fault",
    "overload=0.0006@0.1",
    "--fault",
    "gyro-silent=0.012@0.8",
)  # fallback, lost samples, a fault
STOPPED = 3  # the command's exit code where a fault stops the motors

Flight = tuple[Path, Path, "Watched", dict[str, Any]]  # log, trace, samples, what `fly` told
Fly = Callable[..., Flight]


class Watched:
    """The chip's counts at each gyro sample, and the control step that it led to."""

    def __init__(self) -> None:
        self.counts: list[NDArray[np.int64]] = []  # (3,) chip axes
        self.steps: list[int] = []

    def wrap(self, exchange: Callable[..., Reply]) -> Callable[..., Reply]:
        """`exchange` of a port, looked at."""

        def watched(port: Any, sample: Sample, channels_us: Any) -> Reply:
            self.counts.append(CHIP * counts(sample.gyro).astype(np.int64))
            reply = exchange(port, sample, channels_us)
            self.steps.append(reply.step)
            return reply

        return watched

    def of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Counts (N, d * 3) of the d samples of each control step, of which the last one led to it."""
        told = np.array(self.steps)
        firsts = np.flatnonzero(np.diff(told, prepend=-1))
        last = firsts[np.searchsorted(told[firsts], steps)]
        assert (told[last] == steps).all()
        divider = int(np.diff(firsts)[1])
        rows = last[:, None] - np.arange(divider - 1, -1, -1)
        taken: NDArray[np.int64] = np.array(self.counts, np.int64)[rows]
        return taken.reshape(len(steps), -1)


@pytest.fixture
def logged(
    host_program: Path,
    board_image: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Iterator[Fly]:
    """`neuroflight fly` with a log, on the port or to the card that is named."""
    monkeypatch.setattr(fly_ports, "BUILD", host_program.parent)

    def fly(where: str, *arguments: str, code: int = 0) -> Flight:
        port = PORTS["emulator" if where == "card" else where]
        seen, log, trace = Watched(), tmp_path / f"{where}.bbl", tmp_path / f"{where}.npz"
        monkeypatch.setattr(port, "exchange", seen.wrap(port.exchange))  # type: ignore[attr-defined]
        to = ["--card", str(new_card(tmp_path / "card.img"))] if where == "card" else ["--blackbox", str(log)]
        on = ["--on", where]
        if where in ("card", "emulator"):
            on = ["--on", "emulator", "--build", str(board_image.parent)]
        capsys.readouterr()
        assert main(["fly", *on, *to, "--trace", str(trace), "--json", *arguments]) == code
        told = json.loads(capsys.readouterr().out)
        if where == "card":
            taken = ["mcopy", "-i", str(tmp_path / "card.img"), "::LOG00001.BBL", str(log)]
            subprocess.run(taken, check=True, timeout=60)
        return log, trace, seen, told

    yield fly


def new_card(image: Path) -> Path:
    """A card as a user makes it: formatted by a computer, with empty files for logs."""
    with image.open("wb") as file:
        file.truncate(256 << 20)
    subprocess.run(["mkfs.vfat", "-F", "32", str(image)], check=True, capture_output=True, timeout=60)
    assert main(["log", "card", str(image), "--files", "2", "--size", "16"]) == 0
    return image


def assert_log_is_flight(flight: Flight, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By orangebox as published: no invalid frame, each sample and motor value; by `log`: each figure."""
    log, npz, seen, told = flight
    assert told["blackbox"]["dropped"] == 0 and told["blackbox"]["ended"]
    peer = decoded(log, folder)
    assert peer["invalid"] == 0
    names = [str(name) for name in peer["names"]]
    rows = peer["rows"].astype(np.int64)
    assert len(rows) == told["blackbox"]["frames"]

    def matrix(name: str) -> NDArray[np.int64]:
        return rows[:, [k for k, other in enumerate(names) if other.startswith(f"{name}[")]]

    iteration = rows[:, names.index("loopIteration")]
    assert (np.diff(iteration) == 1).all()
    first_step = next(
        int(line.split(b":")[1])
        for line in log.read_bytes()[:65536].split(b"\n")
        if line.startswith(b"H nf_first_step:")
    )
    steps = iteration + first_step
    assert np.array_equal(matrix("gyroRaw"), seen.of(steps))
    trace = load_trace(npz)
    flown = slice(first := int(np.argmax(matrix("motor").any(axis=1))), first + len(trace.t))
    assert np.array_equal(matrix("motor")[flown], trace.dshot)
    assert np.array_equal(bits(matrix("gyroFloat"))[flown], trace.gyro)
    setpoint = bits(matrix("setpointFloat"))[flown]
    assert np.array_equal(setpoint[:, :3], trace.setpoint) and np.array_equal(setpoint[:, 3], trace.throttle)
    figures = []
    for file in (log, npz):
        to = ["--to", str(len(trace.t) / trace.control_rate_hz)]
        assert main(["log", "metrics", str(file), *to, "--idle", "0.05", "--mix", "centred", "--json"]) == 0
        figures.append(json.loads(capsys.readouterr().out))
        figures[-1].pop("file")
    assert figures[0] == figures[1]


def bits(values: NDArray[np.int64]) -> NDArray[np.float32]:
    """Floats whose bits were logged."""
    return (values & 0xFFFFFFFF).astype(np.uint32).view(np.float32)


@pytest.mark.parametrize("where", sampled(["reference", "emulator"], "reference"))
def test_a_log_is_its_flight_when_others_decode_it(
    where: str, logged: Fly, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "second.toml"
    scenario.write_text(
        "[[segment]]\nduration_s = 0.6\nsetpoint_deg_s = [100, -50, 30]\nthrottle = 0.3\n"
        "[[segment]]\nduration_s = 0.4\nsetpoint_deg_s = [0, 0, 0]\n"
    )
    assert_log_is_flight(logged(where, "--scenario", str(scenario)), tmp_path, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["reference", "host", "emulator", "card"])
def test_a_log_of_a_minute_is_its_flight(
    where: str, logged: Fly, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = logged(where, "--scenario", "pulses", "--count", str(MINUTE))
    assert_log_is_flight(flight, tmp_path, capsys)


@pytest.fixture
def story(tmp_path: Path) -> str:
    """Policy, PID, failsafe, policy."""
    path = tmp_path / "story.toml"
    path.write_text(STORY)
    return str(path)


def assert_replays(
    log: Path, on: str, host_program: Path, board_image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each motor value of the log comes again, to its end."""
    build = board_image.parent if on == "emulator" else host_program.parent
    assert main(["log", "replay", str(log), "--on", on, "--build", str(build), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["equal"] and told["different"] == 0 and told["incomplete"] is None and not told["damaged"]
    assert told["steps"] == len(read_log(log).columns["time"])


@pytest.mark.slow
def test_a_troubled_flight_of_the_board_is_replayed_to_the_bit(
    logged: Fly, story: str, host_program: Path, board_image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, *_ = logged("emulator", "--scenario", story, *TROUBLE, code=STOPPED)
    modes = read_log(log).held("nfFlags")
    assert modes is not None
    assert {FlightState.FAILSAFE_HOLD, FlightState.FAULT} <= set((modes >> 1 & 7).tolist())
    assert {0, 1} <= set((modes & 1).tolist()) and FallbackCause.DEADLINE in (modes >> 8 & 15)
    assert replayable(read_log(log)).inputs.lost.sum() > 100
    assert_replays(log, "library", host_program, board_image, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["reference", "host", "emulator", "card"])
def test_a_log_of_each_is_replayed_on_each(
    where: str,
    logged: Fly,
    story: str,
    host_program: Path,
    board_image: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    faulty = where in ("emulator", "card")
    options = TROUBLE if faulty else ()
    log, *_ = logged(where, "--scenario", story, *options, code=STOPPED if faulty else 0)
    for on in ("library", "host", "emulator"):
        assert_replays(log, on, host_program, board_image, capsys)


@pytest.mark.slow
def test_a_card_that_stalls_costs_no_control_step(
    logged: Fly, story: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, clean, *_ = logged("card", "--scenario", story)
    unhurt = load_trace(clean)
    log, trace, _, told = logged("card", "--scenario", story, "--fault", "card-stall=0.5@0.4")
    assert load_trace(trace).same(unhurt)
    dropped = told["blackbox"]["dropped"]  # as LOG_INFO has it
    read = read_log(log)
    assert dropped > 0 and read.ended
    counted = read.held("dropped")
    assert counted is not None and counted[-1] - counted[0] == dropped
    assert (np.diff(read.columns["loopIteration"]) - 1).sum() == dropped
    assert main(["log", "quality", str(log)]) == 0
    assert f"{dropped:,} control steps" in " ".join(capsys.readouterr().out.split())
    checked = ["fsck.vfat", "-n", str(tmp_path / "card.img")]
    assert subprocess.run(checked, capture_output=True, timeout=60, check=False).returncode == 0
