"""Training of policies. Importing this registers `neuroflight/Attitude-v0` with Gymnasium."""

import neuroflight

__all__ = ["neuroflight"]
