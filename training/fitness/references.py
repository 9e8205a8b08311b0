"""The references of a check, the aircraft's PID and Betaflight, flown once in a process of their own.

The policy flies in the caller's process meanwhile, and the check of a second policy of the same aircraft
waits for them no more.
"""

from __future__ import annotations

from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Self

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import AircraftError, NeuroflightError, TrainingError
from neuroflight.toolchain.workers import Worker
from neuroflight.training.fitness.course import Course, course

if TYPE_CHECKING:
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.fitness.flying import CourseFigures


class References:
    """The references of one aircraft, flown in another process; leaving the `with` block stops it."""

    def __init__(
        self, aircraft: Aircraft, named: str, betaflight: Betaflight | None, missing: str = ""
    ) -> None:
        """named: the aircraft, as a command takes it; betaflight: None: it does not fly, for the reason
        `missing`.

        Raises AircraftError without any reference.
        """
        self.aircraft, self._betaflight = aircraft, betaflight
        self.course: Course = course(aircraft)
        self._missing = [missing] if missing else []
        if not aircraft.pids:
            tune = f"neuroflight pid tune --aircraft {named} --out FILE.toml"
            if betaflight is None:
                raise AircraftError(
                    f"aircraft {aircraft.name} has no PID to check a policy against, nor flies Betaflight "
                    f"({missing}); run: {tune}"
                )
            self._missing.append(f"the aircraft has no PID; `{tune}` finds one")
        self._worker: Worker | None = None
        self._flown: tuple[CourseFigures, ...] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self) -> None:
        """Start to fly them, unless that was done."""
        if self._worker is None and self._flown is None:
            way = (self.aircraft, self._betaflight, self.course)
            self._worker = Worker(_work, *way, name="the references", quiet=True)

    def flown(self) -> tuple[tuple[CourseFigures, ...], tuple[str, ...]]:
        """Wait for the references; return their figures, and why one of them is missing."""
        self.begin()
        if self._flown is None:
            assert self._worker is not None
            try:
                self._flown, failed = self._worker.hear()
            except EOFError as error:
                raise TrainingError("the process of the references ended early; is memory short?") from error
            self._missing += failed
            self.close()
        if not self._flown:
            raise AircraftError(f"no reference flew: {'; '.join(self._missing)}")
        return self._flown, tuple(self._missing)

    def close(self) -> None:
        """End the other process."""
        if self._worker is not None:
            self._worker.end()  # not killed: Betaflight's processes end with it
            self._worker = None


def _work(link: Connection, aircraft: Aircraft, betaflight: Betaflight | None, way: Course) -> None:
    """Fly the references and send their figures."""
    link.send(fly_references(aircraft, betaflight, way))


def fly_references(
    aircraft: Aircraft, betaflight: Betaflight | None, way: Course
) -> tuple[tuple[CourseFigures, ...], list[str]]:
    """Fly the PID, if the aircraft has one, and Betaflight; return their figures and why that is missing."""
    from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
    from neuroflight.training.evaluation.betaflight import BetaflightSpec
    from neuroflight.training.evaluation.controllers import PID, load_controller
    from neuroflight.training.fitness.flying import fly_course

    flown, missing = [], []
    if betaflight is not None:
        try:
            with ArmedBetaflight(betaflight, aircraft) as armed:
                flown.append(fly_course(BetaflightSpec(armed), way.nominal() if aircraft.pids else way))
        except NeuroflightError as error:
            missing.append(f"Betaflight: {error}")
    if aircraft.pids:
        flown.insert(0, fly_course(load_controller(PID, aircraft), way))
    return tuple(flown), missing
