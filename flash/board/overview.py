"""An overview of a firmware: state, what forbids arming, battery, receiver, attitude, load."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.board.hints import HINTS, betaflight_reasons
from neuroflight.flash.board.info import is_ours
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import Analog, Attitude, BatteryState, EscReport
from neuroflight.toolchain.contract import GYRO_FILES, GYRO_IDENTITIES, GyroChip, Msp


@dataclass(frozen=True)
class Flight:
    """The state that only this project's firmware reports."""

    state: str
    airborne: bool | None  # it has taken off since it was armed; None: the firmware does not tell
    flies: str  # "policy" or "PID": flying, or flying if armed now
    stop_cause: str  # why the motors stopped last
    fallback_cause: str  # why the PID took over last
    refused_cause: str  # why the policy must not fly until it is acknowledged
    gyro_chip: str  # name and identity of the chip; "" where there is none, as on a host
    gyro_health: str
    gyro_temperature_deg_c: float
    brown_out_level: int | None  # of the supply's detector, 0: it is off; None: not told
    policy: str
    policy_good: bool
    pid_built_in: bool  # there is a PID to fall back on
    boots: int
    fault: str | None  # kind of the newest one that nobody acknowledged


@dataclass(frozen=True)
class Overview:
    """The overview of a firmware of any make."""

    armed: bool
    arming_reasons: dict[str, str]  # reasons against arming, with how to lift them; "" if unknown
    flight: Flight | None  # None from a firmware of another make
    battery: BatteryState
    attitude: Attitude
    receiver_percent: int
    control_period_us: int
    load_percent: int
    escs: tuple[
        EscReport, ...
    ] = ()  # what they tell over the motor wire, by motor; (): nothing, or not asked


def read_overview(client: Client) -> Overview:
    """Read all of it. Raises LinkError."""
    ours = is_ours(client)
    extended = messages.status_ex(client.request(Msp.STATUS_EX))
    battery = messages.battery_state(client.request(Msp.BATTERY_STATE))
    attitude = messages.attitude(client.request(Msp.ATTITUDE))
    if ours:
        safety = records.safety(client.request(Msp.SAFETY))
        reasons = messages.arming_reasons(safety.arming_flags)
        flight, percent, hints = _flight(client, safety), safety.receiver_percent, _hints(safety)
        escs = messages.motor_telemetry(client.request(Msp.MOTOR_TELEMETRY))
    else:
        reasons = betaflight_reasons(extended.arming_flags, extended.arming_flag_count)
        flight, percent, hints = None, _percent(messages.analog(client.request(Msp.ANALOG))), {}
        escs = ()
    return Overview(
        armed=extended.status.armed,
        arming_reasons={reason: hints.get(reason, "") for reason in reasons},
        flight=flight,
        battery=battery,
        attitude=attitude,
        receiver_percent=percent,
        control_period_us=extended.status.cycle_time_us,
        load_percent=extended.status.load_percent,
        escs=escs if any(esc != EscReport(0, 0.0, 0, 0.0, 0.0) for esc in escs) else (),
    )


def _hints(safety: records.Safety) -> dict[str, str]:
    """Return how to lift each reason; an unknown gyro chip is not mended by a restart."""
    if safety.gyro in GYRO_FILES:
        return HINTS | {
            "GYRO_BAD": f"the gyro is a {safety.gyro_chip}, which measures only with its maker's "
            f"configuration: was the image built with --gyro-file, {GYRO_FILES[safety.gyro]}? Else "
            f"{HINTS['GYRO_BAD']}"
        }
    if safety.gyro_identity in (None, records.NO_CHIP) or safety.gyro is not None:
        return HINTS
    known = ", ".join(f"{chip.name} (0x{GYRO_IDENTITIES[chip]:02X})" for chip in GyroChip)
    return HINTS | {"GYRO_BAD": f"the gyro is an {safety.gyro_chip}, this firmware knows {known}"}


def _flight(client: Client, safety: records.Safety) -> Flight:
    faults = records.faults(client.request(Msp.FAULTS))
    policy = messages.policy_info(client.request(Msp.POLICY_INFO))
    return Flight(
        state=safety.state.name,
        airborne=safety.airborne,
        flies="PID" if safety.pid_flies else "policy",
        stop_cause=safety.stop_cause.name,
        fallback_cause=safety.fallback_cause.name,
        refused_cause=safety.refused_cause.name,
        gyro_chip=safety.gyro_chip,
        gyro_health=safety.gyro_health.name,
        gyro_temperature_deg_c=safety.temperature_deg_c,
        brown_out_level=safety.brown_out_level,
        policy=policy.name,
        policy_good=safety.policy_good,
        pid_built_in=safety.pid_built_in,
        boots=faults.boots,
        fault=faults.pending.kind.name if faults.pending is not None else None,
    )


def _percent(analog: Analog) -> int:
    return round(100 * analog.rssi / 1023)
