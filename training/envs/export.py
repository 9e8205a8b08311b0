"""Makes a policy file of an actor that another library trained in one of these environments."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import torch

from neuroflight.sim.control.estimator import observed_model
from neuroflight.toolchain.errors import PolicyError, TrainingError
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, import_onnx
from neuroflight.toolchain.policy.model import PolicyModel
from neuroflight.toolchain.verification.original import compare
from neuroflight.training.envs.batch import AttitudeBatch
from neuroflight.training.envs.setup import Setup


class Fractions(torch.nn.Module):
    """An actor between raw observations and motor fractions, as its environment has them."""

    scale: torch.Tensor

    def __init__(self, actor: torch.nn.Module, batch: AttitudeBatch) -> None:
        super().__init__()
        output, self.motors = batch.setup.config.output, batch.setup.aircraft.motor_count
        self.actor, self.gain, self.offset = actor, output.scale, output.offset
        self.low, self.high = max(0.0, self.offset - self.gain), min(1.0, self.offset + self.gain)
        self.register_buffer("scale", torch.from_numpy(batch.scale))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return motor fractions (1, M) of a raw observation (1, n)."""
        action = self.actor(observation * self.scale)
        return torch.clamp(self.gain * action + self.offset, self.low, self.high)


def export_policy(actor: torch.nn.Module, env: object, path: str | Path) -> PolicyModel:
    """Write what `actor` does in `env` as a policy file: raw observations in, motor fractions out.

    actor: a module that gives actions (1, M), the mean of a distribution, of the environment's observations
    (1, n); with everything that its trainer puts between the two, such as a normalizer. env: any of our
    environments, wrapped or not, or a vector of them; it says observation, rate, aircraft, idle, mix and
    filters. Raises PolicyError, one line, on an actor that is no policy; then nothing is written.
    """
    batch = batch_of(env)
    if not isinstance(actor, torch.nn.Module):
        raise PolicyError(
            f"export_policy: the actor is a {type(actor).__name__}, expected a torch.nn.Module that gives "
            f"the mean action of an observation"
        )
    module = Fractions(actor, batch)
    modes = {part: part.training for part in module.modules()}
    observation = torch.zeros(1, len(batch.scale))
    try:
        module.eval()
        _try(module, observation)
        with tempfile.TemporaryDirectory() as folder:
            model = Path(folder) / "actor.onnx"
            try:
                torch.onnx.export(module, (observation,), str(model), verbose=False)
            except Exception as error:
                cause = error.__cause__ or error
                why = " ".join(f"{type(cause).__name__}: {cause}".split())[:200]
                raise PolicyError(
                    "export_policy: torch cannot export the actor; give the layers that make the mean action "
                    f"alone, without a distribution: {why}"
                ) from None
            policy, _ = import_onnx(model, Path(path), _claims(batch.setup), clip=False, prove=compare)
    finally:
        for part, training in modes.items():
            part.training = training
    return policy


def _try(module: Fractions, observation: torch.Tensor) -> None:
    """Raise PolicyError where the actor takes no observation or gives no action: torch says so in pages."""
    inputs, motors = observation.shape[1], module.motors
    try:
        with torch.no_grad():
            action = module.actor(observation)
    except Exception as error:
        why = " ".join(str(error).split())[:200]
        raise PolicyError(
            f"export_policy: the actor does not take observations (1, {inputs}) of this environment: {why}"
        ) from None
    if not isinstance(action, torch.Tensor) or action.shape != (1, motors):
        got = tuple(action.shape) if isinstance(action, torch.Tensor) else f"a {type(action).__name__}"
        raise PolicyError(
            f"export_policy: the actor gives {got}, expected the mean action (1, {motors}): the layers that "
            f"make it, not a whole policy"
        )


def _claims(setup: Setup) -> PolicyClaims:
    aircraft, config = setup.aircraft, setup.config
    rate_hz = config.control_rate_hz
    return PolicyClaims(
        observation=config.observation,
        control_rate_hz=rate_hz,
        filters=json.dumps(config.gyro_filters.chain),
        aircraft=aircraft.name,
        aircraft_sha256=aircraft.sha256,
        motors=aircraft.motor_count,
        idle=config.idle,
        mix=config.mixing,
        model=observed_model(aircraft, config.blocks(), rate_hz),
    )


def batch_of(env: Any) -> AttitudeBatch:  # noqa: ANN401
    """Return the batch that an environment, or the first one of a vector of them, is a view of.

    Raises TrainingError on another environment, or on one in another process.
    """
    found = getattr(env, "unwrapped", env)
    if getattr(found, "envs", None):  # of DummyVecEnv and SyncVectorEnv
        found = found.envs[0].unwrapped
    batch = getattr(found, "batch", None)
    if not isinstance(batch, AttitudeBatch):
        raise TrainingError(
            f"export_policy: {type(found).__name__} is no environment of ours in this process; give one that "
            f"was made with the same arguments, such as gymnasium.make('neuroflight/Attitude-v0')"
        )
    return batch
