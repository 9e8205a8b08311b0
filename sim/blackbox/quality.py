"""The questions that a log can answer, by missing fields, lost rows and limits that were reached."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.flight import GYRO_LOST
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.sticks import beyond, is_stick
from neuroflight.sim.blackbox.units import Channels, channels, control_rate_hz
from neuroflight.toolchain.contract import AXES, DSHOT_MAX

GYRO_FULL_DEG_S = 2000.0  # of the chip's range (sim.physics.imu)
NEAR_FULL = 0.995  # of it, that is taken for saturated
FULL = 0.999  # motor fraction that is taken for full power
STATE = "nf_state_000"  # header that begins the state of the control path
REPLAYABLE = "state, raw counts, receiver and edges of each control step"
PER_PERIOD = 10.0  # samples of a period needed to see a shape, not only a spectrum
JITTER = 0.02  # of the time between two rows, its standard deviation, above which a spectrum is blurred


class Answer(Enum):
    """Answers to whether a log suffices for a question."""

    YES = "yes"
    PARTLY = "partly"
    NO = "no"


Finding = tuple[Answer, str]  # and why


@dataclass(frozen=True)
class Question:
    """A question about a log."""

    name: str
    answer: Answer
    why: str  # the finding, or what is missing and how to log it next time


@dataclass(frozen=True)
class Quality:
    """The questions that a log can answer; a log without trouble has no warnings."""

    questions: tuple[Question, ...]
    warnings: tuple[str, ...]
    rows: int
    seconds: float
    rate_hz: float
    control_rate_hz: float
    lost: int  # rows
    longest_gap_s: float
    gyro_saturated: tuple[float, float, float]  # part of the rows, per axis
    motors_full: float  # part of the rows with a motor at full power
    motors_idle: float  # part of the rows with a motor at or below its idle


def quality(log: Log) -> Quality:
    """Examine everything that a log of N > 0 rows is used for."""
    told = channels(log)
    rows = told.armed if told.armed.any() else np.ones(len(log), bool)
    saturated = _saturated(told, rows)
    full, idle = _motor_limits(told, rows)
    gap_s = float(log.missing.max(initial=0)) * log.row_us * 1e-6
    return Quality(
        questions=tuple(_questions(log, told)),
        warnings=tuple(_warnings(log, told, saturated, full, gap_s)),
        rows=len(log),
        seconds=log.seconds,
        rate_hz=log.rate_hz,
        control_rate_hz=control_rate_hz(log),
        lost=log.lost,
        longest_gap_s=gap_s,
        gyro_saturated=saturated,
        motors_full=full,
        motors_idle=idle,
    )


def replay_obstacles(log: Log) -> list[str]:
    """List why a log cannot be replayed; empty if it can."""
    if log.maker is not Maker.NEUROFLIGHT:
        return [f"it is {log.maker.value}'s; only Neuroflight's logs hold what its control path was given"]
    found = []
    if STATE not in log.header:
        found.append("its headers hold no state of the control path (nf_state_000)")
    if log.matrix("gyroRaw") is None:
        found.append("it has no raw counts (group REPLAY of blackbox_disabled_mask)")
    if log.stride != 1:
        found.append(f"it holds one control step of {log.stride} only (blackbox_divider)")
    if log.lost:
        found.append(f"{log.lost} rows are lost")
    if log.matrix("motor") is None:
        found.append("it has no motor values to compare with")
    return found


def _questions(log: Log, told: Channels) -> list[Question]:
    ours, attitude = log.maker is Maker.NEUROFLIGHT, log.matrix("imuQuaternion", 3)
    timed, timing = "controlTime" in log.columns, f"no controlTime{' (group TIMING)' if ours else ''}"
    obstacles = replay_obstacles(log)
    unfiltered = f"no gyroUnfilt[0..2]{'' if ours else ' (Betaflight before 4.4 logs it by debug_mode only)'}"
    found = {
        "tracking and step responses": _tracking(log, told),
        "figures to the bit": _exact(log, told),
        "effort and smoothness of the motors": _effort(told, ours=ours),
        "speeds of the rotors": _rotors(log, told),
        "vibration": _spectrum(log),
        "what the gyro's filters do": _one(
            told.gyro_unfiltered is not None, "gyroUnfilt beside gyroADC", unfiltered
        ),
        "battery": _one(told.voltage is not None, "voltage", "no voltage whose unit the log tells"),
        "attitude": _one(attitude is not None, "imuQuaternion[0..2]", "no imuQuaternion[0..2]"),
        "forces": _one(told.acceleration is not None, "accSmooth in g", "no accSmooth[0..2] with acc_1G"),
        "inside of the controller": _inside(log),
        "time that the control task takes": _one(timed, "controlTime in cycles", timing),
        "replay": _one(not obstacles, REPLAYABLE, "; ".join(obstacles)),
    }
    return [Question(name, *finding) for name, finding in found.items()]


def _one(there: bool, yes: str, no: str) -> Finding:
    return (Answer.YES, yes) if there else (Answer.NO, no)


def _tracking(log: Log, told: Channels) -> Finding:
    lacking = [] if told.setpoint is not None else [told.pilot.lacks]
    if told.gyro is None:
        lacking.append(GYRO_LOST if log.matrix("gyroADC", 3) is not None else "no gyroADC[0..2]")
    if lacking:
        return Answer.NO, "; ".join(lacking)
    if told.pilot.note:
        return Answer.PARTLY, told.pilot.note
    if log.lost:
        lost = f"{log.lost} of {len(log) + log.lost} rows are lost"
        words = f"setpoint and gyro, but {lost}: figures are those of the rest, taken as evenly spaced"
        return Answer.PARTLY, words
    return Answer.YES, "setpoint and gyro; the true rate is in no log"


def _exact(log: Log, told: Channels) -> Finding:
    if told.exact:
        return Answer.YES, "float32 values as the controller had them"
    step = 0.1 if log.headers.integer("blackbox_high_resolution", 0) else 1.0
    mend = " (group EXACT)" if log.maker is Maker.NEUROFLIGHT else ""
    return Answer.NO, f"setpoint and gyro are rounded to {step:g} deg/s{mend}"


def _effort(told: Channels, *, ours: bool) -> Finding:
    if told.motors is None:
        return Answer.NO, told.motors_note or "no motor[0..]"
    if not ours:
        words = "of the motors' whole command: how its mixer laid the throttle on top is not known"
        return Answer.PARTLY, words
    if told.idle is None:
        return Answer.PARTLY, "no nf_idle in the headers: give --idle"
    return Answer.YES, f"motor[0..], idle {told.idle:g}"


def _rotors(log: Log, told: Channels) -> Finding:
    if told.rpm is not None:
        poles = log.header["motor_poles"]
        return Answer.YES, f"eRPM with {poles} poles, up to {told.rpm.max():,.0f} rpm"
    if log.matrix("eRPM") is None:
        return Answer.NO, "no eRPM[0..] (bidirectional DShot)"
    words = "eRPM without motor_poles: add --header motor_poles=N, the motor's magnets"
    return Answer.NO, words


def _spectrum(log: Log) -> Finding:
    rate, control = log.rate_hz, control_rate_hz(log)
    if not rate:
        return Answer.NO, "too few rows"
    words = (
        f"{rate:,.0f} rows a second: spectra up to {rate / 2:,.0f} Hz, shapes up to "
        f"{rate / PER_PERIOD:,.0f} Hz"
    )
    if log.stride > 1:
        words += (
            f"; one control step of {log.stride} is logged, without a filter: what lies between "
            f"{rate / 2:,.0f} and {control / 2:,.0f} Hz appears below that"
        )
        return Answer.PARTLY, words
    return Answer.YES, words


def _inside(log: Log) -> Finding:
    if log.maker is Maker.NEUROFLIGHT:
        told = sum(1 for header in log.header if header.startswith("nf_debug_"))
        return _one(
            told > 0 and log.matrix("debug") is not None,
            f"action and observation in debug[0..], {told} of them told by nf_debug_",
            "no debug[0..] (group DEBUG)",
        )
    terms = [one for one in ("axisP", "axisI", "axisD", "axisF") if f"{one}[0]" in log.columns]
    return _one(bool(terms), f"terms {', '.join(terms)}", "no axisP, axisI, axisD")


def _saturated(told: Channels, rows: np.ndarray) -> tuple[float, float, float]:
    """Return the share of rows with each axis at the end of the gyro's range, unfiltered if logged."""
    gyro = told.gyro if told.gyro_unfiltered is None else told.gyro_unfiltered
    if gyro is None:
        return 0.0, 0.0, 0.0
    limit = np.deg2rad(GYRO_FULL_DEG_S * NEAR_FULL)
    roll, pitch, yaw = (np.abs(gyro[rows]) >= limit).mean(axis=0).tolist()
    return roll, pitch, yaw


