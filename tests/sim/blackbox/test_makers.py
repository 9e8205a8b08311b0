"""What fields mean in logs of each firmware: scales, arm flag, motors, sticks."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.firmware import Firmware, Maker, firmware
from neuroflight.sim.blackbox.flight import log_trace
from neuroflight.sim.blackbox.log import Log, read_log
from neuroflight.sim.blackbox.motors import IMPOSSIBLE
from neuroflight.sim.blackbox.quality import Answer, quality
from neuroflight.sim.blackbox.units import Channels, channels
from neuroflight.toolchain.errors import TraceError
from tests.sim.blackbox.writer import END, PRODUCT, Column, fields, flight, header, slow

BETAFLIGHT = "Betaflight 4.4.2 (abc) SITL"
MINMOTOR, MINTHROTTLE = 11, 4  # predictors


def written(
    folder: Path,
    rows: Any,
    names: list[str],
    lines: Mapping[str, object],
    flags: tuple[int, ...] = (1,),
    bases: dict[str, int] | None = None,
    told: dict[str, str] | None = None,
    slow_names: tuple[str, ...] = ("flightModeFlags",),
) -> Log:
    """Write a log of these rows and read it; bases: a field's predictor in I frames."""
    columns = [Column(name) for name in names]
    described = fields(columns, list(slow_names)).decode()
    if bases:
        predictors = [bases.get(name, 0) for name in ("loopIteration", "time", *names)]
        old = "Field I predictor:" + ",".join(["0"] * len(predictors))
        assert old in described
        described = described.replace(old, "Field I predictor:" + ",".join(map(str, predictors)))
    head = PRODUCT + header({"I interval": 32, "P interval": "1/1", **lines}) + described.encode()
    path = folder / "LOG00001.BFL"
    path.write_bytes(head + slow(flags) + flight(columns, rows, interval=1 if bases else 32) + END)
    return read_log(path, lines=told)


def units(folder: Path, rows: Any, names: list[str], lines: Mapping[str, object], **more: Any) -> Channels:
    return channels(written(folder, rows, names, lines, **more))


def bits(value: float) -> str:
    return f"0x{struct.unpack('<I', struct.pack('<f', value))[0]:x}"


@pytest.mark.parametrize(
    ("revision", "kind", "maker", "version"),
    [
        ("Betaflight 3.1.7 (e1c4b5c) BETAFLIGHTF3", "Cleanflight", Maker.BETAFLIGHT, (3, 1, 7)),
        ("Betaflight 2025.12.1 (77d01ba3b) STM32F7X2", "Cleanflight", Maker.BETAFLIGHT, (2025, 12, 1)),
        ("INAV 7.1.2 (4e1e59eb) MATEKF722", "Cleanflight", Maker.INAV, (7, 1, 2)),
        ("EmuFlight 0.4.1 (abcdef) STRIXF10", "Cleanflight", Maker.EMUFLIGHT, (0, 4, 1)),
        ("Rotorflight 4.5.0 (abcdef) NEXUS", "Rotorflight", Maker.ROTORFLIGHT, (4, 5, 0)),
        ("Cleanflight 2.5.0 (abcdef) SPRACINGF3", "Cleanflight", Maker.CLEANFLIGHT, (2, 5, 0)),
        ("bdaf8ec", "Cleanflight", Maker.CLEANFLIGHT, ()),
        ("", "Baseflight", Maker.BASEFLIGHT, ()),
        ("", "Cleanflight", Maker.OTHER, ()),  # a lost line: it may have been any of these
        ("", "", Maker.OTHER, ()),
    ],
)
def test_maker_and_version_are_those_of_the_header(
    revision: str, kind: str, maker: Maker, version: tuple[int, ...]
) -> None:
    lines = {"Firmware revision": revision, "Firmware type": kind}
    assert firmware({name: text for name, text in lines.items() if text}) == Firmware(maker, version)


