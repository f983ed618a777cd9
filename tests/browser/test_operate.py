"""Operate: a live run watched, commanded, paused, looked back at; what happens when a process goes away."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.stage import (
    CHARGING,
    FAULT,
    FIRST_FRAME_MS,
    IDLE,
    LOADING,
    MOVING,
    PAUSED,
    TO_CHARGER,
    WAITING,
    Spot,
    api,
    at_time,
    chip,
    clock_s,
    menu_at,
    menu_of,
    note,
    open_stage,
    past_time,
    pause,
    place_at,
    step,
    stop_run,
    tab,
    until,
    vehicle_at,
    vehicle_in,
)

pytestmark = pytest.mark.browser
DRIVING = (MOVING, WAITING, TO_CHARGER)
WORKING = (*DRIVING, LOADING, CHARGING, IDLE)


@pytest.fixture(scope="module")
def run(dashboard: Any) -> Iterator[str]:
    """The live run that the tests of this file share."""
    made = api(dashboard.url, "/api/runs", {"scenario": "soochow2022-continuous", "seed": 5, "speed": 16})
    yield made["run_id"]
    stop_run(dashboard.url, made["run_id"])


@pytest.fixture
def operated(dashboard: Any, kept_page: Page, run: str) -> Page:
    """The page of the live run, opened anew, going at 16 times real time, some way into it."""
    page = kept_page
    open_stage(page, f"{dashboard.url}/operate?run={run}")
    for asked in ({"op": "speed", "speed": 16}, {"op": "play"}):
        api(dashboard.url, f"/api/runs/{run}/control", asked)
    past_time(page, 30)
    chip(page, "LIVE")
    return page


@pytest.fixture
def paused(operated: Page) -> Page:
    """The page of the live run, paused for everyone."""
    pause(operated)
    return operated


def state_of(page: Page, vehicle: int) -> int:
    return int(page.evaluate(f"wattlane.stage.map.frame.state[{vehicle}]"))


def step_until(page: Page, vehicle: int, state: int, most: int = 60) -> None:
    """Steps a paused run until a vehicle is in a state."""
    for _ in range(most):
        if state_of(page, vehicle) == state:
            return
        step(page, 1)
    pytest.fail(f"vehicle {vehicle} did not come into state {state} within {most} ticks")


def test_the_front_page_is_a_running_warehouse(dashboard: Any, page: Page) -> None:
    open_stage(page, dashboard.url)
    chip(page, "LIVE")
    until(page, "Number(document.querySelector('#map').dataset.frames) >= 20")
    past_time(page, 2)
    expect(page.locator(".wl-rates")).to_have_text(re.compile(r"updates/s"))
    expect(page.locator(".wl-kpi")).to_have_count(14)
    width = page.locator(".wl-map-canvas").bounding_box()["width"]  # type: ignore[index]
    assert width >= 0.55 * 1440
    # drawn anew by Dash, the map is taken again
    page.evaluate("((map) => map.replaceWith(Object.assign(document.createElement('div'), { id: 'map' })))"
                  "(document.getElementById('map'))")  # fmt: skip
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)


def test_map_table_inspector_and_address_agree(paused: Page) -> None:
    page = paused
    vehicle = vehicle_in(page, *WORKING)
    page.mouse.click(*vehicle_at(page, vehicle)())
    expect(page.locator(".wl-right h2")).to_have_text(f"Vehicle {vehicle}")
    assert f"sel=v{vehicle}" in page.url
    tab(page, "Fleet")
    row = page.locator(f"#fleet-grid .ag-center-cols-container [row-id='{vehicle}']")
    expect(row).to_have_class(re.compile("ag-row-selected"))
    other = 0 if vehicle else 1
    page.locator(f"#fleet-grid .ag-center-cols-container [row-id='{other}'] [col-id='state']").click()
    expect(page.locator(".wl-right h2")).to_have_text(f"Vehicle {other}")
    assert page.evaluate("wattlane.stage.map.selection.id") == other
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("f")
    assert page.evaluate("wattlane.stage.map.follow") is True
    page.keyboard.press("Escape")
    expect(page.locator(".wl-right h2")).to_have_text("Fleet")
    assert "sel=" not in page.url


def test_paused_is_said_only_when_the_simulation_stands(dashboard: Any, operated: Page, run: str) -> None:
    """The chip follows what the run reports, not what was asked for: the map must not move under a click after it."""
    page = operated
    page.route("**/control", lambda route: None)  # the request never arrives
    page.get_by_role("button", name=re.compile("^Pause the simulation")).click()
    expect(page.get_by_role("button", name=re.compile("^Continue the simulation"))).to_be_visible()
    now = page.evaluate("wattlane.stage.time")
    past_time(page, now + 5)
    chip(page, "LIVE")
    api(dashboard.url, f"/api/runs/{run}/control", {"op": "pause"})
    chip(page, "PAUSED")
    assert page.evaluate("wattlane.stage.map.frame.paused") is True


def test_commands_are_answered_with_their_reason(paused: Page) -> None:
    page = paused
    vehicle = vehicle_in(page, *DRIVING)
    spot = vehicle_at(page, vehicle)
    menu_at(page, spot, "Pause")
    note(page, "Pause vehicle: accepted")
    menu_at(page, spot, "Pause")
    note(page, re.compile("Pause vehicle: rejected.*already", re.DOTALL))
    step_until(page, vehicle, PAUSED)
    menu_at(page, spot, "Why waiting?")
    note(page, re.compile(f"Vehicle {vehicle}.*paused by the operator", re.DOTALL))
    menu_at(page, spot, "Continue")
    note(page, "Continue vehicle: accepted")
    step(page, 2)
    assert state_of(page, vehicle) != PAUSED


def test_a_vehicle_is_sent_where_the_next_click_points(paused: Page) -> None:
    page = paused
    free = vehicle_in(page, IDLE, CHARGING)
    menu_at(page, vehicle_at(page, free), "Send to…")
    expect(page.locator(".wl-map-canvas.aiming")).to_be_visible()
    target = page.evaluate("wattlane.stage.floor.parking.concat(wattlane.stage.floor.chargers)[0].place")
    page.mouse.click(*place_at(page, target)())
    note(page, re.compile("Send: (accepted|rejected)"))
    expect(page.locator(".wl-map-canvas.aiming")).to_have_count(0)


def test_charging_is_commanded_and_levels_and_rate_are_changed(paused: Page) -> None:
    page = paused
    menu_at(page, vehicle_at(page, vehicle_in(page, MOVING, WAITING, LOADING)), "Charge now")
    note(page, re.compile("Charge now: accepted.*goes charging", re.DOTALL))
    page.fill("#rate-value", "300")
    page.get_by_role("button", name="Change rate").click()
    note(page, re.compile("Order rate: accepted.*300 orders per hour", re.DOTALL))
    page.get_by_text("Charging levels", exact=True).click()
    page.fill("#level-good", "35")
    page.get_by_role("button", name="Change levels").click()
    note(page, re.compile("Charging levels: accepted.*good 35 %", re.DOTALL))
    page.fill("#level-good", "95")
    page.get_by_role("button", name="Change levels").click()
    note(page, re.compile("Charging levels: rejected.*must rise", re.DOTALL))


def test_destructive_commands_say_the_consequence_first(paused: Page) -> None:
    page = paused
    vehicle = vehicle_in(page, *DRIVING)
    spot = vehicle_at(page, vehicle)
    menu_at(page, spot, "Break down…")
    dialog = page.locator(".wl-dialog")
    expect(dialog).to_contain_text("until it is repaired")
    dialog.get_by_role("button", name="Cancel").click()
    expect(dialog).to_have_count(0)
    expect(page.locator(".mantine-Notification-root")).to_have_count(0)
    menu_at(page, spot, "Break down…")
    dialog.get_by_role("button", name="Break it down").click()
    note(page, "Break down: accepted")
    step_until(page, vehicle, FAULT)
    offered = menu_of(page, spot)
    assert not {"Pause", "Continue", "Send to…", "Charge now", "Break down…"} & set(offered), offered
    menu_at(page, spot, "Repair")
    note(page, "Repair: accepted")
    step(page, 2)
    assert state_of(page, vehicle) != FAULT


def test_a_cell_is_blocked_and_unblocked_on_the_map(paused: Page) -> None:
    page = paused
    place = page.evaluate("""(() => { const m = wattlane.stage.map;
        return wattlane.stage.floor.one_way.map((o) => o.place).find((p) => { const [x, y] = m.placeScreen(p);
            const t = m.pick(x, y); return t.kind === 'place' && y > 60; }); })()""")
    menu_at(page, place_at(page, place), "Block this cell…")
    page.get_by_role("button", name="Block", exact=True).click()
    note(page, "Block: accepted")
    step(page, 1)
    menu_at(page, place_at(page, place), "Unblock this cell")
    note(page, "Unblock: accepted")


def test_a_charger_is_taken_out_and_put_back(paused: Page) -> None:
    page = paused
    place = page.evaluate("""(() => { const m = wattlane.stage.map;
        return wattlane.stage.floor.chargers.find((c) => m.pick(...m.placeScreen(c.place)).kind === 'charger').place;
        })()""")
    spot: Spot = place_at(page, place)
    menu_at(page, spot, "Charger out of order…")
    page.get_by_role("button", name="Take out").click()
    note(page, "Charger out: accepted")
    page.mouse.click(*spot())
    expect(page.locator(".wl-right")).to_contain_text("out of order")
    menu_at(page, spot, "Charger back in order")
    note(page, "Charger back: accepted")
    expect(page.locator(".wl-right")).not_to_contain_text("out of order")


def test_an_order_is_given_and_withdrawn_while_it_can_be(dashboard: Any, paused: Page, run: str) -> None:
    page = paused
    page.locator("#order-from").click()
    page.get_by_role("option", name="I1 (inbound)").click()
    page.locator("#order-to").click()
    page.get_by_role("option", name="R9 (rack)").click()
    page.get_by_role("button", name="Give the order").click()
    note(page, "New order: accepted")
    tab(page, "Orders")
    mine = page.locator("#orders-grid .ag-row", has_text="operator")
    expect(mine).to_have_count(1)
    mine.get_by_role("button", name="Withdraw…").click()
    page.get_by_role("button", name="Withdraw", exact=True).click()
    note(page, "Withdraw: accepted")
    expect(mine.get_by_role("button", name="Withdraw…")).to_have_count(0)
    orders = api(dashboard.url, f"/api/runs/{run}/view?parts=orders")["orders"]
    picked = [order["order"] for order in orders if order["state"] == "picked"]
    for number in picked:
        row = page.locator(f"#orders-grid [row-id='{number}']")
        assert not row.get_by_role("button", name="Withdraw…").count(), f"order {number} is picked up"


def test_time_is_stepped_looked_back_at_and_live_again(paused: Page) -> None:
    page = paused
    now = clock_s(page)
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("ArrowRight")
    at_time(page, now + 1)
    page.keyboard.press("Shift+ArrowRight")
    at_time(page, now + 11)
    page.keyboard.press("Home")
    chip(page, "REPLAY")
    expect(page.locator(".wl-note")).to_contain_text("Return to LIVE")
    at_time(page, 0)
    until(page, "wattlane.stage.map.frame.tick === 0 && !wattlane.stage.map.moving")
    offered = menu_of(page, vehicle_at(page, 0))
    assert offered == ["Follow"], "the past takes no commands"
    page.keyboard.press("Escape")
    page.locator("#speed").select_option("8")
    page.locator(".wl-map-canvas").focus()
    page.keyboard.press("Space")
    past_time(page, 4)
    page.keyboard.press("End")
    chip(page, "PAUSED")
    at_time(page, now + 11)
    assert "t=" not in page.url.split("?")[1].replace("layers", "")


def test_speed_is_asked_for_and_reached(operated: Page) -> None:
    page = operated
    page.locator("#speed").select_option("4")
    until(page, "wattlane.stage.map.frame.asked === 4")
    expect(page.locator(".wl-reached")).to_have_text(re.compile(r"reached \d+\.?\d*×"))


@pytest.mark.parametrize(
    ("name", "shows"),
    [
        ("Charts", "#soc-graph .main-svg"),
        ("State bands", "#bands-graph .main-svg"),
        ("Reservations", "#reservations-graph .main-svg"),
        ("Events", "#events-grid .ag-header"),
        ("Orders", "#orders-grid .ag-row"),
        ("Chargers", "#chargers-grid .ag-row"),
        ("Fleet", "#fleet-grid .wl-soc-tick"),
    ],
)
def test_every_tab_shows_its_part(operated: Page, name: str, shows: str) -> None:
    tab(operated, name)
    expect(operated.locator(shows).first).to_be_visible()


def test_the_start_form_refuses_with_the_nearest_name_and_starts_a_run(
    dashboard: Any, operated: Page, run: str
) -> None:
    page = operated
    page.get_by_text("Start a run").click()
    page.fill("#start-more", "fleet.cuont = 3")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#start-error")).to_contain_text("did you mean")
    page.fill("#start-more", "")
    page.fill("#start-fleet", "4")
    page.fill("#start-seed", "11")
    page.get_by_role("button", name="Start", exact=True).click()
    page.wait_for_url(re.compile(f"run=(?!{run})"))
    expect(page.locator(".wl-left")).to_contain_text("4 vehicles")
    expect(page.locator(".wl-left")).to_contain_text("11")
    made = re.search(r"run=([^&]+)", page.url)
    assert made
    stop_run(dashboard.url, made[1])


def test_a_killed_worker_is_shown_and_resumed(dashboard: Any, page: Page) -> None:
    run = api(dashboard.url, "/api/runs", {"scenario": "soochow2022-continuous", "seed": 6})["run_id"]
    open_stage(page, f"{dashboard.url}/operate?run={run}")
    chip(page, "LIVE")
    found = subprocess.run(["pgrep", "-f", f"app.worker .*{run}"], capture_output=True, text=True, check=True)
    os.kill(int(found.stdout.split()[0]), signal.SIGKILL)
    expect(page.locator("#run-banner")).to_contain_text("process has ended")
    page.get_by_role("button", name="Resume from the last checkpoint").click()
    page.wait_for_selector("#map[data-frames]", timeout=FIRST_FRAME_MS)
    chip(page, "LIVE")
    stop_run(dashboard.url, run)


def test_a_lost_server_is_a_veil_until_it_is_back(new_dashboard: Callable[..., Any], page: Page, watch: Any) -> None:
    watch.allow(
        "ERR_CONNECTION_REFUSED|WebSocket|Failed to fetch|ERR_EMPTY_RESPONSE|ERR_CONNECTION_RESET|"
        "ERR_SOCKET_NOT_CONNECTED|Callback failed"
    )
    own = new_dashboard()
    open_stage(page, own.url)
    own.kill()
    veil = page.locator(".wl-veil")
    expect(veil).to_be_visible()
    expect(veil).to_contain_text(re.compile(r"What you see is \d+ (s|min) old"))
    chip(page, "DISCONNECTED")
    own.start()
    expect(veil).to_be_hidden()


COUNTED = r"""
async (n) => {
  const W = 128, H = 96, cells = [], places = [];
  for (let y = 0; y < H; y++) {
    let row = "";
    for (let x = 0; x < W; x++) {
      const rack = x % 6 >= 2 && x % 6 <= 4 && y % 5 !== 0;
      row += rack ? "S" : ".";
      if (!rack) places.push([x + 0.5, y + 0.5]);
    }
    cells.push(row);
  }
  const host = document.createElement("div");
  host.style.cssText = "position:fixed;inset:50px 330px 300px 290px;z-index:9";
  document.body.append(host);
  const map = new wattlane.FleetMap(host, { select() {}, menu() {} });
  map.setFloor({ width: W, height: H, cell_m: 1, cells, places, stations: [], chargers: [], parking: [], one_way: [] });
  const at = Array.from({ length: n }, (_, i) => ({ x: (i * 37) % W, y: (i * 61) % H }));
  let sequence = 0;
  const push = () => {
    const bytes = new ArrayBuffer(32 + 8 * n), v = new DataView(bytes);
    v.setUint8(0, 0x57); v.setUint8(1, 0x4c); v.setUint8(2, 1);
    v.setUint32(4, ++sequence, true); v.setFloat64(8, sequence / 20, true); v.setUint16(24, n, true);
    at.forEach((p, i) => {
      p.x = (p.x + 0.05 * (1 + (i % 3))) % W;
      const o = 32 + 8 * i;
      v.setUint16(o, (p.x / W) * 65535, true); v.setUint16(o + 2, (p.y / H) * 65535, true);
      v.setUint8(o + 4, (i + sequence) & 255); v.setUint8(o + 5, i % 250);
      v.setUint8(o + 6, i % 8); v.setUint8(o + 7, i % 4);
    });
    map.push(wattlane.decodeFrame(bytes, W, H));
  };
  const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
  push();
  for (let k = 0; k < 5; k++) await frame();
  let copies = 0, sprites = 0, mutations = 0, stills = 0;
  const copy = map.ctx.drawImage.bind(map.ctx), sprite = wattlane.marks.vehicle, still = map._drawStill.bind(map);
  map.ctx.drawImage = (...args) => { copies += 1; copy(...args); };
  map._drawStill = () => { stills += 1; still(); };
  wattlane.marks.vehicle = (...args) => { sprites += 1; sprite(...args); };
  const watch = new MutationObserver((list) => { mutations += list.length; });
  watch.observe(host, { subtree: true, childList: true, attributes: true, characterData: true });
  const draws = map.stats.draws, begin = performance.now();
  let refreshes = 0;
  for (let update = 0; update < 40; update++) {
    push(); push(); push();   // faster than the screen
    await frame(); refreshes += 1;
  }
  await frame(); refreshes += 1;
  mutations += watch.takeRecords().length;
  const result = { draws: map.stats.draws - draws, refreshes, copies, sprites, stills, mutations, ms: map.stats.ms };
  wattlane.marks.vehicle = sprite;
  map.destroy();
  host.remove();
  return result;
}
"""


def test_a_thousand_vehicles_cost_little(dashboard: Any, page: Page, record_property: Any) -> None:
    """An update costs one copy per vehicle and nothing else, however fast frames come; the times are only recorded."""
    page.goto(f"{dashboard.url}/runs")
    expect(page.locator(".wl-catalogue, .wl-empty").first).to_be_visible()
    n, looks = 1000, 32 * 8 * 4  # headings, states, flags
    measured = page.evaluate(COUNTED, n)
    record_property("map", measured)
    assert 1 <= measured["draws"] <= measured["refreshes"], measured
    assert measured["copies"] <= (n + 2) * measured["draws"], measured
    assert measured["sprites"] <= looks, measured
    assert measured["stills"] == measured["mutations"] == 0, measured
