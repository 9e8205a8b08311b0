"""The fit: parameters of the twin's equations from flights, all at once, with intervals.

Gauss-Newton on the prediction error of the rates, and of the rotors' speeds where ESCs tell them; the noise's
density and the weights of the blocks are found anew in each round. Intervals come from how much blocks of a
second disagree (a sandwich, neighbours included), not from the noise model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.gyro_path import Complex
from neuroflight.sim.identification.fit.model import (
    LEAKS,
    Layout,
    Loads,
    PieceModel,
    columns,
    gains,
    loads,
    turned,
)
from neuroflight.sim.identification.fit.noise import density, whitener
from neuroflight.toolchain.contract import AXES

ROUNDS_MAX = 20
CLEANED = 1  # times that rates are freed of what is not said of them, each time that a fit has settled
DAMPING_MAX = 100.0  # from which no step is better
ROUGH_ROUNDS = 4  # that take a typical noise
WORSE = 1e-3  # of the squares, that a step may bring
RIDGE = 1e-4  # of instruments that are all but the same, relative
WIDER_MAX = 1e6
LOUDER, SHORTEST = 1.2, 0.1  # of the residual's squares that a step by instruments may make; of its length
MOVED_MAX = 0.2  # standard deviations, of all parameters together, in a round that ends them
BLOCK_S = 0.25  # whose scores are taken for independent, but of neighbours
BURST_S = 0.25  # blocks that are weighted by their power
HEAVY = 1.7  # power over the usual from which one counts less
SETTLE_S = 0.4  # at the start of a piece, where neither rotors' speeds nor the high-pass have settled
HIGHS_HZ = (
    45.0,
    90.0,
)  # above which the equations leave out too much: of a fit, and of the one it is held against
STEP = {"delay_s": 2e-4, "told_late_s": 2e-4}  # of the differences; others:
STEP_ELSE = 0.01
LIMITS = {"bend": (-0.5, 0.95), "delay_s": (0.0, 0.025), "told_late_s": (-0.005, 0.02), "foot": (0.0, 0.5)}


@dataclass(frozen=True)
class Wiring:
    """The rotor of the file that each logged motor drives, and the directions these turn in."""

    order: tuple[int, ...]
    spins: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Data:
    """A piece, and which of its rows count."""

    model: PieceModel
    used: Flags  # (N,)
    size: int  # of its FFT
    path: Complex  # response of the gyro's way at the FFT's frequencies
    high_hz: float  # from where the noise is taken for larger than it is

    def heard(self, said: Array) -> Array:
        """Return rates (N, K) as the logged gyro has them."""
        spectrum = fft.rfft(said, self.size, axis=0) * self.path[:, None]
        return np.asarray(fft.irfft(spectrum, self.size, axis=0)[: len(said)])

    def filtered(self, values: Array, taps: Array, *, heard: bool = False) -> Array:
        """Filter rows (K, N) by `taps` (L,); heard: first as the logged gyro has them."""
        gain = fft.rfft(taps, self.size)
        spectrum = fft.rfft(values, self.size, axis=1) * (gain * self.path if heard else gain)
        return np.asarray(fft.irfft(spectrum, self.size, axis=1)[:, : values.shape[1]])


@dataclass(frozen=True, eq=False)
class Estimate:
    """The end of a fit."""

    theta: Array
    covariance: Array
    cost: float
    frequency: Array  # (F,) [Hz]
    noise: Array  # (F, 3) density of the rates' residual, a sample's variance [(rad/s)^2]
    rounds: int
    blocks: int
    weights: Array  # (3,) mean weight of the blocks
    wider: float = 1.0  # factor of the covariance by all that moved, by which instruments say otherwise


def prepare(
    flights: Sequence[Flight],
    aircraft: Aircraft,
    keep: Callable[[Flight, Array], Flags] | None = None,
    *,
    other: bool = False,
) -> list[Data]:
    """Lay out the pieces of flights; keep: which rows at times (N,) [s] of a flight count, all unless given.

    other: with other weights of low and high frequencies, for a second opinion.
    """
    found = []
    for flight in flights:
        for piece in flight.pieces:
            model = PieceModel(flight, piece, aircraft, LEAKS[other])
            used = piece.flown.copy()
            settle = round(SETTLE_S / piece.step_s)
            for start in [0, *(1 + np.flatnonzero(np.diff(used.astype(int)) > 0))]:
                used[start : start + settle] = False
            if keep is not None:
                times = np.asarray(piece.start_s + np.arange(len(used)) * piece.step_s, np.float64)
                used &= keep(flight, times)
            size = fft.next_fast_len(len(used) + round(2.0 / piece.step_s), real=True)
            frequency = fft.rfftfreq(size, piece.step_s)
            path = np.asarray(flight.path.response(frequency))
            if aircraft.gyro.bandwidth_hz is not None:
                path = path / (1.0 + 1j * frequency / aircraft.gyro.bandwidth_hz)
            found.append(Data(model, used, size, path, HIGHS_HZ[other]))
    return [one for one in found if one.used.any()]


@dataclass(frozen=True, eq=False)
class Seen:
    """The model beside one piece: residual and derivatives."""

    residual: Array  # (N, 3)
    columns: Array  # (3, P, N)
    speed_residual: Array | None  # (N, M)
    speed_columns: Array | None  # (M, P, N)


def say(model: PieceModel, values: dict[str, float], wiring: Wiring) -> tuple[Array, Array, Loads]:
    """Return the gains of rates (K - 1, 3) that the model says, rotor speeds (K, M), and their loads."""
    speeds = model.speeds(values)
    load = loads(model, speeds, np.array(wiring.order), np.array(wiring.spins))
    return gains(model, load, values), speeds, load


def see(data: Data, laid: Layout, theta: Array, wiring: Wiring) -> Seen:
    """Compare a piece with the model at `theta`, with derivatives."""
    model = data.model
    values = laid.values(theta)
    said, speeds, load = say(model, values, wiring)
    course = model.course(said)
    residual = model.measured - data.heard(turned(course, values))
    told = None if model.piece.speed is None else model.told(speeds, values)
    found = np.zeros((3, len(laid.names), len(residual)))
    speed_found = None if told is None else np.zeros((told.shape[1], len(laid.names), len(told)))
    linear = columns(model, load, values)
    for at, name in enumerate(laid.names):
        if name.startswith("turn."):
            axis = np.zeros(3)
            axis[AXES.index(name.removeprefix("turn."))] = 1.0
            found[:, at] = np.cross(course, axis).T
        elif at >= laid.shape:
            found[:, at] = model.course(linear[name]).T * laid.scale(name, values)
        else:
            step = STEP.get(name, STEP_ELSE)
            moved = theta.copy()
            moved[at] += step
            other = laid.values(moved)
            other_speeds = speeds
            if name != "told_late_s":
                changed, other_speeds, _ = say(model, other, wiring)
                found[:, at] = model.course((changed - said) / step).T
            if told is not None and speed_found is not None:
                speed_found[:, at] = ((model.told(other_speeds, other) - told) / step).T
    logged = model.piece.speed
    left = None if told is None or logged is None else logged - told
    return Seen(residual, found, left, speed_found)


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations of a round."""

    matrix: Array  # (P, P) what multiplies the residuals, times their derivatives
    own: Array  # (P, P) the former squared
    scores: Array  # (B, P) of blocks
    cost: float
    frequency: Array
    noise: Array
    weights: Array
    whitened: list[tuple[Array, list[Array]]]  # of each output: filter, and weights (N,) of each piece
    squares: float  # sum of the whitened and weighted residuals' squares
    squares_before: float  # with filters and weights of the round before


