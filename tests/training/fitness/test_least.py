"""A check tells how far its flights are above the least error that motors could leave."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.evaluation.floor import floors
from neuroflight.training.fitness.course import FLIGHT, CommandFlight, Condition, Course
from neuroflight.training.fitness.flying import CommandFigures, with_least

NF1 = load_aircraft("nf1")
IDLE = 0.055
NONE = (0.0, 0.0, 0.0)


def test_legs_in_the_aircraft_of_the_file_have_a_least_error_and_others_have_none() -> None:
    flights = (CommandFlight("heavy", 2.0, Condition("slow rotors")), CommandFlight("hover", 1.0))
    setpoint = FLIGHT.episodes(2, np.random.default_rng(1), 1000)
    thrust = np.array([2.0, 1.0], np.float32)
    flown = Flights(
        setpoint=setpoint,
        rate=setpoint,
        output=np.zeros((*setpoint.shape[:2], 4), np.float32),
        step_s=1e-3,
        lift=np.broadcast_to(GRAVITY * thrust[:, None], setpoint.shape[:2]),
        course=FLIGHT.course,
        samples=4,
    )
    own = CommandFigures(2.0, 200.0, NONE, NONE, NONE, 0.0)
    varied, as_filed = with_least((own, own), Course(NF1, flights, ()), flown, IDLE)
    assert varied == own
    before_hover = setpoint[1:, flown.commanded]
    expected = floors(NF1, before_hover, 1e-3, thrust=1.0, idle=IDLE, samples=4)
    assert expected is not None
    assert as_filed.mae_least == pytest.approx(expected.mae[0], rel=1e-4)
    assert as_filed.mse_least == pytest.approx(expected.mse[0], rel=1e-4)
    assert (as_filed.mae, as_filed.mse) == (own.mae, own.mse)
