/* Compare: two to four runs beside each other on one clock. Each has a panel; the player moves them all. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const TOLD_MS = 300, PLAYHEAD_MS = 200, CHARTS = ["compare-orders", "compare-energy", "compare-waiting"];

  const whole = (value) => wl.number(value);
  const signed = (by, text, like) => (by > 0 ? `+${text(by, like)}` : by < 0 ? `−${text(-by, like)}` : "±0");
  /** word, key, and how a value is written: in the unit that suits `like`. */
  const NUMBERS = [
    ["orders", "orders_done", whole],
    ["energy", "energy_j", (value) => wl.heatText("energy", value)],
    ["waiting", "waiting_s", (value, like = value) => (like < 5400 ? `${whole(value)} s` : `${(value / 3600).toFixed(1)} h`)],
  ];

  /** Seconds on a chart's date axis, which would read a whole number of two or four digits as a year. */
  const onAxis = (seconds) => {
    const ms = seconds * 1000;
    return Number.isInteger(ms) && ((ms >= 10 && ms < 100) || (ms >= 1000 && ms < 10000)) ? ms + 0.25 : ms;
  };

  class Comparison extends wl.Player {
    /** config: runs [{letter, run, label, fleet}], t_end (s) of the longest, tick_s. */
    constructor(config) {
      super(config);
      const query = new URLSearchParams(location.search), view = wl.readView(query);
      this.selection = view.selection;
      this.layersWanted = view.layers;
      this.startAt = wl.Player.startIn(query);
      this.panels = [];
    }

    async start() {
      const hosts = await Promise.all(this.config.runs.map(({ letter }) => wl.found(`map-${letter}`)));
      if (this.gone || hosts.includes(null)) return;
      this.host = hosts[0];
      this.buildStatus();
      this.buildTransport("To the end (End)");
      this.panels = this.config.runs.map((run, i) => this._panel(run, hosts[i]));
      const loaded = await Promise.all(this.panels.map((panel) => panel.start(this.layersWanted)));
      if (this.gone || !loaded.every(Boolean)) return;
      this.map = this.panels[0].map;
      this.findBox = this.panels[0].findBox;
      this.panels[0].legendIn(document.getElementById("compare-legend"));
      this.seek(this.startAt ?? 0, true);
      if (this.selection) this.select(this.selection, { centre: true });
      this.beat = setInterval(() => this._beat(), 100);
    }

    _panel(run, host) {
      const panel = new wl.Panel(host, run, {
        frame: (frame) => this._frame(panel, frame),
        status: (status) => { if (typeof status.sim_s === "number") this.end = Math.max(this.end, status.sim_s); },
        select: (selection, options) => this.select(selection, options),
        menu: (target, x, y) => this.menu(panel, target, x, y),
        follow: () => this.toggleFollow(),
        layers: (change) => this.setLayers(change),
        fit: () => this.fit(),
        zoomed: () => this._zoomed(panel),
        scaled: () => this._share(),
        again: () => wl.bindCompare(this.config),
      });
      return panel;
    }

    destroy() {
      super.destroy();
      for (const panel of this.panels) panel.destroy();
      wl.closeMenu();
    }

    _frame(panel, frame) {
      if (this.gone || !frame.replay) return;
      this.frames.push(performance.now());
      panel.shown(frame);
    }

    show(time, snap) { for (const panel of this.panels) panel.show(time, snap); }

    written() {
      if (this.gone || !this.map) return;
      const query = new URLSearchParams(location.search);
      query.set("runs", this.config.runs.map(({ run }) => run).join(","));
      query.set("t", String(Math.round(this.time * 100) / 100));
      wl.writeView(query, this.selection, this.map.layers);
      history.replaceState(history.state, "", `${location.pathname}?${query}`);
    }

    // ---- ten times a second

    _beat() {
      if (this.gone) return;
      if (!this.mounted(["/compare"], wl.bindCompare)) return;
      const now = performance.now(), down = this.panels.some((panel) => panel.link_state === "down");
      this.showStatus(now, down ? "DISCONNECTED" : "REPLAY");
      this.showTransport();
      for (const panel of this.panels) panel.beat(now, this.time, false);
      if (now - (this.toldAt || 0) > TOLD_MS && !this.telling && this.toldTime !== this.time && !document.hidden) this._tell(now);
      if (now - (this.headAt || 0) > PLAYHEAD_MS) this._playhead(now);
    }

    /** What each run has come to at the moment shown, and where they part. */
    async _tell(now) {
      this.toldAt = now;
      this.toldTime = this.time;
      this.telling = true;
      try {
        const ids = this.config.runs.map(({ run }) => encodeURIComponent(run)).join(",");
        const told = await wl.fetchJson(`/api/compare?runs=${ids}&t=${this.time}`);
        if (!this.gone) this._told(told);
      } catch { /* the links already say when the server is gone */ }
      this.telling = false;
    }

    _told(told) {
      for (const run of told.runs) {
        const host = document.getElementById(`numbers-${run.letter}`);
        if (!host) continue;
        const over = told.time_s > run.end_s + 1e-9 ? [el("span", { class: "wl-run-over" }, `ended at ${wl.clock(run.end_s)}`)] : [];
        const numbers = this.map && this.map.ground ? NUMBERS.filter(([, key]) => key !== "orders_done") : NUMBERS;
        host.replaceChildren(...numbers.map(([word, key, text]) => el("span", {}, `${word} `, el("b", {}, text(run[key])),
          run.letter === "A" ? null : el("small", {}, ` ${signed(run[key] - told.runs[0][key], text, run[key])}`))), ...over);
        host.dataset.t = String(told.time_s);
      }
      const words = document.getElementById("compare-parting");
      if (words && words.textContent !== told.parting_text) words.textContent = told.parting_text;
      this.parting = told.parting;
      const button = document.getElementById("compare-goto");
      if (button) button.hidden = !told.parting;
      const pin = told.parting ? [{ t: told.parting.time_s, level: 3, label: "first divergence" }] : [];
      if (this.marks.length !== pin.length || (pin.length && this.marks[0].t !== pin[0].t)) this.marks = pin;
    }

    /** To the first tick at which the runs' motions differ. */
    toParting() {
      if (!this.parting) return;
      this.playing = false;
      this.seek(this.parting.time_s, true);
      this.select({ kind: "vehicle", id: this.parting.vehicle }, { centre: false });
    }

    /** The moment shown, as a line in each chart. */
    _playhead(now) {
      if (!window.Plotly) return;
      const at = onAxis(this.time);
      for (const id of CHARTS) {
        const chart = document.querySelector(`#${id} .js-plotly-plot`);
        const shapes = chart && chart.layout && chart.layout.shapes;
        if (!shapes || !shapes.length || shapes[0].x0 === at) continue;
        this.headAt = now;
        window.Plotly.relayout(chart, { "shapes[0].x0": at, "shapes[0].x1": at });
      }
    }

    // ---- all panels alike

    select(selection, options = {}) {
      if (selection && selection.kind === "vehicle" && this.map.n && selection.id >= this.map.n) {
        wl.notify("Not found", `There is no vehicle ${selection.id}.`, "warning");
        return;
      }
      this.selection = this.panels[0].placed(selection);
      for (const panel of this.panels) panel.select(this.selection, options.centre);
      this.written();
    }

    toggleFollow() {
      if (!this.selection || this.selection.kind !== "vehicle") {
        wl.notify("Follow", "Select a vehicle first, on one of the maps.", "info");
        return;
      }
      const on = !this.map.follow;
      for (const panel of this.panels) panel.setFollow(on);
    }

    setLayers(change) {
      for (const panel of this.panels) panel.setLayers(change);
      this.written();
    }

    toggleLayer(name) { this.setLayers(this.panels[0].toggled(name)); }

    fit() { for (const panel of this.panels) panel.map.fit(); }

    zoom(factor) { this.map.zoom(factor); }

    /** The others look where this one was moved to. */
    _zoomed(moved) {
      if (this.moving) return;
      this.moving = true;
      const { x, y, scale } = moved.map.view;
      for (const panel of this.panels) if (panel !== moved && panel.map) panel.map.centre(x, y, scale);
      this.moving = false;
    }

    /** One scale of heat and of power for all maps, so that a colour means the same in each. */
    _share() {
      wl.FleetMap.share(this.panels.map((panel) => panel.map));
      for (const panel of this.panels) panel.showScale();
    }

    setTheme() {
      for (const panel of this.panels) panel.setTheme();
      this.ruler.stale = true;
    }

    pulseSoon() { this.toldTime = null; }

    act(data) {
      if (data.action === "parting") this.toParting();
      else if (data.action === "goto") { this.playing = false; this.seek(data.t, true); }
    }

    menu(panel, target, x, y) {
      const items = [], add = (label, run) => items.push({ label, run });
      if (target.kind === "vehicle") {
        this.select(target, { from: "map" });
        add(this.map.follow ? "Stop following" : "Follow", () => this.toggleFollow());
      } else add("Centre here", () => panel.map.centreOn(target));
      const { letter, run } = panel.config;
      add(`Replay run ${letter} from here`, () => wl.go(`/replay?run=${encodeURIComponent(run)}&t=${this.time}`));
      wl.openMenu(panel.map.describe(target), items, x, y);
    }
  }

  /** Puts runs beside each other on the stage. */
  wl.bindCompare = (config) => {
    wl.bind(null);
    if (!config || !config.runs) return;
    wl.stage = new Comparison(config);
    wl.stage.start();
  };

  Object.assign(window.dash_clientside.wattlane, {
    bindCompare(config) { wl.bindCompare(config); return window.dash_clientside.no_update; },
    /** New curves, or the old ones once more in another colour scheme: the numbers are asked for anew, too. */
    compareDrawn() { if (wl.stage && wl.stage.toldTime !== undefined) wl.stage.pulseSoon(); },
  });
})();
