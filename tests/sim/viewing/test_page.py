"""The page of a flight in a browser: it plays, follows its controls and stays inside its window."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.trace import load_trace, save_trace
from neuroflight.sim.viewing.poses import attitudes
from tests.sim.viewing.test_view import rolling_trace

pytestmark = pytest.mark.slow

Pixels = NDArray[np.int16]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = shutil.which("chromium")
    assert program, "chromium is missing; run: make chromium"
    with sync_playwright() as driver:
        # Inside a container the browser cannot make a sandbox of its own.
        opened = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1 s of constant rates about all axes; its page is beside it."""
    path = tmp_path_factory.mktemp("page") / "<b onclick='x'>roll.npz"
    still = rolling_trace()
    save_trace(path, replace(still, rate=np.tile([1.6, 0.9, -0.7], (len(still.t), 1))))
    assert main(["view", str(path), "--out", str(path.with_name("roll.html"))]) == 0
    return path


@contextmanager
def opened(browser: Browser, flight: Path, motion: str = "reduce", **how: object) -> Iterator[Page]:
    """The page in a tab of its own; it may load nothing and complain of nothing."""
    page = browser.new_page(reduced_motion=motion, **how)  # type: ignore[arg-type]
    failures: list[str] = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    page.on("console", lambda said: failures.append(said.text))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    address = flight.with_name("roll.html").as_uri()
    page.goto(address)
    yield page
    assert failures == [] and asked == [address]
    page.close()


@pytest.fixture
def page(browser: Browser, flight: Path) -> Iterator[Page]:
    """The page, which stands still at first, as for one who asked for less motion."""
    with opened(browser, flight) as tab:
        yield tab


def let_draw(page: Page, frames: int = 2) -> None:
    """Return when the browser has drawn so many frames."""
    for _ in range(frames):
        page.evaluate("() => new Promise(requestAnimationFrame)")


def seen(page: Page, canvas: str = "view") -> Pixels:
    """What a canvas shows once all that was asked of the page is drawn: (height, width, 3)."""
    let_draw(page)
    picture = Image.open(BytesIO(page.locator(f"#{canvas}").screenshot()))
    return np.asarray(picture.convert("RGB"), np.int16)


def now(page: Page) -> str:
    """The time that the page tells."""
    let_draw(page)
    return page.locator("#now").inner_text()


def test_it_plays_to_the_end_and_again(browser: Browser, flight: Path) -> None:
    with opened(browser, flight, motion="no-preference") as page:
        page.wait_for_function("document.getElementById('play').textContent === 'Play'", timeout=30_000)
        assert now(page) == "1.00 of 1.00 s"
        page.click("#play")
        page.wait_for_function("parseFloat(document.getElementById('now').textContent) < 1")
        assert page.locator("#play").inner_text() == "Pause"


def test_who_asked_for_less_motion_gets_a_page_that_stands(page: Page) -> None:
    assert now(page) == "0.00 of 1.00 s"
    assert page.locator("#play").inner_text() == "Play"
    still = seen(page)
    let_draw(page, 20)
    assert np.array_equal(seen(page), still)
    assert now(page) == "0.00 of 1.00 s"


def test_the_slider_the_keys_and_the_charts_set_the_time(page: Page) -> None:
    level = seen(page)
    page.locator("#seek").fill("25")
    assert now(page) == "0.50 of 1.00 s"
    assert not np.array_equal(seen(page), level)
    page.locator("#seek").blur()
    page.keyboard.press("ArrowRight")
    assert now(page) == "0.52 of 1.00 s"
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert now(page) == "0.48 of 1.00 s"
    box = page.locator("#rates").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] - 2, box["y"] + box["height"] / 2)
    assert now(page) == "1.00 of 1.00 s"
    page.mouse.click(box["x"] + 2, box["y"] + box["height"] / 2)
    assert now(page) == "0.00 of 1.00 s"
    assert np.array_equal(seen(page), level)


def test_dragging_turns_the_view_the_wheel_comes_closer_and_reset_goes_back(page: Page) -> None:
    first = seen(page)
    box = page.locator("#view").bounding_box()
    assert box is not None
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 80, middle[1] + 30)
    page.mouse.up()
    turned = seen(page)
    assert not np.array_equal(turned, first)
    page.mouse.move(*middle)  # after the button is up the pointer turns nothing
    assert np.array_equal(seen(page), turned)
    page.click("#reset")
    assert np.array_equal(seen(page), first)
    page.mouse.move(*middle)
    page.evaluate("() => { window.wheeled = new Promise((done) => addEventListener('wheel', done)); }")
    page.mouse.wheel(0, -300)
    page.evaluate("() => window.wheeled.then(() => true)")
    assert coloured(seen(page)) > 1.5 * coloured(first)
    page.click("#reset")
    assert np.array_equal(seen(page), first)


def coloured(pixels: Pixels) -> int:
    """How many pixels are of no grey: discs and rims."""
    return int((np.ptp(pixels, axis=2) > 40).sum())


def test_the_page_draws_the_attitude_of_the_flight(page: Page, flight: Path) -> None:
    trace = load_trace(flight)
    truth = attitudes(trace.t, trace.rate)
    arm = load_aircraft("nf1").rotor_positions[0].tolist()
    for frame, row in ((0, 0), (12.5, 50), (25, 100), (50, 200)):
        drawn = page.evaluate(
            """([k, arm]) => {
                 const data = JSON.parse(document.getElementById("data").textContent);
                 return rotate(pose(data, k).attitude, arm);
               }""",
            [frame, arm],
        )
        assert drawn == pytest.approx(truth[row] @ arm, abs=5e-5)  # of 0.11 m


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_ink_stands_out_from_the_page_in_both_schemes(browser: Browser, flight: Path, scheme: str) -> None:
    with opened(browser, flight, color_scheme=scheme) as page:
        chart = seen(page, "rates").mean(axis=2)
        ground = float(np.median(chart))
        assert (ground < 64) if scheme == "dark" else (ground > 192)
        assert np.abs(chart - ground).max() > 128


@pytest.mark.parametrize("size", [(360, 640), (768, 1024), (1600, 900)])
def test_it_fits_the_window_and_fills_its_canvases(
    browser: Browser, flight: Path, size: tuple[int, int]
) -> None:
    window = {"width": size[0], "height": size[1]}
    with opened(browser, flight, viewport=window, device_scale_factor=2) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        for canvas in ("view", "rates", "motors"):
            shown = page.evaluate(
                "(id) => { const c = document.getElementById(id); return [c.width, c.clientWidth]; }", canvas
            )
            assert shown[0] == 2 * shown[1] > 300
            assert np.ptp(seen(page, canvas)) > 60


def test_a_name_of_a_file_is_text(page: Page) -> None:
    assert "<b onclick='x'>roll.npz" in page.locator("h1").inner_text()
    assert page.locator("b").count() == 0