@pytest.mark.parametrize(
    ("lines", "deg_s"),
    [
        (
            {"Firmware type": "Cleanflight", "Firmware revision": "bdaf8ec", "gyro.scale": bits(1 / 16.4)},
            1 / 16.4,
        ),
        ({"Firmware revision": "Betaflight 2.9.0 (a) NAZE", "gyro.scale": bits(0.0610)}, 0.0610),
        ({"Firmware type": "Baseflight", "gyro_scale": bits(np.deg2rad(1e-6) / 16.4)}, 1 / 16.4),
        ({"Firmware revision": BETAFLIGHT, "gyro_scale": bits(1.0)}, 1.0),
        ({"Firmware revision": BETAFLIGHT}, 1.0),  # its line is lost, and always 1
        ({"Firmware revision": BETAFLIGHT, "blackbox_high_resolution": 1}, 0.1),
        ({"Firmware type": "Cleanflight", "Firmware revision": "bdaf8ec"}, None),
        ({"Firmware type": "Cleanflight"}, None),
    ],
)
@pytest.mark.parametrize("name", ["gyroADC", "gyroData", "gyroUnfilt"])
def test_gyro_is_in_its_makers_unit(
    name: str, lines: dict[str, object], deg_s: float | None, tmp_path: Path
) -> None:
    rows = np.column_stack([np.arange(-40, 40) * 41, np.arange(80), np.full(80, -820)])
    told = units(tmp_path, rows.tolist(), [f"{name}[{axis}]" for axis in range(3)], lines)
    gyro = told.gyro_unfiltered if name == "gyroUnfilt" else told.gyro
    if deg_s is None:
        assert gyro is None
        return
    assert gyro is not None
    assert np.abs(np.rad2deg(gyro.astype(float)) - rows * deg_s).max() < 1e-3


@pytest.mark.parametrize(
    ("revision", "names", "counts", "lines", "volts", "amperes"),
    [
        (BETAFLIGHT, ("vbatLatest", "amperageLatest"), (1652, 1234), {}, 16.52, 12.34),
        ("Betaflight 3.4.0 (a) X", ("vbatLatest", "amperageLatest"), (164, 1234), {}, 16.4, 12.34),
        ("EmuFlight 0.3.5 (a) X", ("vbatLatest", "amperageLatest"), (164, 1234), {}, 16.4, 12.34),
        ("INAV 7.1.2 (a) X", ("vbat", "amperage"), (1652, 1234), {}, 16.52, 12.34),
        ("Rotorflight 4.5.0 (a) X", ("Vbat", "Ibat"), (4520, 1234), {}, 45.2, 12.34),
        (
            "Betaflight 2.9.0 (a) X",
            ("vbatLatest", "amperageLatest"),
            (1850, 400),
            {"vbatscale": 110, "currentMeter": "50,400"},
            1850 * 3.3 / 4095 * 11,
            (400 * 3300 / 4095 - 50) / 40,
        ),
        (
            "Betaflight 3.0.1 (a) X",
            ("vbatLatest", "rssi"),
            (1850, 0),
            {"vbatscale": 110},
            1850 * 3.3 / 4095 * 11,
            None,
        ),
        ("Betaflight 3.0.1 (a) X", ("vbatLatest", "rssi"), (163, 0), {"vbatscale": 110}, 16.3, None),
        ("Betaflight 2.9.0 (a) X", ("vbatLatest", "amperageLatest"), (1850, 400), {}, None, None),
        ("unheard of", ("vbatLatest", "amperageLatest"), (1652, 1234), {"vbatscale": 110}, None, None),
    ],
)
def test_battery_is_in_volts_and_amperes(
    revision: str,
    names: tuple[str, str],
    counts: tuple[int, int],
    lines: dict[str, object],
    volts: float | None,
    amperes: float | None,
    tmp_path: Path,
) -> None:
    told = units(tmp_path, [list(counts)] * 40, list(names), {"Firmware revision": revision, **lines})
    for found, expected in ((told.voltage, volts), (told.current, amperes)):
        assert found is None if expected is None else found == pytest.approx(np.full(40, expected))


@pytest.mark.parametrize(
    ("lines", "flags", "armed"),
    [
        ({"Firmware revision": BETAFLIGHT}, 0, False),
        ({"Firmware revision": BETAFLIGHT}, 1, True),
        ({"Firmware revision": "Betaflight 2.7.0 (a) X"}, 0, False),
        ({"Firmware revision": "Betaflight 2.6.0 (a) X"}, 0, True),  # modes, of a log that is armed only
        ({"Firmware revision": "bdaf8ec", "Firmware type": "Cleanflight"}, 2, True),
        ({"Firmware revision": "Cleanflight 2.1.0 (a) X"}, 2, False),
        ({"Firmware revision": "INAV 7.1.2 (a) X"}, 0, False),
        ({"Firmware revision": "EmuFlight 0.3.5 (a) X"}, 4, False),
    ],
)
def test_arm_flag_is_where_its_maker_puts_it(
    lines: dict[str, object], flags: int, armed: bool, tmp_path: Path
) -> None:
    told = units(tmp_path, [[1]] * 40, ["debug[0]"], lines, flags=(flags,))
    assert told.armed.all() if armed else not told.armed.any()


