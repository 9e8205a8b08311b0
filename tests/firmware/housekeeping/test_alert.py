"""alert.c: what is heard and seen, slot by slot."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import pytest

from neuroflight.toolchain.contract import ARMING_COUNTS, SETTINGS, ArmingReason

SLOT_MS = 50
NAMES = (
    *(
        "FAULT",
        "CRASHED",
        "FIND_ME",
        "NOT_ARMING",
        "RECEIVER_LOST",
        "TOOK_OVER",
        "BATTERY_LOW",
        "MOTOR",
        "FAULT_TOLD",
    ),
    *("POLICY_REFUSED", "BATTERY_WARN", "CALIBRATING", "ARMED", "DISARMED"),
)
SILENT, DARK = {"FAULT", "CALIBRATING"}, {"FAULT_TOLD", "BATTERY_WARN"}
BEEPS = set(NAMES) - SILENT
ONCE = {"ARMED", "DISARMED"}


MUTED_BY = {
    **{f"beep_{name.lower()}": name for name in NAMES},
    "beep_fault": "FAULT_TOLD",  # of a fault the beeper tells only that
}
BEEP_SETTINGS = [setting.name for setting in SETTINGS if setting.name.startswith("beep_")]


class Alert:
    def __init__(self, core: Any, *muted: str) -> None:
        """muted: settings beep_... that are off."""
        self.core, self.lib, self.self = core, core.lib, core.new("struct alert *")
        self.settings = core.new("struct nf_settings *")
        self.lib.settings_default(self.settings)
        for name in muted:
            setattr(self.settings, name, 0)
        self.lib.alert_init(self.self, self.settings)

    def step(self, ms: int, *names: str, flashes: int = 0, count: int = 2) -> tuple[bool, bool]:
        conditions = sum(1 << getattr(self.lib, f"ALERT_{name}") for name in names)
        counts = self.core.new("struct alert_counts *", (flashes, count, count))
        state = self.lib.alert_step(self.self, conditions, counts, ms & 0xFFFFFFFF)
        return state.beeper, state.led

    def play(
        self,
        *names: str,
        start: int = 0,
        slots: int = 200,
        every_ms: int = SLOT_MS,
        flashes: int = 0,
        count: int = 2,
    ) -> tuple[str, str]:
        """Beeper and LED as texts, a character a step."""
        seen = [
            self.step(start + every_ms * index, *names, flashes=flashes, count=count)
            for index in range(slots)
        ]
        beeper, led = ("".join(".#"[state[output]] for state in seen) for output in range(2))
        return beeper, led


@pytest.fixture
def alert(scripted: Any) -> Alert:
    return Alert(scripted)


def test_nothing_is_heard_and_seen_when_nothing_holds(alert: Alert) -> None:
    assert alert.play() == ("." * 200, "." * 200)


def test_the_order_is_that_of_urgency_when_named(alert: Alert) -> None:
    values = [getattr(alert.lib, f"ALERT_{name}") for name in NAMES]
    assert values == list(range(alert.lib.ALERT_CONDITION_COUNT))


@pytest.mark.parametrize("name", NAMES)
def test_a_rhythm_plays_at_once_and_goes_on_when_its_condition_holds(scripted: Any, name: str) -> None:
    beeper, led = Alert(scripted).play(name)
    if name in BEEPS:
        assert beeper[0] == "#"
        assert ("#" in beeper[100:]) is (name not in ONCE)
    else:
        assert set(beeper) == {"."}
    if name not in DARK:
        assert led[0] == led[100:].strip(".")[:1] == "#"


def test_rhythms_can_be_told_apart_when_heard_or_seen(scripted: Any) -> None:
    heard = [Alert(scripted).play(name)[0] for name in NAMES if name in BEEPS]
    seen = [Alert(scripted).play(name)[1] for name in NAMES if name not in DARK | {"FAULT"}]
    assert len(set(heard)) == len(heard)
    assert len(set(seen)) == len(seen)


@pytest.mark.parametrize("flashes", [0, 1, 2, 5, 9])
def test_a_fault_flashes_its_number_when_it_holds(alert: Alert, flashes: int) -> None:
    beeper, led = alert.play("FAULT", "ARMED", flashes=flashes, slots=400)
    assert "#" not in beeper[4:], "a fault leaves the beeper to others"
    rounds = [text for text in led.strip(".").split("." * 10) if text.strip(".")]
    counts = [text.count("#") for text in rounds[:-1]]
    assert set(counts) == {max(flashes, 1)}
    assert len(counts) > 5
    assert max(len(list(run)) for value, run in groupby(led) if value == "#") == 1


@pytest.mark.parametrize("flashes", [0, 1, 3, 5])
def test_a_fault_beeps_as_often_as_it_flashes_when_it_is_told(alert: Alert, flashes: int) -> None:
    beeper, led = alert.play("FAULT", "FAULT_TOLD", "ARMED", flashes=flashes, slots=900)
    beeps = [text.count("###") for text in beeper.strip(".").split("." * 30) if text.strip(".")]
    seen = [text.count("#") for text in led.strip(".").split("." * 10) if text.strip(".")]
    assert set(beeps[:-1]) == set(seen[:-1]) == {max(flashes, 1)}
    assert {len(list(run)) for value, run in groupby(beeper) if value == "#"} == {3}, "long enough to count"


# --- What keeps it from arming ----------------------------------------------------------------
BUZZ = "#.#.#.#.#."


@pytest.mark.parametrize("count", range(1, 9))
def test_a_buzz_and_then_beeps_and_flashes_count_why_it_does_not_arm(alert: Alert, count: int) -> None:
    beeper, led = alert.play("NOT_ARMING", "DISARMED", "BATTERY_WARN", count=count, slots=500)
    assert beeper == led
    rounds = [text.strip(".") for text in f"{beeper}!".split(BUZZ)][1:-1]
    assert len(rounds) >= 4
    assert set(rounds) == {"....".join(["###"] * count)}


def test_the_count_begins_anew_when_another_reason_is_the_most_urgent(alert: Alert) -> None:
    first, _ = alert.play("NOT_ARMING", count=6, slots=33)
    second, light = alert.play("NOT_ARMING", count=2, start=33 * SLOT_MS, slots=100)
    assert first.startswith(BUZZ) and second.startswith(BUZZ)
    assert second == light == Alert(alert.core).play("NOT_ARMING", count=2, slots=100)[0]


@pytest.mark.parametrize("number", range(1, 9))
def test_long_beeps_and_flashes_count_the_number_of_a_motor(alert: Alert, number: int) -> None:
    beeper, led = alert.play("MOTOR", "ARMED", count=number, slots=900)
    assert beeper == led
    counts = [text.count("#" * 9) for text in beeper.strip(".").split("." * 24) if text.strip(".")]
    assert set(counts[:-1]) == {number} and len(counts) > 3
    assert {len(list(run)) for value, run in groupby(beeper.rstrip("#")) if value == "#"} == {9}


@pytest.mark.parametrize("reasons", [(), *((reason,) for reason in ArmingReason), tuple(ArmingReason)])
def test_the_count_is_that_of_the_reason_with_the_highest(
    alert: Alert, reasons: tuple[ArmingReason, ...]
) -> None:
    expected = max((ARMING_COUNTS[reason] for reason in reasons), default=0)
    assert alert.lib.alert_count(sum(1 << reason for reason in reasons)) == expected


@pytest.mark.parametrize("urgent", range(len(NAMES)))
def test_the_most_urgent_plays_when_several_hold(scripted: Any, urgent: int) -> None:
    for other in range(urgent + 1, len(NAMES)):
        both = Alert(scripted).play(NAMES[urgent], NAMES[other])
        alone = Alert(scripted).play(NAMES[urgent])
        less = Alert(scripted).play(NAMES[other])
        assert both[0] == (alone if NAMES[urgent] in BEEPS else less)[0]
        assert both[1] == (less if NAMES[urgent] in DARK else alone)[1]


def test_a_rhythm_begins_anew_when_its_condition_returns(alert: Alert) -> None:
    begin = alert.play("DISARMED", slots=10)
    assert begin[0] == "#..#......"
    assert alert.play("DISARMED", slots=10, start=500)[0] == "." * 10, "told once"
    assert alert.play("ARMED", slots=10, start=1000)[0] == "####......"
    assert alert.play("DISARMED", slots=10, start=1500)[0] == begin[0]


def test_a_rhythm_goes_on_when_a_less_urgent_condition_comes_or_goes(alert: Alert) -> None:
    alone = Alert.play(alert, "RECEIVER_LOST", slots=40)
    alert.lib.alert_init(alert.self, alert.settings)
    first = alert.play("RECEIVER_LOST", slots=3)
    second = alert.play("RECEIVER_LOST", "BATTERY_LOW", "ARMED", start=150, slots=37)
    assert (first[0] + second[0], first[1] + second[1]) == alone


def test_the_rhythm_is_the_same_when_steps_come_at_another_rate(scripted: Any) -> None:
    slow, fast = Alert(scripted).play("CRASHED"), Alert(scripted).play("CRASHED", slots=1000, every_ms=10)
    assert slow == (fast[0][::5], fast[1][::5])
    assert max(len(list(run)) for _, run in groupby(fast[0])) >= 5


def test_a_rhythm_goes_on_when_the_milliseconds_wrap(scripted: Any) -> None:
    assert Alert(scripted).play("FIND_ME", start=2**32 - 1000) == Alert(scripted).play("FIND_ME")


# --- Muted conditions -------------------------------------------------------------------------
def test_every_beep_but_the_pilots_own_can_be_muted() -> None:
    assert {MUTED_BY[name] for name in BEEP_SETTINGS} == BEEPS - {"FIND_ME"}


@pytest.mark.parametrize("setting", BEEP_SETTINGS)
def test_the_beeper_is_silent_and_the_led_is_not_when_a_condition_is_muted(
    scripted: Any, setting: str
) -> None:
    name = MUTED_BY[setting]
    loud, muted = Alert(scripted).play(name), Alert(scripted, setting).play(name)
    assert "#" in loud[0]
    assert muted == ("." * 200, loud[1])


@pytest.mark.parametrize("setting", BEEP_SETTINGS)
def test_the_next_condition_is_heard_when_a_more_urgent_one_is_muted(scripted: Any, setting: str) -> None:
    name = MUTED_BY[setting]
    for other in BEEPS - {name}:
        assert Alert(scripted, setting).play(name, other)[0] == Alert(scripted).play(other)[0]


def test_the_pilots_call_is_heard_when_all_else_is_muted(scripted: Any) -> None:
    everything = Alert(scripted, *BEEP_SETTINGS).play(*NAMES)
    assert everything[0] == Alert(scripted).play("FIND_ME")[0]
    assert everything[1] == Alert(scripted).play(*NAMES)[1]
    assert Alert(scripted, *BEEP_SETTINGS).play(*set(NAMES) - {"FIND_ME"})[0] == "." * 200
