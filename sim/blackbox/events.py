"""Events of a log in words."""

from __future__ import annotations

from neuroflight.sim.blackbox.decoding import Event
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.log import Log
from neuroflight.toolchain.contract import FallbackCause, FlightState, LogEvent, StopCause

DISARMING = (  # Betaflight's reasons, which our logs use as well
    *("arming disabled", "failsafe", "throttle too long low", "sticks", "switch", "crash"),
    *("runaway take-off", "GPS rescue", "command over a line"),
)
STATE, STOP, FALLBACK = (17, 3), (20, 4), (24, 4)  # first bit and width in our flags of FLIGHT_MODE
PID = 1 << 16
ARM = 1


def words(log: Log, event: Event) -> str:
    if event.kind == LogEvent.DISARM:
        reason = event.values.get("reason", 0)
        return f"disarming: {DISARMING[reason] if reason < len(DISARMING) else reason}"
    if event.kind == LogEvent.FLIGHT_MODE:
        new, old = event.values.get("new", 0), event.values.get("old", 0)
        return _ours(new, old) if log.maker is Maker.NEUROFLIGHT else _modes(new, old)
    if event.kind == LogEvent.LOGGING_RESUME:
        return f"resumed, {int(log.missing[min(event.row, len(log) - 1)])} rows lost"
    return event.name


def _modes(new: int, old: int) -> str:
    """Describe a change of Betaflight's modes: the arm switch, and other boxes by their number."""
    changed = new ^ old
    if changed & ARM:
        return "armed" if new & ARM else "disarmed"
    return f"modes {old & 0xFFFF:#x} to {new & 0xFFFF:#x}"


def _ours(new: int, old: int) -> str:
    """Describe a change of our own flags, otherwise of the modes."""
    found = []
    if (new ^ old) & PID:
        found.append("the PID flies" if new & PID else "the policy flies")
    if (cause := _bits(new, FALLBACK)) != _bits(old, FALLBACK) and cause:
        found.append(f"because of {_name(FallbackCause, cause)}")
    if (state := _bits(new, STATE)) != _bits(old, STATE):
        found.append(_name(FlightState, state))
    if (stop := _bits(new, STOP)) != _bits(old, STOP) and stop:
        found.append(f"stopped by {_name(StopCause, stop)}")
    return ", ".join(found) or _modes(new, old)


def _bits(flags: int, place: tuple[int, int]) -> int:
    first, width = place
    return flags >> first & ((1 << width) - 1)


def _name(kind: type[FallbackCause] | type[FlightState] | type[StopCause], number: int) -> str:
    """Return the name of a number, or the number itself if this tool does not know it."""
    return next((one.name.lower().replace("_", " ") for one in kind if one == number), str(number))
