"""Parts that are fitted to a board: gyro chip and how it is turned, pack; its wiring by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.board.devices.gyro_bmi import BMI270
from neuroflight.sim.board.devices.gyro_chip import GyroKind
from neuroflight.sim.board.devices.gyro_icm import ICM42605, ICM42688P
from neuroflight.sim.board.devices.gyro_lsm import LSM6DSK320X, LSM6DSV16X
from neuroflight.sim.board.devices.gyro_mount import board_axes
from neuroflight.sim.board.devices.gyro_mpu import (
    ICM20601,
    ICM20602,
    ICM20608G,
    ICM20689,
    MPU6000,
    MPU6500,
    MPU9250,
)
from neuroflight.toolchain.boards import facts
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.board_file import board_beside
from neuroflight.toolchain.boards.description import described
from neuroflight.toolchain.boards.gyro_kinds import FILES
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    SIM_BATTERY_MV,
    SIM_GYRO_ALIGNMENT,
    Alignment,
    image_header,
)
from neuroflight.toolchain.errors import LinkError, WiringError


@dataclass(frozen=True)
class Gyro:
    """A gyro chip as it sits on the board."""

    chip: GyroKind
    alignment: Alignment  # of the chip on the board
    turn_deg: facts.Turn = facts.NOT_TURNED  # of the board by its maker

    @property
    def to_board(self) -> NDArray[np.float64] | None:
        """The matrix from the body's axes to the board's; None: they are the same."""
        return board_axes(self.turn_deg).T if any(self.turn_deg) else None


_CW180 = Alignment(SIM_GYRO_ALIGNMENT)
GYROS = {
    "icm20602": Gyro(ICM20602, _CW180),  # F722-STD and F722-OSD
    "mpu6500": Gyro(MPU6500, _CW180),  # boards of before
    "icm20689": Gyro(ICM20689, Alignment.CW90),  # sources disagree, CW180 is said too
    # No board with these is known: how they are turned is the pilot's to say.
    "icm20601": Gyro(ICM20601, _CW180),
    "icm20608g": Gyro(ICM20608G, _CW180),
    "mpu9250": Gyro(MPU9250, _CW180),
    "mpu6000": Gyro(MPU6000, _CW180),
    "icm42688p": Gyro(ICM42688P, _CW180),
    "icm42605": Gyro(ICM42605, _CW180),
    "bmi270": Gyro(BMI270, _CW180),
    "lsm6dsv16x": Gyro(LSM6DSV16X, _CW180),
    "lsm6dsk320x": Gyro(LSM6DSK320X, _CW180),
}
GYRO = GYROS["icm20602"]
FULL_VOLTS = SIM_BATTERY_MV / 1000  # four cells, full, at rest
MATEKF722 = find_board("MATEKF722")


def fitted_gyro(board: facts.Board, place: int = 0, kind: str | None = None) -> Gyro:
    """Return a gyro that boards of this name carry, or one of that kind, turned as the board's.

    Raises LinkError: none is modelled.
    """
    if board.name == MATEKF722.name:
        return GYRO if kind is None else GYROS[kind]  # of each it is known how it is turned, or disputed
    kinds = sorted(board.gyro_kinds, key=FILES.__contains__)  # what its image may lack comes last
    for one in kinds if kind is None else (kind,):
        if (known := GYROS.get(one.lower())) is not None:
            return Gyro(known.chip, Alignment(board.gyros[place].alignment), board.turn_deg)
    told = ", ".join(board.gyro_kinds) or "none that is told"
    raise LinkError(f"{board.name}: the emulated board has none of its gyros: {told}; name one (--gyro)")


@dataclass(frozen=True)
class Lines:
    """The UARTs that an image uses, by number; None: it has none for that."""

    receiver: int
    msp: int | None
    second: int | None  # the second serial port


def image_lines(flashed: bytes, wiring: facts.Board, receiver: int | None = None) -> Lines:
    """Return the UARTs that an image in either bank uses, as its description tells them.

    receiver: UART that one is wired to, instead. Without an image: those that one would use.
    """
    told = (described(flashed[bank.address - FLASH_BASE :]) for bank in FLASH_BANKS)
    if receiver is None and (found := next((one for one in told if one), None)) is not None:
        msp, second = (found[name]["number"] or None for name in ("msp", "second"))
        return Lines(found["receiver"]["number"], msp, second)
    served = allocate(wiring, receiver)
    return Lines(served.receiver, served.msp, served.second)


def image_wiring(path: Path, flashed: bytes) -> facts.Board:
    """Return the wiring of the board that an image is for: what its build wrote beside it, else the table's.

    path: of its file; flashed: content of flash, the image in either bank. Raises LinkError if neither knows
    its name.
    """
    banks = (image_header(flashed[bank.address - FLASH_BASE :]) for bank in FLASH_BANKS)
    names = (header.board for header in banks if header is not None)
    try:
        return board_beside(path, next(names, ""))
    except WiringError as error:
        raise LinkError(f"{path}: {error}") from None
