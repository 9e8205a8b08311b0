"""The typical aircraft of a few answers: a complete file, each number with how it is known."""

from neuroflight.sim.aircraft.typical.aircraft import TypicalAircraft, typical
from neuroflight.sim.aircraft.typical.answers import Answers, Propeller

__all__ = ["Answers", "Propeller", "TypicalAircraft", "typical"]
