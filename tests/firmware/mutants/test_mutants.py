"""The core with one mistake each: the tests of its rooms notice all of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.firmware.mutants.__main__ import SURVIVORS_MAX, main, try_out, where
from tests.firmware.mutants.mutant import Mutant, MutantError
from tests.firmware.mutants.table import MUTANTS
from tests.firmware.mutants.workshop import ROOT, Workshop

FIRMWARE = ROOT / "firmware"


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """A copy of the checkout."""
    return Workshop(tmp_path_factory.mktemp("mutants"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [m.name for m in MUTANTS], ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_is_noticed_when_the_core_makes_it(workshop: Workshop, name: str) -> None:
    (mutant,) = (m for m in MUTANTS if m.name == name)
    verdict = workshop.try_out(mutant)
    print(verdict.caught_by or "survived")
    assert verdict.as_told, verdict.caught_by or "no test fails"


@pytest.mark.slow
def test_the_tests_pass_when_there_is_no_mistake(workshop: Workshop) -> None:
    assert workshop.test(sorted({test for mutant in MUTANTS for test in mutant.tests})) == ""


@pytest.mark.slow
def test_nothing_is_said_of_a_mutant_when_it_has_no_place_or_does_not_compile(workshop: Workshop) -> None:
    some = MUTANTS[0]
    source = some.source(workshop.folder / "firmware")
    before = source.read_text()
    with pytest.raises(MutantError, match=r"'no such text' is found 0 times, expected once"):
        workshop.try_out(replace(some, old="no such text"))
    with pytest.raises(MutantError, match=rf"(?s)mutant {some.name}: it does not compile:.*error: "):
        workshop.try_out(replace(some, new="+"))
    with pytest.raises(MutantError, match="its tests do not run"):
        workshop.try_out(replace(some, tests=("no_such_file.py",)))
    assert source.read_text() == before


def test_mistakes_have_their_places_in_the_sources_of_today_in_all_rooms_of_the_core() -> None:
    files = {path.relative_to(FIRMWARE) for path in (FIRMWARE / "src").rglob("*.c")}
    rooms = {file.parts[1] for file in files} - {"main.c"}
    made = {Path(where(m)).parts[1] for m in MUTANTS if where(m).startswith("src/")}
    assert made == rooms
    assert len({m.name for m in MUTANTS}) == len(MUTANTS) >= 60
    assert all((ROOT / "tests/firmware" / test.split("::")[0]).is_file() for m in MUTANTS for test in m.tests)
    assert sum(bool(m.argued) for m in MUTANTS) <= SURVIVORS_MAX * len(MUTANTS)


def test_a_mistake_is_made_however_the_source_is_formatted() -> None:
    mutant = Mutant("more", "f(a, b)\n- 1u;", "f(b, a);", ())
    assert mutant.made("x = xf (a,b); y = f (a,\n\tb) -\n1u; z") == "x = xf (a,b); y = f(b, a); z"


def test_mutants_are_listed_and_strange_names_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(MUTANTS)
    assert main(["no such mutant"]) == 1
    assert capsys.readouterr().err == (
        "tests.firmware.mutants: no mutant's name has 'no such mutant'; see --list\n"
    )


@pytest.mark.slow
def test_the_exit_code_tells_when_a_mutant_survives_or_an_argument_is_wrong(
    capsys: pytest.CaptureFixture[str],
) -> None:
    some = MUTANTS[0]
    assert try_out([some], 1) == 0
    assert try_out([some, replace(some, name="no mistake", new=some.old + " ")], 1) == 1
    out = capsys.readouterr().out
    assert f"{where(some)}: no mistake: SURVIVED\n" in out
    assert "1 of 2 caught, 1 survived, 1 otherwise than told, 0 without a verdict\n" in out
    assert try_out([replace(some, argued="nobody looks")], 1) == 1
    assert try_out([replace(some, new="+")], 1) == 1