def _motor_limits(told: Channels, rows: np.ndarray) -> tuple[float, float]:
    """Return the shares of rows with a motor at full power, and with one at its idle or below."""
    if told.motors is None or told.dshot is None:
        return 0.0, 0.0
    motors = np.nan_to_num(told.motors[rows], nan=1.0 - FULL)  # neither full nor idle
    full = (motors >= FULL) | (told.dshot[rows] == DSHOT_MAX)
    idle = np.zeros(1) if told.idle is None else (motors <= told.idle + 1e-3).any(axis=1)
    return float(full.any(axis=1).mean()), float(idle.mean())


def _warnings(
    log: Log,
    told: Channels,
    saturated: tuple[float, float, float],
    full: float,
    gap_s: float,
) -> list[str]:
    found = [*log.notes, *_impossible(log, told)]
    if told.motors_note and not {"motorOutput", "minthrottle"} & log.headers.lost().keys():
        found.append(told.motors_note)
    if log.lost:
        part = 100 * log.lost / (len(log) + log.lost)
        places = int((log.missing > 0).sum())
        found.append(
            f"{log.lost} rows ({part:.2g} %) are lost at {places} place{'s' * (places > 1)}, the longest "
            f"{gap_s * 1e3:.0f} ms: the device was too slow, or the file is damaged"
        )
    dropped = log.slow.get("dropped")
    if dropped is not None and len(dropped) and dropped.max():
        found.append(f"the firmware counts {int(dropped.max())} control steps that it could not log")
    for name, part in zip(AXES, saturated, strict=True):
        if part:
            found.append(
                f"gyro {name} at the end of its range in {_percent(part)} of the rows: rates are larger"
            )
    if full:
        found.append(f"a motor at full power in {_percent(full)} of the rows: tracking is limited by thrust")
    apart = np.diff(log.time_us)[log.missing[1:] == 0]
    if len(apart) > 1 and log.row_us and (spread := float(apart.std()) / log.row_us) > JITTER:
        found.append(f"rows come unevenly: {100 * spread:.0f} % of {log.row_us:.0f} us; spectra are blurred")
    if not told.armed.any():
        found.append("the motors were never armed")
    return found


def _impossible(log: Log, told: Channels) -> list[str]:
    """Return warnings of values that no stick or motor can have; such rows are not evaluated."""
    found = []
    asked, wrong = told.pilot, {}
    if asked.throttle is not None:
        wrong["a throttle that no stick gives"] = ~is_stick(asked.throttle)
    if asked.rates is not None:
        wrong["a commanded rate that no stick gives"] = beyond(asked.rates)
    if told.motors is not None:
        wrong["a value that no motor is given"] = np.asarray(np.isnan(told.motors).any(axis=1))
    for what, bad in wrong.items():
        if bad.any():
            row = int(bad.argmax())
            found.append(f"{int(bad.sum())} rows have {what}, the first row {row} at {log.t[row]:.3f} s")
    if asked.rates is not None and (part := float(np.isnan(asked.rates).any(axis=1).mean())):
        found.append(f"the stick commands an angle in {_percent(part)} of the rows")
    return found


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %"
