"""Aircraft files: what is read, and one line naming the key for what is refused."""

import re
from pathlib import Path

import pytest

from sim.aircraft import FOLDER, load_aircraft, parse_aircraft, shipped
from toolchain.errors import AircraftError

NF1 = (FOLDER / "nf1.toml").read_text()


def replaced(pattern: str, text: str) -> bytes:
    changed, count = re.subn(pattern, text, NF1, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return changed.encode()


def test_nf1_has_four_motors_in_bench_order_when_loaded_by_name() -> None:
    aircraft = load_aircraft("nf1")
    assert "nf1" in shipped()
    assert aircraft.motor_count == 4
    x, y = aircraft.rotor_positions[:, 0], aircraft.rotor_positions[:, 1]
    assert [(a > 0, b > 0) for a, b in zip(x, y, strict=True)] == [
        (False, False),  # rear right
        (True, False),  # front right
        (False, True),  # rear left
        (True, True),  # front left
    ]
    assert aircraft.spins.tolist() == [-1.0, 1.0, 1.0, -1.0]


def test_hash_is_that_of_the_file_when_loaded_by_path(tmp_path: Path) -> None:
    copy = tmp_path / "mine.toml"
    copy.write_bytes(NF1.encode())
    assert load_aircraft(copy).sha256 == load_aircraft("nf1").sha256
    copy.write_bytes(NF1.encode() + b"\n# changed\n")
    assert load_aircraft(copy).sha256 != load_aircraft("nf1").sha256


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (replaced(r"^format = 1$", "format = 2"), "format: got 2"),
        (replaced(r"^name = .*$", ""), "name: missing"),
        (replaced(r"^mass_kg = 0.194$", "mass_kg = -0.194"), r"part\[1\].mass_kg: got -0.194"),
        (replaced(r"^mass_kg = 0.194$", 'mass_kg = "heavy"'), r"part\[1\].mass_kg: got 'heavy'"),
        (replaced(r"^mass_kg = 0.194$", "mass_kg = nan"), r"part\[1\].mass_kg: got nan"),
        (replaced(r"^mass_kg = 0.194$", "mass = 0.194"), r"part\[1\].mass_kg: missing"),
        (replaced(r'^spin = "cw"$', 'spin = "left"'), r"rotor\[0\].spin: got 'left'.*cw, ccw"),
        (replaced(r"^speed_curve_rpm = \[[^]]*\]", "speed_curve_rpm = [1.0, 2.0]"), "speed_curve_rpm: got"),
        (replaced(r"^speed_curve_rpm = \[[^]]*\]", "speed_curve_rpm = [-9e4, 1e4, 0]"), "must rise"),
        (replaced(r"^delay_s = .*$", "delay_s = 2.0"), "propulsion.delay_s: got 2.0"),
        (replaced(r"^delay_s = ", "delai_s = 0.1\ndelay_s = "), "propulsion.delai_s: unknown key"),
        (replaced(r"^\[gyro\]$", "[gyroscope]"), "gyro: missing"),
        (replaced(r"^noise_deg_s = .*$", "noise_deg_s = [1.0, inf, 1.0]"), r"gyro.noise_deg_s\[1\]: got inf"),
        (replaced(r"^inertia_kg_m2 = \[1.6783e-4", "inertia_kg_m2 = [9e-4"), "no rigid body's"),
        (b"name = [", "not TOML"),
        (b"\xff\xfe", "not UTF-8"),
    ],
)
def test_refuses_in_one_line_naming_the_key_when_malformed(data: bytes, expected: str) -> None:
    with pytest.raises(AircraftError, match=expected) as caught:
        parse_aircraft(data, "mine.toml")
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_refuses_with_the_shipped_names_when_there_is_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(AircraftError, match=r"no such file.*nf1"):
        load_aircraft(tmp_path / "none.toml")


def test_refuses_an_oversized_file(tmp_path: Path) -> None:
    big = tmp_path / "big.toml"
    big.write_bytes(b"#" * (1 << 20))
    with pytest.raises(AircraftError, match="expected at most"):
        load_aircraft(big)
