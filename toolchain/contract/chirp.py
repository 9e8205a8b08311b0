"""The chirp: a swept sine on the setpoint of one axis; the ecosystem's tools make Bode plots of its log."""

from __future__ import annotations

# Above CHIRP_LAG_HZ the amplitude falls with the frequency, to a tenth from CHIRP_LEAD_HZ on, because an
# aircraft follows fast commands less and the motors must not saturate. These are the ecosystem's defaults.
CHIRP_LAG_HZ, CHIRP_LEAD_HZ = 3.0, 30.0
# The error of a loop that is stable by the usual margins is at most twice what excites it (its sensitivity).
# Only a larger one counts as an oscillation on the axis that the chirp excites.
CHIRP_ERROR_FACTOR = 2.0
CHIRP_FADE_MS = 200  # time constant with which an excitation fades
CHIRP_RATE_PART = 0.4  # of the control rate: no frequency is above it
