"""The file of a typical aircraft: every number with a mark that says how it is known."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroflight.sim.aircraft.known import How, Known, known_line
from neuroflight.sim.aircraft.model import Aircraft, parse_aircraft
from neuroflight.sim.aircraft.typical.airframe import Airframe, typical_airframe
from neuroflight.sim.aircraft.typical.answers import INCH, Answers, Whole, completed
from neuroflight.sim.aircraft.typical.drive import EFFICIENCY, RPM, Drive, typical_drive
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError

CELL_FULL = 4.2  # [V]
TOLD = "your answer"
SPINS = ("cw", "ccw", "ccw", "cw")  # rear right, front right, rear left, front left, propellers in


@dataclass(frozen=True)
class TypicalAircraft:
    """An aircraft file made of answers."""

    text: str
    known: Mapping[str, Known]
    whole: Whole  # the answers, and what was taken for those not given

    def aircraft(self, where: str = "typical aircraft", folder: Path | None = None) -> Aircraft:
        """Parse the file."""
        return parse_aircraft(self.text.encode(), where, folder)


def typical(answers: Answers) -> TypicalAircraft:
    """Make the file of the aircraft that is typical for these answers.

    The same answers make the same file. Raises AircraftError on answers that fit no aircraft together.
    """
    whole = completed(answers)
    drive = typical_drive(whole)
    frame = typical_airframe(whole, drive)
    full = 4 * drive.thrust_coefficient * (RPM * sum(drive.speed_curve_rpm)) ** 2 / GRAVITY
    if full < whole.weight:
        raise AircraftError(
            f"four motors of that size, {whole.kv:.0f} Kv, with such propellers on {whole.cells}S lift "
            f"{full:.2g} kg, the aircraft weighs {whole.weight:.3g} kg; check weight, cells, Kv, motor and "
            f"propeller"
        )
    lines = [*_head(answers, whole, frame), *_parts(whole, drive, frame), *_rotors(answers, whole, frame)]
    lines += _tables(whole, drive, frame)
    known = _marks(whole)
    lines += ["", "[known]", *(known_line(*mark) for mark in known.items())]
    return TypicalAircraft("\n".join(lines) + "\n", known, whole)


def _head(answers: Answers, whole: Whole, frame: Airframe) -> list[str]:
    size = f"{whole.diameter / INCH:.3g}x{whole.pitch / INCH:.2g}x{whole.blades} propellers"
    told = f"{1000 * whole.weight:.4g} g, {whole.kv:.0f} Kv motors, {size}, {whole.cells}S"
    return [
        "# Made of answers by `neuroflight aircraft new`; [known] at the end says how each number is known.",
        "# Body frame: x forward, y left, z up [m]; origin below the middle of the motors, on the frame's",
        "# bottom. Motor order: 1 rear right, 2 front right, 3 rear left, 4 front left.",
        "format = 1",
        f"name = {json.dumps(answers.name)}",
        f"description = {json.dumps(told)}",
        f"centre_of_thrust_m = {_list(0.0, 0.0, frame.hub)}",
    ]


def _parts(whole: Whole, drive: Drive, frame: Airframe) -> list[str]:
    lines = []
    for box in frame.boxes:
        lines += ["", "[[part]]", f"name = {json.dumps(box.name)}", f"mass_kg = {_few(box.mass)}"]
        lines += [f"position_m = {_list(*box.position)}"]
        lines += [f"yaw_rad = {box.yaw:.4f}"] if box.yaw else []
        lines += [f"box_m = {_list(*box.size)}"]
    half = float(_few(drive.propeller_inertia / 2))
    radius, height = frame.motor_size
    return [
        *lines,
        "",
        "[motor_part]",
        f"mass_kg = {_few(whole.motor_mass)}",
        f"centre_of_mass_m = {_list(0.0, 0.0, height / 2)}",
        f"cylinder_m = {_list(radius, height)}",
        "",
        "[propeller_part] # a turning blade is a disc on average: half of its moment across the axis",
        f"mass_kg = {_few(drive.propeller_mass)}",
        "centre_of_mass_m = [0.0, 0.0, 0.0]",
        f"inertia_kg_m2 = [{half!r}, {half!r}, {2 * half!r}]",
    ]


def _rotors(answers: Answers, whole: Whole, frame: Airframe) -> list[str]:
    along = whole.arm / math.sqrt(2)
    base = 0.05 * whole.arm
    lines = []
    for (x, y), spin in zip(((-1, -1), (1, -1), (-1, 1), (1, 1)), SPINS, strict=True):
        turned = spin if not answers.props_out else {"cw": "ccw", "ccw": "cw"}[spin]
        lines += [
            "",
            "[[rotor]]",
            f"motor_m = {_list(x * along, y * along, base)}",
            f"propeller_m = {_list(x * along, y * along, frame.hub)}",
            f'spin = "{turned}"',
        ]
    return lines


def _tables(whole: Whole, drive: Drive, frame: Airframe) -> list[str]:
    return [
        "",
        "[propulsion]",
        f"speed_curve_rpm = {_list(*drive.speed_curve_rpm)}",
        f"thrust_coefficient = {_few(drive.thrust_coefficient)}",
        f"torque_ratio_m = {_few(drive.torque_ratio)}",
        f"propeller_diameter_m = {_few(whole.diameter)}",
        f"supply_voltage_v = {_few(drive.supply_voltage)}",
        f"rotor_inertia_kg_m2 = {_few(drive.rotor_inertia)}",
        f"drag_coefficient = {_few(drive.drag_coefficient)}",
        f"rolling_coefficient = {_few(drive.rolling_coefficient)}",
        f"delay_s = {_few(whole.delay)}",
        f"efficiency = {EFFICIENCY}",
        "",
        "[propulsion.response]",
        'kind = "first_order"',
        f"time_constant_up_s = {_few(drive.time_up)}",
        f"time_constant_down_s = {_few(drive.time_down)}",
        "",
        "[gyro]",
        "noise_deg_s = [1.3, 1.0, 1.4]",
        "bias_deg_s = 0.25",
        "",
        "[accelerometer]",
        "noise_m_s2 = [0.09, 0.09, 0.09]",
        "bias_m_s2 = 0.2",
        "",
        "[esc]",
        "speed_step_rpm = 14.2857",
        "voltage_step_v = 0.01",
        "current_step_a = 0.01",
        "",
        "[battery]",
        f"cells = {whole.cells}",
        f"capacity_ah = {_few(whole.capacity)}",
        f"rest_voltage_v = {_few(CELL_FULL * whole.cells)}",
        f"resistance_ohm = {_few(_resistance(whole))}",
        f"electronics_w = {_few(_electronics(whole))}",
        "",
        "[body]",
        f"size_m = {_list(*frame.size)}",
        f"centre_m = {_list(0.0, 0.0, frame.size[2] / 2)}",
        f"drag_area_m2 = {_list(*frame.drag_area)}",
    ]


def _resistance(whole: Whole) -> float:
    """Return the resistance [ohm] of pack and leads.

    4.5 mohm a cell for an ampere hour, as healthy racing packs have, half a milliohm of its tabs and 4 mohm
    of leads and plug; a whoop's small plug and wires have 15.
    """
    return whole.cells * (0.0045 / whole.capacity + 0.0005) + (0.015 if whole.cells == 1 else 0.004)


def _electronics(whole: Whole) -> float:
    """Return the power [W] of controller, receiver and video: a whoop has about 2, a five inch 8."""
    return min(8.0, 2.0 + 12.0 * max(0.0, whole.weight - 0.03))


def _marks(whole: Whole) -> dict[str, Known]:
    """Return how each number is known: as answered, as is typical, or guessed."""
    marks: dict[str, Known] = {}

    def typical_of(key: str, source: str, *needed: str) -> None:
        """Mark as typical, or as guessed where an answer that it follows from is missing."""
        missing = [_NAMES[name] for name in needed if name not in whole.answered]
        unknown = f"{' and '.join(missing)} not told"
        marks[key] = Known(How.GUESSED, None, unknown) if missing else Known(How.TYPICAL, None, source)

    def answered(key: str, name: str, otherwise: str) -> None:
        known = name in whole.answered
        marks[key] = Known(How.MEASURED, None, TOLD) if known else Known(How.GUESSED, None, otherwise)

    marks["centre_of_thrust_m"] = Known(How.GUESSED, None, "in proportion to the arm")
    marks["part"] = Known(How.GUESSED, None, "the weight spread over boxes in proportion to the arm")
    typical_of("part.battery.mass_kg", "140 Wh/kg, packs as sold", "cells", "capacity_ah")
    typical_of("motor_part", "motors of that size as sold", "stator_mm")
    typical_of("propeller_part", "propellers of that size as sold; 0.05 m D^2", "propeller")
    answered("rotor", "arm_m", "an arm of 0.85 propellers")
    typical_of("propulsion.speed_curve_rpm", _CURVE, "kv", "cells", "propeller")
    typical_of("propulsion.thrust_coefficient", _THRUST, "pitch")
    typical_of("propulsion.torque_ratio_m", _TORQUE, "pitch")
    answered("propulsion.propeller_diameter_m", "propeller", "by the weight")
    typical_of("propulsion.supply_voltage_v", "3.7 V a cell, nominal", "cells")
    typical_of("propulsion.rotor_inertia_kg_m2", _INERTIA, "propeller", "stator_mm")
    typical_of("propulsion.drag_coefficient", _DRAG, "propeller")
    typical_of("propulsion.efficiency", "electrical power in the same thrust tests")
    marks["propulsion.rolling_coefficient"] = Known(How.GUESSED, None, "as public twins have, by D^4")
    typical_of("propulsion.delay_s", "ESC and a 1 kHz loop, by protocol; assumed, as the shipped aircraft's")
    typical_of("propulsion.response", _RESPONSE, "propeller", "stator_mm")
    typical_of("gyro.noise_deg_s", "the NF1's, armed on the ground (Koch 2019, chapter 5)")
    typical_of("gyro.bias_deg_s", "the NF1's, likewise")
    typical_of("accelerometer.noise_m_s2", "400 ug/sqrt(Hz) over 500 Hz, data sheets of common chips")
    marks["accelerometer.bias_m_s2"] = Known(How.GUESSED, None, "what a hobby calibration leaves")
    typical_of("esc", "BLHeli's telemetry, 14 poles")
    answered("battery.cells", "cells", "by the weight")
    answered("battery.capacity_ah", "capacity_ah", "30 % of the weight, 140 Wh/kg")
    typical_of("battery.rest_voltage_v", "4.2 V a full cell", "cells")
    typical_of("battery.resistance_ohm", "4.5 mohm Ah a cell of racing packs, and leads", "capacity_ah")
    marks["battery.electronics_w"] = Known(How.GUESSED, None, "2 to 8 W by the weight")
    marks["body"] = Known(How.GUESSED, None, "in proportion to the arm")
    return marks


_NAMES = {
    "propeller": "propeller",
    "pitch": "propeller's pitch",
    "stator_mm": "motor's size",
    "kv": "Kv",
    "cells": "cells",
    "capacity_ah": "capacity",
}
_THRUST = "(0.05 + 0.11 P/D) sqrt(blades/2): UIUC's and Mini Quad Test Bench's static tests, most within 15 %"
_TORQUE = "figures of merit of the same propellers, 0.44 to 0.68"
_CURVE = "Kv, volts and load: thrust tests of six motors, most within 10 %"
_INERTIA = "masses of propellers and bells as sold"
_RESPONSE = "rotor inertia over motor strength and propeller drag; the NF1's measured lag within 10 %"
_DRAG = "0.5/s of a hovering quadrotor's speed (Faessler 2017), by D^3"


def _few(value: float) -> str:
    return repr(float(f"{value:.4g}"))


def _list(*values: float) -> str:
    return f"[{', '.join(_few(value + 0.0) for value in values)}]"
