"""The loss of a flight and its derivatives by rates and actions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.learners.pathwise.flight import Batch, Flight

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Weights:
    """Weights of the parts of the loss; that of the mean absolute error [deg/s] is 1."""

    square: float  # [s/deg], of the mean squared error
    output: float  # [deg/s], of the mean output
    change: float  # [deg/s], of the outputs' mean absolute change in a control step


@dataclass(frozen=True)
class Figures:
    """Weighted means over the control steps of a batch, and over axes or motors."""

    mae: float  # [deg/s]
    mse: float  # [deg^2/s^2]
    output: float
    change: float

    def loss(self, weights: Weights) -> float:
        """The loss [deg/s]."""
        return (
            self.mae + weights.square * self.mse + weights.output * self.output + weights.change * self.change
        )


@dataclass(frozen=True, eq=False)
class FlightGradient:
    """Derivatives of a loss by the rates and actions of a flight."""

    rate: Array  # (T, B, 3) [s/rad deg/s]
    action: Array  # (T, B, M) [deg/s]


def figures_and_gradient(flight: Flight, batch: Batch, weights: Weights) -> tuple[Figures, FlightGradient]:
    """Figures of a flight against the true rate, and the derivatives of its loss."""
    motors = flight.action.shape[2]
    error = np.rad2deg(batch.setpoint - flight.rate)
    action = flight.action.astype(np.float64)
    change = np.diff(action, axis=0)

    def share(counts: Array, parts: int) -> Array:
        """The share of each of `parts` axes or motors in a mean, (T, B, 1)."""
        shares: Array = counts.T[:, :, None] / max(counts.sum() * parts, 1.0)
        return shares

    absolute, square = share(batch.step_weights.error, 3), share(batch.step_weights.square, 3)
    a_motor = share(batch.step_weights.effort, motors)
    figures = Figures(
        mae=float((absolute * np.abs(error)).sum()),
        mse=float((square * np.square(error)).sum()),
        output=float((a_motor * action).sum()),
        change=float((a_motor[1:] * np.abs(change)).sum()),
    )
    by_rate = -np.rad2deg(1.0) * (absolute * np.sign(error) + 2.0 * weights.square * square * error)
    by_action = np.repeat(weights.output * a_motor, motors, axis=2)
    by_change = weights.change * a_motor[1:] * np.sign(change)
    by_action[1:] += by_change
    by_action[:-1] -= by_change
    return figures, FlightGradient(by_rate, by_action)
