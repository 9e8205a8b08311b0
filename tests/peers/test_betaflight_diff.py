"""Betaflight's SITL as the judge: it is told settings over MSP and prints them as `diff all` or `dump`.

Brought over from that, this firmware tells the same over MSP.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import Transport, open_transport
from neuroflight.toolchain.contract import Mode, Msp
from tests.firmware.conftest import Program

CRAFT = 2  # a kind of GET_TEXT and SET_TEXT; SITL does not print the pilot's
RATES_TYPES = {0: "BETAFLIGHT", 3: "ACTUAL"}
WAIT_S = 20.0


def tell(client: Client, rng: random.Random) -> None:
    """Set what has a counterpart to values that both firmwares take."""
    kind = rng.choice(list(RATES_TYPES))
    rc, top = ((30, 150), (10, 70)) if kind == 0 else ((2, 40), (41, 140))
    rates = [rng.randint(*rc) for _ in range(3)] + [rng.randint(*top) for _ in range(3)]
    expo = [rng.randint(1, 99) for _ in range(3)]
    told = bytes([rates[0], expo[0], *rates[3:], 0, 50, 0]) + struct.pack("<H", 0)
    told += (
        bytes([expo[2], rates[2], rates[1], expo[1], 0, 100])
        + struct.pack("<3H", 1998, 1998, 1998)
        + bytes([kind])
    )
    client.request(Msp.SET_RC_TUNING, told)
    client.request(Msp.SET_RX_MAP, bytes(rng.sample(range(4), 4) + rng.sample(range(4, 8), 4)))
    for slot, mode in enumerate((Mode.ARM, Mode.BEEPER, Mode.BLACKBOX)):
        low = rng.randint(0, 40)
        client.request(
            Msp.SET_MODE_RANGE, bytes([slot, mode, rng.randint(0, 11), low, rng.randint(low + 1, 48), 0, 0])
        )
    client.request(
        Msp.SET_FAILSAFE_CONFIG,
        struct.pack(
            "<BBHBHB",
            rng.randint(4, 150),
            rng.randint(0, 25),
            rng.randint(1000, 2000),
            0,
            100,
            rng.randint(0, 1),
        ),
    )
    low = rng.randint(280, 330)
    warn = rng.randint(340, 400)
    client.request(
        Msp.SET_BATTERY_CONFIG,
        struct.pack("<BBBHBBHHH", low // 10, 43, warn // 10, rng.randint(1, 9000), 1, 1, low, 430, warn),
    )
    client.request(Msp.SET_MIXER_CONFIG, bytes([3, rng.randint(0, 1)]))
    client.request(
        Msp.SET_BOARD_ALIGNMENT_CONFIG, struct.pack("<3h", *(rng.randint(-179, 179) for _ in range(3)))
    )
    client.request(Msp.SET_RC_DEADBAND, struct.pack("<BBBH", rng.randint(0, 32), rng.randint(0, 100), 40, 50))
    client.request(Msp.SET_ARMING_CONFIG, bytes([5, 0, rng.randint(1, 179)]))
    name = "".join(rng.choices("abcdefgh IJKLM-.", k=rng.randint(2, 15))).strip() or "x"
    client.request(Msp.SET_TEXT, bytes([CRAFT, len(name)]) + name.encode())


def heard(client: Client) -> dict[str, object]:
    """Read those settings from a firmware."""
    rates = client.request(Msp.RC_TUNING)
    modes = client.request(Msp.MODE_RANGES)
    shared = {Mode.ARM, Mode.BEEPER, Mode.BLACKBOX}
    failsafe = struct.unpack_from("<BBHBHB", client.request(Msp.FAILSAFE_CONFIG))
    battery = struct.unpack_from("<BBBHBBHHH", client.request(Msp.BATTERY_CONFIG))
    return {
        "rates": (rates[0:5], rates[10:14], rates[22]),
        "map": client.request(Msp.RX_MAP)[:8],
        "modes": {
            modes[at : at + 4]
            for at in range(0, 80, 4)
            if modes[at] in shared and modes[at + 2] < modes[at + 3]
        },
        "failsafe": (*failsafe[:3], failsafe[5]),
        "battery": (battery[3], battery[6], battery[8]),
        "reversed": client.request(Msp.MIXER_CONFIG)[1],
        "board": struct.unpack_from("<3h", client.request(Msp.BOARD_ALIGNMENT_CONFIG)),
        "deadbands": client.request(Msp.RC_DEADBAND)[:2],
        "angle": client.request(Msp.ARMING_CONFIG)[2],
        "name": client.request(Msp.GET_TEXT, bytes([CRAFT])),
    }


def printed(line: Transport, command: str) -> str:
    """Return what Betaflight's command line prints for `command`."""
    end = "# end the command batch\r\n" if command == "dump" else "# save configuration\r\nsave"
    line.write(b"#")  # sent alone: it drops characters that come within 100 ms
    _read(line, "# ")
    line.write(f"{command}\r\n".encode())
    return _read(line, end)


def _read(line: Transport, end: str) -> str:
    told = b""
    while end.encode() not in told:
        piece = line.read(WAIT_S)
        assert piece, told[-200:]
        told += piece
    return told.decode()


@pytest.mark.parametrize(("seed", "command"), [(1, "diff all"), (2, "diff all"), (3, "dump")])
def test_this_firmware_tells_what_betaflight_told_when_its_print_is_imported(
    betaflight_port: int,
    start_host: Callable[..., Program],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    seed: int,
    command: str,
) -> None:
    rng = random.Random(seed)
    file, line = tmp_path / "print.txt", open_transport(f"tcp:127.0.0.1:{betaflight_port}")
    with Client(line) as betaflight:
        tell(betaflight, rng)
        wanted = heard(betaflight)
        file.write_text(printed(line, command))
    port = f"tcp:127.0.0.1:{start_host().ports['msp']}"
    assert main(["board", "settings", "import", str(file), "--yes", "--port", port]) == 0, (
        capsys.readouterr().err
    )
    with Client(open_transport(port)) as ours:
        assert heard(ours) == wanted
