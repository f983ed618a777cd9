/* One run's map with its tools, layers and legend, and its link to the server. Replay has one panel, Compare several. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const ROUTES_MS = 500, POWER_MS = 1000, HEAT_MS = 3000, GROUND_AGAIN_MS = 1500, VEIL_AFTER_MS = 2500;
  const ROUTES_UP_TO = 40;
  const SWITCHES = ["grid", "ids", "paths", "log", "contours", "veil", "frontier"];
  const GROUND_COLOURS = { state: "plain", power: "energy rate" };
  const LETTER = { vehicle: "v", station: "s", charger: "c", place: "p" };

  wl.icon = (name) => el("span", { class: `wl-icon wl-icon-${name}`, "aria-hidden": "true" });
  wl.toolButton = (name, label, onclick, extra = {}) =>
    el("button", { type: "button", class: "wl-tool", "aria-label": label, title: label, onclick, ...extra }, wl.icon(name));

  /** What the address says of selection and layers. */
  wl.readView = (query) => {
    const view = { selection: null, layers: {} };
    const sel = /^([vscp])(\d+)$/.exec(query.get("sel") || "");
    if (sel) view.selection = { kind: Object.keys(LETTER).find((k) => LETTER[k] === sel[1]), id: Number(sel[2]) };
    if (view.selection && view.selection.kind === "place") view.selection.place = view.selection.id;
    const layers = query.get("layers");
    if (layers === null) return view;
    const words = new Set(layers.split(","));
    for (const name of SWITCHES) view.layers[name] = words.has(name);
    for (const word of words) {
      if (word.startsWith("heat-") && word.slice(5) in wl.HEATS) view.layers.heat = word.slice(5);
      if (word.startsWith("by-") && word.slice(3) in wl.COLOURINGS) view.layers.colour = word.slice(3);
      if (/^w\d+$/.test(word)) view.layers.window = Number(word.slice(1));
    }
    return view;
  };

  wl.writeView = (query, selection, layers) => {
    if (selection && LETTER[selection.kind]) query.set("sel", LETTER[selection.kind] + selection.id); else query.delete("sel");
    const words = SWITCHES.filter((name) => layers[name]);
    if (layers.heat) words.push(`heat-${layers.heat}`, `w${layers.window}`);
    if (layers.colour !== "state") words.push(`by-${layers.colour}`);
    query.set("layers", words.join(","));
  };

  wl.Panel = class {
    /** host: an element · config: run, fleet · hooks: frame(frame, bytes), status(status), select(selection, options),
     *  menu(target, x, y), follow(), layers(change), fit(), zoomed(), scaled() when a scale may have changed, again(), perhaps tools(floor). */
    constructor(host, config, hooks) {
      this.host = host;
      this.config = config;
      this.hooks = hooks;
      this.link_state = "connecting";
      this.selection = null;
      host.replaceChildren();
      host.classList.add("wl-map");
    }

    /** Resolves to whether the floor could be loaded; the reason stands in the panel otherwise. */
    async start(layers) {
      let floor;
      try {
        floor = await wl.fetchJson(wl.runPath(this.config.run, "/floor"));
      } catch (problem) {
        if (!this.gone) this._fail(problem.message);
        return false;
      }
      if (this.gone) return false;
      this._build(floor, layers);
      this.link = new wl.Link(this.config.run, { width: floor.width_m || floor.width * floor.cell_m, height: floor.height_m || floor.height * floor.cell_m }, {
        frame: (frame, bytes) => this.hooks.frame(frame, bytes),
        status: (status) => this._status(status),
        state: (state, age) => this._linkState(state, age),
      });
      this.link.start();
      return true;
    }

    destroy() {
      this.gone = true;
      if (this.link) this.link.stop();
      if (this.map) this.map.destroy();
    }

    _fail(reason) {
      this.host.replaceChildren(el("div", { class: "wl-empty", role: "alert" },
        el("h2", {}, "The floor could not be loaded"), el("p", {}, reason),
        el("button", { type: "button", class: "wl-button primary", onclick: () => this.hooks.again() }, "Try again")));
    }

    // ---- the link

    /** Asks for a moment of the past. */
    show(time, snap) {
      this.snapNext = this.snapNext || snap;
      if (!this.link) return;
      this.link.watchLive(false);
      this.link.ask(time);
    }

    /** A frame of the past that was asked for. */
    shown(frame) {
      this.map.push(frame, this.snapNext);
      this.snapNext = false;
      this.counted();
    }

    counted() { this.host.dataset.frames = String(Number(this.host.dataset.frames || 0) + 1); }

    _status(status) {
      const error = status.error || (status.type === "error" && status.text);
      if (error) {
        if (error !== this.lastError) wl.notify("The live link reports", String(error), "warning");
        this.lastError = error;
        return;
      }
      this._phase(status);
      this.hooks.status(status);
    }

    /** What the run's process is busy with before its first tick, and after its last. */
    _phase(status) {
      const busy = status.alive && status.phase && status.phase !== "running" ? status.phase : "";
      this.phase.hidden = !busy;
      if (busy) this.phase.textContent = `${busy[0].toUpperCase()}${busy.slice(1)}…`;
    }

    _linkState(state, age) {
      this.link_state = state;
      const veil = state === "down" || age > (state === "polling" ? VEIL_AFTER_MS : 2 * VEIL_AFTER_MS);
      if (veil) this.link_state = "down";
      this.veil.hidden = !veil;
      if (veil) this.veilText.textContent = `No connection. What you see is ${wl.span(age / 1000)} old; trying again…`;
    }

    // ---- ten times a second: side requests

    /** time: seconds shown · follow: the run's present is shown. */
    beat(now, time, follow) {
      this.time = time;
      this.follow = follow;
      if (this.map.ground) {
        const again = follow && now - (this.groundAt || 0) > GROUND_AGAIN_MS;   // others may drop obstacles into a paused run
        const stale = again || time !== this.groundTime || this.groundFor !== this.map.layers.frontier;
        if (stale && now - (this.groundAt || 0) > ROUTES_MS && !this.groundBusy) this._fetchGround(now);
        return;
      }
      const moved = time !== this.routesTime || this.routesFor !== this._routesKey();
      if (moved && now - (this.routesAt || 0) > ROUTES_MS && !this.routesBusy) this._fetchRoutes(now);
      if (this.map.layers.colour === "power" && now - (this.powerAt || 0) > POWER_MS && this.powerTime !== time) this._fetchPower(now);
      if (this.map.layers.heat && now - (this.heatAt || 0) > HEAT_MS && (this.heatTime !== time || this.heatKey !== this._heatKey())) this._fetchHeat(now);
      if (this.map.onArc && now - (this.arcsAt || 0) > HEAT_MS && this.arcsKey !== `${this.map.layers.window}|${time}`) this._fetchArcs(now);
    }

    _routesKey() { return this.map.layers.paths ? "all" : this.selection && this.selection.kind === "vehicle" ? `v${this.selection.id}` : ""; }

    /** What was fetched may be outdated though the time is not: a command was given. */
    anew() { this.groundTime = null; }

    async _fetchRoutes(now) {
      const key = this._routesKey();
      this.routesAt = now;
      this.routesFor = key;
      this.routesTime = this.time;
      if (!key) { this.map.setRoutes([]); return; }
      this.routesBusy = true;
      try {
        const answer = await wl.fetchJson(wl.runPath(this.config.run, this.follow ? "/routes" : `/routes?t=${this.time}`));
        if (!this.gone) this.map.setRoutes(Array.isArray(answer) ? answer : answer.routes || []);
      } catch { /* the link already says when the server is gone */ }
      this.routesBusy = false;
    }

    /** What lies and moves on terrain: search, way, obstacles, and what of the track is new. */
    async _fetchGround(now) {
      const { ground, layers } = this.map;
      this.groundAt = now;
      this.groundTime = this.time;
      this.groundFor = layers.frontier;
      this.groundBusy = true;
      const query = `since=${ground.track.next}&way=${ground.wayRow}&frontier=${layers.frontier}${this.follow ? "" : `&t=${this.time}`}`;
      try {
        const told = await wl.fetchJson(wl.runPath(this.config.run, `/ground?${query}`));
        if (!this.gone) {
          if (ground.told(told)) this.hooks.scaled();
          if (!this.groundSeen) this.showLegend();
          this.groundSeen = true;
          this.host.dataset.ground = String(Number(this.host.dataset.ground || 0) + 1);
        }
      } catch { /* the link already says when the server is gone */ }
      this.groundBusy = false;
    }

    async _fetchPower(now) {
      this.powerAt = now;
      this.powerTime = this.time;
      try {
        const answer = await wl.fetchJson(wl.runPath(this.config.run, this.follow ? "/power" : `/power?t=${this.time}`));
        if (this.gone || !this.map.setPower(answer.values)) return;
        this.hooks.scaled();
        this.showLegend();
      } catch { /* the link already says when the server is gone */ }
    }

    /** What is known of the arcs, while one of them is pointed at. */
    async _fetchArcs(now) {
      const { window } = this.map.layers;
      this.arcsAt = now;
      this.arcsKey = `${window}|${this.time}`;
      const from = window ? Math.max(0, this.time - window) : 0;
      try {
        const answer = await wl.fetchJson(wl.runPath(this.config.run, `/arcs?t0=${from}&t1=${this.time}`));
        if (!this.gone) this.map.setArcs(answer);
      } catch { /* the link already says when the server is gone */ }
    }

    _heatKey() { const { heat, window } = this.map.layers; return `${heat}|${window}`; }

    async _fetchHeat(now) {
      const { heat, window } = this.map.layers;
      this.heatAt = now;
      this.heatKey = this._heatKey();
      this.heatTime = this.time;
      const from = window ? Math.max(0, this.time - window) : 0;
      try {
        const answer = await wl.fetchJson(wl.runPath(this.config.run, `/heat?kind=${heat}&t0=${from}&t1=${this.time}`));
        if (this.gone) return;
        this.map.setHeat(Array.isArray(answer) ? answer : answer.values);
        this.hooks.scaled();
        this._showHeatScale();
      } catch (problem) { this.heatNote.textContent = problem.message; }
    }

    // ---- selection

    /** The selection with its place, when it has one. */
    placed(selection) {
      if (!selection || selection.place !== undefined || !this.floor) return selection;
      const list = { station: this.floor.stations, charger: this.floor.chargers }[selection.kind];
      const item = list && list.find((i) => i.number === selection.id);
      return item ? { ...selection, place: item.place } : selection;
    }

    select(selection, centre) {
      this.selection = selection;
      this.routesFor = null;
      if (!this.map) return;
      this.map.setSelection(selection);
      if (centre && selection) this.map.centreOn(selection);
      this._showFollow();
    }

    setFollow(on) {
      this.map.setFollow(on);
      this._showFollow();
    }

    _showFollow() { this.followButton.setAttribute("aria-pressed", String(this.map.follow)); }

    /** The selection that a word names: a vehicle's number, a station, a charger, a parking bay; null when none does. */
    found(text) {
      const word = text.trim().toLowerCase();
      const item = [...(this.floor.stations || []).map((s) => ["station", s]), ...(this.floor.chargers || []).map((c) => ["charger", c])]
        .find(([, i]) => i.name.toLowerCase() === word);
      if (item) return { kind: item[0], id: item[1].number, place: item[1].place };
      const spot = (this.floor.parking || []).find((p) => p.name.toLowerCase() === word);
      if (spot) return { kind: "place", id: spot.place, place: spot.place };
      const cell = this.map.ground && /^\(?(\d+)\s*[,;\s]\s*(\d+)\)?$/.exec(word);
      if (cell && Number(cell[1]) < this.floor.width && Number(cell[2]) < this.floor.height) {
        const place = Number(cell[2]) * this.floor.width + Number(cell[1]);
        return { kind: "place", id: place, place };
      }
      const number = /^(?:v|vehicle|agv)?\s*(\d+)$/.exec(word);
      return number ? { kind: "vehicle", id: Number(number[1]) } : null;
    }

    _find(text) {
      if (!text.trim()) return;
      const selection = this.found(text);
      if (selection) this.hooks.select(selection, { centre: true });
      else wl.notify("Not found", this.map.ground ? `“${text}” is no cell; type its column and row, such as 120, 80.`
        : `“${text}” is no vehicle number, station, charger or parking name.`, "warning");
    }

    // ---- building

    _build(floor, layers) {
      this.floor = floor;
      const canvasHost = el("div", { class: "wl-map-host" });
      this.veilText = el("p", {});
      this.veil = el("div", { class: "wl-veil", hidden: true, role: "alert" }, this.veilText);
      this.followButton = wl.toolButton("follow", "Follow the selected vehicle (F)", () => this.hooks.follow(), { "aria-pressed": "false" });
      const [example, finds] = floor.kind === "terrain" ? ["Find: 120, 80", "Find a cell"] : ["Find: 4, R7, C2", "Find a vehicle, station or charger"];
      this.findBox = el("input", { type: "search", class: "wl-find", placeholder: example, "aria-label": finds });
      this.findBox.addEventListener("keydown", (event) => {
        if (event.key === "Enter") { this._find(this.findBox.value); this.findBox.blur(); }
        if (event.key === "Escape") { this.findBox.value = ""; this.findBox.blur(); }
      });
      this.phase = el("div", { class: "wl-phase", role: "status", hidden: true });
      this.host.append(el("div", { class: "wl-map-view" }, canvasHost,
        el("div", { class: "wl-map-tools", role: "toolbar", "aria-label": "Map" },
          wl.toolButton("plus", "Zoom in (+)", () => this.map.zoom(1.4)), wl.toolButton("minus", "Zoom out (−)", () => this.map.zoom(1 / 1.4)),
          wl.toolButton("fit", "Fit the floor (R)", () => this.hooks.fit()), this.followButton,
          ...(this.hooks.tools ? this.hooks.tools(floor) : []), this._buildLayers()),
        el("div", { class: "wl-map-find" }, this.findBox),
        this.phase, this.veil));
      this.map = new wl.FleetMap(canvasHost, { select: (s, o) => this.hooks.select(s, o), menu: (t, x, y) => this.hooks.menu(t, x, y), zoomed: () => this.hooks.zoomed() });
      this.map.setFloor(floor);
      // Hundreds of routes at once hide the floor: then only that of the selected vehicle, unless the address says more.
      this.setLayers({ paths: (this.config.fleet || 0) <= ROUTES_UP_TO, ...layers });
    }

    /** Draws this panel's legend into an element from now on. */
    legendIn(host) {
      this.legendHost = el("div", { class: "wl-legend" });
      this.heatLegend = el("div", { class: "wl-heat-scale wl-heat-legend" });
      host.append(el("details", { class: "wl-map-legend", open: matchMedia("(min-width: 901px)").matches },
        el("summary", {}, "Legend"), this.heatLegend, this.legendHost));
      this.showLegend();
      this._showHeatScale();
    }

    /** After the scale of a colour was changed from outside. */
    showScale() {
      this.showLegend();
      this._showHeatScale();
    }

    showLegend() { if (this.legendHost) wl.legend(this.legendHost, this.map); }

    _buildLayers() {
      const box = (name, label) => {
        const input = el("input", { type: "checkbox", dataset: { layer: name } });
        input.addEventListener("change", () => this.hooks.layers({ [name]: input.checked }));
        return el("label", {}, input, label);
      };
      const choice = (name, label, options) => {
        const select = el("select", { class: "wl-select", dataset: { layer: name } }, ...options.map(([value, word]) => el("option", { value }, word)));
        select.addEventListener("change", () => this.hooks.layers({ [name]: name === "window" ? Number(select.value) : select.value }));
        return el("label", {}, el("span", {}, label), select);
      };
      this.heatNote = el("div", { class: "wl-heat-scale" });
      const menu = () => el("details", { class: "wl-layer-menu" }, el("summary", { class: "wl-tool", "aria-label": "Layers", title: "Layers" }, wl.icon("layers")), this.layerPanel);
      if (this.floor.kind === "terrain") {
        this.layerPanel = el("div", { class: "wl-layers" },
          box("paths", "Way and track (P)"), box("contours", "Contours"), box("veil", "Veil what is not seen yet"),
          box("frontier", "Search: OPEN and INCONS"), box("grid", "Grid (G)"),
          choice("colour", "Track's colour", Object.entries(GROUND_COLOURS)));
        return menu();
      }
      this.layerPanel = el("div", { class: "wl-layers" },
        box("paths", "Routes (P)"), box("ids", "Numbers (I)"), box("grid", "Grid (G)"),
        choice("colour", "Colour by", Object.entries(wl.COLOURINGS)),
        choice("heat", "Heat map (H)", Object.entries(wl.HEATS)),
        choice("window", "over the last", [[600, "10 min"], [3600, "1 h"], [28800, "8 h"], [0, "whole run"]]),
        box("log", "logarithmic scale"), this.heatNote);
      return menu();
    }

    setLayers(change) {
      if (this.map.ground) {   // what an address or a key may ask for, and terrain does not have
        change = { ...change };
        delete change.heat;
        if (!(change.colour in GROUND_COLOURS)) delete change.colour;
      }
      this.map.setLayers(change);
      if ("colour" in change) this.powerTime = null;
      if ("heat" in change || "window" in change) { this.map.setHeat(null); this.heatAt = this.arcsAt = 0; this.heatTime = null; }
      for (const input of this.layerPanel.querySelectorAll("[data-layer]")) {
        const value = this.map.layers[input.dataset.layer];
        if (input.type === "checkbox") input.checked = value; else input.value = String(value);
      }
      this.showLegend();
      this._showHeatScale();
      this.routesFor = null;
    }

    /** The change that a layer's key asks for. */
    toggled(name) {
      if (name !== "heat" || this.map.ground) return { [name]: !this.map.layers[name] };
      const kinds = Object.keys(wl.HEATS), at = kinds.indexOf(this.map.layers.heat);
      return { heat: kinds[(at + 1) % kinds.length] };
    }

    _showHeatScale() {
      const { heat, log } = this.map.layers, shown = heat && this.map.heat;
      const [low, top] = shown ? this.map.heatEnds.map((value) => wl.heatText(heat, value)) : [];
      const scale = () => (low === top ? [el("span", {}, `${low} everywhere`)]
        : [el("span", {}, low), el("span", { class: "wl-heat-bar" }), el("span", {}, `${top}${log ? " (log)" : ""}`)]);
      this.heatNote.replaceChildren(...(shown ? scale() : []));
      if (this.heatLegend) this.heatLegend.replaceChildren(...(shown ? [el("b", {}, wl.HEATS[heat]), ...scale()] : []));
    }

    setTheme() {
      if (!this.map) return;
      this.map.setTheme();
      this.showLegend();
    }
  };
})();
