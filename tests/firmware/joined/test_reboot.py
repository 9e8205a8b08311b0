"""Starts into something else: by the letter of programs without REBOOT (USB, alone), and to show the card."""

from __future__ import annotations

import pytest

from neuroflight.toolchain.contract import (
    MSP_PORT_COUNT,
    MSP_PORT_USB,
    MSP_ROM_SILENCE_MS,
    Msp,
    Reboot,
    Refusal,
)
from tests.firmware.conftest import Core
from tests.firmware.joined.ground import API_VERSION, Ground, Request


class Asked:
    """A firmware on the ground, and the restarts that its board was asked for."""

    def __init__(self, core: Core) -> None:
        self.ground = Ground(core)
        self.kinds: list[int] = []
        self._kept = core.ffi.callback("bool(void *, uint8_t)", self._reset)
        self.ground.hal.reset = self._kept
        self.ground.get_ready()

    def _reset(self, context: object, kind: int) -> bool:
        self.kinds.append(kind)
        return True


@pytest.fixture
def asked(scripted: Core) -> Asked:
    return Asked(scripted)


def test_it_is_heard_on_usb_and_nothing_arms_from_then_on(asked: Asked) -> None:
    assert asked.ground.send(b"R", MSP_PORT_USB) == b""
    assert asked.kinds == [Reboot.ROM]
    assert asked.ground.background.rebooting


@pytest.mark.parametrize("port", [port for port in range(MSP_PORT_COUNT) if port != MSP_PORT_USB])
def test_it_is_noise_on_every_other_line(asked: Asked, port: int) -> None:
    asked.ground.send(b"R", port)
    assert asked.kinds == [] and asked.ground.answers(port)


@pytest.mark.parametrize("said", [b"RR", b"AT+GMR", b"R\n", b"r", b"$", b"$M<R"])
def test_it_is_heard_only_alone(asked: Asked, said: bytes) -> None:
    asked.ground.send(said, MSP_PORT_USB)
    asked.ground.run(MSP_ROM_SILENCE_MS // 2)
    asked.ground.send(b"R", MSP_PORT_USB)
    assert asked.kinds == []


def test_it_is_a_letter_within_a_frame_and_in_a_command_line(asked: Asked) -> None:
    for before in (API_VERSION[:3], b"#"):
        asked.ground.send(before, MSP_PORT_USB)
        asked.ground.run(2 * MSP_ROM_SILENCE_MS)
        asked.ground.send(b"R", MSP_PORT_USB)
        asked.ground.leave(MSP_PORT_USB)
    assert asked.kinds == []


def test_it_does_nothing_while_armed(asked: Asked) -> None:
    asked.ground.take_off()
    asked.ground.send(b"R", MSP_PORT_USB)
    assert asked.kinds == [] and asked.ground.armed


@pytest.mark.parametrize("kind", [Reboot.CARD, Reboot.CARD_UTC])
def test_the_card_is_shown_on_request_but_not_while_armed_or_on_probation(asked: Asked, kind: Reboot) -> None:
    """A start that shows the card proves nothing of a new image, but counts as one."""
    ground, request = asked.ground, Request(Msp.REBOOT, bytes([kind]))
    probation = ground.background.probation
    probation.present, probation.confirmed = True, False
    assert not ground.ask(request) and ground.reason == Refusal.ORDER
    probation.confirmed = True
    ground.take_off()
    assert not ground.ask(request) and ground.reason == Refusal.ARMED
    assert asked.kinds == []
    ground.channels[4] = 1000
    ground.channels[2] = 1000
    ground.run(1000)
    assert not ground.armed
    assert ground.ask(request)
    assert asked.kinds == [Reboot.CARD] and ground.background.rebooting
