"""Files for logs in the folder of a mounted card; which folders and devices are never written to."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.card.files import carry_out, file_name, plan_files
from neuroflight.flash.card.folder import FolderCard
from neuroflight.flash.card.place import check_device, check_folder, disks_of, open_card, read_mounts
from neuroflight.toolchain.errors import CardError

SIZE = 3 << 20
MOUNTS = r"""22 1 8:2 / / rw - ext4 /dev/sda2 rw
23 22 8:1 / /boot/efi rw - vfat /dev/sda1 rw
24 22 8:17 / /media/me/MY\040CARD rw shared:1 - vfat /dev/sdb1 rw
25 22 8:33 / /media/me/X rw - exfat /dev/sdc1 rw
26 22 253:0 / /home rw - ext4 /dev/mapper/vg-home rw
27 22 8:49 / /mnt/more rw - vfat /dev/sdd1 rw
"""


@pytest.fixture
def blocks(tmp_path: Path) -> Path:
    """A /sys/dev/block with disks sda..sdd; /home lies on sdd by LVM."""
    devices, links = tmp_path / "devices", tmp_path / "dev"
    links.mkdir()
    for number, disk in enumerate(("sda", "sdb", "sdc", "sdd")):
        for part in (0, 1, 2):
            folder = devices / disk / (f"{disk}{part}" if part else "")
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "dev").write_text(f"8:{16 * number + part}\n")
            if part:
                (folder / "partition").write_text(f"{part}\n")
            (links / f"8:{16 * number + part}").symlink_to(folder)
    mapper = devices / "dm-0"
    (mapper / "slaves").mkdir(parents=True)
    (mapper / "slaves" / "sdd2").symlink_to(devices / "sdd" / "sdd2")
    (links / "253:0").symlink_to(mapper)
    return links


def test_files_are_made_kept_and_emptied(tmp_path: Path) -> None:
    card = FolderCard(tmp_path, None)
    plan = plan_files(card.files(), 10 * SIZE, SIZE, 3)
    files = carry_out(card, plan, lambda *_: None)
    assert [(f.name, f.bytes, f.blank, f.whole) for f in files] == [
        (file_name(k), SIZE, True, None) for k in (1, 2, 3)
    ]
    log = tmp_path / "LOG00001.BBL"
    with log.open("r+b") as file:
        file.write(b"H Product")
    assert [file.blank for file in card.files()] == [False, True, True]
    with pytest.raises(CardError, match="it is there already"):
        card.create("LOG00001.BBL", SIZE, lambda _: None)
    assert log.read_bytes()[:9] == b"H Product"
    card.clear("LOG00001.BBL", lambda _: None)
    assert log.read_bytes() == bytes(SIZE)


def test_a_file_that_was_interrupted_is_not_there(tmp_path: Path) -> None:
    card = FolderCard(tmp_path, None)

    def interrupt(done: int) -> None:
        if done > SIZE // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        card.create("LOG00001.BBL", SIZE, interrupt)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "LOG00001.NEW").write_bytes(b"cut off by a power failure")
    assert card.files() == []
    card.create("LOG00001.BBL", SIZE, lambda _: None)
    assert [path.name for path in tmp_path.iterdir()] == ["LOG00001.BBL"]
    assert (tmp_path / "LOG00001.BBL").read_bytes() == bytes(SIZE)


def test_mounts_are_read_with_blanks_in_their_names() -> None:
    mount = read_mounts(MOUNTS)[2]
    assert (mount.number, str(mount.point), mount.kind) == ("8:17", "/media/me/MY CARD", "vfat")


def test_disks_are_found_through_partitions_and_layers(blocks: Path) -> None:
    assert disks_of("8:17", blocks) == {"sdb"} == disks_of("8:16", blocks)
    assert disks_of("253:0", blocks) == {"sdd"}
    assert disks_of("9:9", blocks) == set()


FOLDERS = {
    "/media/me/X": "its file system is exFAT, expected a card's with FAT32",
    "/tmp": "its file system is ext4",
    "/boot/efi": "system disk",
    "/mnt/more": "system disk",  # /home lies on it
    "/media/me/MY CARD/DCIM": "expected the card's root, where the firmware looks; name /media/me/MY CARD",
}


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_that_are_no_card_are_refused(folder: str, blocks: Path) -> None:
    with pytest.raises(CardError, match=FOLDERS[folder]):
        check_folder(Path(folder), read_mounts(MOUNTS), blocks)


DEVICES = {
    "8:0": "system disk",
    "8:1": "system disk",
    "8:48": "system disk",
    "8:16": "mounted at /media/me/MY CARD",  # the disk of a mounted partition
    "8:18": "mounted at /media/me/MY CARD",  # its neighbour: cards have one
}


@pytest.mark.parametrize("number", DEVICES)
def test_devices_of_the_system_and_mounted_ones_are_refused(number: str, blocks: Path) -> None:
    with pytest.raises(CardError, match=DEVICES[number]):
        check_device(Path("/dev/x"), number, read_mounts(MOUNTS), blocks)


def test_a_device_of_its_own_is_taken(blocks: Path) -> None:
    mounts = [mount for mount in read_mounts(MOUNTS) if mount.number != "8:17"]
    check_device(Path("/dev/sdb"), "8:16", mounts, blocks)


def test_a_place_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CardError, match="no such file or directory, expected a mounted card's folder"):
        open_card(tmp_path / "nothing")
