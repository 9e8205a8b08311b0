"""The gyro chips that a board may carry: by the words of configurations, and by those of the firmware."""

from __future__ import annotations

from collections.abc import Iterable

# By `enum gyro_chip` of the firmware, which is a chip's place here.
GYRO_CHIPS = (
    *("MPU6500", "ICM20689", "ICM20602", "ICM20601", "ICM20608G", "MPU9250", "MPU6000"),
    *("ICM42688P", "ICM42605", "BMI270", "LSM6DSV16X", "LSM6DSK320X"),
)
FLOWN = GYRO_CHIPS[:9]  # that the firmware has a driver for
# A configuration names a driver of Betaflight's, and makers fit what that driver takes as well: boards called
# MATEKF722, which tells MPU6500, carry an ICM-20602.
_KIN = {
    "MPU6500": ("MPU6500", "MPU9250", "ICM20601", "ICM20602", "ICM20608G"),
    "MPU9250": ("MPU9250", "MPU6500"),
    "ICM42688P": ("ICM42688P", "ICM42605"),
    "ICM42605": ("ICM42605", "ICM42688P"),
}


def with_kin(told: Iterable[str]) -> tuple[str, ...]:
    """Return the chips that boards carry whose configuration tells these, in the firmware's order."""
    meant = {kin for kind in told for kin in _KIN.get(kind, (kind,))}
    return tuple(chip for chip in GYRO_CHIPS if chip in meant)