def test_inavs_box_flags_of_version_8_arm(tmp_path: Path) -> None:
    told = units(
        tmp_path,
        [[1]] * 40,
        ["debug[0]"],
        {"Firmware revision": "INAV 8.0.0 (a) X"},
        flags=(0,),
        slow_names=("rcModeFlags",),
    )
    assert not told.armed.any()


def test_inavs_axis_rate_is_its_setpoint(tmp_path: Path) -> None:
    names = [f"axisRate[{axis}]" for axis in range(3)] + [f"rcCommand[{axis}]" for axis in range(4)]
    names += [f"gyroADC[{axis}]" for axis in range(3)] + [f"motor[{motor}]" for motor in range(4)]
    rows = [[350, -20, 10, 250, 0, 0, 1475, 340, -20, 10, *[1450] * 4]] * 100
    lines = {"Firmware revision": "INAV 7.1.2 (a) X", "rates": "70,70,60", "motorOutput": "1100,1850"}
    log = written(tmp_path, rows, names, {**lines, "minthrottle": 1100, "maxthrottle": 1850})
    trace = log_trace(log)
    assert np.rad2deg(trace.setpoint) == pytest.approx(np.array([[350.0, -20, 10]] * 100), abs=1e-4)
    assert trace.throttle == pytest.approx(np.full(100, 0.5)) and trace.motors == pytest.approx(0.45)
    assert quality(log).questions[0].answer is Answer.YES


@pytest.mark.parametrize(
    ("lines", "values", "fractions"),
    [
        ({"motorOutput": "138,2047"}, (0, 48, 138, 2047), (0, 0, 90 / 1999, 1)),
        ({"motorOutput": "138,2047"}, (0, 48, 138, 2048), (0, 0, 90 / 1999, 1)),  # as Betaflight 3.4 rounds
        ({"motorOutput": "1070,2000"}, (1000, 1070, 1500, 2000), (0, 0.07, 0.5, 1)),
        ({"motor_pwm_protocol": 7}, (0, 48, 1047, 2047), (0, 0, 999 / 1999, 1)),
        ({"motor_pwm_protocol": 1}, (1000, 1250, 1500, 2000), (0, 0.25, 0.5, 1)),
        ({}, (0, 138, 400, 1200), (0, 90 / 1999, 352 / 1999, 1152 / 1999)),  # no pulse is so short
        ({}, (1000, 1200, 1500, 1800), (0, 0.2, 0.5, 0.8)),
    ],
)
def test_motors_are_fractions_by_the_protocol(
    lines: dict[str, object], values: tuple[int, ...], fractions: tuple[float, ...], tmp_path: Path
) -> None:
    names = [f"motor[{motor}]" for motor in range(4)]
    told = units(tmp_path, [list(values)] * 40, names, {"Firmware revision": BETAFLIGHT, **lines})
    assert told.motors is not None and told.motors == pytest.approx(np.array([fractions] * 40), abs=1e-12)
    assert bool(told.motors_note) == (not lines)


def test_rotorflights_motors_are_thousandths(tmp_path: Path) -> None:
    told = units(
        tmp_path, [[0, 650]] * 40, ["motor[0]", "motor[1]"], {"Firmware revision": "Rotorflight 4.5.0 (a) X"}
    )
    assert told.motors is not None and told.motors == pytest.approx(np.array([[0, 0.65]] * 40))


