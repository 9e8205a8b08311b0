"""A PID's settings into aircraft files as people write them."""

from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.sim.aircraft.model import FOLDER, PidSettings, load_aircraft
from neuroflight.sim.aircraft.pid_write import write_pid
from neuroflight.toolchain.errors import AircraftError

NF1 = (FOLDER / "nf1.toml").read_text()
BARE = NF1[: NF1.index("# Found by `neuroflight tune-pid")]
OTHERS = """# Mine, by hand.
# Do not touch.
[pid.mine]
derivative_cutoff_hz = 60
roll = [1, 2, 0]
pitch = [1, 2, 0]
yaw = [1, 2, 0]

[pid.mine.mixer]
roll = [-1, -1, 1, 1]
pitch = [1, -1, 1, -1]
yaw = [1, -1, -1, 1]
"""
SETTINGS = PidSettings(((1.5, 0.0, 0.02), (1.25, 30.0, 0.0201), (2.0, 0.5, 0.0)), 33.5, 0.15)


def written(folder: Path, text: str, settings: PidSettings = SETTINGS, name: str = "tuned") -> str:
    source, target = folder / "source.toml", folder / "target.toml"
    source.write_bytes(text.encode())
    write_pid(source, target, name, settings, "Found by `neuroflight pid tune --seed 7`.\nGood.")
    return target.read_bytes().decode()


def test_table_comes_first_and_other_lines_stay_when_the_file_has_pids(tmp_path: Path) -> None:
    text = written(tmp_path, BARE + OTHERS)
    block = text[len(BARE) : -len(OTHERS)]
    assert text == BARE + block + OTHERS
    assert block.startswith("# Found by `neuroflight pid tune --seed 7`.\n# Good.\n[pid.tuned]\n")
    aircraft = load_aircraft(tmp_path / "target.toml")
    assert [name for name, _ in aircraft.pids] == ["tuned", "mine"]
    assert aircraft.pids[0][1] == SETTINGS


def test_table_is_replaced_where_it_stands_when_it_is_there(tmp_path: Path) -> None:
    first = written(tmp_path, BARE + OTHERS)
    other = PidSettings(((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)), None, 0.0)
    assert written(tmp_path, written(tmp_path, first, other)) == first
    assert written(tmp_path, first.replace("pid tune", "tune-pid")) == first, "by the old name, too"
    assert load_aircraft(tmp_path / "target.toml").pids[0][1] == SETTINGS


def test_attenuation_and_nominal_voltage_are_written_when_they_are_known(tmp_path: Path) -> None:
    settings = replace(SETTINGS, tpa_rate=0.2, tpa_breakpoint=0.5, nominal_voltage=14.8)
    assert "tpa_rate = 0.2\ntpa_breakpoint = 0.5\nnominal_voltage_v = 14.8\n" in written(
        tmp_path, BARE, settings
    )
    assert load_aircraft(tmp_path / "target.toml").pids[0][1] == settings


def test_comment_of_a_person_stays_when_the_table_below_it_is_replaced(tmp_path: Path) -> None:
    text = written(tmp_path, BARE + OTHERS, name="mine")
    assert "# Mine, by hand.\n# Do not touch.\n# Found by" in text
    aircraft = load_aircraft(tmp_path / "target.toml")
    assert aircraft.pids == (("mine", SETTINGS),)


def test_table_goes_to_the_end_when_the_file_has_none(tmp_path: Path) -> None:
    text = written(tmp_path, BARE.rstrip("\n"))
    assert text.startswith(BARE.rstrip("\n") + "\n\n# Found by")
    assert load_aircraft(tmp_path / "target.toml").pids == (("tuned", SETTINGS),)


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (BARE + OTHERS, "a b", "PID name 'a b': expected 1 to 32 letters"),
        (BARE + OTHERS.replace("yaw = [1, 2, 0]", "yaw = [1, 2]"), "tuned", "pid.mine.yaw"),
        ("pid = { x = 1 }\n" + BARE, "tuned", "x"),
    ],
)
def test_target_stays_as_it_was_when_the_source_cannot_be_edited(
    tmp_path: Path, text: str, name: str, message: str
) -> None:
    (tmp_path / "target.toml").write_text("old")
    with pytest.raises(AircraftError, match=message):
        written(tmp_path, text, name=name)
    assert (tmp_path / "target.toml").read_text() == "old"


def test_inline_tables_are_refused_when_they_hold_the_pids(tmp_path: Path) -> None:
    gains = "roll = [1, 2, 0], pitch = [1, 2, 0], yaw = [1, 2, 0]"
    with pytest.raises(AircraftError, match=r"give it plain tables \[pid.NAME\]"):
        written(tmp_path, f"pid = {{ mine = {{ {gains} }} }}\n" + BARE)
