"""Learn: the lessons edited, stepped, pointed at, and reopened from their address."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import until

pytestmark = pytest.mark.browser
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
DARK = {"color_scheme": "dark"}
PATIENCE_MS = 480_000
"""The first answer of all may have to wait for cold kernels."""
COUNTEREXAMPLE = (
    "/learn/search?map=3x3bhAA&start=0.0&goal=2.2&panels=eea.table.fifo~eea-cell.paper.fifo~eea-time.paper.fifo"
)


def open_lesson(page: Page, address: str) -> None:
    page.goto(address)
    settled(page, PATIENCE_MS)


def settled(page: Page, timeout_ms: float = 30_000) -> None:
    """The newest answer is shown."""
    page.wait_for_selector("#lesson[data-answers]:not([aria-busy])", timeout=timeout_ms)


def answers(page: Page) -> int:
    return int(page.locator("#lesson").get_attribute("data-answers") or 0)


def after(page: Page, before: int) -> None:
    """Waits for an answer newer than the one counted before."""
    until(
        page,
        f"(s => Number(s.dataset.answers) > {before} && !s.hasAttribute('aria-busy'))"
        "(document.querySelector('#lesson'))",
    )


def view(panel: int | None) -> str:
    return "wattlane.lesson.floorView" if panel is None else f"wattlane.lesson.panels[{panel}].view"


def at_cell(page: Page, x: int, y: int, panel: int | None = 0) -> tuple[float, float]:
    """Where a cell is on the page."""
    spot = page.evaluate(f"([x, y]) => {{ const v = {view(panel)}; return v.place(x + y * v.floor.width); }}", [x, y])
    return spot[0], spot[1]


def counts(page: Page, panel: int = 0) -> str:
    return page.locator(".wl-lesson-counts").nth(panel).inner_text()


def colour(page: Page, x: int, y: int, panel: int = 0) -> str:
    """The colour of a spot beside a cell's middle, as the canvas shows it."""
    return str(
        page.evaluate(
            f"""([x, y]) => {{ const v = {view(panel)}, g = v.geometry, ratio = v.canvas.width / v.canvas.clientWidth;
            const cell = x + y * g.width, at = [g.left(cell) + g.size * 0.82, g.top(cell) + g.size * 0.6];
            const [r, gr, b] = v.canvas.getContext('2d').getImageData(at[0] * ratio, at[1] * ratio, 1, 1).data;
            return '#' + [r, gr, b].map((n) => n.toString(16).padStart(2, '0')).join(''); }}""",
            [x, y],
        )
    )


