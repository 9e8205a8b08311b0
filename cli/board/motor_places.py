"""The position of each motor and the way it turns, in words, from the aircraft's file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from neuroflight.toolchain.contract import MOTOR_PLACES
from neuroflight.toolchain.errors import AircraftError

if TYPE_CHECKING:
    from neuroflight.flash.hold_down.wiring import Layout
    from neuroflight.sim.aircraft.model import Aircraft

MIDDLE = 0.1  # of the largest distance: nearer to an axis than that is neither front nor rear, left nor right


@dataclass(frozen=True)
class MotorPlace:
    """One motor."""

    where: str
    turns: str  # seen from above; "" where no file says it

    def __str__(self) -> str:
        return f"{self.where}, {self.turns} seen from above" if self.turns else self.where


def motor_places(aircraft: str | None, trained_for: str, count: int, reverse: bool) -> tuple[MotorPlace, ...]:
    """Return the motors of the aircraft of that name or file, in motor order.

    aircraft: as the user said it; None: the one that the policy was trained for, where its file is shipped.
    reverse: all turn the other way than in the file. Raises AircraftError for a file that is none, or of an
    aircraft with another number of motors.
    """
    model = _model(aircraft, trained_for, count)
    if model is None:
        names = (*MOTOR_PLACES, *(f"number {number}" for number in range(len(MOTOR_PLACES) + 1, count + 1)))
        return tuple(MotorPlace(name, "") for name in names[:count])
    reach = max(abs(value) for rotor in model.rotors for value in rotor.position[:2])
    return tuple(
        MotorPlace(
            where=_where(rotor.position[0] / reach, rotor.position[1] / reach),
            turns="counter-clockwise" if (rotor.spin > 0) != reverse else "clockwise",
        )
        for rotor in model.rotors
    )


def motor_layout(aircraft: str | None, trained_for: str, count: int, reverse: bool) -> Layout:
    """Return the same as numbers. Raises AircraftError also where no file tells."""
    import numpy as np

    from neuroflight.flash.hold_down.wiring import Layout

    model = _model(aircraft, trained_for, count)
    if model is None:
        raise AircraftError(
            f"the policy's aircraft is {trained_for!r}, whose file is not shipped; give --aircraft FILE"
        )
    arms = np.array([rotor.position[:2] for rotor in model.rotors]) - model.mass_properties.centre[:2]
    spins = np.array([rotor.spin for rotor in model.rotors], float)
    return Layout(arms, -spins if reverse else spins)


def _model(aircraft: str | None, trained_for: str, count: int) -> Aircraft | None:
    """Return the aircraft; None where no file of it is known."""
    from neuroflight.sim.aircraft.model import load_aircraft, shipped
    from neuroflight.sim.aircraft.props_out import NAME_END, SUFFIX

    plain = trained_for.removesuffix(NAME_END)
    if aircraft is None and plain not in shipped():
        return None
    model = load_aircraft(aircraft or (trained_for if plain == trained_for else plain + SUFFIX))
    if len(model.rotors) != count:
        raise AircraftError(
            f"aircraft {model.name}: got {len(model.rotors)} motors, expected the firmware's {count}; "
            "give --aircraft NAME or FILE of the one that is on the bench"
        )
    return model


def _where(forward: float, left: float) -> str:
    """Return the position in words. forward, left: -1 to 1."""
    along = "front" if forward > MIDDLE else "rear" if forward < -MIDDLE else ""
    across = "left" if left > MIDDLE else "right" if left < -MIDDLE else ""
    return f"{along} {across}".strip() or "middle"