@pytest.mark.parametrize(
    ("base", "name", "lines", "mend"),
    [
        (MINMOTOR, "motorOutput", {"dshot_idle_value": 450}, "--header motorOutput=138,2047"),
        (MINMOTOR, "motorOutput", {}, "--header motorOutput=LOW,HIGH"),
        (MINTHROTTLE, "minthrottle", {}, "--header minthrottle=LOW"),
    ],
)
def test_motors_are_not_read_when_the_line_that_they_count_from_is_lost(
    base: int, name: str, lines: dict[str, object], mend: str, tmp_path: Path
) -> None:
    counts, lines = [[5, 9, 12, 30]] * 40, {"Firmware revision": BETAFLIGHT, **lines}
    names = [f"motor[{motor}]" for motor in range(4)]
    bases = dict.fromkeys(names, base)
    log = written(tmp_path, counts, names, lines, bases=bases)
    told = channels(log)
    assert told.motors is None and told.dshot is None
    assert mend in told.motors_note and name in told.motors_note
    assert len([one for one in quality(log).warnings if f"--header {name}=" in one]) == 1
    if name == "motorOutput":
        told = units(tmp_path, counts, names, lines, bases=bases, told={"motorOutput": "138,2047"})
        assert told.motors is not None
        assert told.motors[0] == pytest.approx((np.array(counts[0]) + 138 - 48) / 1999)


@pytest.mark.parametrize("digital", [True, False])
def test_no_motor_value_out_of_range_reads_as_a_fraction(digital: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = rng.integers(-300, 3000, (1000, 4))
    values[::7] = 4294968296 - (1 << 32)
    names = [f"motor[{motor}]" for motor in range(4)]
    lines = {"Firmware revision": BETAFLIGHT, "motorOutput": "138,2047" if digital else "1070,2000"}
    log = written(tmp_path, values.tolist(), names, lines)
    told = channels(log)
    assert told.motors is not None and told.dshot is not None
    low, high = (48, 2048) if digital else (750, 2250)
    possible = (values == 0) | ((values >= low) & (values <= high))
    assert (np.isnan(told.motors) == ~possible).all() and ((told.dshot == IMPOSSIBLE) == ~possible).all()
    assert any(
        f"{(~possible).any(axis=1).sum()} rows have a value that no motor is given" in one
        for one in quality(log).warnings
    )


def test_speeds_of_rotors_take_the_count_of_poles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [[100, 200, 300, 0]] * 40
    names = [f"eRPM[{motor}]" for motor in range(4)]
    log = written(tmp_path, rows, names, {"Firmware revision": BETAFLIGHT})
    assert channels(log).rpm is None
    (lacks,) = [one for one in quality(log).questions if one.name == "speeds of the rotors"]
    assert "--header motor_poles=N" in lacks.why
    log = written(tmp_path, rows, names, {"Firmware revision": BETAFLIGHT, "motor_poles": 14})
    found = channels(log).rpm
    assert found is not None and found[0] == pytest.approx([100 * 100 / 7, 200 * 100 / 7, 300 * 100 / 7, 0])
    out = tmp_path / "flight.npz"
    assert main(["log", "decode", str(log.path), "--npz", str(out), "--header", "motor_poles=12"]) == 0
    capsys.readouterr()
    with np.load(out) as saved:
        assert saved["rpm"][0] == pytest.approx([100 * 100 / 6, 200 * 100 / 6, 300 * 100 / 6, 0])


def test_a_header_line_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = written(tmp_path, [[1]] * 40, ["debug[0]"], {"Firmware revision": BETAFLIGHT})
    for text in ("motorOutput", "=1", "name=", "Field I name=a", "a=\x07"):
        assert main(["log", "quality", str(log.path), "--header", text]) == 1
        error = capsys.readouterr().err
        assert "--header: got" in error and error.count("\n") == 1


def test_figures_are_refused_with_the_row_when_a_stick_or_a_motor_cannot_be(tmp_path: Path) -> None:
    names = [f"setpoint[{axis}]" for axis in range(4)] + [f"gyroADC[{axis}]" for axis in range(3)]
    names += [f"motor[{motor}]" for motor in range(4)]
    lines = {"Firmware revision": BETAFLIGHT, "motorOutput": "138,2047"}
    for column, value, message in (
        (3, 1250, r"in row 57 \(0\.057 s\) the throttle is 1\.25, expected 0 to 1; leave them out"),
        (1, -2300, r"in row 57 \(0\.057 s\) pitch is asked to turn at -2300 deg/s, expected at most 2000"),
        (9, 2100, r"in row 57, 0\.057 s, motor\[2\] is 2100, which no motor is given; leave them out"),
    ):
        rows = [[10, 20, 30, 400, 9, 19, 29, 500, 500, 500, 500] for _ in range(100)]
        rows[57][column] = value
        log = written(tmp_path, rows, names, lines)
        with pytest.raises(TraceError, match=message):
            log_trace(log)
