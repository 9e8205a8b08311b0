"""Editing an aircraft file: the keys asked for change, nothing else does."""

from pathlib import Path

import pytest

from neuroflight.sim.aircraft.edit import Value, edit_aircraft
from neuroflight.sim.aircraft.known import How, Known
from neuroflight.sim.aircraft.model import FILE_BYTES_MAX, FOLDER, load_aircraft
from neuroflight.toolchain.errors import AircraftError

NF1 = (FOLDER / "nf1.toml").read_bytes()
NOISE = (0.5, 0.25, 0.125)
GYRO = b"noise_deg_s = [1.3373, 0.9990, 1.4516]\nbias_deg_s = 0.25\n"


def write(folder: Path, data: bytes) -> Path:
    path = folder / "own.toml"
    path.write_bytes(data)
    return path


INLINE = b"format = 1\ngyro = { noise_deg_s = [1, 2, 3], bias_deg_s = 1 }"


def replaced(old: bytes, new: bytes) -> bytes:
    assert NF1.count(old) == 1
    return NF1.replace(old, new)


def test_file_keeps_every_other_byte_when_a_value_changes(tmp_path: Path) -> None:
    path = write(
        tmp_path, replaced(GYRO, b"noise_deg_s=[ 1, 2 ,3 ]  # of that day\n\tbias_deg_s  =  0.25#x\n")
    )
    edit_aircraft(path, {"gyro": {"noise_deg_s": NOISE, "bias_deg_s": 0.75}})
    assert path.read_bytes() == replaced(
        GYRO, b"noise_deg_s=[0.5, 0.25, 0.125]  # of that day\n\tbias_deg_s  =  0.75#x\n"
    )


def test_file_keeps_its_line_ends_when_they_are_of_windows(tmp_path: Path) -> None:
    path = write(tmp_path, NF1.replace(b"\n", b"\r\n"))
    edit_aircraft(path, {"gyro": {"bias_deg_s": 0.75}, "esc": {"speed_step_rpm": 10.0}})
    data = path.read_bytes()
    assert data.count(b"\n") == data.count(b"\r\n")
    assert b"\r\nbias_deg_s = 0.75\r\n" in data


def test_value_is_replaced_whole_when_it_spans_lines(tmp_path: Path) -> None:
    spread = b"noise_deg_s = [\n  1.3373, # ] roll\n  0.9990,\n  1.4516,\n]\nbias_deg_s = 0.25\n"
    path = write(tmp_path, replaced(GYRO, spread))
    edit_aircraft(path, {"gyro": {"noise_deg_s": NOISE}})
    assert path.read_bytes() == replaced(GYRO, b"noise_deg_s = [0.5, 0.25, 0.125]\nbias_deg_s = 0.25\n")


def test_key_is_added_below_its_header_when_it_is_absent(tmp_path: Path) -> None:
    path = write(tmp_path, replaced(b"\nbias_deg_s = 0.25", b""))
    edit_aircraft(path, {"gyro": {"bias_deg_s": 0.75}})
    assert b"[gyro]\nbias_deg_s = 0.75\nnoise_deg_s = [1.3373, 0.9990, 1.4516]\n" in path.read_bytes()


def test_table_is_added_at_the_end_when_it_is_absent(tmp_path: Path) -> None:
    start = NF1.index(b"[accelerometer]")
    without = NF1[:start] + NF1[NF1.index(b"\n[", start) + 1 :]
    path = write(tmp_path, without.rstrip(b"\n"))
    edit_aircraft(path, {"accelerometer": {"noise_m_s2": NOISE}})
    assert path.read_bytes().endswith(b"\n\n[accelerometer]\nnoise_m_s2 = [0.5, 0.25, 0.125]\n")
    accelerometer = load_aircraft(path).accelerometer
    assert accelerometer is not None
    assert accelerometer.noise == NOISE


def test_same_key_elsewhere_is_left_alone_when_one_table_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, NF1)
    edit_aircraft(
        path, {"propulsion.response": {"gain": 2.0e-4}, "propulsion": {"speed_curve_rpm": (1.0, 2.0, 3.0)}}
    )
    before, after = NF1.decode().splitlines(), path.read_text().splitlines()
    changed = [new for old, new in zip(before, after, strict=True) if old != new]
    assert len(changed) == 2
    assert changed[0].startswith("speed_curve_rpm = [1.0, 2.0, 3.0]")
    assert changed[1].startswith("gain = 0.0002 ")


def test_text_that_looks_like_a_table_is_left_alone_when_it_is_a_string(tmp_path: Path) -> None:
    start = NF1.index(b"description = ")
    end = NF1.index(b"\n", start)
    text = (
        b'# [gyro]\n# bias_deg_s = 1\ndescription = """\\\n  [gyro]\\\n  \\"bias_deg_s = 1 # [ """ # "[gyro]'
    )
    data = NF1[:start] + text + NF1[end:]
    path = write(tmp_path, data)
    edit_aircraft(path, {"gyro": {"bias_deg_s": 0.75}})
    assert path.read_bytes() == data.replace(b"bias_deg_s = 0.25", b"bias_deg_s = 0.75")