def test_the_cards_lead_to_the_lessons_and_their_examples(dashboard: Any, page: Page) -> None:
    page.goto(f"{dashboard.url}/learn")
    cards = page.locator(".wl-lesson-card")
    titles = ["Search playback", "Heuristics matrix", "Anytime and repair", "Constraint tree", "Learned time"]
    expect(cards.locator("h2")).to_have_text([*titles, "Motor to battery", "Ants", "Break it"])
    page.get_by_role("link", name="Tie rules").click()
    settled(page, PATIENCE_MS)
    expect(page.locator(".wl-lesson-panel")).to_have_count(4)
    expect(page.get_by_role("button", name="Tie rules")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("link", name="Constraint tree").click()
    expect(page.locator(".wl-lesson-svg")).to_be_visible()
    settled(page, PATIENCE_MS)
    page.go_back()
    expect(page.locator(".wl-lesson-panel")).to_have_count(4)


def test_a_search_is_stepped_with_keys_and_buttons(dashboard: Any, page: Page) -> None:
    open_lesson(page, dashboard.url + COUNTEREXAMPLE)
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("0 / 4 expanded")
    page.keyboard.press("ArrowRight")
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("1 / 4 expanded")
    assert "#1: (0, 0)" in counts(page)
    assert colour(page, 0, 1) == "#98fb98"  # open
    page.keyboard.press("ArrowRight")
    assert colour(page, 0, 1) == "#afeeee"  # closed
    page.keyboard.press("ArrowLeft")
    assert colour(page, 0, 1) == "#98fb98"
    page.keyboard.press("Shift+ArrowRight")
    assert page.get_by_label("Step number").input_value() == "11"
    page.keyboard.press("End")
    assert "1,432.9 J" in counts(page).replace("\n", " ")
    assert "least energy" in counts(page)
    for panel in (1, 2):
        assert "+14.7 %" in counts(page, panel)
    page.keyboard.press("Home")
    page.get_by_role("button", name="One step on").click()
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("1 / 4 expanded")
    page.get_by_label("Step number").fill("3")
    page.keyboard.press("Enter")
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("3 / 4 expanded")
    page.get_by_label("Steps per second").select_option("250")
    page.get_by_role("button", name="Play (Space)").click()
    expect(page.get_by_label("Step number")).to_have_value("128")
    expect(page.get_by_role("button", name="Play (Space)")).to_be_visible()


def test_the_matrix_steps_all_its_searches_together(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/heuristics?step=30")
    panels = page.locator(".wl-lesson-panel")
    expect(panels).to_have_count(8)
    done = page.locator(".wl-lesson-counts").evaluate_all("each => each.map((e) => Number(e.dataset.done))")
    assert done == [30, 30, 30, 30, 10, 20, 30, 18]
    page.keyboard.press("End")
    expect(page.locator(".wl-lesson-counts").nth(0)).to_contain_text("14.00 long")
    expect(page.locator(".wl-lesson-counts").nth(7)).to_contain_text("11.07 long")
    rows = page.locator(".wl-lesson-now tbody tr")
    expect(rows).to_have_count(8)
    expect(rows.nth(4)).to_have_text("8 neighbours, Manhattan *1011.07")
    # another heuristic of one search, from its menu; the address holds it
    before = answers(page)
    page.get_by_label("Connectivity of search 8").select_option("cut")
    after(page, before)
    until(page, "location.search.includes('~cut.octile.fifo')")
    page.reload()
    settled(page)
    expect(page.get_by_label("Connectivity of search 8")).to_have_value("cut")
    page.get_by_role("button", name="Manhattan oversteps").click()
    expect(panels).to_have_count(6)
    settled(page)
    page.keyboard.press("End")
    expect(page.locator(".wl-lesson-counts").nth(1)).to_contain_text("+6.6 %")


def test_pointing_at_a_cell_tells_its_states(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}{COUNTEREXAMPLE}&step=200")
    page.mouse.move(*at_cell(page, 1, 1))
    told = page.locator("#lesson-now")
    expect(told.locator("h2")).to_have_text("Cell (1, 1)")
    first = told.locator("tbody").first.locator("tr").first.locator("td")
    # east, 628.1 + 338.4 J driven, a straight cell and a turn to go, third, from (0, 1)
    expect(first).to_have_text(["→", "966", "466", "1,433", "#3", "(0, 1) #2"])
    expect(page.locator(".wl-lesson-panel .wl-tip").first).to_contain_text("heading east, closed as #3")
    page.mouse.move(5, 5)
    expect(told.locator("h2")).to_have_text("A cell")


def test_an_edited_floor_is_planned_again_and_its_address_reopens_it(dashboard: Any, page: Page) -> None:
    open_lesson(
        page, f"{dashboard.url}/learn/search?map=9x7&start=0.3&goal=8.3&panels=astar.manhattan.fifo~eea.table.lifo"
    )
    page.keyboard.press("End")
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("8 m")
    before = answers(page)
    page.mouse.move(*at_cell(page, 4, 0))
    page.mouse.down()
    page.mouse.move(*at_cell(page, 4, 5), steps=3)
    page.mouse.up()
    after(page, before)
    page.keyboard.press("End")
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("14 m")
    before = answers(page)
    page.mouse.move(*at_cell(page, 8, 3, 1))
    page.mouse.down()
    page.mouse.move(*at_cell(page, 7, 1, 1), steps=4)
    page.mouse.up()
    after(page, before)
    until(page, "wattlane.lesson.state.goal == '7.1'")
    before = answers(page)
    page.get_by_label("Algorithm of search 1").select_option("dijkstra-energy")
    after(page, before)
    page.keyboard.press("Home")
    page.locator("body").click(position={"x": 5, "y": 60})
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    expect(page).to_have_url(re.compile(r"step=7"))
    seen = [counts(page, 0), counts(page, 1)]
    address = page.url
    assert re.search(
        r"map=9x7b[\w-]+&start=0\.3&goal=7\.1&panels=dijkstra-energy\.zero\.fifo~eea\.table\.lifo&step=7$", address
    )
    page.goto("about:blank")
    open_lesson(page, address)
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("7 / ")
    assert [counts(page, 0), counts(page, 1)] == seen
    until(page, "wattlane.lesson.floor.walls.reduce((a, b) => a + b) == 6")
    before = answers(page)
    page.get_by_role("button", name="Clear").click()
    after(page, before)
    until(page, "location.href.includes('map=9x7&')")


def test_the_floor_is_drawn_with_the_keyboard(dashboard: Any, page: Page) -> None:
    open_lesson(
        page, f"{dashboard.url}/learn/search?map=5x4&start=0.0&goal=4.3&panels=astar.manhattan.fifo~eea.table.lifo"
    )
    page.locator(".wl-lesson-canvas").first.focus()
    for key in ("ArrowUp", "ArrowUp", "ArrowRight"):
        page.keyboard.press(key)
    before = answers(page)
    page.keyboard.press("Enter")
    after(page, before)
    until(page, "[...wattlane.lesson.floor.walls].indexOf(1) == 6")
    page.keyboard.press("ArrowUp")
    before = answers(page)
    page.keyboard.press("s")
    after(page, before)
    until(page, "wattlane.lesson.state.start == '1.2'")
    page.keyboard.press("Escape")
    page.keyboard.press("ArrowRight")
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("1 / ")


def test_random_floors_and_searches_are_added_and_removed(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/search?panels=astar.manhattan.fifo")
    page.get_by_label("Columns", exact=True).fill("12")
    page.get_by_label("Rows", exact=True).fill("10")
    page.get_by_label("Seed", exact=True).fill("5")
    before = answers(page)
    page.get_by_role("button", name="Random floor").click()
    after(page, before)
    until(page, "location.href.includes('map=12x10r20s5&')")
    until(page, "wattlane.lesson.floor.walls.reduce((a, b) => a + b) == 24")
    for many in (2, 3, 4):
        page.get_by_role("button", name="Add a search").click()
        expect(page.locator(".wl-lesson-panel")).to_have_count(many)
        settled(page)
    expect(page.get_by_role("button", name="Add a search")).to_be_disabled()
    page.get_by_role("button", name="Remove search 2").click()
    expect(page.locator(".wl-lesson-panel")).to_have_count(3)


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("/learn/search?map=90x90", "sides of 2 to 60 cells were expected, got 90"),
        ("/learn/search?panels=astar.manhatan.fifo", "did you mean 'manhattan'?"),
        ("/learn/break-it?case=parkd", "did you mean 'parked'?"),
        ("/learn/tree?vehicles=0.0-3.3", "2 to 5 were expected, got 1"),
        ("/learn/learned-time?start=E77&goal=N20", "did you mean 'E7'?"),
        ("/learn/motor?gear=900", "gear: a number from 5 to 60"),
    ],
)
def test_a_bad_address_says_so_and_shows_the_first_example(
    dashboard: Any, page: Page, path: str, sentence: str
) -> None:
    open_lesson(page, dashboard.url + path)
    expect(page.get_by_role("alert").filter(has_text=sentence)).to_be_visible()
    expect(page.locator(".wl-lesson-group .wl-button").first).to_have_attribute("aria-pressed", "true")


def told_nodes(page: Page) -> list[dict[str, Any]]:
    """The nodes that the server answered with."""
    nodes: list[dict[str, Any]] = page.evaluate("wattlane.lesson.data.nodes")
    return nodes


def test_the_tree_is_played_chosen_from_and_reopened(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/tree")
    shown = page.locator(".wl-lesson-node:not(.hidden)")
    now = page.locator("#lesson-now")
    expect(shown).to_have_count(1)
    page.keyboard.press("ArrowRight")
    nodes = told_nodes(page)
    expect(shown).to_have_count(1 + sum(node["parent"] == 0 for node in nodes))
    expect(now.locator("h2")).to_have_text("Node 0")
    expect(now).to_contain_text("It is the only open node.")
    expect(now).to_contain_text(nodes[0]["conflict"]["text"])
    page.locator(".wl-lesson-node[data-node='1']").click()
    expect(now.locator("h2")).to_have_text("Node 1")
    expect(now).to_contain_text(nodes[1]["constraint"])
    page.get_by_label("Time of the plan in steps").fill("3")
    expect(page).to_have_url(re.compile(r"&step=1&node=1&time=3$"))
    address = page.url
    page.goto("about:blank")
    open_lesson(page, address)
    expect(now.locator("h2")).to_have_text("Node 1")
    expect(page.locator(".wl-lesson-clock")).to_contain_text("step 3 /")
    page.keyboard.press("End")
    expect(page.locator(".wl-lesson-node.answer")).to_have_count(1)
    expect(now).to_contain_text("6,125.7 J")
    last = page.get_by_label("Time of the plan in steps").get_attribute("max")
    page.get_by_role("button", name="Drive").click()
    expect(page.locator(".wl-lesson-clock")).to_have_text(f"step {last} / {last}")
    answer = next(node for node in nodes if not node["conflicts"] and node["status"] == 3)
    page.locator(".wl-lesson-svg").focus()
    page.keyboard.press("ArrowUp")
    expect(now.locator("h2")).to_have_text(f"Node {answer['parent']}")


def test_switches_and_edits_change_the_tree(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/tree")
    status = page.locator(".wl-lesson-status")
    expect(status).to_contain_text("6,125.7 J")
    few, before = len(told_nodes(page)), answers(page)
    page.get_by_label("disjoint splitting").uncheck()
    after(page, before)
    expect(status).to_contain_text("6,125.7 J")
    assert len(told_nodes(page)) > 4 * few
    before = answers(page)
    page.get_by_label("Planner").select_option("cbs")
    after(page, before)
    expect(status).to_contain_text("24 steps")
    before = answers(page)
    page.mouse.move(*at_cell(page, 1, 1, None))
    page.mouse.down()
    page.mouse.up()
    after(page, before)
    until(page, "wattlane.lesson.floor.walls[5] == 1")
    before = answers(page)
    page.get_by_role("button", name="One vehicle less").click()
    after(page, before)
    until(page, "wattlane.lesson.plan.length == 3")
    before = answers(page)
    page.mouse.move(*at_cell(page, 3, 3, None))
    page.mouse.down()
    page.mouse.move(*at_cell(page, 3, 2, None), steps=3)
    page.mouse.up()
    after(page, before)
    assert page.evaluate("wattlane.lesson.state.vehicles").startswith("0.0-3.2~")
    page.get_by_role("button", name="Rule B").click()
    expect(status).to_contain_text("the priority rule left no plan")


def test_learned_times_are_scrubbed_and_a_request_is_routed(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/learned-time")
    now = page.locator("#lesson-now")
    rows = now.locator("tbody tr")
    expect(rows).to_have_text([re.compile(f"^{name}16.2 m117.2 sleast$") for name in
                               ("stochastic", "literal", "astar-turns", "astar-distance")])  # fmt: skip
    page.keyboard.press("End")
    expect(rows.first).to_contain_text("16.2 m2")
    expect(rows.nth(2)).to_contain_text(re.compile(r"16\.2 m1.*\+\d\d %$"))
    expect(page.locator(".wl-lesson-status")).to_contain_text("after refresh 20 of 20, 10:00:00")
    expect(page).to_have_url(re.compile("step=20$"))
    # an arc tells what is expected of it, what was seen, and how long it was held
    lane = page.evaluate(
        "wattlane.lesson.map.floor.lanes.find((l) => wattlane.lesson.map.stationAt.get(l.from).name === 'N59').place"
    )
    box = page.locator(".wl-lesson-map .wl-map-canvas").bounding_box()
    assert box is not None

    def at(place: int) -> tuple[float, float]:
        x, y = page.evaluate(f"wattlane.lesson.map.placeScreen({place})")
        return box["x"] + x, box["y"] + y

    page.mouse.move(*at(lane))
    expect(page.locator(".wl-lesson-map .wl-tip")).to_have_text(
        re.compile(
            r"^(lane|kerb) N59→[EN]\d+ · expected \d\.\d\d s · [\d,]+ passages in the last 30 min · occupied \d+\.\d %"
        )
    )
    # a click sets the start, the next one the goal; a list does too
    nodes = page.evaluate("Object.fromEntries(wattlane.lesson.map.floor.stations.map((s) => [s.name, s.place]))")
    for name in ("E5", "N70"):
        before = answers(page)
        page.mouse.click(*at(nodes[name]))
        after(page, before)
    expect(now.locator("h2")).to_have_text("E5 → N70")
    before = answers(page)
    page.get_by_label("Goal", exact=True).select_option("E6")
    after(page, before)
    page.get_by_label("stochastic as printed").uncheck()
    expect(page.locator(".wl-plot-keys > span:visible")).to_have_count(3)
    expect(page).to_have_url(re.compile(r"\?start=E5&goal=E6&show=stochastic.astar-turns.astar-distance&step=20$"))
    shown, address = now.inner_text(), page.url
    page.goto("about:blank")
    open_lesson(page, address)
    expect(page.get_by_label("stochastic as printed")).not_to_be_checked()
    assert now.inner_text() == shown


def test_a_drive_is_changed_played_and_reopened(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/motor")
    status, limits, now = (
        page.locator(".wl-lesson-status"),
        page.locator(".wl-lesson-limits"),
        page.locator("#lesson-now"),
    )
    expect(page.locator(".wl-plot svg")).to_have_count(8)
    expect(status).to_contain_text(re.compile(r"motors take 8\d\.\d %"))
    expect(limits).to_be_hidden()
    expect(now.locator("h2").first).to_have_text("At 0.0 s: speeding up")
    # the paper's formula beside: ½ · 500 kg · (1 m/s)², and 20 W for 12 s
    expect(now).to_contain_text("½ m v² of the start250 J")
    expect(now).to_contain_text("together490 J")
    before = answers(page)
    page.get_by_role("button", name="The printed turn").click()
    after(page, before)
    expect(limits).to_contain_text("Not possible as asked: from 7.0 s on, turning, the motors need up to 25.")
    before = answers(page)
    page.get_by_label("Time to turn by 90° in s").fill("2")
    after(page, before)
    expect(limits).to_be_hidden()
    expect(now).to_contain_text("½ m v² of both starts500 J")
    before = answers(page)
    page.get_by_label("Mass of the vehicle in kg").fill("300")
    after(page, before)
    expect(now).to_contain_text("½ m v² of both starts300 J")
    plot = page.locator(".wl-plot svg").nth(3)
    box = plot.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] * 0.5, box["y"] + box["height"] * 0.5)
    expect(now.locator("h2").first).to_contain_text(": turning")
    until(page, "location.search.includes('step=')")
    shown, address = now.inner_text(), page.url
    assert "mass=300&load=0&gear=30&speed=1.0&distance=10&turn=90&turning=2.0" in address
    page.goto("about:blank")
    open_lesson(page, address)
    expect(now.locator("h2").first).to_contain_text(": turning")
    assert now.inner_text() == shown


@pytest.mark.parametrize("context", [PHONE], indirect=True)
@pytest.mark.parametrize(
    "path",
    [
        "/learn",
        "/learn/search?step=60",
        "/learn/tree?step=5",
        "/learn/learned-time?step=9",
        "/learn/motor?step=9",
        "/learn/ants?step=9",
        "/learn/break-it?step=4",
    ],
)
def test_on_a_phone_nothing_sticks_out(dashboard: Any, page: Page, path: str) -> None:
    if "?" in path:
        open_lesson(page, dashboard.url + path)
        page.get_by_role("button", name="One step on").tap()
    else:
        page.goto(dashboard.url + path)
        expect(page.locator(".wl-lesson-card").first).to_be_visible()
    until(page, "document.documentElement.scrollWidth <= 390")


@pytest.mark.parametrize("context", [PHONE], indirect=True)
def test_a_finger_reads_cells_and_draws_when_asked(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/search?map=9x7&start=0.3&goal=8.3&panels=astar.manhattan.fifo&step=4")
    page.touchscreen.tap(*at_cell(page, 1, 3))
    expect(page.locator(".wl-lesson-panel .wl-tip")).to_contain_text("f 8 m = g 1 + h 7")
    assert page.evaluate("wattlane.lesson.floor.walls.includes(1)") is False
    page.get_by_role("button", name="Draw", exact=True).tap()
    page.locator(".wl-lesson-canvas").scroll_into_view_if_needed()
    before = answers(page)
    page.touchscreen.tap(*at_cell(page, 4, 3))
    after(page, before)
    until(page, "wattlane.lesson.floor.walls[4 + 3 * 9] == 1")


@pytest.mark.parametrize("context", [{}, DARK], indirect=True)
def test_words_stand_out_from_what_is_behind_them(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/search")
    pairs = page.evaluate(
        """() => {
        const c = wattlane.learnColours(), style = getComputedStyle(document.documentElement);
        const read = (name) => style.getPropertyValue(name).trim();
        const marks = ['start', 'goal', 'v0', 'v1', 'v2', 'v3', 'v4'];
        return [...['free', 'open', 'closed', 'pruned'].map((name) => [c.text, c[name]]), ['#17202b', c.path],
          ...marks.map((name) => [c['mark-text'], c[name]]),
          ...['--wl-muted', '--wl-live', '--wl-paused'].map((name) => [read(name), read('--wl-panel')])]; }"""
    )

    def luminance(text: str) -> float:
        parts = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    for ink, ground in pairs:
        light, dark = sorted((luminance(ink), luminance(ground)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5, (ink, ground)


def test_the_printed_inducement_is_switched_on_and_off_without_effect(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/ants?map=12x9r25s2&start=0.0&goal=11.8&panels=literal~off&ants=6&step=3")
    same = page.locator(".wl-lesson-same")
    expect(same).to_contain_text("Colonies 1 and 2 are identical")
    expect(page.locator(".wl-lesson-curve")).to_have_attribute("aria-label", re.compile(r"A\* needs \d+ steps"))
    before = answers(page)
    page.get_by_role("button", name="Printed inducement").click()
    after(page, before)
    expect(page.get_by_label("Colony 1", exact=True)).to_have_value("off")
    expect(same).to_contain_text("identical")
    before = answers(page)
    page.get_by_label("Colony 1", exact=True).select_option("exponent")
    after(page, before)
    expect(same).to_be_empty()
    before = answers(page)
    page.get_by_label("Iterations", exact=True).fill("7")
    page.get_by_label("Iterations", exact=True).blur()
    after(page, before)
    page.keyboard.press("End")
    expect(page).to_have_url(re.compile(r"panels=exponent~off.*iterations=7.*step=7"))
    expect(page.locator(".wl-lesson-counts").first).to_contain_text("best")


def test_every_case_breaks_the_table_and_not_the_corrected_planner(dashboard: Any, page: Page) -> None:
    open_lesson(page, f"{dashboard.url}/learn/break-it")
    verdicts = page.locator(".wl-lesson-verdict")
    for button, word in (
        ("Parked vehicle", "1 breach"),
        ("Disconnected", "no way"),
        ("Crossing diagonals", "1 breach"),
    ):
        before = answers(page)
        page.get_by_role("button", name=button).click()
        after(page, before)
        expect(verdicts.nth(0)).to_contain_text(word)
        expect(verdicts.nth(1)).to_contain_text("0 breaches")
    for _ in range(2):
        page.keyboard.press("ArrowRight")
    expect(page).to_have_url(re.compile(r"break-it\?case=crossing&step=2$"))
    address = page.url
    page.goto("about:blank")
    open_lesson(page, address)
    expect(page.get_by_label("Step number")).to_have_value("2")
    expect(page.get_by_role("button", name="Crossing diagonals")).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#lesson-now")).to_contain_text("cut each other's corner")
