"""The file of an aircraft as it is: one part with its mass and moments, every number written out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import RPM, Aircraft, FirstOrderResponse, Propulsion

SPINS = {1: "ccw", -1: "cw"}


def truth_text(name: str, told: Aircraft, mass: MassProperties, drive: Propulsion) -> str:
    """Return an aircraft file with the rotors' places, gyro, battery and body of `told`.

    mass, drive: of the aircraft as it is; its rotors answer with a first-order lag.
    """
    response = drive.response
    assert isinstance(response, FirstOrderResponse)
    inertia = mass.inertia
    moments = (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2])
    gyro, battery, body = told.gyro, told.battery, told.body
    lines = [
        "format = 1",
        f'name = "{name}"',
        f"centre_of_thrust_m = {_row(told.centre_of_thrust)}",
        "",
        "[[part]]",
        'name = "all of it"',
        f"mass_kg = {mass.mass:.6g}",
        "position_m = [0.0, 0.0, 0.0]",
        f"centre_of_mass_m = {_row(mass.centre)}",
        f"inertia_kg_m2 = {_row(moments)}",
    ]
    for rotor in told.rotors:
        lines += ["", "[[rotor]]", f"propeller_m = {_row(rotor.position)}", f'spin = "{SPINS[rotor.spin]}"']
    lines += [
        "",
        "[propulsion]",
        f"speed_curve_rpm = {_row(np.array(drive.speed_curve) / RPM)}",
        f"thrust_coefficient = {_row(drive.thrust_coefficient)}",
        f"torque_ratio_m = {_row(drive.torque_ratio)}",
        f"rotor_inertia_kg_m2 = {drive.rotor_inertia:.6g}",
        f"drag_coefficient = {drive.drag_coefficient:.6g}",
        f"rolling_coefficient = {drive.rolling_coefficient:.6g}",
        f"delay_s = {drive.delay:.6g}",
        f"efficiency = {drive.efficiency:.6g}",
    ]
    if drive.supply_voltage is not None:
        lines.append(f"supply_voltage_v = {drive.supply_voltage:.6g}")
    if drive.propeller_diameter is not None:
        lines.append(f"propeller_diameter_m = {drive.propeller_diameter:.6g}")
    lines += [
        "",
        "[propulsion.response]",
        'kind = "first_order"',
        f"time_constant_up_s = {response.time_constant_up:.6g}",
        f"time_constant_down_s = {response.time_constant_down:.6g}",
        "",
        "[gyro]",
        f"noise_deg_s = {_row(np.rad2deg(gyro.noise))}",
        f"bias_deg_s = {np.rad2deg(gyro.bias):.6g}",
        f"vibration_deg_s = {_row(np.rad2deg(gyro.vibration))}",
    ]
    if battery is not None:
        lines += [
            "",
            "[battery]",
            f"cells = {battery.cells}",
            f"capacity_ah = {battery.capacity / 3600:.6g}",
            f"rest_voltage_v = {battery.rest_voltage:.6g}",
            f"resistance_ohm = {battery.resistance:.6g}",
            f"electronics_w = {battery.electronics_power:.6g}",
        ]
    if body is not None:
        lines += [
            "",
            "[body]",
            f"size_m = {_row(body.size)}",
            f"centre_m = {_row(body.centre)}",
            f"drag_area_m2 = {_row(body.drag_area)}",
        ]
    return "\n".join(lines) + "\n"


def _row(values: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"[{', '.join(f'{float(value):.6g}' for value in values)}]"
