"""hal/host/flash_file.c: the file that the host program's flash lies in, when the machine lets it down."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.link import records, requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import SETTINGS, Msp
from neuroflight.toolchain.errors import LinkError

Start = Callable[..., Any]
PORTS = [f"--{name}-port=0" for name in ("state", "receiver", "power", "msp")]
GYRO_RATE = [setting.name for setting in SETTINGS].index("gyro_rate_hz")
END_S = 10.0  # for a program that should end at once


def ask(p: Any) -> Client:
    return Client(open_transport(f"tcp:127.0.0.1:{p.ports['msp']}"))


def set_gyro_rate(client: Client, rate_hz: int) -> None:
    client.request(Msp.SETTING_SET, requests.setting_set(GYRO_RATE, rate_hz, kind="uint32_t"))
    client.request(Msp.EEPROM_WRITE)


def gyro_rate(client: Client) -> float:
    told = client.request(Msp.SETTING_GET, requests.setting_index(GYRO_RATE))
    return float(requests.setting_value(told))


def refusal_of(build: Path, flash: Path, preexec_fn: Callable[[], None] | None = None) -> str:
    """The one line of a program that does not start."""
    command = [str(build / "neuroflight"), f"--settings={flash}", *PORTS]
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=preexec_fn, timeout=END_S)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    return done.stderr


def limit_file_size() -> None:
    """A file may not become as large as the flash: to a program the same as a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (contract.FLASH_BYTES // 2,) * 2)


def test_nothing_is_left_when_there_is_no_space_for_a_new_file(scripted_build: Path, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    words = refusal_of(scripted_build, flash, limit_file_size)
    assert words.startswith(f"neuroflight: flash file {flash}: File too large")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("zeros", [bytes(contract.FLASH_BYTES), b"\xff" * 0x60000 + bytes(0x20000)])
def test_a_file_that_was_not_written_whole_is_left_alone_when_given(
    scripted_build: Path, tmp_path: Path, zeros: bytes
) -> None:
    flash = tmp_path / "flash.bin"
    flash.write_bytes(zeros)
    assert f"flash file {flash}: a sector of it is all zeros" in refusal_of(scripted_build, flash)
    assert flash.read_bytes() == zeros


def test_an_empty_file_is_left_alone_when_given(scripted_build: Path, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    flash.touch()
    assert "it has another size" in refusal_of(scripted_build, flash)
    assert flash.stat().st_size == 0


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_the_program_ends_when_the_file_is_none(scripted_build: Path, tmp_path: Path, kind: str) -> None:
    flash = Path("/dev/zero")
    if kind == "pipe":
        flash = tmp_path / "pipe"
        os.mkfifo(flash)
    assert f"flash file {flash}: it is no file" in refusal_of(scripted_build, flash)


def test_a_second_program_is_refused_when_the_first_runs(
    start: Start, scripted_build: Path, tmp_path: Path
) -> None:
    flash = tmp_path / "flash.bin"
    first = start(f"--settings={flash}")
    assert f"flash file {flash}: another program uses it" in refusal_of(scripted_build, flash)
    first.process.kill()
    first.process.wait()
    second = start(f"--settings={flash}")
    with ask(second) as client:
        assert records.faults(client.request(Msp.FAULTS)).boots == 2


@pytest.mark.parametrize("left", [0, 5000])
def test_all_settings_are_in_the_file_again_when_it_was_cut_short_meanwhile(
    start: Start, tmp_path: Path, left: int
) -> None:
    flash = tmp_path / "flash.bin"
    first = start(f"--settings={flash}")
    with ask(first) as client:
        set_gyro_rate(client, 2000)
        before = flash.read_bytes()
        os.truncate(flash, left)
        assert gyro_rate(client) == 2000
        set_gyro_rate(client, 8000)
    after = flash.read_bytes()
    assert len(after) == contract.FLASH_BYTES
    log = contract.FLASH_FAULT_RECORD.address - contract.FLASH_BASE
    assert after[log:] == before[log:]
    first.end()
    with ask(start(f"--settings={flash}")) as client:
        assert gyro_rate(client) == 8000
        assert records.faults(client.request(Msp.FAULTS)).boots == 2


def test_saving_is_refused_when_the_file_was_removed_meanwhile(start: Start, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    p = start(f"--settings={flash}")
    flash.unlink()
    with ask(p) as client, pytest.raises(LinkError, match="refuses MSP EEPROM_WRITE"):
        set_gyro_rate(client, 2000)
    assert not flash.exists()


def test_saving_is_refused_and_the_file_whole_when_it_may_not_grow_back(start: Start, tmp_path: Path) -> None:
    """The limit comes while the program runs, as a disk fills up."""
    flash = tmp_path / "flash.bin"
    p = start(f"--settings={flash}")
    whole = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    with ask(p) as client:
        os.truncate(flash, 0)
        resource.prlimit(p.process.pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        with pytest.raises(LinkError, match="refuses MSP EEPROM_WRITE"):
            set_gyro_rate(client, 2000)
        resource.prlimit(p.process.pid, resource.RLIMIT_FSIZE, whole)
        client.request(Msp.EEPROM_WRITE)
    p.end()
    with ask(start(f"--settings={flash}")) as client:
        assert gyro_rate(client) == 2000


def test_the_program_says_so_when_nobody_can_read_its_ports(scripted_build: Path) -> None:
    with Path("/dev/full").open("w") as full:
        command = [str(scripted_build / "neuroflight"), *PORTS]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=END_S)
    assert done.returncode == 1
    assert done.stderr.startswith("neuroflight: cannot write to stdout: No space left on device")
    assert done.stderr.count("\n") == 1
