"""Manoeuvres in free flight, with drag, battery and gusts, of policies, PIDs and Betaflight on equal terms.

Every controller flies alone behind its port, from its boot, through the lockstep loop of `neuroflight fly`:
receiver frames, calibration and arming included. Before that it flies the stairs: zero command, the centre
of mass held, gyro noise on, the same battery, a throttle after the other; what thrust its rotors give is its
curve, by which the thrust that a manoeuvre asks for becomes its own throttle. A policy is computed in Python
with float32's roundings, which flies any file without a build.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import Mean, mean_of, paired
from neuroflight.sim.analysis.manoeuvre import ManoeuvreFigures, manoeuvre_figures
from neuroflight.sim.analysis.stick_flight import DescentFigures, descent_figures
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.flight.loop import Progress, fly
from neuroflight.sim.flight.manoeuvres import DESCENT, HOVER_S, SETTLE_S, Manoeuvre, ThrustCurve, stairs
from neuroflight.sim.flight.motion import Motion
from neuroflight.sim.flight.scenario import Scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.port import BetaflightPort, aircraft_settings
from neuroflight.sim.ports.betaflight.tune import Tune
from neuroflight.sim.ports.port import FirmwarePort
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ
from neuroflight.toolchain.errors import PolicyError
from neuroflight.training.evaluation.betaflight import betaflight_facts, betaflight_idle, betaflight_label
from neuroflight.training.evaluation.controllers import ControllerSpec, load_controller

COMPARED = ("mae", "mse")  # figures of which the lowest wins


@dataclass(frozen=True)
class Air:
    """Battery and wind that everybody flies with."""

    charge: float  # of the battery at power-on, 0..1
    gust: float  # wind 20 feet above the ground whose turbulence is flown in [m/s]


@dataclass(frozen=True)
class PortController:
    """A controller that can be put behind a port, freshly booted."""

    name: str  # as the user wrote it
    label: str
    open: Callable[[], FirmwarePort]
    idle: float
    facts: dict[str, str]  # what a stored result records of it


def port_controller(name: str, aircraft: Aircraft) -> PortController:
    """Load a policy file, `pid` or `pid:NAME`.

    Raises AircraftError or PolicyError where it does not exist or cannot fly the aircraft behind a port.
    """
    spec = load_controller(name, aircraft)
    controller = spec.build(1)
    if isinstance(controller, PolicyController) and "gravity" in controller.senses:
        raise PolicyError(
            f"{name}: observes the attitude, which no port gives; evaluate it with `neuroflight evaluate`"
        )
    return PortController(name, spec.label, lambda: _port(spec, aircraft), spec.idle, spec.facts)


def betaflight_controller(
    name: str, aircraft: Aircraft, built: Betaflight, tune: Tune | None
) -> PortController:
    """Return Betaflight, its defaults or a pilot's settings. Raises AircraftError if it cannot fly it."""
    settings = aircraft_settings(aircraft)
    return PortController(
        name=name,
        label=betaflight_label(tune),
        open=lambda: BetaflightPort(built, GYRO_RATE_DEFAULT_HZ, settings, tune, aircraft.motor_count),
        idle=betaflight_idle(tune),
        facts=betaflight_facts(tune),
    )


def _port(spec: ControllerSpec, aircraft: Aircraft) -> ControllerPort:
    return ControllerPort(
        spec.build(1),
        aircraft.motor_count,
        GYRO_RATE_DEFAULT_HZ,
        spec.control_rate_hz,
        spec.idle,
        mix=spec.mix,
        gyro_filters=spec.gyro_filters,
    )


