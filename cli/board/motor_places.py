"""The position of each motor and the way it turns, in words, from the aircraft's file."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.toolchain.contract import MOTOR_PLACES
from neuroflight.toolchain.errors import AircraftError

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
    from neuroflight.sim.aircraft.model import load_aircraft, shipped
    from neuroflight.sim.aircraft.props_out import NAME_END, SUFFIX

    plain = trained_for.removesuffix(NAME_END)
    if aircraft is None and plain not in shipped():
        names = (*MOTOR_PLACES, *(f"number {number}" for number in range(len(MOTOR_PLACES) + 1, count + 1)))
        return tuple(MotorPlace(name, "") for name in names[:count])
    model = load_aircraft(aircraft or (trained_for if plain == trained_for else plain + SUFFIX))
    if len(model.rotors) != count:
        raise AircraftError(
            f"aircraft {model.name}: got {len(model.rotors)} motors, expected the firmware's {count}; "
            "give --aircraft NAME or FILE of the one that is on the bench"
        )
    reach = max(abs(value) for rotor in model.rotors for value in rotor.position[:2])
    return tuple(
        MotorPlace(
            where=_where(rotor.position[0] / reach, rotor.position[1] / reach),
            turns="counter-clockwise" if (rotor.spin > 0) != reverse else "clockwise",
        )
        for rotor in model.rotors
    )


def _where(forward: float, left: float) -> str:
    """Return the position in words. forward, left: -1 to 1."""
    along = "front" if forward > MIDDLE else "rear" if forward < -MIDDLE else ""
    across = "left" if left > MIDDLE else "right" if left < -MIDDLE else ""
    return f"{along} {across}".strip() or "middle"
