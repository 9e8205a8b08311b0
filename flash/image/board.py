"""The board at the other end of the line, and whether an image may be written to it now."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.board.info import check_api
from neuroflight.flash.image.messages import Banks, image_info
from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.messages import BatteryLevel, BatteryState
from neuroflight.flash.policy.slots import Policies, read_policies
from neuroflight.toolchain.contract import IMAGE_LAYOUT, MSP_FIRMWARE, Msp
from neuroflight.toolchain.errors import LinkError

_OTHERS = {
    "BTFL": "Betaflight",
    "INAV": "INAV",
    "CLFL": "Cleanflight",
    "EMUF": "EmuFlight",
    "ARDU": "ArduPilot",
}
_RESCUE = "install Neuroflight with `neuroflight board rescue`"


@dataclass(frozen=True)
class Board:
    """A board with our firmware."""

    port: str  # as the user would write it
    target: str
    version: str
    uid: str
    armed: bool
    battery: BatteryState
    policies: Policies
    banks: Banks


def read_board(client: Client) -> Board:
    """Read a board's identity and state. Raises LinkError if another firmware or nobody answers."""
    api_checked = _check_is_ours(client)
    banks = _banks(client)
    return Board(
        port=client.name,
        target=api_checked[0],
        version=api_checked[1],
        uid=messages.uid(client.request(Msp.UID)),
        armed=messages.status_ex(client.request(Msp.STATUS_EX)).status.armed,
        battery=messages.battery_state(client.request(Msp.BATTERY_STATE)),
        policies=read_policies(client),
        banks=banks,
    )


def _check_is_ours(client: Client) -> tuple[str, str]:
    """Return target and version. Raises LinkError for a firmware of another make."""
    try:
        check_api(client)  # first: it closes a command line that another program left open on this port
        payload = client.request(Msp.IDENTITY)
    except RefusedError:
        raise LinkError(
            f"{client.name}: {_other_firmware(client)}, expected {MSP_FIRMWARE}; {_RESCUE} if this is a "
            "board that it is meant for"
        ) from None
    told = messages.identity(payload)
    if told.firmware != MSP_FIRMWARE:
        raise LinkError(
            f"{client.name}: a firmware that calls itself {told.firmware!r}, expected {MSP_FIRMWARE}"
        )
    return told.target, told.version


def _other_firmware(client: Client) -> str:
    """Describe a firmware of another make by its own answers."""
    try:
        variant = messages.fc_variant(client.request(Msp.FC_VARIANT))
        version = messages.fc_version(client.request(Msp.FC_VERSION))
        board = messages.board_info(client.request(Msp.BOARD_INFO))
    except LinkError:
        return "a device that speaks MSP and does not say what it is"
    on = board.target or board.identifier
    return f"{_OTHERS.get(variant, variant)} {version} on {on or 'a board without a name'}"


def _banks(client: Client) -> Banks:
    try:
        banks = image_info(client.request(Msp.IMAGE_INFO))
    except RefusedError:
        raise LinkError(
            f"{client.name}: the {MSP_FIRMWARE} there takes no images over MSP: it is of an older layout, "
            f"expected one with two banks of images; {_RESCUE} once"
        ) from None

    if banks.layout != IMAGE_LAYOUT:
        age, do = (
            ("older", _RESCUE) if banks.layout < IMAGE_LAYOUT else ("newer", "use this tool in its version")
        )
        raise LinkError(
            f"{client.name}: the {MSP_FIRMWARE} there takes images of layout {banks.layout}, {age} than "
            f"{IMAGE_LAYOUT}, which this tool writes; {do}"
        )
    return banks


def check_ready(board: Board) -> None:
    """Raise LinkError if flash must not be written now."""
    if board.armed:
        raise LinkError(f"{board.port}: the motors are armed, expected a disarmed board; disarm first")
    battery = board.battery
    if battery.level is BatteryLevel.CRITICAL:
        raise LinkError(
            f"{board.port}: the battery is low, {battery.voltage_v:.2f} V of {battery.cells} cells, expected "
            "one above `battery_low_v` a cell, or USB power alone; charge or unplug it"
        )
