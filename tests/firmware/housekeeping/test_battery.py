"""battery.c: cells, level, sag and charge from millivolts at pins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.control.battery_voltage import BatteryVoltage

UNKNOWN, GOOD, WARN, LOW = range(4)
RATE_HZ = 100
SCALE = 11.0  # of the divider, the board's
MV_PER_A = 17.9


class Battery:
    """A battery of its own, fed with the pack's volts and amperes."""

    def __init__(self, core: Any, **settings: float) -> None:
        self._lib = core.lib
        self.settings = core.new("struct nf_settings *")
        self._lib.settings_default(self.settings)
        for name, value in settings.items():
            setattr(self.settings, name, value)
        self.struct = core.new("struct battery *")
        self._board = core.new("struct board_identity *", {"volts_scale": SCALE, "amps_scale": MV_PER_A})
        self._lib.battery_init(self.struct, self.settings, self._board)

    def run(self, volts: float, seconds: float, amps: float = 0.0, *, valid: bool = True) -> int:
        """Returns the level after so long."""
        for _ in range(round(seconds * RATE_HZ)):
            self._lib.battery_step(self.struct, round(volts * 1000 / SCALE), round(amps * MV_PER_A), valid)
        return self.level

    @property
    def level(self) -> int:
        return int(self.struct.level)

    @property
    def cells(self) -> int:
        return int(self.struct.cells)

    @property
    def sag(self) -> float:
        return float(self.struct.rest_volts - self.struct.volts)

    @property
    def mah(self) -> int:
        return int(self.struct.mah)


Make = Callable[..., Battery]


@pytest.fixture
def make(scripted: Any) -> Make:
    return lambda **settings: Battery(scripted, **settings)


@pytest.fixture
def battery(make: Make) -> Battery:
    return make()


def test_the_twins_voltage_is_the_firmwares_to_the_bit_when_a_pack_sags(make: Make) -> None:
    firmware, twin = make(battery_cells=4), BatteryVoltage(1000)
    for step in range(3000):
        if twin.due(step):
            volts = 16.6 if step < 500 else 14.3 if step < 2000 else 15.9 + 1e-4 * step
            firmware.run(volts, 1 / RATE_HZ)
            (filtered,) = twin.measure(np.array([volts]))
            assert firmware.struct.volts == filtered


@pytest.mark.parametrize("cells", range(1, 7))
@pytest.mark.parametrize("cell", [3.75, 4.2, 4.3])
def test_cells_are_found_when_the_pack_is_charged(battery: Battery, cells: int, cell: float) -> None:
    assert battery.run(cells * cell, 0.45) == UNKNOWN
    assert battery.run(cells * cell, 0.2) == GOOD
    assert battery.cells == cells
    assert battery.struct.volts == pytest.approx(cells * cell, abs=0.01)


def test_cells_are_those_set_when_the_pilot_knows_better(make: Make) -> None:
    battery = make(battery_cells=4)
    assert battery.run(12.8, 0.01) == LOW, "3.2 V a cell: of a full pack of three it would be 4.27 V"
    assert battery.cells == 4


def test_no_more_than_six_cells_are_found_when_the_voltage_is_too_high(battery: Battery) -> None:
    battery.run(30.0, 1)
    assert battery.cells == 6


def test_cells_are_found_when_the_voltage_comes_up_slowly(battery: Battery) -> None:
    for volts in np.linspace(0, 22.2, 20):
        battery.run(float(volts), 0.01)
    battery.run(22.2, 1)
    assert battery.cells == 6


@pytest.mark.parametrize("volts", [0.0, 0.3, 2.4, 4.5, 4.9])
def test_nothing_is_known_when_only_usb_feeds_the_board(battery: Battery, volts: float) -> None:
    assert battery.run(volts, 10) == UNKNOWN
    assert battery.cells == 0


def test_nothing_is_known_when_the_measurement_is_not_valid(battery: Battery) -> None:
    assert battery.run(16.0, 5, valid=False) == UNKNOWN
    assert (battery.cells, battery.struct.volts, battery.mah) == (0, 0, 0)
    assert battery.run(16.0, 1) == GOOD
    assert battery.run(3.0, 1, 50.0, valid=False) == UNKNOWN
    assert battery.run(16.0, 0.01) == GOOD, "the cells are still known"
    assert battery.mah == 0


@pytest.mark.parametrize(("limit", "better", "worse"), [(3.5, GOOD, WARN), (3.3, WARN, LOW)])
def test_a_level_is_left_only_with_some_to_spare_when_the_voltage_returns(
    battery: Battery, limit: float, better: int, worse: int
) -> None:
    battery.run(4 * 4.0, 1)
    assert battery.run(4 * (limit + 0.01), 3) == better
    assert battery.run(4 * (limit - 0.01), 3) == worse
    assert battery.run(4 * (limit + 0.09), 3) == worse
    assert battery.run(4 * (limit + 0.11), 3) == better
    assert battery.cells == 4


