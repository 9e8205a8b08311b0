"""Plot of the spectra of motor outputs, of one controller or of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes

from neuroflight.sim.analysis.spectrum import Spectrum
from neuroflight.sim.plotting import MOTOR_COLOURS, dress, plain_numbers

PERCENT_MIN = 1e-4  # what is drawn of the amplitudes' scale [% of full command]


@dataclass(frozen=True)
class Line:
    """A controller's spectrum."""

    name: str
    spectrum: Spectrum
    smoothness: float  # its Sm


def draw_spectra(panel: Axes, lines: Sequence[Line]) -> None:
    """Draw the amplitude of one component over its frequency, both logarithmic; the first line in front."""
    for number, line in enumerate(lines):
        panel.plot(
            line.spectrum.frequency_hz,
            100 * line.spectrum.amplitude,
            color=MOTOR_COLOURS[number % len(MOTOR_COLOURS)],
            lw=1.7,
            label=f"{line.name}, Sm {1e6 * line.smoothness:.1f}e-6",
            zorder=2 + len(lines) - number,
        )
    panel.set_xscale("log")
    panel.set_yscale("log")
    for axis in (panel.xaxis, panel.yaxis):
        plain_numbers(axis)
    least = min((float(line.spectrum.amplitude.min(initial=1.0)) for line in lines), default=1.0)
    panel.set_ylim(bottom=max(PERCENT_MIN, 50 * least))
    dress(panel, "spectrum of the motors", "frequency, Hz", "amplitude, % of full")
    panel.legend(loc="lower left", frameon=False, fontsize=9, handlelength=1.6)
