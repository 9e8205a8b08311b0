"""The drawing shows every rotor in its place with its number and spin, in millimetres."""

import dataclasses
import functools
import io
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, shipped
from neuroflight.sim.design.airworthiness import examine
from neuroflight.sim.design.drawing import draw_aircraft, save_drawing


def drawn(aircraft: Aircraft) -> Figure:
    return draw_aircraft(aircraft, examine(aircraft)[0])


@functools.cache
def drawn_shipped(name: str) -> Figure:
    return drawn(load_aircraft(name))


def words(figure: Figure) -> str:
    inside = [text.get_text() for axes in figure.axes for text in axes.texts]
    return "\n".join(inside + [text.get_text() for text in figure.texts])


@pytest.mark.parametrize("name", shipped())
def test_numbers_stand_at_their_hubs_when_seen_from_above(name: str) -> None:
    aircraft, above = load_aircraft(name), drawn_shipped(name).axes[0]
    places = {text.get_text(): text.get_position() for text in above.texts}
    for number, rotor in enumerate(aircraft.rotors, start=1):
        assert places[str(number)] == pytest.approx((1000 * rotor.position[1], 1000 * rotor.position[0]))


def test_forward_is_up_and_left_is_left_when_on_the_page() -> None:
    above, behind = drawn_shipped("nf1").axes
    for view in (above, behind):
        origin, left, up = view.transData.transform([(0, 0), (100, 0), (0, 100)])
        assert left[0] < origin[0] and left[1] == pytest.approx(origin[1])
        assert up[1] > origin[1] and up[0] == pytest.approx(origin[0])
    assert above.get_ylabel() == "x forward, mm"
    assert behind.get_ylabel() == "z up, mm"
    assert behind.get_xlabel() == "y left, mm"
    # One scale for both views.
    lengths = [np.ptp(view.transData.transform([(0, 0), (100, 0)])[:, 0]) for view in (above, behind)]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.01)


def test_arrows_turn_with_the_propellers_when_seen_from_above() -> None:
    above = drawn_shipped("nf1").axes[0]
    arrows = [
        patch
        for patch in above.patches
        if isinstance(patch, FancyArrowPatch) and patch.get_linewidth() == 1.8
    ]
    assert len(arrows) == 4
    turns = []
    for arrow in arrows:
        points = above.transData.transform(arrow._path_original.vertices)  # type: ignore[attr-defined]
        x, y = (points - points.mean(axis=0)).T
        turns.append(np.sign(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))  # on the page, + counter-clockwise
    assert turns == load_aircraft("nf1").spins.tolist()


def test_discs_have_the_propellers_size_when_it_is_known() -> None:
    def radii(figure: Figure) -> set[float]:
        return {round(p.get_radius(), 2) for p in figure.axes[0].patches if isinstance(p, Circle)}

    nf1 = load_aircraft("nf1")
    assert 64.77 in radii(drawn_shipped("nf1"))
    of_none = dataclasses.replace(nf1.propulsion, propeller_diameter=None)
    unknown = drawn(dataclasses.replace(nf1, propulsion=of_none))
    assert 64.77 not in radii(unknown)
    texts = unknown.legends[0].get_texts()
    assert "diameter not given" in " ".join(text.get_text() for text in texts)


def test_figures_stand_beside_the_views_when_the_aircraft_hovers() -> None:
    text = words(drawn_shipped("nf1"))
    for expected in ("nf1", "0.391 kg", "213 mm", "6.69", "27 %", "9,658 rpm", "3.2 A", "21 min", "50 mm"):
        assert expected in text


@pytest.mark.parametrize("name", shipped())
def test_nothing_is_cut_off_or_overlaps_when_rendered(name: str) -> None:
    figure = drawn_shipped(name)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    boxes.append(figure.legends[0].get_window_extent(renderer))
    boxes += [axes.title.get_window_extent(renderer) for axes in figure.axes]
    labels = [axes.yaxis.label.get_window_extent(renderer) for axes in figure.axes]
    page = figure.bbox
    for box in boxes + labels:
        assert page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
    for i, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[i + 1 :])


def test_file_is_a_picture_when_saved(tmp_path: Path) -> None:
    aircraft = load_aircraft("iris")
    save_drawing(tmp_path / "new" / "iris.png", aircraft, examine(aircraft)[0])
    picture = matplotlib.image.imread(io.BytesIO((tmp_path / "new" / "iris.png").read_bytes()))
    assert picture.shape[0] > 800 and picture.shape[1] > 800
    assert picture[..., :3].std() > 0.02
