"""MAVSDK, MAVProxy and dronekit, as they install from the registry, against the gateway.

The host program flies in its twin, in lockstep with the gateway; both go as fast as the clock of this
computer, which is the clients'.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.mavlink.parameter_names import parameter_name
from neuroflight.flash.mavlink.parameters import FLOAT32_WHOLE_MAX
from neuroflight.toolchain.contract import RECEIVER_LOST_MS, SETTINGS, Mode, ModeRange
from tests.flash.logs.log_model import log_board, log_of
from tests.flash.mavlink.conftest import LOOPBACK, Lockstep, MakeLockstep, lockstep  # noqa: F401 - a fixture
from tests.flash.mavlink.test_logs import LineWithLogs

FOLDER = Path(__file__).parent
INSTALL_SECONDS_MAX, RUN_SECONDS_MAX = 900, 100
LAG_S = 0.02  # that time here may be made up for: more in one go would be a client's silence
PARAMETERS = [setting for setting in SETTINGS if setting.kind != "text"]
LOG = log_of(30_000)
ROLL_RAD_S = math.radians(60)  # what clients fly
MAVSDK = {3: "mavsdk==3.17.*", 4: "mavsdk==4.1.*"}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., dict[str, str]]:
    """Install packages once; return the environment that finds them."""
    made: dict[tuple[str, ...], Path] = {}

    def install(*wanted: str) -> dict[str, str]:
        if wanted not in made:
            made[wanted] = tmp_path_factory.mktemp("packages")
            command = [sys.executable, "-m", "pip", "install", "--quiet", "--target", str(made[wanted])]
            done = subprocess.run(
                [*command, *wanted], capture_output=True, text=True, timeout=INSTALL_SECONDS_MAX
            )
            if done.returncode:
                lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
                pytest.skip(f"pip cannot install {wanted}: {(lines or ['no reason given'])[-1]}")
        return os.environ | {"PYTHONPATH": str(made[wanted]), "PYTHONUNBUFFERED": "1"}

    return install


def free_port(kind: socket.SocketKind) -> int:
    """Return a port on which nobody listens."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind((LOOPBACK, 0))
        return int(free.getsockname()[1])


def plan(folder: Path, **more: Any) -> Path:
    """Return each parameter's kind, another value that the client sets, and its own."""
    rows = []
    for setting in PARAMETERS:
        value = 2.0 if setting.name == "receiver_protocol" else float(setting.default)
        wanted = float(setting.low if value != setting.low else setting.high)
        if setting.kind == "mode":
            wanted = float(ModeRange(Mode.BEEPER, 12, 900, 1300, and_others=True).packed)
        rows.append((parameter_name(setting.name).upper(), setting.kind, wanted, value))
    path = folder / "plan.json"
    path.write_text(json.dumps({"parameters": rows, "log": str(folder / "log.bbl"), **more}))
    return path


class Flight:
    """A gateway in front of a host program that flies, and a client in a process of its own."""

    def __init__(self, make: MakeLockstep, folder: Path) -> None:
        self.port, self.output = free_port(socket.SOCK_DGRAM), folder / "output.txt"
        board = log_board(b"", LOG)
        self.gateway: Lockstep = make(
            also=(f"udp:{LOOPBACK}:{self.port}",), through=lambda line: LineWithLogs(line, board)
        )
        self.most = 0.0  # of the setpoints about roll [rad/s]
        self.flown_ms = 0

    @contextlib.contextmanager
    def client(self, command: list[str], environment: dict[str, str], **more: Any) -> Iterator[Any]:
        """Run it; it ends with this, and all that it started."""
        with self.output.open("w") as out:
            process = subprocess.Popen(
                command, env=environment, stdout=out, stderr=out, text=True, start_new_session=True, **more
            )
            try:
                yield process
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def fly_until(self, done: Callable[[], bool]) -> None:
        """Let time pass."""
        begun = now = time.monotonic()
        due = now  # of the next millisecond
        while not done():
            self.gateway.run(1)
            self.most = max(self.most, float(self.gateway.reply.setpoint[0]))
            self.flown_ms += bool(self.gateway.reply.armed)
            now = time.monotonic()
            assert now - begun < RUN_SECONDS_MAX, self.told()
            due = max(due + 0.001, now - LAG_S)
            if due > now:
                select.select(self.gateway.peers, [], [], due - now)

    def told(self) -> str:
        """Return what the client has printed."""
        return self.output.read_text(errors="replace")

    def report(self) -> dict[str, Any]:
        """Return the last line that it has printed."""
        return dict(json.loads(self.told().splitlines()[-1]))


