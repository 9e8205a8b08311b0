"""The emulated board in an aircraft that is held down softly, in lockstep with programs on its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.control.motors import each_fraction
from neuroflight.sim.physics.esc import rotor_words
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Held, Mount
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.errors import LinkError

SOFT = Held(3.0, 0.15)
TRUE = np.eye(3)


@dataclass(frozen=True, eq=False)
class Build:
    """How somebody built an aircraft, other than its file says."""

    order: Sequence[int] = (0, 1, 2, 3)  # output i turns rotor order[i]
    other_way: Sequence[int] = ()  # rotors whose motors turn the other way
    down: Sequence[int] = ()  # rotors that push down
    dead: Sequence[int] = ()  # rotors that do not turn
    gyro: NDArray[np.float64] | None = None  # (3, 3) body to what the gyro's board is in; None: as set


def built_twin(aircraft: Aircraft, build: Build, rate_hz: int, held: Held = SOFT, seed: int = 1) -> Twin:
    """A twin on a soft mount."""
    rotors = tuple(
        replace(rotor, spin=-rotor.spin) if i in build.other_way else rotor
        for i, rotor in enumerate(aircraft.rotors)
    )
    twin = Twin(
        replace(aircraft, rotors=rotors),
        rate_hz=rate_hz,
        mount=Mount.RIG,
        held=held,
        rng=np.random.default_rng(seed),
    )
    geometry, propulsion = twin._geometry, aircraft.propulsion
    for rotor in build.down:
        geometry.thrust_wrench[rotor] *= -1.0
        if geometry.square_wrench is not None:
            each = geometry.thrust_wrench[rotor] + propulsion.torque_ratio[0] * geometry.torque_wrench[rotor]
            geometry.square_wrench[rotor] = propulsion.thrust_coefficient[0] * each
    if build.dead:
        twin.weaken(np.array([float(i not in build.dead) for i in range(len(rotors))]))
    return twin


class HeldBoard:
    """A port whose gyro feels its twin. `run_to` lets both run."""

    def __init__(self, port: EmulatedPort, twin: Twin, build: Build) -> None:
        self.port, self.twin, self.build = port, twin, build
        self.lean = np.eye(3)  # of the whole mount, body to world
        self.shove = np.zeros(3)  # [rad/s] that something else turns it by
        self.most = np.zeros(twin.aircraft.motor_count)  # the largest fraction that each output was told
        self.fractions = np.zeros(twin.aircraft.motor_count)
        self._motors = np.zeros((1, twin.aircraft.motor_count))
        self._sample = Sample(0.0, *(np.zeros(3), np.eye(3)), *np.zeros((3, 3)))
        self.line = UartLine(port.board)

    def run_to(self, cycle: int) -> None:
        """Run to the first edge behind that cycle."""
        while self.port.board.cycle < cycle:
            self._exchange()

    def sleep(self, seconds: float) -> None:
        self.run_to(self.port.board.cycle + round(seconds * TIME_HZ))

    def clock(self) -> float:
        return self.port.board.cycle / TIME_HZ

    def client(self) -> Client:
        return Client(LineTransport(self.line, self.run_to), self.clock)

    def raise_nose(self, degrees: float) -> None:
        """Lean the mount."""
        angle = np.radians(degrees)
        self.lean = np.array(
            [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
        )

    def _exchange(self) -> None:
        live, to_board = self.twin.live, TRUE if self.build.gyro is None else self.build.gyro
        self._sample.gyro[:] = to_board @ (live.gyro[0] + self.shove)
        self._sample.specific_force[:] = to_board @ (self.lean.T @ live.accelerometer[0])
        self._sample.time_s = self.clock()
        self.port.set_rotors(rotor_words(live.rotor_speed[0])[np.array(self.build.order)])
        try:
            self.fractions = np.array(each_fraction(self.port.exchange(self._sample, None).dshot))
        except LinkError:  # while flash is written the core stands still and samples are lost
            self.port._samples = int(self.port._taken[0])
        self.most = np.maximum(self.most, self.fractions)
        self._motors[0, list(self.build.order)] = self.fractions
        self.twin.step(self._motors)
