"""The conditions and refusals of each request; docs/reference/msp.md prints them, tests hold the C to it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from neuroflight.toolchain.contract.msp import Msp, Refusal
from neuroflight.toolchain.contract.msp_configuration import CONFIGURATIONS
from neuroflight.toolchain.contract.settings import AT_ONCE

__all__ = ["Access", "MspWhen", "access_of", "acknowledge_access"]


class MspWhen(Enum):
    """Conditions for carrying out a request; otherwise it is refused as ARMED."""

    ALWAYS = "always"
    STOPPED = "disarmed"
    STORING = "disarmed, and nothing arms meanwhile: flash is written"
    NEVER = "it is no request"


@dataclass(frozen=True)
class Access:
    """The condition for carrying out a request, and all its other refusals."""

    when: MspWhen = MspWhen.ALWAYS
    refusals: tuple[Refusal, ...] = ()
    note: str = ""


_R = Refusal
_STOPPED, _STORING = MspWhen.STOPPED, MspWhen.STORING
_STARTED = (
    "REBOOT starts it; `blob` where no slot holds a policy that it can fly; may be repeated: the number stays"
)
_BOTH = "while the other bank's image is started next, or is the one to go back to"
_READ_FIRST = "refused as `order` until this peer has read its counterpart, as its zeros mean something"
_LOG_REFUSALS = (_R.PAYLOAD, _R.INDEX, _R.ORDER, _R.LOG, _R.ABSENT)
_LOG_ORDER = "`absent` where the device keeps no logs, `order` while one is written"
# SETs of lists; those of single values are in CONFIGURATIONS.
_LISTS = (
    Msp.SET_MODE_RANGE,
    Msp.SET_RXFAIL_CONFIG,
    Msp.COMMON_SET_SERIAL_CONFIG,
    Msp.SET_MOTOR_OUTPUT_REORDERING,
    Msp.SET_TEXT,
)
_SETS = {pair.request.message: pair.read_first for pair in CONFIGURATIONS if pair.request is not None}
_SETS |= {message: message is Msp.SET_MODE_RANGE for message in _LISTS}
_BESIDES = (_R.PAYLOAD, _R.INDEX, _R.RANGE, _R.CONFLICT, _R.ABSENT)

_ACTS = {
    Msp.SET_RAW_RC: Access(
        MspWhen.ALWAYS,
        (_R.PAYLOAD, _R.ABSENT, _R.ORDER),
        "`absent` unless the setting `receiver_protocol` is msp; `order` before the last channels were taken",
    ),
    Msp.ARMING_DISABLE: Access(
        MspWhen.ALWAYS,
        (_R.PAYLOAD, _R.ARMED, _R.ABSENT),
        "nothing arms while a peer says so; `00 01` opens the motor test and is `armed` unless the state "
        "is disarmed; it lasts until the peer takes it back, hangs up (TCP) or the firmware starts anew",
    ),
    Msp.STREAM: Access(
        MspWhen.ALWAYS, (_R.PAYLOAD, _R.ABSENT), "ends with rate 0, with its TCP connection, with a restart"
    ),
    Msp.STREAM_SAMPLE: Access(MspWhen.NEVER, (), "comes unasked after STREAM"),
    Msp.SETTING_INFO: Access(MspWhen.ALWAYS, (_R.PAYLOAD, _R.INDEX)),
    Msp.SETTING_GET: Access(MspWhen.ALWAYS, (_R.PAYLOAD, _R.INDEX)),
    Msp.GET_TEXT: Access(MspWhen.ALWAYS, (_R.INDEX,)),
    Msp.TASKS: Access(MspWhen.ALWAYS, (_R.PAYLOAD,)),
    Msp.FAULTS: Access(MspWhen.ALWAYS, (_R.PAYLOAD,)),
    Msp.SETTING_SET: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.INDEX, _R.RANGE),
        f"flown from the next boot on, {AT_ONCE} at once; "
        "what does not go together is refused when it is stored",
    ),
    Msp.SETTINGS_DEFAULT: Access(_STOPPED, (_R.PAYLOAD,), "not stored yet"),
    Msp.CALIBRATE: Access(_STOPPED, (_R.PAYLOAD, _R.ABSENT), "in the state disarmed only, else `armed`"),
    Msp.MOTOR_TEST: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.ABSENT),
        "`armed` unless the state is disarmed; the frames of a DShot command go before its values",
    ),
    Msp.SET_MOTOR: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.INDEX, _R.RANGE, _R.ORDER, _R.ABSENT),
        "`order` without an open motor test, `range` above its limits for a motor and for all together; "
        "values that stop are always taken; as many values as the aircraft has motors, none above 1125, of a "
        "peer that holds the arming lock, open a test up to there, which values that stop all end",
    ),
    Msp.DSHOT_COMMAND: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.INDEX, _R.ORDER, _R.ABSENT),
        "`armed` beside a motor test, `order` while another is under way",
    ),
    Msp.SEND_DSHOT_COMMAND: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.INDEX, _R.ORDER, _R.ABSENT),
        "one command a message, or one and SAVE; ends the peer's test that SET_MOTOR opened; "
        "otherwise as DSHOT_COMMAND",
    ),
    Msp.REBOOT: Access(
        _STOPPED,
        (_R.PAYLOAD, _R.ABSENT),
        "kind 0, or none, starts the firmware, 1 the boot loader in the chip's ROM, "
        "`absent` on the host program",
    ),
    Msp.EEPROM_WRITE: Access(
        _STORING,
        (_R.PAYLOAD, _R.CONFLICT, _R.FLASH, _R.ABSENT, _R.SPOILT),
        "`spoilt` after a refusal of a change of this peer: what was not refused is stored",
    ),
    Msp.RESET_CONF: Access(_STORING, (_R.PAYLOAD, _R.CONFLICT, _R.FLASH, _R.ABSENT), "stores the defaults"),
    Msp.ACKNOWLEDGE: Access(_STORING, (_R.PAYLOAD, _R.INDEX, _R.FLASH, _R.ABSENT)),
    Msp.POLICY_SLOT_BEGIN: Access(
        _STORING,
        (_R.PAYLOAD, _R.ORDER, _R.FLASH, _R.ABSENT),
        f"`order` after a revert, until the restart, and {_BOTH}",
    ),
    Msp.POLICY_SLOT_WRITE: Access(
        _STORING, (_R.PAYLOAD, _R.ORDER, _R.FLASH, _R.ABSENT), "the last one may be repeated"
    ),
    Msp.POLICY_SLOT_END: Access(
        _STORING, (_R.PAYLOAD, _R.ORDER, _R.FLASH, _R.BLOB, _R.SEQUENCE, _R.ABSENT), "may be repeated"
    ),
    Msp.POLICY_SLOT_REVERT: Access(
        _STORING,
        (_R.PAYLOAD, _R.ORDER, _R.FLASH, _R.ABSENT),
        "`order` where no slot is flown or the other one holds no policy for this image, after an update "
        f"until the restart, and {_BOTH}; may be repeated",
    ),
    Msp.POLICY_SLOT_INFO: Access(MspWhen.ALWAYS, (_R.PAYLOAD, _R.INDEX)),
    Msp.IMAGE_INFO: Access(MspWhen.ALWAYS, (_R.PAYLOAD, _R.ABSENT)),
    Msp.IMAGE_BEGIN: Access(
        _STORING,
        (_R.PAYLOAD, _R.ORDER, _R.IMAGE, _R.FLASH, _R.ABSENT),
        "`image` before anything is erased; `order` while the running image is not confirmed and the other "
        "bank's is, to which the board may have to go back; erasing takes one to two seconds, in which "
        "nothing is answered",
    ),
    Msp.IMAGE_WRITE: Access(
        _STORING, (_R.PAYLOAD, _R.ORDER, _R.FLASH, _R.ABSENT), "the last one may be repeated"
    ),
    Msp.IMAGE_END: Access(_STORING, (_R.PAYLOAD, _R.ORDER, _R.IMAGE, _R.ABSENT), "may be repeated"),
    Msp.IMAGE_HASH: Access(_STOPPED, (_R.PAYLOAD, _R.INDEX, _R.IMAGE, _R.ABSENT)),
    Msp.LOG_INFO: Access(MspWhen.ALWAYS, (_R.PAYLOAD, _R.ABSENT)),
    Msp.LOG_ENTRY: Access(_STOPPED, _LOG_REFUSALS, _LOG_ORDER),
    Msp.LOG_READ: Access(_STOPPED, _LOG_REFUSALS, _LOG_ORDER),
    Msp.LOG_ERASE: Access(
        _STOPPED, (_R.PAYLOAD, _R.ORDER, _R.LOG, _R.ABSENT), f"{_LOG_ORDER}; may be repeated"
    ),
    Msp.IMAGE_SWITCH: Access(
        _STORING, (_R.PAYLOAD, _R.ORDER, _R.IMAGE, _R.BLOB, _R.FLASH, _R.ABSENT), _STARTED
    ),
}


def access_of(message: Msp) -> Access:
    """Return the access rules of a message; of FAULTS, those without a payload. Reading is always allowed."""
    if message in _SETS:
        if _SETS[message]:
            slot = "; a refused range leaves its slot empty" if message is Msp.SET_MODE_RANGE else ""
            return Access(_STOPPED, (*_BESIDES, _R.ORDER), _READ_FIRST + slot)
        return Access(_STOPPED, _BESIDES)
    if message in (Msp.FILTER_CONFIG, Msp.SIMPLIFIED_TUNING):
        return Access(MspWhen.ALWAYS, (_R.ABSENT,), "where the filters are a chain that it cannot say")
    return _ACTS.get(message, Access())


def acknowledge_access() -> Access:
    """Return the access rules of FAULTS with a payload, which acknowledges."""
    return Access(_STORING, (_R.PAYLOAD, _R.INDEX, _R.FLASH, _R.ABSENT))
