"""The exceptions of the project: one small tree, one line each for the person who reads them."""

from __future__ import annotations


class NeuroflightError(Exception):
    """A mistake of the world or the user; the message says what, got, expected and how to mend.

    The command line prints the message as one line and exits with status 1. Our own mistakes are
    ordinary Python exceptions and keep their traceback.
    """


class AircraftError(NeuroflightError):
    """An aircraft file that is missing, malformed or physically impossible."""


class PolicyError(NeuroflightError):
    """A policy (checkpoint or ONNX) that is damaged, unsupported or does not fit the build."""


class BuildError(NeuroflightError):
    """A firmware build that cannot go on: unknown target, missing compiler, image too large."""


class WiringError(NeuroflightError):
    """A board that the firmware cannot fly, or a description of one that cannot be read."""


class ImageError(NeuroflightError):
    """A file that holds no image for the board, or a damaged one."""


class LinkError(NeuroflightError):
    """A port (socket or serial) that nobody answers on, or that answers with nonsense."""


class ScenarioError(NeuroflightError):
    """A scenario that is unknown, malformed or asks for what the sticks cannot express."""


class TrainingError(NeuroflightError):
    """A training configuration that cannot be run."""


class InUseError(NeuroflightError):
    """A resource that another process is using."""


class TraceError(NeuroflightError):
    """A recorded flight that is damaged or not one."""


class DynoError(NeuroflightError):
    """A recording of a bench that is damaged or does not show what is asked of it."""


class CardError(NeuroflightError):
    """A card for logs that cannot be used as it is, or a place that is none."""
