"""The card that the user's path names: a mounted card, an image or a device; system disks are refused."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.card.fat32 import FORMAT, Fat32
from neuroflight.flash.card.files import Card
from neuroflight.flash.card.folder import FolderCard
from neuroflight.flash.card.image import ImageCard
from neuroflight.toolchain.errors import CardError

MOUNTS, BLOCKS = Path("/proc/self/mountinfo"), Path("/sys/dev/block")
FAT, FAT_NAMES = ("vfat", "msdos"), {"exfat": "exFAT", "fuseblk": "NTFS or exFAT"}
SYSTEM = ("/", "/boot", "/boot/efi", "/efi", "/boot/firmware", "/usr", "/var", "/home")
FAT16_CLUSTERS_MAX = 65_524  # of Microsoft's specification


@dataclass(frozen=True)
class Mount:
    """A mounted file system."""

    number: str  # major:minor of its device
    point: Path
    kind: str
    device: str


def read_mounts(text: str) -> list[Mount]:
    """Parse the lines of /proc/self/mountinfo."""
    found = []
    for line in text.splitlines():
        words = line.split()
        kind, device = words[words.index("-") + 1 :][:2]
        found.append(Mount(words[2], Path(_unescaped(words[4])), kind, _unescaped(device)))
    return found


def _unescaped(word: str) -> str:
    """Replace the octal escapes of blanks in a path of mountinfo."""
    for escape, meant in (("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")):
        word = word.replace(escape, meant)
    return word


def disks_of(number: str, blocks: Path = BLOCKS) -> set[str]:
    """Return the names of the disks below the device `number` (major:minor), through layers such as LVM."""
    device = blocks / number
    if not device.exists():
        return set()
    if below := _disks_below(device):
        return below
    place = device.resolve()
    return {(place.parent if (place / "partition").exists() else place).name}


def _disks_below(device: Path) -> set[str]:
    slaves = device / "slaves"
    found: set[str] = set()
    for slave in slaves.iterdir() if slaves.is_dir() else []:
        found |= disks_of((slave / "dev").read_text().strip(), device.parent)
    return found


def open_card(place: Path) -> Card:
    """Open the card that `place` names. Raises CardError for anything that must not be written."""
    mounts = read_mounts(MOUNTS.read_text()) if MOUNTS.exists() else []
    try:
        facts = place.stat()
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise CardError(
            f"{place}: {why}, expected a mounted card's folder, an image file or a device"
        ) from None
    if stat.S_ISDIR(facts.st_mode):
        return FolderCard(place, check_folder(place.resolve(), mounts))
    if stat.S_ISBLK(facts.st_mode):
        number = f"{os.major(facts.st_rdev)}:{os.minor(facts.st_rdev)}"
        check_device(place, number, mounts)
    elif not stat.S_ISREG(facts.st_mode):
        raise CardError(f"{place}: it is a pipe or the like, expected a folder, an image file or a device")
    return ImageCard(place)


def check_folder(folder: Path, mounts: Sequence[Mount], blocks: Path = BLOCKS) -> Path | None:
    """Return the device mounted at `folder`. Raises CardError unless it is the root of a FAT32 card."""
    if not mounts:  # not Linux: what is mounted cannot be seen, and files alone do no harm
        return None
    mount = max(
        (mount for mount in mounts if folder.is_relative_to(mount.point)),
        key=lambda mount: len(mount.point.parts),
    )
    if mount.kind not in FAT:
        kind = FAT_NAMES.get(mount.kind, mount.kind)
        raise CardError(
            f"{folder}: its file system is {kind}, expected a card's with FAT32; name the folder where the "
            f"card is mounted, and if that is this one {FORMAT}"
        )
    if _is_system(mount.number, mounts, blocks) or str(mount.point) in SYSTEM:
        raise CardError(
            f"{folder}: it lies on this computer's system disk, expected a card; nothing was written"
        )
    if folder != mount.point:
        raise CardError(
            f"{folder}: a folder on the card {mount.point}, expected the card's root, where the firmware "
            f"looks; name {mount.point}"
        )
    device = Path(mount.device)
    _check_fat32(folder, device)
    return device


def _check_fat32(folder: Path, device: Path) -> None:
    """Raise CardError for FAT12 and FAT16, which are mounted under the same name."""
    try:
        with device.open("rb") as file:
            Fat32(file, str(folder))
    except OSError:  # this user may not read it
        clusters = os.statvfs(folder).f_blocks
        if clusters <= FAT16_CLUSTERS_MAX:
            raise CardError(
                f"{folder}: its file system has {clusters:,} clusters, as FAT16 has, expected FAT32; {FORMAT}"
            ) from None


def check_device(place: Path, number: str, mounts: Sequence[Mount], blocks: Path = BLOCKS) -> None:
    """Raise CardError for a disk of the system, and for a device of which something is mounted."""
    if _is_system(number, mounts, blocks):
        raise CardError(f"{place}: it is this computer's system disk, expected a card; nothing was written")
    disks = disks_of(number, blocks)
    for mount in mounts:
        if mount.number == number or (disks and disks_of(mount.number, blocks) & disks):
            raise CardError(
                f"{place}: it is mounted at {mount.point}, expected one that is not; name that folder, "
                "or unmount it first"
            )


def _is_system(number: str, mounts: Sequence[Mount], blocks: Path) -> bool:
    ours = disks_of(number, blocks)
    return any(
        mount.number == number or ours & disks_of(mount.number, blocks) for mount in _system_mounts(mounts)
    )


def _system_mounts(mounts: Sequence[Mount]) -> Iterator[Mount]:
    return (mount for mount in mounts if str(mount.point) in SYSTEM)
