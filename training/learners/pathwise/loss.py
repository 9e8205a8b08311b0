"""The parts of the loss of a batch of flights, and their weights."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Weights:
    """Weights of the parts of the loss; that of the mean absolute error [deg/s] is 1."""

    square: float  # [s/deg], of the mean squared error
    output: float  # [deg/s], of the mean output
    change: float  # [deg/s], of the mean absolute change of outputs or motors
    closed: float = 0.0  # [deg/s], of the mean motor fraction at closed throttle


@dataclass(frozen=True)
class LossFigures:
    """Weighted means over the control steps of a batch, and over axes or motors."""

    mae: float  # [deg/s]
    mse: float  # [deg^2/s^2]
    output: float
    change: float  # of outputs in a control step, or of motors in 1 ms
    closed: float = 0.0  # motor fraction above the idle

    def error(self, square: float) -> float:
        """Return the part of the loss that is the error's [deg/s]; square: see Weights."""
        return self.mae + square * self.mse

    def loss(self, weights: Weights) -> float:
        """Return the loss [deg/s]."""
        return (
            self.error(weights.square)
            + weights.output * self.output
            + weights.change * self.change
            + weights.closed * self.closed
        )
