"""Flame graphs: each box stands on its caller's, its width in proportion to its instructions."""

from __future__ import annotations

from xml.etree import ElementTree

from neuroflight.sim.board.debug.flame_graph import MARGIN, ROW, WIDTH, flame_graph

SVG = "{http://www.w3.org/2000/svg}"
STACKS = ("main 100", "main;work 300", "main;work;a<b> 500", "tick 99", "tick;rare 1")


def boxes(svg: str) -> dict[str, tuple[float, float, float]]:
    """Place and width of each box by the name in its hint."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        rect, hint = group.find(f"{SVG}rect"), group.findtext(f"{SVG}title")
        assert rect is not None and hint is not None
        found[hint.split(":")[0]] = (
            float(rect.attrib["x"]),
            float(rect.attrib["y"]),
            float(rect.attrib["width"]),
        )
    return found


def test_boxes_are_as_wide_as_their_instructions_when_drawn() -> None:
    found = boxes(flame_graph(STACKS, "a & b"))
    widths = {name: round(1000 * width / WIDTH) for name, (_, _, width) in found.items()}
    assert widths == {"all": 1000, "main": 900, "work": 800, "a<b>": 500, "tick": 100, "rare": 1}
    rows = {name: round((found["all"][1] - y) / ROW) for name, (_, y, _) in found.items()}
    assert rows == {"all": 0, "main": 1, "work": 2, "a<b>": 3, "tick": 1, "rare": 2}
    assert found["tick"][0] == MARGIN + WIDTH * 0.9
    for upper, lower in (("a<b>", "work"), ("work", "main"), ("rare", "tick")):
        assert found[lower][0] <= found[upper][0]
        assert found[upper][0] + found[upper][2] <= found[lower][0] + found[lower][2] + 0.02


def test_what_is_too_narrow_to_see_is_left_out_when_drawn() -> None:
    assert set(boxes(flame_graph(("main 1000000", "main;tiny 1"), "t"))) == {"all", "main"}
    assert set(boxes(flame_graph((), "nothing"))) == set()


def test_names_are_cut_and_escaped_when_the_box_is_narrow() -> None:
    texts = [text.text for text in ElementTree.fromstring(flame_graph(STACKS, "a & b")).iter(f"{SVG}text")]
    assert texts[0] == "a & b"
    assert {"all", "main", "work", "a<b>", "tick"} == set(texts[1:])
    (cut,) = [
        text.text
        for text in ElementTree.fromstring(flame_graph(("x 900", "a_long_name 50"), "")).iter(f"{SVG}text")
        if (text.text or "").endswith("..")
    ]
    assert cut is not None and "a_long_name".startswith(cut[:-2])
