"""What a browser makes of the page (skipped where there is none)."""

from __future__ import annotations

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

import trackrs as tr
from chromium import Chromium, find_chromium
from report_pages import (
    EVIL,
    MOTION,
    RADAR,
    course,
    every_section,
    scene_of,
    tracks_of,
)
from trackrs.report import (
    Curves,
    Line,
    Prose,
    Scene,
    write_report,
)

needs_browser = pytest.mark.skipif(find_chromium() is None, reason="there is no Chromium on this machine")


@pytest.fixture(scope="module")
def chromium():
    browser = Chromium(find_chromium())
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    write_report(folder / "all.html", "All", every_section())
    return folder


@pytest.fixture
def browser(chromium, pages):
    """The page with everything, in a window of a desk."""
    chromium.window(1200, 900)
    chromium.prefer(prefers_color_scheme="light", prefers_reduced_motion="no-preference")
    chromium.open(pages / "all.html")
    return chromium


SCAN = "report.scenes[0].clock.scan"
FOCUS_PLANE = "document.querySelector('canvas').focus({preventScroll: true})"


def plane(browser):
    """The pixels of the plane."""
    browser.frame()
    data = browser.run("document.querySelector('canvas').toDataURL('image/png')")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data.split(",")[1]))).convert("RGB"), dtype=int)


def box_of(browser, selector):
    """Left, top, width and height of an element in the window."""
    find = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
    return browser.run(f"(({{left, top, width, height}}) => [left, top, width, height])({find})")


def curve_cursor(browser):
    return float(browser.run("document.querySelector('.cursor').getAttribute('x1')"))


@needs_browser
def test_it_loads_in_silence(browser):
    assert browser.complaints == []
    assert [url for url in browser.requests if not url.startswith("data:")] == [browser.run("location.href")]
    assert browser.run("document.querySelectorAll('svg.curves path').length") == 3
    assert browser.run("document.querySelector('section.picture img').naturalWidth") == 40
    assert plane(browser).std() > 5.0
    # What is only said by colour in the picture is said by words as well.
    assert browser.run("document.querySelector('.time').textContent").startswith("29.0 s")


@needs_browser
def test_the_policy_stops_everything_else(browser):
    browser.run(
        "document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.bad = 1'}))"
    )
    stopped = browser.run("fetch('https://example.org/').then(() => 'fetched', () => 'stopped')")
    assert (browser.run("window.bad"), stopped) == (None, "stopped")


@needs_browser
def test_the_slider_moves_the_picture(browser):
    browser.run("report.scenes[0].clock.show(0)")
    before, cursor = plane(browser), curve_cursor(browser)
    slider = "document.querySelector('input[type=range]')"
    browser.run(f"{slider}.value = 20; {slider}.dispatchEvent(new Event('input'))")
    assert browser.run(SCAN) == 20
    assert np.mean(np.any(plane(browser) != before, axis=2)) > 0.003
    assert curve_cursor(browser) > cursor + 100.0
    assert browser.run(f"{slider}.getAttribute('aria-valuetext')") == "20.0 s, scan 21 of 30"


@needs_browser
def test_play_runs_to_the_end_and_begins_anew(browser):
    browser.run("report.scenes[0].clock.speed = 50; report.scenes[0].clock.show(0)")
    browser.click_on("[data-do=play]")
    assert browser.run("document.querySelector('[data-do=play]').getAttribute('aria-label')") == "Pause"
    browser.until(f"{SCAN} === 29 && !report.scenes[0].clock.playing")
    browser.run("report.scenes[0].clock.speed = 5")
    browser.click_on("[data-do=play]")
    assert browser.run(SCAN) < 29
    browser.until(f"{SCAN} > 0")
    browser.click_on("[data-do=play]")
    scan = browser.run(SCAN)
    browser.frame()
    assert browser.run(SCAN) == scan


