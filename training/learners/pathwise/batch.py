"""The episodes of an update: what is drawn for them, and their shares in the means of the loss."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.sim.control.told import told
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.policy.specialize import REFERENCE
from neuroflight.training.config.any_aircraft import difficulty, draw_aircraft
from neuroflight.training.config.pathwise_config import BLOCK, PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.tasks.random_steps import RandomStepsTask, StepWeights

KNOT_S = 0.15  # in which the air around a tumbling aircraft changes
CALM = 0.3  # of the aircraft
LEAST = 0.03  # of the largest standard deviation
YAW = 0.2  # of the standard deviation in roll and pitch: the drag of rotors above the centre of mass tilts
WASH_HZ = (3.3, 80.0)  # of prop wash, sim/physics/air.py: half power, of propellers of 5 inches
WASH_YAW = 0.1  # of the standard deviation in roll and pitch: drag torques have short levers
WASHED = 0.5  # of the aircraft
STILL = 0.6  # of the aircraft that are drawn: their gyro is shaken as in the run's file
WASH_BEGUN_S = 0.3  # before the episode: some times the memory of the band-pass


@dataclass(frozen=True, eq=False)
class Batch:
    """Episodes of T control steps for B aircraft."""

    setpoint: Array32  # (B, T, 3) [rad/s]
    step_weights: StepWeights  # (B, T), weight of each control step
    throttle: Array32  # (B, T), the pilot's thrust
    variation: Variation  # of the B aircraft
    seed: int  # of the noise
    disturbance: Array32 | None = None  # (B, T, 3) [rad/s^2], by moments from outside at the file's inertia
    # Of each BLOCK of the B, what is told of them; none: all are the run's.
    told: tuple[Aircraft, ...] = ()

    def shares(self) -> list[Array32]:
        """Return the shares (B, T) of the control steps in the means.

        Of the absolute error, of the squared error, of output and change, and of the motors at closed
        throttle.
        """
        weights = self.step_weights
        closed = weights.effort * (self.throttle == 0.0)
        return [
            (part / max(float(part.sum()), 1.0)).astype(np.float32)
            for part in (weights.error, weights.square, weights.effort, closed)
        ]


def draw_batch(
    config: TrainingConfig, pathwise: PathwiseConfig, aircraft: Aircraft, rng: np.random.Generator
) -> Batch:
    """Draw the episodes of an update. aircraft: the run's."""
    count = pathwise.aircraft
    task, world, rate_hz = config.task, config.world, config.control_rate_hz
    if isinstance(task, RandomStepsTask):
        setpoint, step_weights = task.batch(count, rng, rate_hz)
    else:
        setpoint = task.episodes(count, rng, rate_hz)
        step_weights = StepWeights.equal(*setpoint.shape[:2])
    batch = Batch(
        setpoint=setpoint,
        step_weights=step_weights,
        throttle=world.draw_throttles(count, setpoint.shape[1], rate_hz, rng),
        variation=world.randomization.draw_near(count, rng, aircraft.propulsion.delay),
        seed=int(rng.integers(2**63)),
        disturbance=_moments(pathwise, setpoint.shape[1], rate_hz, rng),
    )
    return _of_any(config, batch, aircraft, rng) if world.aircraft == "any" else batch


def _of_any(config: TrainingConfig, batch: Batch, base: Aircraft, rng: np.random.Generator) -> Batch:
    """Return the batch flown by aircraft that are drawn, one for each BLOCK.

    Errors count in parts of what the aircraft cannot avoid, and moments from outside turn a large one less.
    """
    count = len(batch.setpoint)
    drawn = tuple(draw_aircraft(base, rng) for _ in range(-(-count // BLOCK)))
    delays = [aircraft.propulsion.delay for aircraft in drawn for _ in range(BLOCK)][:count]
    known = [told(aircraft) for aircraft in drawn]
    hard = np.repeat([difficulty(each) for each in known], BLOCK)[:count, None]
    strong = [each.authority[0] / REFERENCE.authority[0] for each in known]
    weights, shaken = batch.step_weights, batch.disturbance
    variation = config.world.randomization.draw_near(count, rng, np.array(delays))
    still = np.repeat(rng.random(len(drawn)) < STILL, BLOCK)[:count]
    variation = replace(variation, vibration=np.where(still, np.nan, variation.vibration))
    if shaken is not None:
        shaken = shaken * np.repeat(np.clip(strong, 0.15, 2.5), BLOCK)[:count, None, None].astype(np.float32)
    return replace(
        batch,
        step_weights=replace(weights, error=weights.error / hard, square=weights.square / hard),
        variation=variation,
        disturbance=shaken,
        told=drawn,
    )


def _moments(pathwise: PathwiseConfig, steps: int, rate_hz: int, rng: np.random.Generator) -> Array32 | None:
    """See Batch.disturbance."""
    count, sums = pathwise.aircraft, None
    if pathwise.disturbance:
        sums = disturbances(count, steps, rate_hz, pathwise.disturbance, rng)
    if pathwise.wash:
        shaken = washes(count, steps, rate_hz, pathwise.wash, rng)
        sums = shaken if sums is None else sums + shaken
    return sums


def disturbances(count: int, steps: int, rate_hz: int, largest: float, rng: np.random.Generator) -> Array32:
    """Draw angular accelerations (count, steps, 3) [rad/s^2] that no rotor makes, as drag in fast air does.

    Straight lines between values that are drawn every KNOT_S. Their standard deviation is drawn log-uniformly
    up to `largest`; CALM of the aircraft have none.
    """
    knots = math.ceil(steps / rate_hz / KNOT_S) + 1
    sigma = largest * LEAST ** rng.random(count) * (rng.random(count) >= CALM)
    values = rng.standard_normal((count, knots, 3)) + rng.standard_normal((count, 1, 3))
    values = values * sigma[:, None, None] * (1.0, 1.0, YAW)
    at = np.arange(steps) / rate_hz / KNOT_S
    before = at.astype(np.intp)
    part = (at - before)[:, None]
    lines = (1.0 - part) * values[:, before] + part * values[:, before + 1]
    return lines.astype(np.float32)


def washes(count: int, steps: int, rate_hz: int, largest: float, rng: np.random.Generator) -> Array32:
    """Draw angular accelerations (count, steps, 3) [rad/s^2] with the spectrum of an aircraft's own prop
    wash.

    The standard deviation of WASHED of the aircraft is drawn up to `largest`; the others have none.
    """
    begun = round(WASH_BEGUN_S * rate_hz)
    sigma = largest * rng.random(count) * (rng.random(count) < WASHED)
    above, below = butter(1, WASH_HZ, "bandpass", fs=rate_hz)
    white = rng.standard_normal((count, begun + steps, 3))
    band = lfilter(above, below, white, axis=1)[:, begun:]
    unit = math.sqrt(rate_hz / (math.pi * (WASH_HZ[1] - WASH_HZ[0])))  # of white noise through such a band
    shaken: Array32 = (band * (unit * sigma[:, None, None] * (1.0, 1.0, WASH_YAW))).astype(np.float32)
    return shaken
