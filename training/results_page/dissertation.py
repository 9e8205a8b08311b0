"""The figures that Koch 2019 printed, for the rows beside ours on the page of results; rates in deg/s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Axes = tuple[float, float, float]  # roll, pitch, yaw
Known = tuple[float | None, float | None, float | None]  # None: nothing to average


@dataclass(frozen=True)
class Difference:
    """A controller's figure minus another's on the same commands."""

    value: float
    margin: float  # half width of its 95 % confidence interval
    significant: bool  # whether the interval excludes zero


@dataclass(frozen=True)
class Row:
    """One controller on one task; unknown figures are missing or None."""

    label: str
    episodes: int
    tracking: Mapping[str, Axes] = field(default_factory=dict)  # mae, mse and the sums
    mae_margin: Axes | None = None
    output: float | None = None
    change: float | None = None
    smoothness: float | None = None  # Sm
    response: Mapping[str, Known] = field(default_factory=dict)
    in_band: Mapping[str, float] = field(default_factory=dict)  # % of time or commands, over all axes
    against: str = ""  # label of the row that is subtracted
    difference: Mapping[str, Difference] = field(default_factory=dict)
    printed: bool = False  # from the dissertation, with its digits


@dataclass(frozen=True)
class Timing:
    """Durations on the dissertation's board, a MATEKF722 at 216 MHz."""

    label: str
    work: str  # as `neuroflight timing` names it
    worst_us: float
    best_us: float


# Koch 2019, chapter 4: the policy is one of 6-32-32-4.
PRINTED_TIMING = (
    Timing("dissertation, policy 6-32-32-4, armed", "control algorithm", 210, 195),
    Timing("dissertation, Betaflight's PID", "control algorithm", 15, 9),
    Timing("dissertation, policy 6-32-32-4, armed", "control task", 423, 263),
    Timing("dissertation, policy 6-32-32-4, disarmed", "control task", 244, 229),
    Timing("dissertation, Betaflight", "control task", 238, 78),
)
# Koch 2019, chapter 5: the NF1 in simulation, 100 unseen pulses.
PRINTED_PULSES = (
    Row(
        "dissertation, policy",
        100,
        {
            "mae": (3, 2, 2),
            "mse": (148, 135, 66),
            "iae": (3311, 2235, 2075),
            "ise": (148_804, 135_805, 66_807),
            "itae": (6233, 4033, 3435),
            "itse": (237_168, 211_846, 95_983),
        },
        output=0.12,
        change=0.02,
        printed=True,
    ),
    Row(
        "dissertation, PID",
        100,
        {
            "mae": (4, 4, 3),
            "mse": (414, 492, 199),
            "iae": (4773, 4941, 3829),
            "ise": (414_216, 493_033, 199_662),
            "itae": (7680, 7937, 6574),
            "itse": (608_092, 712_863, 300_222),
        },
        output=0.03,
        change=0.04,
        printed=True,
    ),
)


def _episodic(label: str, success: Axes, rise: Axes, peak: Axes, error: Axes) -> Row:
    response: dict[str, Known] = {"success": success, "rise_ms": rise, "peak": peak, "error": error}
    return Row(f"dissertation, {label}", 1000, response=response, printed=True)


# Koch 2019, chapter 3: the Iris, best of three agents; m observations are remembered.
PRINTED_EPISODIC = (
    _episodic(
        "PPO, m = 1", (99.8, 100, 100), (66.6, 70.8, 72.9), (112.6, 109.4, 127.0), (317.0, 326.3, 217.5)
    ),
    _episodic(
        "PPO, m = 2", (100, 53.3, 99.8), (64.4, 102.8, 148.2), (118.4, 104.2, 124.2), (329.4, 815.3, 320.6)
    ),
    _episodic(
        "PPO, m = 3", (98.7, 74.7, 99.3), (97.9, 121.9, 79.5), (111.4, 111.1, 120.8), (396.7, 540.6, 237.1)
    ),
    _episodic(
        "TRPO, m = 1",
        (32.8, 59.0, 87.4),
        (119.9, 149.0, 103.9),
        (103.0, 117.4, 142.8),
        (1965, 930.5, 713.7),
    ),
    _episodic(
        "DDPG, m = 1", (84.1, 52.5, 90.4), (64.7, 118.9, 51.0), (165.6, 135.4, 150.8), (929.1, 1490, 485.3)
    ),
    _episodic("PID", (100, 100, 100), (79.0, 99.8, 67.7), (136.9, 112.7, 135.1), (416.1, 269.6, 245.1)),
)
# Koch 2019, chapter 5: the NF1, share of time in the band, without saying of which axes.
PRINTED_ENVELOPE = (
    Row("dissertation, policy", 1000, in_band={"in_band_500": 72, "in_band_750": 76}, printed=True),
    Row("dissertation, PID", 1000, in_band={"in_band_500": 16, "in_band_750": 29}, printed=True),
)
# Koch 2019, chapter 5: largest drift of a link [mm] by step [ms], maximal coordinates; reduced ones had none.
PRINTED_DRIFT_MM = {2.0: 95.0, 1.0: 39.0, 0.5: 10.0}
PRINTED_AIRCRAFT = {"pulse": "nf1", "episodic": "iris", "envelope": "nf1"}
PRINTED = {"pulse": PRINTED_PULSES, "episodic": PRINTED_EPISODIC, "envelope": PRINTED_ENVELOPE}