@dataclass(frozen=True)
class Pilot:
    """A controller that flies an aircraft alone, behind its port from its boot."""

    controller: PortController
    aircraft: Aircraft
    air: Air

    def curve(self, seed: int, progress: Progress | None = None) -> ThrustCurve:
        """Fly the stairs and return thrust at rest against throttle."""
        _, motion, rate_hz = self._fly(stairs(), seed, progress)
        return ThrustCurve.of_steps(motion.thrust.tolist(), rate_hz)

    def manoeuvre(
        self, manoeuvre: Manoeuvre, curve: ThrustCurve, seed: int, progress: Progress | None = None
    ) -> ManoeuvreFigures:
        """Fly a manoeuvre and a hover; the seed draws noise, bias and gusts."""
        scenario = manoeuvre.then_hover().scenario(curve.throttle_of)
        trace, motion, _ = self._fly(scenario, seed, progress)
        return manoeuvre_figures(trace, motion.thrust, manoeuvre.commanded, SETTLE_S, HOVER_S)

    def trace(
        self, manoeuvre: Manoeuvre, curve: ThrustCurve, seed: int, progress: Progress | None = None
    ) -> Trace:
        """Fly the manoeuvre and return it as it was flown."""
        return self._fly(manoeuvre.scenario(curve.throttle_of), seed, progress)[0]

    def descent(self, curve: ThrustCurve, seed: int, progress: Progress | None = None) -> DescentFigures:
        """Fly the descent of a seed: from the hover, level, the throttle closed."""
        _, motion, rate_hz = self._fly(DESCENT.scenario(curve.throttle_of), seed, progress)
        return descent_figures(motion, round(SETTLE_S * rate_hz), rate_hz)

    def _fly(self, scenario: Scenario, seed: int, progress: Progress | None) -> tuple[Trace, Motion, int]:
        """Fly in a fresh twin; noise and gusts are those of the seed, whoever flies."""
        port = self.controller.open()
        with closing(port):
            twin = Twin(
                self.aircraft,
                rate_hz=port.gyro_rate_hz,
                mount=scenario.mount,
                charge=self.air.charge,
                gust=self.air.gust if scenario.mount is Mount.FREE else 0.0,
                rng=np.random.default_rng((seed, 1)),
            )
            with closing(twin):
                motion = Motion(twin)
                trace = fly(twin, port, scenario, progress=progress, watch=motion)
                return trace, motion, port.control_rate_hz


# --- Means over seeds ------------------------------------------------------------------------
@dataclass(frozen=True)
class Flown:
    """All flights of one controller."""

    controller: PortController
    curve: ThrustCurve
    manoeuvres: dict[str, tuple[ManoeuvreFigures, ...]]  # by name, a flight a seed
    descents: tuple[DescentFigures, ...]


def means(flights: Sequence[ManoeuvreFigures] | Sequence[DescentFigures]) -> dict[str, Mean]:
    """Return each figure over seeds with its 95 % confidence."""
    names = [field.name for field in fields(flights[0])]
    return {name: mean_of(_values(flights, name)) for name in names}


def winner(flown: Sequence[Flown], manoeuvre: str, figure: str) -> int:
    """Return the index of the controller with the lowest mean."""
    return int(np.argmin([_values(one.manoeuvres[manoeuvre], figure).mean() for one in flown]))


def significant(flown: Sequence[Flown], manoeuvre: str, figure: str, best: int) -> bool:
    """Return True if the best differs from every other with 95 % confidence, seed by seed."""
    others = [one for k, one in enumerate(flown) if k != best]
    above = [less(flown[best], one, manoeuvre, figure) for one in others]
    return all(mean.count > 1 and mean.low > 0.0 for mean in above)


def less(first: Flown, one: Flown, manoeuvre: str, figure: str) -> Mean:
    """Return a figure of `one` less that of `first`, seed by seed."""
    return paired(*(_values(each.manoeuvres[manoeuvre], figure) for each in (first, one)))


def _values(
    flights: Sequence[ManoeuvreFigures] | Sequence[DescentFigures], figure: str
) -> NDArray[np.float64]:
    return np.array([getattr(flight, figure) for flight in flights], np.float64)