@needs_browser
def test_keys(browser):
    browser.run(FOCUS_PLANE)
    browser.key("ArrowLeft")
    browser.key("ArrowLeft")
    assert browser.run(SCAN) == 27
    browser.key("ArrowRight")
    assert browser.run(SCAN) == 28
    before = browser.run("[report.scenes[0].scale, report.scenes[0].x]")
    browser.key("+")
    assert browser.run("report.scenes[0].scale") > before[0]
    browser.key("ArrowRight", shift=True)
    assert browser.run("report.scenes[0].x") > before[1]
    browser.key("-")
    browser.key("Home")
    assert browser.run("[report.scenes[0].scale, report.scenes[0].x]") == before
    browser.key(" ")
    assert browser.run("report.scenes[0].clock.playing")
    browser.key(" ")
    assert not browser.run("report.scenes[0].clock.playing")


@needs_browser
def test_everything_is_reached_by_tab(browser):
    browser.run("document.body.focus()")
    seen, focus = set(), "document.activeElement"
    for _ in range(60):
        browser.key("Tab")
        seen.add(browser.run(f"({focus}.getAttribute('aria-label') ?? {focus}.className) || {focus}.tagName"))
        assert browser.run(f"{focus} === document.body || {focus}.matches(':focus-visible')")
    assert {
        "Dark colours",
        "Zoom in",
        "Fit all",
        "Play",
        "One scan on",
        "Scan",
        "Show track 1",
        "SELECT",
        "sort",
    } <= seen
    assert any(name.startswith("Plane: tracks on a plane") for name in seen)
    nameless = """[...document.querySelectorAll('button, select, input')].filter((e) =>
        !(e.getAttribute('aria-label') ?? e.textContent + (e.labels?.[0]?.textContent ?? '')).trim()).length"""
    assert browser.run(nameless) == 0


@needs_browser
def test_a_track_is_chosen_and_shown(browser):
    browser.click_on("tr[data-track='1'] button")
    scene = browser.run("[report.scenes[0].chosen, report.scenes[0].x, report.scenes[0].y, report.scenes[0].rowNow(1)]")
    assert scene[0] == 1
    position = browser.run(f"[...report.scenes[0].position.slice({2 * scene[3]}, {2 * scene[3] + 2})]")
    assert scene[1:3] == position
    chosen = browser.run("document.querySelector('.chosen').textContent")
    row = every_section()[0].tracks.of_scan(29)[1]
    assert chosen.startswith("Track 2")
    assert f"{row.state.mean[0]:.2f} m".replace("-", "\N{MINUS SIGN}") in chosen
    assert browser.run("document.querySelector(\"tr[data-track='1'] button\").getAttribute('aria-pressed')") == "true"
    browser.run("window.scrollTo(0, 0)")
    box = box_of(browser, "canvas")
    middle = (box[0] + box[2] / 2, box[1] + box[3] / 2)
    browser.mouse("mouseMoved", *middle)
    assert browser.run("document.querySelector('.tip').textContent").startswith("Track 2")
    browser.click(*middle)  # once more lets it go
    assert browser.run("report.scenes[0].chosen") == -1


@needs_browser
def test_wheel_zooms_and_drag_pans(browser):
    box = box_of(browser, "canvas")
    at = (box[0] + 300, box[1] + 200)
    before = browser.run("[...report.scenes[0].onPlane([300, 200]), report.scenes[0].scale]")
    browser.mouse("mouseWheel", *at, deltaX=0, deltaY=-120)
    browser.until(f"report.scenes[0].scale > {before[2]}")
    assert np.allclose(browser.run("report.scenes[0].onPlane([300, 200])"), before[:2], atol=1e-6)
    browser.mouse("mousePressed", *at, button="left", buttons=1)
    browser.mouse("mouseMoved", at[0] + 60, at[1] + 10, button="left", buttons=1)
    browser.mouse("mouseReleased", at[0] + 60, at[1] + 10, button="left")
    browser.frame()
    assert np.allclose(browser.run("report.scenes[0].onPlane([360, 210])"), before[:2], atol=1e-6)
    assert browser.run("report.scenes[0].chosen") == -1


