"""The masses of a typical airframe and where they sit, from its weight and arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.typical.answers import Whole
from neuroflight.sim.aircraft.typical.drive import Drive
from neuroflight.toolchain.errors import AircraftError

ARMS = 0.30  # of what is neither battery nor motor nor propeller: the five-inch and the NF1 have 0.29, 0.30
BATTERY_DENSITY, CELL_DENSITY = 2000.0, 1750.0  # [kg/m^3], of packs in their wrap, of a single cell
REST_MIN = 0.15  # of the weight, least that frame and electronics have
LONG_CELL, PACK = (5.5, 1.8, 1.0), (2.05, 1.0, 1.0)  # length, width, height of a whoop's cell, of a pack


@dataclass(frozen=True)
class Box:
    """A part as a box of even mass."""

    name: str
    mass: float  # [kg]
    position: Vector  # [m]
    size: Vector  # [m]
    yaw: float = 0.0  # [rad]


@dataclass(frozen=True)
class Airframe:
    """The parts of an aircraft; the origin is below the middle of the four motors, on the frame's bottom."""

    boxes: tuple[Box, ...]
    hub: float  # [m], the propellers' height
    motor_size: tuple[float, float]  # [m], radius and height
    size: Vector  # [m], of the box that touches the ground
    drag_area: Vector  # [m^2]


def typical_airframe(whole: Whole, drive: Drive) -> Airframe:
    """Spread a weight over an airframe of that arm as the five-inch has it. Raises AircraftError.

    Lengths are in arms: plates and electronics 1.45 x 0.38 x 0.36 long, wide and high, the pack on top; a
    whoop's cell hangs below. Arms are beams from end to end, in a whoop out to its ducts' outer side.
    """
    arm = whole.arm
    turning = 4 * (whole.motor_mass + drive.propeller_mass)
    rest = whole.weight - whole.battery_mass - turning
    if rest < REST_MIN * whole.weight:
        raise AircraftError(
            f"weight {1000 * whole.weight:.0f} g: four motors and propellers of that size have about "
            f"{1000 * turning:.0f} g and the battery {1000 * whole.battery_mass:.0f} g; check weight, motor, "
            f"propeller and capacity"
        )
    reach = arm + (0.5 if whole.ducted else 0.07) * whole.diameter
    beam = (2 * reach, 0.145 * arm, 0.05 * arm)
    middle = 0.36 * arm
    single = whole.cells == 1
    shape = LONG_CELL if single else PACK
    density = CELL_DENSITY if single else BATTERY_DENSITY
    unit = (whole.battery_mass / density / math.prod(shape)) ** (1 / 3)
    pack = (shape[0] * unit, shape[1] * unit, shape[2] * unit)
    boxes = (
        Box(
            "electronics and plates",
            (1 - ARMS) * rest,
            (0.0, 0.0, middle / 2),
            (1.45 * arm, 0.38 * arm, middle),
        ),
        Box("arms front left and rear right", ARMS / 2 * rest, (0.0, 0.0, beam[2] / 2), beam, math.pi / 4),
        Box("arms front right and rear left", ARMS / 2 * rest, (0.0, 0.0, beam[2] / 2), beam, -math.pi / 4),
        Box(
            "battery",
            whole.battery_mass,
            (0.0, 0.0, -pack[2] / 2 if single else middle + pack[2] / 2),
            pack,
        ),
    )
    across = 2 * (arm / math.sqrt(2) + (0.5 if whole.ducted else 0.11) * whole.diameter)
    area = (arm / 0.11) ** 2
    return Airframe(
        boxes=boxes,
        hub=0.27 * arm,
        motor_size=((whole.stator[0] / 2 + 2.3 * whole.stator[0] / 22) / 1000, 0.18 * arm),
        size=(across, across, 0.64 * arm),
        drag_area=(0.008 * area, 0.008 * area, 0.020 * area),
    )