@pytest.fixture
def flight(lockstep: MakeLockstep, tmp_path: Path) -> Flight:  # noqa: F811
    """Start a gateway to a firmware with the MSP receiver, arming allowed."""
    folder = tmp_path / "flight"
    folder.mkdir()
    return Flight(lockstep, folder)


def mavsdk_command(flight: Flight, major: int, folder: Path, *, vanish: bool) -> list[str]:
    """Return the command that runs the client's program with that MAVSDK."""
    todo = plan(folder, major=major, vanish=vanish)
    grpc = free_port(socket.SOCK_STREAM)
    address = f"udpin://{LOOPBACK}:{flight.port}"
    return [sys.executable, str(FOLDER / "mavsdk_client.py"), address, str(todo), str(grpc)]


@pytest.mark.parametrize("major", MAVSDK)
def test_mavsdk_watches_sets_downloads_and_flies(
    flight: Flight, installed: Callable[..., dict[str, str]], major: int
) -> None:
    folder = flight.output.parent
    command = mavsdk_command(flight, major, folder, vanish=False)
    with flight.client(command, installed(MAVSDK[major])) as client:
        flight.fly_until(lambda: client.poll() is not None)
        assert client.returncode == 0, flight.told()
    got, todo = flight.report(), json.loads((folder / "plan.json").read_text())
    assert got["euler"] == pytest.approx([0, 0], abs=2) and got["quaternion"] == pytest.approx(
        [1, 0, 0, 0], abs=0.05
    )
    assert got["down_m_s2"] == pytest.approx(-9.8, abs=0.3)
    assert got["scaled_m_s2"] == pytest.approx(-9.8, abs=0.3)
    assert got["voltage"] == pytest.approx(16.8, abs=0.1)
    assert (got["armed"], got["in_air"]) == (False, False)
    rows = {name: (kind != "float", wanted, value) for name, kind, wanted, value in todo["parameters"]}
    assert set(got["ints"]) == {name for name, (whole, _, _) in rows.items() if whole}
    assert set(got["floats"]) == {name for name, (whole, _, _) in rows.items() if not whole}
    assert got["ints"] | got["floats"] == pytest.approx(
        {name: value for name, (_, _, value) in rows.items()}, rel=1e-6
    )
    assert got["set"] == pytest.approx({name: wanted for name, (_, wanted, _) in rows.items()}, rel=1e-6)
    assert (folder / "log.bbl").read_bytes() == LOG
    mission, *refused = got["missions"]
    assert mission == [] and [bool(why) for why in refused] == [True, False, True, True]
    assert got["roll_rad_s"] == pytest.approx(ROLL_RAD_S, abs=0.25)
    assert flight.most == pytest.approx(ROLL_RAD_S, abs=0.02)
    assert got["active"] and got["flying"] == [True, True] and flight.flown_ms > 4000
    assert len(set(got["modes"][2:])) == 1, "offboard, since the heartbeat has told so"
    assert got["set_in_flight"], "refused"
    assert not flight.gateway.reply.armed


@pytest.mark.parametrize("major", MAVSDK)
def test_the_failsafe_acts_when_mavsdk_vanishes(
    flight: Flight, installed: Callable[..., dict[str, str]], major: int
) -> None:
    command = mavsdk_command(flight, major, flight.output.parent, vanish=True)
    with flight.client(command, installed(MAVSDK[major])) as client:
        flight.fly_until(lambda: flight.most > 1.0 or client.poll() is not None)
        assert client.poll() is None, flight.told()
    assert flight.gateway.reply.dshot.all()
    gone = flight.gateway.clock()
    flight.fly_until(lambda: not flight.gateway.reply.dshot.any())
    assert 1000 * (flight.gateway.clock() - gone) < 300 + RECEIVER_LOST_MS + 100
    assert "Companion silent for 0.3 s: offboard ends, failsafe acts" in flight.gateway.lines


