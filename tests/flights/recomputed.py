"""What compare's controller makes of a recorded flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.control.motors import dshot_values, throttle_mix
from neuroflight.sim.flight.trace import Trace
from neuroflight.training.evaluation.controllers import ControllerSpec


def recomputed(trace: Trace, spec: ControllerSpec) -> NDArray[np.uint16]:
    """Return the DShot values of `spec` for the setpoints, gyro and throttle that the firmware had."""
    controller = spec.build(1)
    controller.reset()
    return np.concatenate(
        [
            dshot_values(throttle_mix(controller.step(s[None], g[None], t), t, spec.mix), spec.idle)
            for s, g, t in zip(trace.setpoint, trace.gyro, trace.throttle[:, None], strict=True)
        ]
    )
