"""Options of `neuroflight aircraft` that choose a part of a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import OfPart
from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.sim.identification.recording import Choice

FORMS = (
    "a blackbox log (.BBL, .BFL, .TXT; FILE:N is log N of it), what `log decode` or blackbox_decode make of "
    "it or the Blackbox Explorer exports (.npz, .csv), a trace (.npz), or a .csv with columns t_s, "
    "gyro_x_deg_s, gyro_y_deg_s, gyro_z_deg_s (and acc_x_m_s2, acc_y_m_s2, acc_z_m_s2)"
)


@dataclass(frozen=True, kw_only=True)
class OfGyroLog(OfPart):
    """A request about the gyro's readings in a log."""

    number: Annotated[
        int | None,
        Option("N", "which log of a blackbox file, from 1; default: the last that has frames", name="--log"),
    ] = None
    gyro_unit: Annotated[
        float | None,
        Option(
            "DEG_S",
            "one count of gyroADC in a table that came without the log's header: its gyro_scale, a tenth of "
            "it with blackbox_high_resolution",
            above=0.0,
        ),
    ] = None

    @property
    def choice(self) -> Choice:
        """The log, its part and the unit of its gyro. Raises NeuroflightError for an empty part."""
        from neuroflight.sim.identification.recording import Choice

        return Choice(self.number, self.part, self.gyro_unit)