def _normal(
    data: Sequence[Data],
    seen: Sequence[Seen],
    before: Normal | None = None,
    *,
    rough_hz: float = 0.0,
    instruments: Sequence[Array] | None = None,
) -> Normal:
    """Whiten and weight the residuals, and sum up their products with the derivatives.

    before: of the round before; rough_hz: take a typical noise of rates, not the residual's; see solve.
    instruments: (3, P, N) of each piece, which take the place of the derivatives that are multiplied.
    """
    count = seen[0].columns.shape[1]
    matrix, own, cost = np.zeros((count, count)), np.zeros((count, count)), 0.0
    scores = [np.zeros((1 + int(len(one.used) * one.model.piece.step_s / BLOCK_S), count)) for one in data]
    noises, weights, frequency = [], [], np.empty(0)
    outputs: list[tuple[bool, int]] = [(False, axis) for axis in range(3)]
    told = [one.speed_residual for one in seen if one.speed_residual is not None]
    if told:
        outputs += [(True, motor) for motor in range(told[0].shape[1])]
    whitened: list[tuple[Array, list[Array]]] = []
    squares = squares_before = 0.0
    for at, (speed, number) in enumerate(outputs):
        parts = [
            (one, look, score, look.speed_residual if speed else look.residual)
            for one, look, score in zip(data, seen, scores, strict=True)
        ]
        known = [(one, look, score, left) for one, look, score, left in parts if left is not None]
        step = known[0][0].model.piece.step_s
        frequency, noise = density(
            [left[:, number] for *_, left in known], [one.used for one, *_ in known], step
        )
        if rough_hz and not speed:
            shape = 1.0 + (rough_hz / np.maximum(frequency, frequency[1])) ** 2
            noise = shape * np.exp(np.log(noise / shape).mean())
        taps = whitener(frequency, noise * (1.0 + (frequency / known[0][0].high_hz) ** 6), step)
        white = [one.filtered(left[:, number][None], taps)[0] for one, _, _, left in known]
        weight = _burst_weights(white, [one.used for one, *_ in known], step)
        if not speed:
            noises.append(noise)
            weights.append(
                np.mean(np.concatenate([w[one.used] for w, (one, *_) in zip(weight, known, strict=True)]))
            )
        whitened.append((taps, weight))
        squares += sum(float(share @ error**2) for share, error in zip(weight, white, strict=True))
        if before is not None:
            old, shares = before.whitened[at]
            for (one, _, _, left), share in zip(known, shares, strict=True):
                squares_before += float(share @ one.filtered(left[:, number][None], old)[0] ** 2)
        rows = sum(int(one.used.sum()) for one, *_ in known)
        # Whittle's likelihood in the band, of the density that the residual itself has.
        band = 1.0 / (1.0 + (frequency / known[0][0].high_hz) ** 6)
        cost += rows * float((band * np.log(noise)).mean())
        for number_of, ((one, look, score, _), error, share) in enumerate(
            zip(known, white, weight, strict=True)
        ):
            sides = look.speed_columns if speed else look.columns
            assert sides is not None
            slopes = sides[number]
            active = np.flatnonzero(slopes.any(axis=1))
            taken = one.filtered(slopes[active], taps, heard=not speed)
            by = taken
            if instruments is not None and not speed:
                by = one.filtered(instruments[number_of][number][active], taps, heard=True)
            scaled = by * share
            matrix[np.ix_(active, active)] += scaled @ taken.T
            own[np.ix_(active, active)] += scaled @ by.T
            products = (scaled * error).T
            edges = np.arange(0, len(products), max(1, round(BLOCK_S / one.model.piece.step_s)))
            sums = np.add.reduceat(products, edges, axis=0)
            score[: len(sums), active] += sums[: len(score)]
            if len(sums) > len(score):
                score[-1, active] += sums[len(score) :].sum(axis=0)
    blocks = np.concatenate(scores)
    return Normal(
        matrix,
        own,
        blocks[blocks.any(axis=1)],
        cost,
        frequency,
        np.array(noises).T,
        np.array(weights),
        whitened,
        squares,
        squares_before,
    )


