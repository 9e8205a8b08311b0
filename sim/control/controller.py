"""Rate controllers in Python: the protocol, and a policy.onnx as one."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.motors import throttle_mix
from neuroflight.sim.control.observation import Observer
from neuroflight.toolchain.contract import ESC_BLOCKS, hears_rotors
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.model import PolicyModel

SENSED = ESC_BLOCKS | {"gravity"}  # blocks that no step of a Controller is given


class Controller(Protocol):
    """N rate controllers of aircraft with M motors, stepped together at the control rate."""

    def reset(self) -> None:
        """Clear all state, as when the firmware arms."""
        ...

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """Compute outputs y (N, M), fractions 0..1 before the throttle mix.

        setpoint, gyro: (N, 3) [rad/s], body axes; throttle: (N,), 0..1.
        """
        ...


class PolicyController:
    """N copies of a policy."""

    def __init__(
        self,
        policy: PolicyModel,
        count: int = 1,
        *,
        exact: bool = True,
        idle: float | None = None,
        standing: bool = False,
    ) -> None:
        """policy: stepped at its `control_rate_hz`, behind its `filters`.

        exact: with the roundings of the compiled C; see `toolchain.ir.interpreter`. idle: flown with this
        one, None: the policy's own. standing: the ground holds the aircraft all the time; the firmware knows.
        """
        self._network, _ = optimize(policy.network)
        self._state = clear_state(self._network, count)
        self._exact = exact
        self._everyone = np.arange(count)
        self._mix = policy.mix
        self._observer = Observer(
            policy.blocks,
            count,
            policy.action_count,
            policy.control_rate_hz,
            model=policy.model,
            idle=policy.idle if idle is None else idle,
            standing=standing,
        )
        self._action = np.zeros((count, policy.action_count), np.float32)
        self._sensed: dict[str, Array32] = {}
        self.senses = self._observer.names & SENSED  # which of them each step needs
        self.hears_rotors = hears_rotors(policy.blocks)

    def reset(self) -> None:
        """Clear all state: deltas, the previous action and recurrent state of the next step are zero."""
        self._observer.reset(self._everyone)
        self._action[:] = 0.0
        self._state = clear_state(self._network, len(self._everyone))

    def sense(self, rotor_speed: Array32, rotation: Array) -> None:
        """Set rotor speeds and attitude that the next step may observe.

        rotor_speed: (N, M) [rad/s], as ESCs tell it; rotation: (N, 3, 3), matrices from body to world.
        """
        self._sensed = {
            "rotor_speed": rotor_speed,
            "gravity": -rotation[:, 2].astype(np.float32),
        }

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """See Controller."""
        observation = self._observer.observe(
            slice(None), setpoint, gyro, self._action, throttle, **self._sensed
        )
        self._action, self._state = advance(self._network, observation, self._state, exact=self._exact)
        self._observer.commanded(slice(None), throttle_mix(self._action, throttle, self._mix), throttle)
        return self._action
