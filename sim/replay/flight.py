"""From a decoded log to a flight that can be replayed, or to the reason why it cannot: one line each."""

from __future__ import annotations

import zlib
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.settings.text import parse_setting
from neuroflight.sim.arrays import Array32, Flags
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.log import Log, floats, words
from neuroflight.sim.replay.inputs import Answers, Flight, Inputs
from neuroflight.toolchain.contract import (
    ESC_SILENT,
    GYRO_BAD_MS,
    LOG_RECEIVER_BYTES,
    MOTOR_COUNT_MAX,
    LogEdge,
    LogEvent,
    LogGroup,
)
from neuroflight.toolchain.errors import LinkError, TraceError

SETTING = "nf_set_"
STATE_BYTES_MAX = 1 << 16
_REPLAY = ("gyroRaw[0]", "accRaw[0]", "sampleFlags", "lost")
_CHECK, _CHECK_MASK = "inputCheck", 0x3FFF
_WORDS = "rotorWord"
_HELD = ("edgeForbidden", "edgeGain")
_SLOW = (*_HELD, "edgeFlags", "rxCount")
_RECEIVED = tuple(f"rxBytes[{word}]" for word in range(LOG_RECEIVER_BYTES // 4))
_INVALID, _REPEATED = 0, 8  # the first bit of sampleFlags that says so, of the oldest sample
_SAMPLES = 16  # the first bit of sampleFlags that counts them
_SILENCES = LogEdge.SILENCE.bit_length() - 1  # the first bit of edgeFlags that counts them

Integers = NDArray[np.int64]


def replayable(log: Log) -> Flight:
    """Return the inputs of the control path in the flight of `log`, up to the first step without them.

    Raises TraceError where nothing of it can be replayed.
    """
    _check_kind(log)
    state = _state(log)
    gyro_hz, control_hz = (_rate(log, name) for name in ("nf_gyro_rate", "nf_control_rate"))
    motors = log.matrix("motor")
    if motors is None:
        _refuse(log, "it has no motors to compare with", _mask(log, LogGroup.MOTOR))
    inputs = _inputs(log, gyro_hz // control_hz)
    sound = _sound(log, inputs, motors)
    count, incomplete = _usable(log, inputs, gyro_hz, gyro_hz // control_hz, ~sound)
    answers = Answers(
        dshot=motors.astype(np.uint16)[:count],
        gyro=_exact(log, "gyroFloat", 0, 3, count),
        setpoint=_exact(log, "setpointFloat", 0, 3, count),
        throttle=_exact(log, "setpointFloat", 3, 4, count),
    )
    rows = {name: getattr(inputs, name)[:count] for name in inputs.__dataclass_fields__}
    return Flight(
        path=log.path,
        inputs=Inputs(**rows),
        answers=answers,
        t=log.t[:count],
        state=state,
        settings=_settings(log),
        gyro_rate_hz=gyro_hz,
        control_rate_hz=control_hz,
        header=log.header,
        layout=log.headers.integer("nf_state_layout", 0),
        incomplete=incomplete,
        damaged=bool((~sound[: count + 1]).any()),
    )


def _refuse(log: Log, what: str, mend: str) -> NoReturn:
    raise TraceError(f"{log.path}: cannot be replayed: {what}; {mend}")


def _mask(log: Log, group: LogGroup) -> str:
    """Return what the user sets so that the next log has `group`."""
    now = log.headers.integer(f"{SETTING}blackbox_disabled_mask", 0)
    wanted = now & ~(1 << group)
    return f"fly again with blackbox_disabled_mask = {wanted} (now {now}: bit {int(group)} is off)"


def _check_kind(log: Log) -> None:
    """Raise TraceError unless the log is one of ours, and has every control step and the group REPLAY."""
    if log.maker is not Maker.NEUROFLIGHT:
        what = f"it is of {log.maker.value}, expected one of Neuroflight"
        _refuse(log, what, "its commands can be flown: fly --commands")
    for names, columns in ((_REPLAY, log.columns), (_SLOW, log.slow)):
        if missing := [name for name in names if name not in columns]:
            what = f"it lacks {', '.join(missing)} of the group REPLAY"
            _refuse(log, what, _mask(log, LogGroup.REPLAY))
    if log.stride != 1:
        what = f"it has one control step of {log.stride}, expected each"
        _refuse(log, what, "fly again with blackbox_divider = 1")
    first = int(log.columns["loopIteration"][0])
    if first != 0:
        what = f"its first {first} control steps are missing, and the state is of before them"
        _refuse(log, what, "the file is damaged at its begin; take another copy")


def _state(log: Log) -> bytes:
    """Read the state of struct firmware from the header. Raises TraceError if it is incomplete."""
    again = "take another copy of the file"
    lines = sorted(name for name in log.header if name.startswith("nf_state_") and name[9:].isdigit())
    if not lines:
        what = "its header has no state of the control path (nf_state_000 ..)"
        _refuse(log, what, "it is damaged, or was not begun from the start; take another copy")
    text = "".join(log.header[name].strip() for name in lines)
    try:
        state = bytes.fromhex(text)
    except ValueError:
        _refuse(log, "the state in its header is no hexadecimal number", again)
    whole = lines == [f"nf_state_{number:03d}" for number in range(len(lines))]
    if not whole or len(state) > STATE_BYTES_MAX:
        _refuse(log, "lines of the state in its header are missing", again)
    said = log.header.get("nf_state_crc", "").strip()
    if said and said.lower() != f"{zlib.crc32(state):08x}":
        what = f"the state in its header is damaged (CRC-32 {zlib.crc32(state):08x}, expected {said})"
        _refuse(log, what, again)
    return state


def _rate(log: Log, name: str) -> int:
    """Read a rate [Hz] from the header."""
    value = log.headers.integer(name, 0)
    if not 0 < value <= 32_000:
        what = f"its header says {name} {value}, expected a rate in Hz"
        _refuse(log, what, "take another copy of the file")
    return value


def _settings(log: Log) -> dict[str, float]:
    """Return the settings that were not default, without texts, which change no flight."""
    found = {}
    for name, text in log.header.items():
        if not name.startswith(SETTING):
            continue
        try:
            setting, value = parse_setting(f"{name.removeprefix(SETTING)}={text}")
        except LinkError as error:
            _refuse(log, f"its header says {name}:{text[:40]} ({error})", "use the version that flew")
        if not isinstance(value, str):
            found[setting] = float(value)
    return found


def _inputs(log: Log, divider: int) -> Inputs:
    """Return all rows of the log; `_usable` decides whether they follow from one another."""
    slow = _slow(log)
    flags = words(slow["edgeFlags"])
    raw, accel = log.matrix("gyroRaw"), log.matrix("accRaw", 3)
    if raw is None or accel is None or raw.shape[1] != 3 * divider:
        what = f"it has {0 if raw is None else raw.shape[1]} columns gyroRaw, expected {3 * divider}"
        _refuse(log, what, "take another copy of the file")
    bits = log.columns["sampleFlags"]
    places = np.arange(divider)
    received = np.stack([slow[name] for name in _RECEIVED], axis=1).astype("<u4").view(np.uint8)
    return Inputs(
        step=log.columns["loopIteration"],
        samples=bits >> _SAMPLES,
        counts=raw.astype(np.int16).reshape(len(log), divider, 3),
        invalid=(bits[:, None] >> (_INVALID + places) & 1).astype(bool),
        repeated=(bits[:, None] >> (_REPEATED + places) & 1).astype(bool),
        accel=accel.astype(np.int16),
        lost=log.columns["lost"],
        silences=(flags >> _SILENCES).astype(np.int64),
        flags=flags & np.uint32((1 << _SILENCES) - 1),
        forbidden=words(slow["edgeForbidden"]),
        gain=floats(slow["edgeGain"]),
        received=slow["rxCount"],
        receiver=np.ascontiguousarray(received),
        rotors=_rotors(log),
    )


def _rotors(log: Log) -> NDArray[np.uint16]:
    """Return the words of the ESCs (N, MOTOR_COUNT_MAX); all silent where none are logged."""
    words_told = log.matrix(_WORDS)
    found = np.full((len(log), MOTOR_COUNT_MAX), ESC_SILENT, np.uint16)
    if words_told is not None:
        found[:, : words_told.shape[1]] = words_told[:, :MOTOR_COUNT_MAX]
    return found


def _slow(log: Log) -> dict[str, Integers]:
    """Return the fields of slow frames as (N,): states are held, events belong to their step alone."""
    rows = len(log)
    told = log.slow_row < rows
    at = log.slow_row[told]
    frames = np.searchsorted(log.slow_row, np.arange(rows), side="right") - 1  # that holds in each row
    found = {}
    for name in (*_SLOW, *_RECEIVED):
        values = log.slow[name]
        if name in _HELD:
            found[name] = values[np.maximum(frames, 0)]
        else:
            found[name] = np.zeros(rows, np.int64)
            found[name][at] = values[told]
    return found


def _follows(log: Log, inputs: Inputs, gyro_hz: int) -> Flags:
    """Return True for rows (N,) whose samples, lost ones and silences fill the time since the row before."""
    sample = (log.time_us * gyro_hz + 500_000) // 1_000_000  # of each row, since the boot
    passed = inputs.samples + inputs.lost + inputs.silences * (gyro_hz * GYRO_BAD_MS // 1000)
    follows: Flags = np.diff(sample, prepend=sample[:1] - passed[:1]) == passed
    return follows


def _usable(log: Log, inputs: Inputs, gyro_hz: int, divider: int, wrong: Flags) -> tuple[int, str]:
    """Return the number of usable rows, and what is wrong with the next; "": all are usable."""
    flags = inputs.flags
    resumed = np.zeros(len(log), bool)
    for event in log.events:
        if event.kind == LogEvent.LOGGING_RESUME and event.row < len(log):
            resumed[event.row] = True
    whole = (inputs.samples >= 1) & (inputs.samples <= divider)
    reasons = (
        (resumed | ~_follows(log, inputs, gyro_hz), "control steps before it are missing"),
        (~whole, f"it has another number of gyro samples than 1 to {divider}"),
        (wrong, "a bit of it is wrong in this file"),
        (flags & np.uint32(LogEdge.BENCH) > 0, "a motor test or a DShot command is under way"),
        (flags & np.uint32(LogEdge.MORE_BYTES) > 0, "more receiver bytes came than the log holds"),
        ((inputs.received < 0) | (inputs.received > LOG_RECEIVER_BYTES), "its receiver bytes are damaged"),
    )
    ends = [(int(rows.argmax()), why) for rows, why in reasons if rows.any()]
    if not ends:
        return len(log), ""
    row, why = min(ends)
    if row == 0:
        _refuse(log, f"at its first control step {why}", "fly again")
    at = f"control step {int(inputs.step[row]):,}, {log.t[row]:.3f} s"
    return row, f"replayed up to {at}: {why}"


def _sound(log: Log, inputs: Inputs, motors: Integers) -> Flags:
    """Return True for rows (N,) whose check matches inputs and motors; for all if the log has no check."""
    told = log.columns.get(_CHECK)
    if told is None:
        return np.ones(len(log), bool)
    samples = np.zeros(inputs.invalid.shape, np.dtype([("counts", "<i2", (3,)), ("flags", "<u2")]))
    samples["counts"], samples["flags"] = inputs.counts, inputs.invalid + 2 * inputs.repeated
    head = np.zeros(len(log), np.dtype([("words", "<u4", (5,)), ("numbers", "<u2", (2,))]))
    flags = inputs.flags | (inputs.silences << _SILENCES).astype(np.uint32)
    parts = (inputs.step, inputs.forbidden, inputs.gain.view(np.uint32), flags, inputs.lost)
    head["words"] = np.stack([part.astype(np.uint32) for part in parts], axis=1)
    head["numbers"] = np.stack([inputs.samples, inputs.received], axis=1).astype(np.uint16)
    values = motors.astype("<u2")
    rotors = inputs.rotors[:, : motors.shape[1]].astype("<u2")
    tells = f"{_WORDS}[0]" in log.columns
    found = np.zeros(len(log), np.int64)
    for k, count in enumerate(inputs.samples.tolist()):
        crc = zlib.crc32(samples[k, :count].tobytes(), zlib.crc32(head[k].tobytes()))
        crc = zlib.crc32(inputs.accel[k].tobytes(), crc)
        crc = zlib.crc32(rotors[k].tobytes() if tells else b"", crc)
        crc = zlib.crc32(inputs.receiver[k, : int(inputs.received[k])].tobytes(), crc)
        found[k] = zlib.crc32(values[k].tobytes(), crc) & _CHECK_MASK
    sound: Flags = found == told
    return sound


def _exact(log: Log, name: str, first: int, last: int, count: int) -> Array32 | None:
    """Return columns of the group EXACT, (count, last - first) or (count,); None without them."""
    found = log.matrix(name)
    if found is None or found.shape[1] < last:
        return None
    values = np.ascontiguousarray(floats(np.ascontiguousarray(found[:count, first:last])))
    return values[:, 0].copy() if last - first == 1 else values
