"""`neuroflight fly --throttle`: the pilot's throttle in scenarios that leave it to him."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from neuroflight.toolchain.contract import IDLE_DEFAULT
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.cli.fly.options import FlyOptions
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.toolchain.image.report import Built


@dataclass(frozen=True)
class Thrust:
    """The pilot's throttle in scenarios that leave it to him."""

    value: float | None  # 0..1; None: every scenario has its own
    holds: bool = False  # whether it was chosen because it holds the weight

    @property
    def where(self) -> str:
        """The throttle in words, to follow the name of the scenario."""
        if self.holds:
            return " at hover"
        return " with the throttle closed" if self.value == 0.0 else f" at throttle {self.value:g}"


def chosen_thrust(args: FlyOptions, aircraft: Aircraft, firmware: Built | None) -> Thrust:
    """Return the throttle that the user says, or the one that holds the weight.

    firmware: what was built, if that is known. Raises NeuroflightError where neither can be.
    """
    from neuroflight.sim.design.figures import hover_throttle
    from neuroflight.sim.flight.scenario import AT_THROTTLE

    if args.throttle is not None:
        if own := next((name for name in args.scenario if name not in AT_THROTTLE), None):
            raise NeuroflightError(f"--throttle: scenario {own} has a throttle of its own; leave it out")
        return Thrust(args.throttle)
    if not any(name in AT_THROTTLE for name in args.scenario):
        return Thrust(None)
    found = hover_throttle(aircraft, _idle(args, firmware))
    if found is None:
        raise NeuroflightError(
            f"--throttle: got none, and none holds the weight of {aircraft.name} (see `neuroflight aircraft "
            "check`); expected one to fly, 0 to 1"
        )
    return Thrust(round(found, 3), holds=True)  # a stick has 1,000 steps


def _idle(args: FlyOptions, firmware: Built | None) -> float:
    """Return the motor fraction of armed motors at no thrust; the usual where the build does not tell."""
    from neuroflight.sim.ports.betaflight.port import IDLE

    if args.on == "betaflight":
        return IDLE
    motors = None
    if firmware is not None:
        motors = firmware.policy_motors if args.controller == "policy" else firmware.pid_motors
    return IDLE_DEFAULT if motors is None else motors.idle
