"""Options of `neuroflight aircraft` that choose a part of a log."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from neuroflight.cli.log.reading import add_part_arguments, part
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.recording import Choice

FORMS = (
    "a blackbox log (.BBL, .BFL, .TXT; FILE:N is log N of it), what `log decode` or blackbox_decode make of "
    "it or the Blackbox Explorer exports (.npz, .csv), a trace (.npz), or a .csv with columns t_s, "
    "gyro_x_deg_s, gyro_y_deg_s, gyro_z_deg_s (and acc_x_m_s2, acc_y_m_s2, acc_z_m_s2)"
)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options --log, --from, --to and --gyro-unit."""
    parser.add_argument(
        "--log",
        dest="number",
        type=int,
        metavar="N",
        help="which log of a blackbox file, from 1; default: the last that has frames",
    )
    add_part_arguments(parser, "the log's first sample")
    parser.add_argument(
        "--gyro-unit",
        type=float,
        metavar="DEG_S",
        help="one count of gyroADC in a table that came without the log's header: its gyro_scale, a tenth of "
        "it with blackbox_high_resolution",
    )


def choice(args: argparse.Namespace) -> Choice:
    """Return the choice that the options make. Raises NeuroflightError for a unit that is not above 0."""
    from neuroflight.sim.identification.recording import Choice

    unit = args.gyro_unit
    if unit is not None and not (math.isfinite(unit) and unit > 0.0):
        raise NeuroflightError(f"--gyro-unit {unit}, expected a number above 0")
    return Choice(args.number, part(args), unit)