def _burst_weights(white: Sequence[Array], used: Sequence[Flags], step: float) -> list[Array]:
    """Weight rows by the power of their block against the usual; rows that do not count get 0."""
    length = max(2, round(BURST_S / step))
    powers = []
    for error, flags in zip(white, used, strict=True):
        edges = np.arange(0, len(error), length)
        squares = np.add.reduceat(np.where(flags, error, 0.0) ** 2, edges)
        powers.append(squares / np.maximum(np.add.reduceat(flags.astype(float), edges), 1.0))
    usual = np.median(np.concatenate([power[power > 0] for power in powers]))
    found = []
    for power, flags in zip(powers, used, strict=True):
        weight = np.minimum(1.0, HEAVY * usual / np.maximum(power, 1e-300))
        found.append(np.where(flags, np.repeat(weight, length)[: len(flags)], 0.0))
    return found


def solve(
    data: Sequence[Data],
    laid: Layout,
    theta: Array,
    wiring: Wiring,
    *,
    rounds: int = ROUNDS_MAX,
    rough_hz: float = 0.0,
    free: Flags | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Estimate:
    """Run Gauss-Newton from `theta`; free: which parameters move (P,), all unless given.

    rough_hz: the first rounds take the noise for one that is typical, gusts' below that frequency, the
    gyro's above it: the residual of a bad start says more of the start than of the noise. 0: they do not.
    """
    free = np.ones(len(theta), bool) if free is None else free
    prior = np.diag(1.0 / laid.spread**2)
    damping, cleaned = 0.0, 0
    best: tuple[Array, Normal] | None = None
    current = theta.copy()
    number = 0

    def away(at: Array) -> float:
        return float(((at - laid.start) ** 2 / laid.spread**2).sum())

    for one in data:
        one.model.clean(np.zeros(3))
    for number in range(rounds):
        looks = [see(one, laid, current, wiring) for one in data]
        now = _normal(
            data, looks, None if best is None else best[1], rough_hz=rough_hz * (number < ROUGH_ROUNDS)
        )
        moved = np.inf
        if best is not None:
            # By the noise and the weights that the step was taken for: those of this round are others.
            worse = now.squares_before + away(current) - best[1].squares - away(best[0])
            if worse > WORSE * best[1].squares and damping < DAMPING_MAX:
                damping = max(4.0 * damping, 0.1)
                current = best[0] + _step(best[1], prior, laid, best[0], free, damping)
                continue
            step = current - best[0]
            moved = float(np.sqrt(step @ (now.matrix + prior) @ step))
        best = current, now
        damping = damping / 4.0 if 0.05 < damping < DAMPING_MAX else 0.0
        if moved < MOVED_MAX and (number >= ROUGH_ROUNDS or not rough_hz):
            if cleaned == CLEANED:
                break
            cleaned += 1
            for one, look in zip(data, looks, strict=True):
                one.model.clean(look.residual)
            best = None  # squares from here on are of other rates
            continue
        current = current + _step(now, prior, laid, current, free, damping)
        progress(f"round {number + 1}")
    at, normal = (current, now) if best is None else best
    cost = normal.cost + away(at)
    return Estimate(
        at,
        _covariance(normal, prior, free),
        cost,
        normal.frequency,
        normal.noise,
        number + 1,
        len(normal.scores),
        normal.weights,
    )


def _two_stage(normal: Normal) -> Normal:
    """Weigh the moment equations of instruments by their noise: least squares of them, which has a minimum.

    Directions that no instrument speaks of then stay where the start has them.
    """
    size = np.sqrt(np.maximum(np.diag(normal.own), 1e-30))
    scaled = normal.own / np.outer(size, size) + RIDGE * np.eye(len(size))
    taken = normal.matrix.T @ (np.linalg.inv(scaled) / np.outer(size, size))
    return replace(
        normal,
        matrix=taken @ normal.matrix,
        own=taken @ normal.own @ taken.T,
        scores=normal.scores @ taken.T,
    )


def solve_by(
    instruments: Sequence[Data],
    data: Sequence[Data],
    laid: Layout,
    theta: Array,
    wiring: Wiring,
    *,
    rounds: int = ROUNDS_MAX,
    progress: Callable[[str], None] = lambda _: None,
) -> Estimate:
    """Solve the moment equations of instruments, the pieces as commands alone move them, from `theta`."""
    free, prior = np.ones(len(theta), bool), np.diag(1.0 / laid.spread**2)
    current, step, shorter = theta.copy(), np.zeros(len(theta)), 1.0
    normal: Normal | None = None
    number = 0
    for number in range(rounds):
        tried = current + shorter * step
        looks = [see(one, laid, tried, wiring) for one in data]
        by = [see(one, laid, tried, wiring).columns for one in instruments]
        now = _two_stage(_normal(data, looks, normal, instruments=by))
        if normal is not None and now.squares_before > LOUDER * normal.squares and shorter > SHORTEST:
            shorter /= 2.0
            continue
        current, normal, shorter = tried, now, 1.0
        step = _step(normal, prior, laid, current, free, 0.0)
        progress(f"instruments, round {number + 1}")
        if np.max(np.abs(step) / np.sqrt(np.diag(_covariance(normal, prior, free)))) < MOVED_MAX:
            break
    assert normal is not None
    return Estimate(
        current,
        _covariance(normal, prior, free),
        normal.cost,
        normal.frequency,
        normal.noise,
        number + 1,
        len(normal.scores),
        normal.weights,
    )


def combined(few: Estimate, many: Estimate) -> Estimate:
    """Return the best mean of estimates by instruments, and by all that moved, each with what it can be off.

    `many` is the sharper one, if nothing moved the motors but commands and noise. By how much more than that
    the two differ, against their intervals, tells how much wider its covariance has to be: one factor for all
    directions, by the moment that makes the differences' squares what they should be. Source: Hausman 1978;
    Paule and Mandel 1982; from memory.
    """
    root = np.linalg.cholesky(few.covariance)
    inverse = np.linalg.inv(root)
    sharp, way = np.linalg.eigh(inverse @ many.covariance @ inverse.T)  # over the variance by instruments
    sharp = np.clip(sharp, 1e-9, 1.0 - 1e-3)
    apart = way.T @ inverse @ (many.theta - few.theta)

    def expected(wider: float) -> Array:
        return np.asarray(1.0 - sharp + (wider - 1.0) * sharp)

    low, high = 1.0, WIDER_MAX
    for _ in range(60):
        wider = float(np.sqrt(low * high))
        low, high = (wider, high) if (apart**2 / expected(wider)).sum() > len(apart) else (low, wider)
    share = (1.0 - sharp) / expected(low)
    back = root @ way
    return replace(
        many,
        theta=few.theta + back @ (share * apart),
        covariance=(back * (1.0 - share * (1.0 - sharp))) @ back.T,
        wider=low,
    )


def _step(normal: Normal, prior: Array, laid: Layout, theta: Array, free: Flags, damping: float) -> Array:
    matrix = normal.matrix + prior
    matrix = matrix + damping * np.diag(np.diag(matrix))
    right = normal.scores.sum(axis=0) - (theta - laid.start) / laid.spread**2
    step = np.zeros(len(theta))
    at = np.flatnonzero(free)
    step[at] = np.linalg.solve(matrix[np.ix_(at, at)], right[at])
    for number, name in enumerate(laid.names):
        if name.startswith("log_"):
            step[number] = np.clip(step[number], -0.5, 0.5)
        low, high = LIMITS.get(name, (-np.inf, np.inf))
        step[number] = np.clip(step[number], low - theta[number], high - theta[number])
    return step


def _covariance(normal: Normal, prior: Array, free: Flags) -> Array:
    """Return the sandwich over blocks, neighbours with half weight, nowhere less than by the noise alone."""
    at = np.flatnonzero(free)
    bread = np.linalg.inv((normal.matrix + prior)[np.ix_(at, at)])
    least = bread @ (normal.own + prior)[np.ix_(at, at)] @ bread.T  # by the noise alone
    scores = normal.scores[:, at]
    beside = scores[1:].T @ scores[:-1]
    meat = scores.T @ scores + 0.5 * (beside + beside.T)
    count = len(scores)
    meat *= count / max(1.0, count - min(len(at), 0.5 * count))
    meat += prior[np.ix_(at, at)]
    root = np.linalg.cholesky(least)
    inverse = np.linalg.inv(root)
    size, way = np.linalg.eigh(inverse @ bread @ meat @ bread.T @ inverse.T)  # of the sandwich over it
    found = np.zeros_like(prior)
    found[np.ix_(at, at)] = (root @ way * np.maximum(size, 1.0)) @ (root @ way).T
    return found