@needs_browser
def test_fingers(browser):
    left, top, width, height = box_of(browser, "canvas")
    middle = (left + width / 2, top + height / 2)
    before = browser.run("report.scenes[0].scale")

    def touch(kind, *points):
        browser.send("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in points])

    browser.send("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    for kind, apart in (("touchStart", 40.0), ("touchMove", 60.0), ("touchMove", 80.0)):
        touch(kind, (middle[0] - apart, middle[1]), (middle[0] + apart, middle[1]))
    touch("touchEnd")
    browser.until(f"Math.abs(report.scenes[0].scale / {before} - 2) < 0.01")
    row = browser.run("report.scenes[0].rowNow(0)")
    x, y = browser.run(f"((s) => [s.px(s.position[{2 * row}]), s.py(s.position[{2 * row + 1}])])(report.scenes[0])")
    browser.run(f"report.scenes[0].pan({width / 2} - {x}, {height / 2} - {y})")
    touch("touchStart", middle)
    touch("touchEnd")
    browser.until("report.scenes[0].chosen === 0")
    browser.send("Emulation.setTouchEmulationEnabled", enabled=False)


@needs_browser
def test_the_legend_switches(browser):
    assert browser.run("[...document.querySelectorAll('.legend label')].map((e) => e.textContent)") == [
        "Tracks",
        "7Track numbers",
        "1 and 2 sigma",
        "Gates (99 %)",
        "Truth",
        "radar",
    ]
    pictures = [plane(browser)]
    for k in range(6):
        browser.click_on(f".legend label:nth-of-type({k + 1}) input")
        pictures.append(plane(browser))
        assert np.any(pictures[-1] != pictures[-2])
    assert np.mean(np.any(pictures[-1] != pictures[-1][300, 400], axis=2)) < 0.1  # the grid alone


@needs_browser
def test_dark_and_light(browser):
    light = plane(browser).mean()
    browser.click_on("#theme")
    dark = plane(browser).mean()
    assert dark < 60.0
    assert light > 200.0
    assert browser.run("getComputedStyle(document.body).colorScheme") == "dark"
    browser.click_on("#theme")
    assert plane(browser).mean() == pytest.approx(light, abs=0.1)
    browser.prefer(prefers_color_scheme="dark")
    assert browser.run("document.documentElement.dataset.theme") == "light"  # what was chosen stays


@needs_browser
def test_dark_by_preference(browser, pages):
    browser.prefer(prefers_color_scheme="dark")
    browser.open(pages / "all.html")
    assert plane(browser).mean() < 60.0


@needs_browser
def test_less_motion_if_asked_for(browser):
    browser.prefer(prefers_reduced_motion="reduce")
    browser.run("report.scenes[0].clock.speed = 5; report.scenes[0].clock.show(0)")
    steps = browser.run(
        "new Promise((done) => { const { clock } = report.scenes[0]; const at = []; clock.play();"
        "clock.listeners.push(() => { if (at.push(performance.now()) === 4) { clock.pause(); done(at); } }); })"
    )
    assert np.diff(steps[:4]).min() > 200.0
    assert browser.run("getComputedStyle(document.querySelector('button')).transitionDuration") == "0s"


@needs_browser
def test_a_phone(browser, pages):
    browser.window(375, 700, ratio=2.0, mobile=True)
    browser.open(pages / "all.html")
    assert browser.run("document.documentElement.scrollWidth") == 375
    assert box_of(browser, "canvas")[2] > 300
    controls = box_of(browser, ".controls")
    assert box_of(browser, ".panel")[1] >= controls[1] + controls[3]
    assert browser.complaints == []


@needs_browser
def test_print_is_light(browser):
    browser.click_on("#theme")
    browser.run("window.dispatchEvent(new Event('beforeprint'))")
    assert plane(browser).mean() > 200.0
    browser.run("window.dispatchEvent(new Event('afterprint'))")
    assert plane(browser).mean() < 60.0
    assert base64.b64decode(browser.send("Page.printToPDF")["data"]).startswith(b"%PDF-")


@needs_browser
def test_tables_are_sorted(browser):
    values = "[...document.querySelectorAll('section.table tbody tr')].map((row) => row.cells[1].textContent)"
    assert browser.run(values) == ["1.235", "–", "7"]
    browser.click_on("section.table thead th:nth-child(2) button")
    assert browser.run(values)[-1] == "7"
    browser.click_on("section.table thead th:nth-child(2) button")
    assert browser.run(values)[0] == "7"


@needs_browser
def test_curves_set_the_clock(browser):
    browser.run("document.querySelector('svg.curves').scrollIntoView({block: 'center'})")
    box = box_of(browser, "svg.curves")
    browser.click(box[0] + box[2] / 2, box[1] + 80)
    assert 10 <= browser.run(SCAN) <= 19
    shown = browser.run("[...document.querySelectorAll('.lines b')].map((e) => e.textContent)")
    assert shown[0] == f"{5.0 + np.sin(browser.run(SCAN)):.3g}"


@needs_browser
def test_names_are_text_in_the_browser(chromium, tmp_path):
    scene = Scene(
        tracks_of(course(3, 2), [0.0, 1.0, 2.0], [1, 2]),
        title=EVIL,
        scans=[tr.Scan(float(k), [[0.0, 0.0]], EVIL) for k in range(3)],
        sensors={EVIL: RADAR},
        labels=(EVIL, EVIL),
    )
    lines = Curves([Line(EVIL, [0.0, 1.0], [1.0, 2.0])], EVIL, EVIL, EVIL, band=EVIL)
    write_report(tmp_path / "evil.html", EVIL, [scene, lines, Prose(EVIL)])
    chromium.open(tmp_path / "evil.html")
    chromium.click_on("tr[data-track='0'] button")
    assert chromium.run("document.title") == EVIL
    assert chromium.run("document.querySelector('.prose p').textContent") == EVIL
    assert chromium.run("document.querySelector('.lines span').textContent") == EVIL
    assert chromium.run("[window.evil, document.querySelectorAll('img').length]") == [None, 0]
    assert chromium.complaints == []


@needs_browser
@pytest.mark.parametrize("times", [[], [3.0], [0.0, 0.0], [0.0, 1.0]])
def test_almost_nothing_is_no_fault(chromium, tmp_path, times):
    scans = [tr.Scan(time, [], "radar") for time in times]
    empty = Scene(
        tracks_of(np.zeros((len(times), 0, 4)), times, []), scans=scans, sensors={"radar": RADAR}, motion=MOTION
    )
    means = course(len(times), 1)
    if len(times) > 1:
        means[1] = np.nan
    one = Scene(tracks_of(means, times, [1]), own_ship=np.full((len(times), 2), np.nan), region=5.0, motion=MOTION)
    curves = Curves([Line("a", times, np.full(len(times), np.nan))])
    write_report(tmp_path / "empty.html", "Empty", [empty, one, curves])
    chromium.open(tmp_path / "empty.html")
    for key in ("ArrowRight", " ", "+", "Home"):
        chromium.key(key)
    assert chromium.complaints == []


@needs_browser
def test_a_large_scene(chromium, tmp_path):
    write_report(tmp_path / "large.html", "Large", [scene_of(scans=1000, count=50, detections=100)])
    chromium.window(1200, 900)
    chromium.open(tmp_path / "large.html")
    assert chromium.run("[report.scenes[0].times.length, report.scenes[0].rowsOf.length]") == [1000, 50]
    for history, tail in (("20", "whole"), ("all", "none")):
        chromium.run(f"void Object.assign(report.scenes[0], {{history: '{history}', tail: '{tail}', stale: true}})")
        chromium.run("report.scenes[0].clock.show(500)")
        assert plane(chromium).std() > 10.0
    assert chromium.complaints == []
