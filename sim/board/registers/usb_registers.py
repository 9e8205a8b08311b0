"""OTG_FS in the register table: what is modelled, and where the vendor's description is not the manual's.

The manual is RM0431, "USB on-the-go full-speed/high-speed". The description (version 1.3) has these registers
from an older core (its reset values are those of RM0090, the STM32F4), lacks fields, and takes for read-only
what the manual sets. A row below says what it replaces and why. None of it could be held against the manual's
text here: reset values are those of the vendor's description of the STM32MP15's OTG, a later core of the same
family, and of the manual as remembered; bits are those of the vendor's C header (stm32f722xx.h).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

ENDPOINTS = 6  # in each direction (RM0431, OTG_FS features: 1 bidirectional control, 5 IN, 5 OUT)
FIFO_BASE, FIFO_BYTES = 0x50001000, 0x1000  # of each endpoint's window, one after another (CSR memory map)

_ALL = "*"
_IN = "EPENA EPDIS SODDFRM SD0PID_SEVNFRM SNAK CNAK TXFNUM STALL EPTYP NAKSTS EONUM_DPID USBAEP MPSIZ"
_OUT = "EPENA EPDIS SODDFRM SD0PID_SEVNFRM SNAK CNAK STALL EPTYP NAKSTS EONUM_DPID USBAEP MPSIZ"
_OTHERS = range(1, ENDPOINTS)

# As `MODELLED` of extract.py: the registers, and of each the fields that may differ from their reset value.
USB_MODELLED: dict[str, dict[str, str]] = {
    "OTG_FS_GLOBAL": {
        "GOTGCTL": "BVALOEN BVALOVAL CIDSTS ASVLD BSVLD",
        "GOTGINT": _ALL,
        "GAHBCFG": "GINT TXFELVL",
        "GUSBCFG": "TOCAL TRDT FDMOD",
        "GRSTCTL": "CSRST RXFFLSH TXFFLSH TXFNUM AHBIDL",
        "GINTSTS": _ALL,
        "GINTMSK": "MMISM OTGINT SOFM RXFLVLM GINAKEFFM GONAKEFFM ESUSPM USBSUSPM USBRST ENUMDNEM EOPFM "
        "IEPINT OEPINT IISOIXFRM IPXFRM_IISOOXFRM ISOODRPM CIDSCHGM SRQIM WUIM",
        **dict.fromkeys(["GRXSTSR", "GRXSTSP", "GRXFSIZ", "DIEPTXF0", "CID"], _ALL),
        "GCCFG": "PWRDWN VBDEN",
        **{f"DIEPTXF{i}": _ALL for i in _OTHERS},
        **dict.fromkeys(["GSNPSID", "GHWCFG1", "GHWCFG2", "GHWCFG3", "GHWCFG4", "GDFIFOCFG"], _ALL),
    },
    "OTG_FS_DEVICE": {
        "DCFG": "DSPD NZLSOHSK DAD PFIVL",
        "DCTL": "RWUSIG SDIS GINSTS GONSTS SGINAK CGINAK SGONAK CGONAK POPRGDNE",
        **dict.fromkeys(["DSTS", "DIEPMSK", "DOEPMSK", "DAINT", "DAINTMSK", "DIEPEMPMSK"], _ALL),
        "DIEPCTL0": "EPENA EPDIS SNAK CNAK TXFNUM STALL EPTYP NAKSTS USBAEP MPSIZ",
        "DOEPCTL0": "EPENA EPDIS SNAK CNAK STALL EPTYP NAKSTS USBAEP MPSIZ",
        **{f"DIEPCTL{i}": _IN for i in _OTHERS},
        **{f"DOEPCTL{i}": _OUT for i in _OTHERS},
        **{f"{name}{i}": _ALL for name in ("DIEPINT", "DOEPINT", "DTXFSTS") for i in range(ENDPOINTS)},
        **{f"{name}0": _ALL for name in ("DIEPTSIZ", "DOEPTSIZ")},
        **{f"DIEPTSIZ{i}": "PKTCNT XFRSIZ" for i in _OTHERS},
        **{f"DOEPTSIZ{i}": "PKTCNT XFRSIZ" for i in _OTHERS},
    },
    "OTG_FS_PWRCLK": {"PCGCCTL": "STPPCLK GATEHCLK"},
}

# The vendor's names of registers, which carry the peripheral's; those of host mode are second views.
_TITLES = re.compile(r"OTG_FS_(\w+?)(?:_Device)?")
_FIELD_NAMES = {"Stall": "STALL", "SODDFRM_SD1PID": "SODDFRM", "GOUTNAKEFF": "GONAKEFF"}


@dataclass(frozen=True)
class Correction:
    """The facts of a register that the table has instead of the description's."""

    reset: int | None = None
    access: str | None = None  # r, w or rw
    fields: Mapping[str, tuple[int, int, str]] = field(default_factory=dict)  # lsb, width, access
    rights: Mapping[str, str] = field(default_factory=dict)  # of fields that are described otherwise


