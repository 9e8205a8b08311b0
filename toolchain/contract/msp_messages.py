"""The layouts of all MSP messages, and when each request may come."""

from __future__ import annotations

from neuroflight.toolchain.contract.msp_configuration import CONFIGURATIONS
from neuroflight.toolchain.contract.msp_layouts import Direction, MspLayout
from neuroflight.toolchain.contract.msp_table import Access, Msp, MspWhen, set_access

__all__ = ["LAYOUTS", "access_of", "layout_of", "storing"]
_SETS = {pair.request.message: pair.read_first for pair in CONFIGURATIONS if pair.request is not None}
LAYOUTS = (
    *(layout for pair in CONFIGURATIONS for layout in (pair.reply, pair.request) if layout is not None),
    *(
        MspLayout(message, direction, told.fields, told.required)
        for message in Msp
        for direction, told in zip(Direction, (message.row.request, message.row.reply), strict=True)
        if told is not None
    ),
)
_BY_KEY = {(layout.message, layout.direction): layout for layout in LAYOUTS}


def layout_of(message: Msp, direction: Direction = Direction.REPLY) -> MspLayout:
    """Return the layout of a message. Raises KeyError where its payload is empty."""
    return _BY_KEY[message, direction]


def access_of(message: Msp) -> Access:
    """Return when a message may come; of FAULTS: without a payload."""
    return set_access(_SETS[message]) if message in _SETS else message.row.access


def storing(message: Msp) -> bool:
    """Return whether a message writes flash, by one of its payloads."""
    accesses = (access_of(message), message.row.acknowledges)
    return any(access is not None and access.when is MspWhen.STORING for access in accesses)