MARKS = b"""
[known]
# what the pilot said
"gyro.noise_deg_s[1]" = { how = "measured", range = [0.9, 1.1], from = "a log" }
"gyro.bias_deg_s" = { how = "guessed" } # a day
"propulsion.response.gain" = { how = "typical", from = "a \\"page\\"" }
esc = { how = "guessed" }

[pid.last]
roll = [1.0, 1.0, 0.0]
pitch = [1.0, 1.0, 0.0]
yaw = [1.0, 1.0, 0.0]
"""


def test_new_mark_replaces_what_marked_the_number_and_leaves_the_others(tmp_path: Path) -> None:
    path = write(tmp_path, NF1 + MARKS)
    before = load_aircraft(path).known
    new = {"gyro.noise_deg_s": Known(How.MEASURED, None, "LOG 2"), "esc": Known(How.TYPICAL, None, "a page")}
    edit_aircraft(path, {"gyro": {"noise_deg_s": NOISE}}, known=new)
    kept = {key: before[key] for key in ("gyro.bias_deg_s", "propulsion.response.gain")}
    assert load_aircraft(path).known == kept | new
    text = path.read_text()
    assert '# what the pilot said\n"gyro.bias_deg_s" = { how = "guessed" } # a day\n' in text
    assert dict(load_aircraft(path).pids)["last"].gains[0] == (1.0, 1.0, 0.0)
    plain = write(tmp_path, NF1)
    edit_aircraft(plain, {"gyro": {"noise_deg_s": NOISE}}, known=new)
    assert load_aircraft(plain).known == new


def test_mark_goes_with_its_number(tmp_path: Path) -> None:
    path = write(tmp_path, NF1 + MARKS)
    lag: dict[str, Value | None] = {"kind": "first_order", "time_constant_up_s": 0.03}
    lag |= {"time_constant_down_s": 0.04, "gain": None, "torque_up_n_m": None, "torque_down_n_m": None}
    edit_aircraft(path, {"propulsion.response": lag})
    assert list(load_aircraft(path).known) == ["gyro.noise_deg_s[1]", "gyro.bias_deg_s", "esc"]


def test_mark_of_a_number_that_only_the_base_has_stays(tmp_path: Path) -> None:
    own = b'format = 1\nbase = "nf1"\nname = "own"\n[known]\n"propulsion.delay_s" = { how = "guessed" }\n'
    path = write(tmp_path, own)
    edit_aircraft(path, {"gyro": {"bias_deg_s": 0.75}})
    assert list(load_aircraft(path).known) == ["propulsion.delay_s"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "format: missing"),
        (b"[gyro\n", "not TOML"),
        (b"\xff", "not UTF-8"),
        (b"#" * (FILE_BYTES_MAX + 1), "expected at most"),
        (replaced(b"[gyro]\n" + GYRO, b"").replace(b"format = 1", INLINE), "plain tables"),
        (
            replaced(b"[gyro]\n" + GYRO, b'["gyro"]\nnoise_deg_s = [1, 2, 3]\nbias_deg_s = 1\n'),
            "plain tables",
        ),
        (replaced(b"[gyro]\n", b"[[gyro]]\n"), "plain tables"),
        (replaced(b"bias_deg_s = 0.25\n", b"bais_deg_s = 0.25\n"), "bais_deg_s: unknown key"),
    ],
    ids=["empty", "broken", "not text", "large", "inline", "quoted", "list", "slip"],
)
def test_file_is_refused_and_untouched_when_it_cannot_be_edited(
    tmp_path: Path, data: bytes, message: str
) -> None:
    path = write(tmp_path, data)
    with pytest.raises(AircraftError, match=message) as caught:
        edit_aircraft(path, {"gyro": {"noise_deg_s": NOISE, "bias_deg_s": 0.75}})
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == data
    assert [item.name for item in tmp_path.iterdir()] == ["own.toml"]


def test_file_is_untouched_when_the_value_is_out_of_range(tmp_path: Path) -> None:
    path = write(tmp_path, NF1)
    with pytest.raises(AircraftError, match=r"gyro\.bias_deg_s"):
        edit_aircraft(path, {"gyro": {"bias_deg_s": 1e6}})
    assert path.read_bytes() == NF1


def test_file_is_asked_for_when_it_is_missing(tmp_path: Path) -> None:
    with pytest.raises(AircraftError, match="no such file"):
        edit_aircraft(tmp_path / "none.toml", {"gyro": {"bias_deg_s": 1.0}})
