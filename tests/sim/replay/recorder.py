"""Records what the library's control path is given, from outside: without the firmware's ring or logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.debug.variables import read_variables
from neuroflight.sim.board.devices.gyro_mount import accel_counts, gyro_counts
from neuroflight.sim.board.fitted import GYRO
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample, flight_settings, twin_settings
from neuroflight.sim.ports.receiver_frames import sbus_frame
from neuroflight.sim.replay.inputs import Answers, Flight, Inputs
from neuroflight.sim.replay.library import ReplayLibrary
from neuroflight.toolchain.contract import LOG_RECEIVER_BYTES, LogEdge
from neuroflight.toolchain.errors import LinkError

START_S = 0.9  # after the boot, the gyro calibrated and nothing armed: the flight's state is of then
CONTROL_HZ = 1000


@dataclass
class Step:
    """What one control step is given, and its answer."""

    counts: list[Sequence[int]] = field(default_factory=list)
    invalid: list[bool] = field(default_factory=list)
    accel: Sequence[int] = (0, 0, 0)
    received: bytes = b""
    silences: int = 0
    missed: bool = False
    edges: Any = None
    rotors: Sequence[int] = ()
    answer: tuple[Any, ...] = ()


class Recorder(ReferencePort):
    """The library behind its port, with a note of everything that it is given."""

    def __init__(self, library: Path, rate_hz: int, settings: Mapping[str, float], meddle: Meddle) -> None:
        super().__init__(library, rate_hz, settings)
        (firmware,) = read_variables(library.with_name("neuroflight"), "firmware")
        self._firmware = np.frombuffer(self.reference._memory, firmware.dtype, 1)[0]
        self._depth = rate_hz // CONTROL_HZ
        self._meddle = meddle
        self.state = b""
        self.size = firmware.size
        self.steps: list[Step] = []
        self._now = Step()
        self._count = 0
        self.missed = False

    def silent(self) -> None:
        """The gyro says nothing for a while."""
        self.reference.silent()
        self._now.silences += 1

    def late(self, late: bool) -> None:
        """Control steps miss their deadlines from now on, or no longer."""
        self.missed = late
        self.reference.power(16.0, 0.0, 2e6 / CONTROL_HZ if late else 0.0)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """As the library, noted."""
        self._meddle(self, self._count, sample)
        now = self._now
        bad = bool(np.isnan(sample.gyro).any())
        now.counts.append([0, 0, 0] if bad else gyro_counts(sample.gyro.tolist(), GYRO.alignment))
        now.invalid.append(bad)
        if not bad:
            now.accel = accel_counts(sample.specific_force.tolist(), GYRO.alignment)
        if channels_us is not None:
            now.received += sbus_frame(channels_us)
        reply = super().exchange(sample, channels_us)
        if self._count % self._depth == 0:
            self._close()
        self._count += 1
        if self._count == round(START_S * CONTROL_HZ) * self._depth + 1:
            self.state, self.steps = self.reference._memory.tobytes()[: self.size], []
        return reply

    def _close(self) -> None:
        step, values = self._now, self._firmware
        trace, edges = values["status"]["trace"], values["edges"]
        step.missed = self.missed
        step.edges = (int(edges["forbidden"]), float(edges["voltage_gain"]))
        step.rotors = values["rotors"]["words"].copy()
        step.answer = tuple(trace[name].copy() for name in ("dshot", "gyro", "setpoint", "throttle"))
        self.steps.append(step)
        self._now = Step(accel=step.accel)


Meddle = Callable[[Recorder, int, Sample], None]  # before sample number n is taken


def flown(port: ReferencePort, scenario: Scenario) -> None:
    """Fly the NF1; a fault may leave it disarmed."""
    rng = np.random.default_rng((1, 1))
    twin = Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
    with closing(twin), suppress(LinkError):
        fly(twin, port, scenario)


def recorded(
    library: Path,
    scenario: Scenario,
    *,
    rate_hz: int = 4000,
    settings: Mapping[str, float] | None = None,
    meddle: Meddle = lambda port, number, sample: None,
) -> Flight:
    """A flight of the NF1 on the library, as a log would have it."""
    wanted = flight_settings({**twin_settings(load_aircraft("nf1")), **(settings or {})})
    port = Recorder(library, rate_hz, wanted, meddle)
    with closing(port):
        flown(port, scenario)
    return _flight(library, port, wanted)


def _flight(library: Path, port: Recorder, settings: Mapping[str, float]) -> Flight:
    steps, depth = port.steps, port._depth
    rows = len(steps)
    counts, invalid = np.zeros((rows, depth, 3), np.int16), np.zeros((rows, depth), bool)
    receiver = np.zeros((rows, LOG_RECEIVER_BYTES), np.uint8)
    for k, step in enumerate(steps):
        counts[k, : len(step.counts)], invalid[k, : len(step.counts)] = step.counts, step.invalid
        receiver[k, : len(step.received)] = list(step.received)
    dshot, gyro, setpoint, throttle = (np.array([step.answer[i] for step in steps]) for i in range(4))
    inputs = Inputs(
        step=np.arange(rows),
        samples=np.array([len(step.counts) for step in steps]),
        counts=counts,
        invalid=invalid,
        repeated=np.zeros_like(invalid),
        accel=np.array([step.accel for step in steps], np.int16),
        lost=np.zeros(rows, np.int64),
        silences=np.array([step.silences for step in steps]),
        flags=np.array([LogEdge.MISSED * step.missed for step in steps], np.uint32),
        forbidden=np.array([step.edges[0] for step in steps], np.uint32),
        gain=np.array([step.edges[1] for step in steps], np.float32),
        received=np.array([len(step.received) for step in steps]),
        receiver=receiver,
        rotors=np.array([step.rotors for step in steps], np.uint16),
    )
    flight = Flight(
        path=Path("recorded"),
        inputs=inputs,
        answers=Answers(dshot[:, : port.motor_count], gyro, setpoint, throttle),
        t=np.arange(rows) / CONTROL_HZ,
        state=port.state,
        settings=dict(settings),
        gyro_rate_hz=port.gyro_rate_hz,
        control_rate_hz=CONTROL_HZ,
        header={},
        layout=0,
        incomplete="",
    )
    return replace(flight, layout=ReplayLibrary(library, flight).layout)
