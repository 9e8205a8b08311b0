"""A peer that does as the Betaflight app does; requests are numbers, as in its own tables."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from neuroflight.flash.link import layouts, requests
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import CONFIGURATIONS, SETTINGS, Direction, Msp, layout_of

Values = dict[str, Any]
GETS = {pair.request.message: pair.reply.message for pair in CONFIGURATIONS if pair.request is not None}


class App:
    """A peer that does as the app does."""

    def __init__(self, port: str) -> None:
        self.client = Client(open_transport(port))

    def ask(self, command: int, payload: bytes = b"") -> bytes:
        return self.client.request(Msp(command), payload, retries=0)

    def refused(self, command: int, payload: bytes = b"") -> bool:
        try:
            self.client.request(Msp(command) if command in set(Msp) else command, payload, retries=0)  # type: ignore[arg-type]
        except RefusedError:
            return True
        except AttributeError:  # of a number that has no name
            return True
        return False

    def get(self, command: int) -> Values:
        layout = layout_of(Msp(command))
        payload = self.ask(command)
        values = layouts.decode(layout, payload, whole=True)
        assert layouts.encode(layout, values) == payload
        return values

    def payload(self, command: int, **changes: int) -> bytes:
        """What the app sends as `command`: what it was told, but for `changes`."""
        layout = layout_of(Msp(command), Direction.REQUEST)
        told = self.get(GETS[Msp(command)]) | changes
        return layouts.encode(layout, {field.name: told[field.name] for field in layout.fields})

    def settings(self) -> dict[str, float | str]:
        asked = (self.ask(Msp.SETTING_GET, requests.setting_index(index)) for index in range(len(SETTINGS)))
        return {s.name: requests.setting_value(told) for s, told in zip(SETTINGS, asked, strict=True)}

    def change(self, **values: float) -> None:
        for name, value in values.items():
            index = next(i for i, setting in enumerate(SETTINGS) if setting.name == name)
            self.ask(Msp.SETTING_SET, requests.setting_set(index, value, SETTINGS[index].kind))


def stored(values: Mapping[str, float | str]) -> dict[str, float | str]:
    """`values` as the firmware holds them: floats in 32 bits."""
    held = dict(values)
    for setting in SETTINGS:
        if setting.kind == "float":
            (held[setting.name],) = struct.unpack("<f", struct.pack("<f", values[setting.name]))
    return held


@contextmanager
def connected(program: Any) -> Iterator[App]:
    app = App(f"tcp:127.0.0.1:{program.ports['msp']}")
    with app.client:
        yield app