def test_levels_are_those_set_when_the_pilot_sets_them(make: Make) -> None:
    battery = make(battery_warn_v=3.8, battery_low_v=3.6)
    assert battery.run(4 * 3.85, 1) == GOOD
    assert battery.run(4 * 3.75, 3) == WARN
    assert battery.run(4 * 3.55, 3) == LOW
    assert battery.run(4 * 3.95, 3) == GOOD


def test_a_punch_out_warns_not_when_it_is_short(battery: Battery) -> None:
    battery.run(16.0, 1)
    assert battery.run(13.0, 0.05, 60.0) == GOOD
    assert battery.run(16.0, 1) == GOOD
    assert battery.run(13.0, 1, 60.0) == LOW


def test_sag_is_what_the_load_takes_when_it_lasts(battery: Battery) -> None:
    battery.run(16.0, 2)
    assert battery.sag == pytest.approx(0, abs=0.01)
    battery.run(15.0, 1, 30.0)
    assert battery.sag == pytest.approx(1.0, abs=0.05)
    assert battery.struct.amps == pytest.approx(30.0, rel=0.01)
    battery.run(16.0, 2)
    assert battery.sag == pytest.approx(0, abs=0.05)
    battery.run(15.0, 300)
    assert battery.sag < 0.01, "what lasts is no sag"


def test_a_new_pack_is_counted_anew_when_the_old_one_was_gone_for_a_while(battery: Battery) -> None:
    battery.run(16.0, 1)
    assert battery.run(0.0, 1.9) == UNKNOWN
    assert battery.cells == 4
    assert battery.run(24.0, 1) == GOOD
    assert battery.cells == 4, "a loose plug is no new pack"
    battery.run(0.0, 3)
    assert battery.cells == 0
    assert battery.run(24.0, 1) == GOOD
    assert battery.cells == 6


def test_cells_are_not_forgotten_when_a_loose_plug_adds_up(battery: Battery) -> None:
    battery.run(16.0, 1)
    for _ in range(5):
        battery.run(0.0, 1.5)
        assert battery.run(16.0, 0.1) == GOOD
        assert battery.cells == 4


def test_cells_are_not_counted_when_the_plug_does_not_hold_yet(battery: Battery) -> None:
    for _ in range(5):
        battery.run(16.0, 0.3)
        battery.run(0.0, 1.0)
    assert battery.run(24.0, 0.3) == UNKNOWN
    assert battery.run(24.0, 0.3) == GOOD
    assert battery.cells == 6


def test_a_new_pack_does_not_sag_from_the_old_ones_voltage(battery: Battery) -> None:
    battery.run(24.0, 2)
    battery.run(0.0, 3)
    battery.run(16.0, 2)
    assert battery.sag == pytest.approx(0, abs=0.01)


def test_there_is_no_sag_when_the_voltage_rises(battery: Battery) -> None:
    battery.run(14.0, 2, 30.0)
    battery.run(16.0, 0.2)
    assert battery.sag == 0


def test_cells_set_outlast_the_pack_when_it_is_changed(make: Make) -> None:
    battery = make(battery_cells=3)
    battery.run(12.0, 1)
    battery.run(0.0, 5)
    assert battery.cells == 3


def test_charge_is_the_integral_of_the_current_when_it_changes(battery: Battery) -> None:
    rng = np.random.default_rng(1)
    drawn = 0.0
    for amps in rng.uniform(0, 60, 600):
        battery.run(15.0, 0.5, float(amps))
        drawn += round(amps * MV_PER_A) / MV_PER_A * 0.5 / 3.6
    assert battery.mah == pytest.approx(drawn, abs=1.5)


def test_charge_adds_up_when_the_current_is_small_for_long(battery: Battery) -> None:
    battery.run(15.0, 1800, 0.5)
    assert battery.mah == pytest.approx(round(0.5 * MV_PER_A) / MV_PER_A * 500, abs=1)


def test_scales_are_those_set_when_the_sensors_differ(make: Make) -> None:
    battery = make(battery_scale=22.0, current_scale=35.8)
    battery.run(8.0, 1, 20.0)
    assert battery.struct.volts == pytest.approx(16.0, abs=0.05)
    assert battery.struct.amps == pytest.approx(10.0, rel=0.01)
    assert battery.cells == 4


@pytest.mark.parametrize("scaled", ["battery_scale", "current_scale"])
def test_the_board_s_scale_counts_where_the_settings_have_none(make: Make, scaled: str) -> None:
    own = {"battery_scale": 22.0, "current_scale": 35.8, scaled: 0.0}
    battery = make(**own)
    battery.run(8.0, 1, 20.0)
    halved = scaled == "battery_scale"
    assert battery.struct.volts == pytest.approx(8.0 if halved else 16.0, abs=0.05)
    assert battery.struct.amps == pytest.approx(10.0 if halved else 20.0, rel=0.01)
