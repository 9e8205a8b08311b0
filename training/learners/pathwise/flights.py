"""Flies a batch of episodes in C and finds its gradient: blocks of aircraft on every core.

The aircraft of a block fly side by side. Each block has a gradient of its own, and these are summed
in their order. So the result does not depend on how many cores there are.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.physics.rotor import response_rows
from neuroflight.training.learners.network.library import aligned, load, pointer
from neuroflight.training.learners.pathwise.batch import Batch
from neuroflight.training.learners.pathwise.loss import LossFigures, Weights
from neuroflight.training.learners.pathwise.plan import Surroundings

Floats = NDArray[np.floating]
LANES = 16  # aircraft of a block, as api.h says


@dataclass(frozen=True, eq=False)
class Record:
    """The record of flights: T control steps, N gyro samples, B aircraft with M motors."""

    rate: Floats  # (N, 3, B) [rad/s]
    rotor_speed: Floats  # (N, M, B) [rad/s]
    observation: Floats  # (T, n, B), as the network gets it
    motors: Floats  # (T, M, B), fractions after mix and idle


class Flights:
    """A pool of threads that fly batches of one kind; `close` when done."""

    def __init__(
        self, surroundings: Surroundings, *, workers: int | None = None, number: str = "float32"
    ) -> None:
        """workers: threads, as many as cores unless given; number: float32, or float64 for tests."""
        self._surroundings = surroundings
        self._number = number
        self._library = load("pathwise", number)
        self._workers = workers or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._workers)
        self._memories: SimpleQueue[tuple[Floats, Floats]] = SimpleQueue()
        self._memory_size = 0

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def gradient(self, batch: Batch, parameters: Floats, weights: Weights) -> tuple[LossFigures, Floats]:
        """Compute figures of the batch's flights, and the loss's derivatives by the parameters."""
        own = [self._surroundings] * -(-len(batch.setpoint) // LANES)
        figures, gradients = self.gradients(batch, own, [parameters] * len(own), weights)
        total = gradients[0]
        for gradient in gradients[1:]:
            total += gradient
        return figures, total

    def gradients(
        self, batch: Batch, flown: Sequence[Surroundings], parameters: Sequence[Floats], weights: Weights
    ) -> tuple[LossFigures, list[Floats]]:
        """Compute figures of the batch's flights, and the loss's derivatives by each block's parameters.

        flown, parameters: of each block of LANES flights. What surrounds their networks differs by no more
        than the aircraft and its model.
        """
        figures, gradients, _ = self._fly(batch, flown, parameters, weights, wanted=True, recorded=False)
        return figures, gradients

    def record(self, batch: Batch, parameters: Floats, weights: Weights) -> tuple[LossFigures, Record]:
        """Compute figures of the batch's flights, and return the flights."""
        own = [self._surroundings] * -(-len(batch.setpoint) // LANES)
        given = [parameters] * len(own)
        figures, _, records = self._fly(batch, own, given, weights, wanted=False, recorded=True)
        count = len(batch.setpoint)
        columns = [np.concatenate(parts, axis=2)[:, :, :count] for parts in zip(*records, strict=True)]
        return figures, Record(*columns)

    def _fly(
        self,
        batch: Batch,
        flown: Sequence[Surroundings],
        parameters: Sequence[Floats],
        weights: Weights,
        *,
        wanted: bool,
        recorded: bool,
    ) -> tuple[LossFigures, list[Floats], list[list[Floats]]]:
        """Return figures, the blocks' gradients if `wanted`, and their records if `recorded`."""
        charged = not np.isnan(batch.variation.charge).all()
        plans = {id(own): own.plan(weights, charged, self._number) for own in flown}
        self._prepare(plans[id(flown[0])])
        shares = batch.shares()

        def fly(block: int) -> tuple[NDArray[np.float64], Floats | None, list[Floats]]:
            given = np.ascontiguousarray(parameters[block], self._number)
            found = np.zeros(len(given), self._number) if wanted else None
            record = self._record_arrays() if recorded else []
            figures = np.zeros(5)
            memory = self._memories.get()
            try:
                arrays = self._block(batch, flown[block], shares, block, memory[1])
                made = self._library.ffi.new("struct block *")
                arrays |= {"parameters": given, "gradient": found, "figures": figures}
                arrays |= dict(zip(("rate", "rotor_speed", "observation", "motors"), record, strict=False))
                for name, array in arrays.items():
                    setattr(made, name, pointer(array))
                self._library.lib.flight_run(plans[id(flown[block])], made, pointer(memory[0]))
            finally:
                self._memories.put(memory)
            return figures, found, record

        results = list(self._pool.map(fly, range(len(flown))))
        figures = results[0][0]
        for own, _, _ in results[1:]:
            figures = figures + own
        gradients = [found for _, found, _ in results if found is not None]
        return LossFigures(*figures.tolist()), gradients, [record for _, _, record in results]

    def _prepare(self, plan: Any) -> None:  # noqa: ANN401 - a struct of cffi
        """Allocate as much memory for each worker as the plan needs."""
        size = self._library.lib.flight_memory(plan)
        if size <= self._memory_size:
            return
        self._memory_size = size
        self._memories = SimpleQueue()
        samples = (plan.steps - 1) * plan.samples + 1
        for _ in range(self._workers):
            noise = np.zeros((samples, 3, LANES), self._number)
            self._memories.put((aligned(size, self._number), noise))

    def _block(
        self, batch: Batch, surroundings: Surroundings, shares: Sequence[Floats], block: int, noise: Floats
    ) -> dict[str, NDArray[Any] | None]:
        """Return the arrays of a block. Lanes without an aircraft repeat the first one, without weight."""
        aircraft = surroundings.aircraft
        index = np.arange(block * LANES, (block + 1) * LANES)
        real = index < len(batch.setpoint)
        index = np.where(real, index, 0)
        variation = batch.variation.at(index)
        charge = np.where(np.isnan(variation.charge), -1.0, variation.charge)
        lift, light = variation.thrust / variation.inertia, 1.0 / variation.inertia
        rng = np.random.Generator(np.random.SFC64([batch.seed, block]))
        phase = rng.uniform(-0.5, 0.5, (aircraft.motor_count, LANES))
        self._draw_noise(variation.noise, rng, noise)
        weights = (np.where(real, share[index].T, 0.0) for share in shares)
        rows = {
            "response": response_rows(aircraft.propulsion, surroundings.dt, variation.lag).T,
            "speed": variation.speeds(aircraft.motor_count).T,
            "lift": lift,
            "drag": lift * variation.torque,
            "light": light,
            "load": variation.thrust * variation.torque,
            "charge": charge,
            "shake": np.where(
                np.isnan(variation.vibration), max(aircraft.gyro.vibration), variation.vibration
            ),
            "phase": phase,
            "setpoint": batch.setpoint[index].transpose(1, 2, 0),
            "throttle": batch.throttle[index].T,
            **dict(zip(("absolute", "squared", "effort", "closed"), weights, strict=True)),
        }
        if batch.disturbance is not None:
            inertia = aircraft.mass_properties.inertia
            rows["disturbance"] = (batch.disturbance[index] @ inertia.T).transpose(1, 2, 0)
        arrays: dict[str, NDArray[Any] | None] = {
            name: np.ascontiguousarray(row, self._number) for name, row in rows.items()
        }
        delay = np.maximum(1, np.rint(variation.delay_s / surroundings.dt))
        return arrays | {"delay": delay.astype(np.int32), "noise": noise}

    def _draw_noise(self, factor: NDArray[np.float64], rng: np.random.Generator, noise: Floats) -> None:
        """Fill `noise` (N, 3, LANES): white noise and bias of the gyro, by each aircraft's factor."""
        if not self._surroundings.noise:
            noise[:] = 0.0
            return
        gyro = self._surroundings.aircraft.gyro
        bias = rng.normal(0.0, gyro.bias, (3, LANES)) * factor
        rng.standard_normal(out=noise, dtype=np.dtype(self._number).type)
        noise *= (np.array(gyro.noise)[:, None] * factor).astype(self._number)
        noise += bias.astype(self._number)

    def _record_arrays(self) -> list[Floats]:
        """Return empty arrays of a block's Record."""
        own = self._surroundings
        samples, motors = (own.steps - 1) * own.samples + 1, own.aircraft.motor_count
        shapes = (samples, 3), (samples, motors), (own.steps, own.shape.widths[0]), (own.steps, motors)
        return [np.zeros((*shape, LANES), self._number) for shape in shapes]
