"""The configuration that a BMI270 needs before it measures: its maker's file, which the user gives.

Bosch publishes it as C: one array of bytes in bmi270_maximum_fifo.c of its BMI270_SensorAPI. It is read as
text, nothing of it is executed, and it is stamped into the image as it is.
"""

from __future__ import annotations

import re
from pathlib import Path

from neuroflight.toolchain.contract import GYRO_FILE_BYTES, GYRO_FILES, GyroChip
from neuroflight.toolchain.errors import BuildError

TEXT_MAX = 1 << 20  # bytes that are read of the file; its longer kin has 0.4 MB
_BEGIN = bytes.fromhex("c82e002e")  # what all configurations of this chip begin with
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_ARRAY = re.compile(r"\[[^\[\]]{0,99}\]\s*=\s*\{([^{}]*)\}")
_BYTE = re.compile(r"0[xX][0-9a-fA-F]{1,2}")


def read_gyro_file(path: Path) -> bytes:
    """Return the configuration in a file: GYRO_FILE_BYTES. Raises BuildError, one line: it holds none."""
    wanted = f"expected {GYRO_FILES[GyroChip.BMI270]}"
    try:
        with path.open("rb") as stream:
            data = stream.read(TEXT_MAX + 1)
    except OSError as error:
        raise BuildError(f"--gyro-file {path}: {error.strerror}; {wanted}") from error
    if len(data) > TEXT_MAX:
        raise BuildError(f"--gyro-file {path}: it has more than {TEXT_MAX:,} bytes; {wanted}")
    found = [_bytes(body) for body in _ARRAY.findall(_COMMENT.sub(" ", data.decode("ascii", "replace")))]
    arrays = [array for array in found if array]
    if len(arrays) != 1:
        raise BuildError(f"--gyro-file {path}: got {len(arrays)} arrays of hexadecimal bytes; {wanted}")
    (array,) = arrays
    if len(array) != GYRO_FILE_BYTES:
        raise BuildError(
            f"--gyro-file {path}: its array has {len(array)} bytes, expected the {GYRO_FILE_BYTES} of the "
            f"short configuration; {wanted}"
        )
    if not array.startswith(_BEGIN):
        raise BuildError(
            f"--gyro-file {path}: it begins with {array[:4].hex()}, a BMI270's with {_BEGIN.hex()}; {wanted}"
        )
    return array


def _bytes(body: str) -> bytes:
    """Return an array's bytes; none, if something else is in it."""
    words = [word for word in (word.strip() for word in body.split(",")) if word]
    return bytes(int(word, 16) for word in words) if all(map(_BYTE.fullmatch, words)) else b""