def test_dronekit_watches_sets_and_flies(flight: Flight, installed: Callable[..., dict[str, str]]) -> None:
    todo = plan(flight.output.parent, float_max=FLOAT32_WHOLE_MAX)
    address = f"udpin:{LOOPBACK}:{flight.port}"
    command = [sys.executable, str(FOLDER / "dronekit_client.py"), address, str(todo)]
    with flight.client(command, installed("dronekit==2.9.*", "future")) as client:
        flight.fly_until(lambda: client.poll() is not None)
        assert client.returncode == 0, flight.told()
    got = flight.report()
    rows = {name: (wanted, value) for name, _, wanted, value in json.loads(todo.read_text())["parameters"]}
    assert got["voltage"] == pytest.approx(16.8, abs=0.1) and got["mode"] == "STABILIZE"
    assert got["parameters"] == pytest.approx({name: value for name, (_, value) in rows.items()}, rel=1e-6)
    within = {name: wanted for name, (wanted, _) in rows.items() if wanted <= FLOAT32_WHOLE_MAX}
    assert len(within) > 100
    assert {name: seen for name, (_, seen, _) in got["set"].items()} == pytest.approx(within, rel=1e-6)
    assert all(first and last for first, _, last in got["set"].values())
    assert got["guided"] and got["armed"] and got["rolling"] and got["disarmed"]
    assert flight.most == pytest.approx(1.0, abs=0.02)


ANSWER_LINES = {  # of MAVProxy to each command, in their order
    "param show ROLL_MAX": r"ROLL_MAX +670\.0",
    "param show GYRO_RATE_HZ": r"GYRO_RATE_HZ +4000\.0",
    "param set roll_max 700": "",
    "param fetch roll_max": r"ROLL_MAX = 700\.0",
    "param set deadband_us 7": "",
    "version": "",
    "param fetch DEADBAND_US": r"DEADBAND_US = 7\.0",
    "param set deadband_us 0": "",
    "param set roll_max 670": "",
    "wp list": "Requesting 0 waypoints",
    "wp clear": "MISSION_ACK: TYPE_MISSION: ACCEPTED",
    "ftp list": r"opcode:129",
    "log list": "Log 1 ",
    "log download 1 LOG": "Finished downloading",
    "rc 1 1500": "",
    "rc 2 1500": "",
    "rc 4 1500": "",
    "rc 3 1000": "",
    "mode guided": "Mode GUIDED",
    "arm throttle": "ARMED",
    "rc 3 1300": "",
    "rc 1 1600": "",
    "status HEARTBEAT": "custom_mode : 4",
    "disarm": "DISARMED",
}


def test_mavproxy_watches_sets_downloads_and_flies(
    flight: Flight, installed: Callable[..., dict[str, str]]
) -> None:
    folder = flight.output.parent
    environment = installed("MAVProxy==1.8.*")
    command = [sys.executable, "-m", "MAVProxy.mavproxy", f"--master=udpin:{LOOPBACK}:{flight.port}"]
    with flight.client(
        [*command, f"--state-basedir={folder}", f"--logfile={folder / 'tlog'}"],
        environment,
        stdin=subprocess.PIPE,
        cwd=folder,
    ) as client:
        assert client.stdin is not None
        flight.fly_until(lambda: f"Received {len(PARAMETERS)} parameters" in flight.told())
        for line, answer in ANSWER_LINES.items():
            before = len(flight.told())
            client.stdin.write(line.replace("LOG", str(folder / "log.bbl")) + "\n")
            client.stdin.flush()
            until = flight.gateway.clock() + 0.5  # where it tells nothing
            flight.fly_until(
                lambda before=before, answer=answer, until=until: bool(  # type: ignore[misc]
                    re.search(answer, flight.told()[before:]) if answer else flight.gateway.clock() > until
                )
            )
    stored = (folder / "mav.parm").read_text().split()
    read = dict(zip(stored[::2], map(float, stored[1::2]), strict=True))
    expected = {name: value for name, _, _, value in json.loads(plan(folder).read_text())["parameters"]}
    assert read == pytest.approx(expected, abs=1e-6)
    assert (folder / "log.bbl").read_bytes() == LOG
    assert flight.most == pytest.approx(math.radians(70 * 0.2 + 600 * 0.2**2), abs=0.01), "of 100 us"
    assert not flight.gateway.reply.armed
