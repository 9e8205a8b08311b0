"""Picture of what ESCs tell: a panel a topic with its unit, a line a motor."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.analysis.esc_plot import TITLES, draw_topics
from neuroflight.sim.flight.esc_record import DIGITS


def test_every_topic_has_a_panel_with_its_unit_and_says_when_it_is_not_known() -> None:
    topics = {name: np.outer(np.arange(50.0), np.arange(1.0, 5.0)) for name in DIGITS}
    topics["voltage_v"] = np.full((50, 4), 16.0)
    topics["temperature_c"] = np.full((50, 4), np.nan)
    assert set(TITLES) == set(DIGITS)
    panels = dict(zip(TITLES, draw_topics(topics, 1000, "a flight").axes, strict=True))
    assert {name: len(panel.lines) for name, panel in panels.items()} == {
        **dict.fromkeys(DIGITS, 4),
        "voltage_v": 1,
        "temperature_c": 0,
    }
    assert [panel.get_ylabel() for panel in panels.values()] == [unit for _, unit in TITLES.values()]
    assert [text.get_text() for text in panels["temperature_c"].texts] == ["not in the aircraft file"]
    assert np.max(panels["force_n"].lines[1].get_xdata()) == 0.049