_STATUS_FLAGS = Correction(  # flags of a transfer that the description lacks
    fields={
        "OUTPKTERR": (8, 1, "rw"),
        "STSPHSRX": (5, 1, "rw"),
        "NAK": (13, 1, "rw"),
        "STPKTRX": (15, 1, "rw"),
    }
)
USB_CORRECTIONS: dict[str, Correction] = {
    # A full-speed core has one transceiver: PHYSEL is read-only and 1; TRDT is 5 after reset.
    "OTG_FS_GLOBAL.GUSBCFG": Correction(reset=0x1440, rights={"PHYSEL": "r"}),
    "OTG_FS_GLOBAL.GRSTCTL": Correction(reset=0x80000000),  # AHBIDL: nothing is under way
    "OTG_FS_GLOBAL.GOTGCTL": Correction(reset=0x00010000),  # CIDSTS: no A plug; DHNPEN is 0
    "OTG_FS_GLOBAL.GRXSTSP": Correction(reset=0),  # the receive FIFO is empty
    "OTG_FS_GLOBAL.CID": Correction(reset=0x3000),  # read from an STM32F723 by TinyUSB's authors
    "OTG_FS_GLOBAL.GINTSTS": Correction(fields={"LPMINT": (27, 1, "rw")}),
    "OTG_FS_DEVICE.DCTL": Correction(reset=0x2),  # SDIS: off the bus until the program wants to be found
    "OTG_FS_DEVICE.DIEPMSK": Correction(fields={"NAKM": (13, 1, "rw")}),
    "OTG_FS_DEVICE.DOEPMSK": Correction(
        fields={"STSPHSRXM": (5, 1, "rw"), "OUTPKTERRM": (8, 1, "rw"), "NAKMSK": (13, 1, "rw")}
    ),
    # "rs": the program sets them, the core clears them.
    "OTG_FS_DEVICE.DIEPCTL0": Correction(rights={"EPENA": "rw", "EPDIS": "rw"}),
    "OTG_FS_DEVICE.DOEPCTL0": Correction(rights={"EPENA": "rw"}),
    **{f"OTG_FS_DEVICE.DOEPINT{i}": _STATUS_FLAGS for i in range(ENDPOINTS)},
    **{
        f"OTG_FS_DEVICE.DIEPINT{i}": Correction(
            reset=0x80, fields={"INEPNM": (5, 1, "rw"), "PKTDRPSTS": (11, 1, "rw"), "NAK": (13, 1, "rw")}
        )
        for i in range(ENDPOINTS)
    },
    **{f"OTG_FS_DEVICE.DTXFSTS{i}": Correction(access="r") for i in (4, 5)},
}

# Sizes of blocks [bytes]: PWRCLK's goes beyond the core's registers, into the first FIFO's window.
USB_SIZES = {"OTG_FS_PWRCLK": 0x200}


def usb_title(peripheral: str, name: str) -> str:
    """Return the manual's name of register `name` of `peripheral`."""
    match = _TITLES.fullmatch(name) if peripheral.startswith("OTG_FS_") else None
    return match[1] if match else name


def usb_field(peripheral: str, name: str) -> str:
    """Return the one name of a field that the description spells in several ways."""
    return _FIELD_NAMES.get(name, name) if peripheral.startswith("OTG_FS_") else name


def usb_fifos() -> dict[str, dict[str, object]]:
    """Return the FIFOs' windows as peripherals of the table (RM0431, CSR memory map), which has none of them.

    A word written to the first one of a window goes into that endpoint's transmit FIFO, one read from any of
    them comes out of the receive FIFO. The chip answers in all words of a window, the emulator in the first.
    """
    return {
        f"OTG_FS_FIFO{i}": {
            "base": f"0x{FIFO_BASE + i * FIFO_BYTES:X}",
            "size": f"0x{FIFO_BYTES:X}",
            "registers": [_row("DFIFO", 0, 0, "rw")],
        }
        for i in range(ENDPOINTS)
    }


def _row(name: str, offset: int, reset: int, access: str) -> dict[str, object]:
    return {
        "name": name,
        "offset": f"0x{offset:X}",
        "reset": f"0x{reset:X}",
        "access": access,
        "sizes": [4],
        "fields": {name: [0, 32, access, 1]},
    }


# Registers that the description lacks, as rows of the table. The core's identification is in no manual; other
# people's drivers read it. Its values are those that TinyUSB's authors read from an STM32F723 (GHWCFG3 tells
# 512 words of RAM, which the chip has not).
USB_STATED: dict[str, list[dict[str, object]]] = {
    "OTG_FS_GLOBAL": [
        _row("GSNPSID", 0x40, 0x4F54330A, "r"),
        _row("GHWCFG1", 0x44, 0, "r"),
        _row("GHWCFG2", 0x48, 0x229ED520, "r"),
        _row("GHWCFG3", 0x4C, 0x0200D1E8, "r"),
        _row("GHWCFG4", 0x50, 0x17F08030, "r"),
        # In the vendor's C header, not in the manual; without effect here, its reset value is not known.
        _row("GDFIFOCFG", 0x5C, 0, "rw"),
    ]
}
