/* The stage: one run on the screen. It owns the clock, the link, the map, the transport bar and the address. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 32, 64];
  const PULSE_MS = 700, PULSE_GIVE_UP_MS = 8000, ROUTES_MS = 500, POWER_MS = 1000, HEAT_MS = 3000, ASK_MS = 30, VEIL_AFTER_MS = 2500;
  const ASKED_MS = 1500;   // how long a button shows what was asked for, until a frame shows that it is so
  const ROUTES_UP_TO = 40;
  const HEATS = { "": "no heat map", occupancy: "occupancy", waiting: "waiting", energy: "energy" };
  const LETTER = { vehicle: "v", station: "s", charger: "c", place: "p" };

  const icon = (name) => el("span", { class: `wl-icon wl-icon-${name}`, "aria-hidden": "true" });
  const button = (name, label, onclick, extra = {}) =>
    el("button", { type: "button", class: "wl-tool", "aria-label": label, title: label, onclick, ...extra }, icon(name));

  class Stage {
    /** config: run, page ("operate" | "replay"), live, t_end (s), tick_s, status, title. */
    constructor(config) {
      this.config = config;
      this.follow = config.page === "operate" && config.live;
      this.time = 0;               // seconds shown
      this.end = config.t_end || 0;
      this.playing = false;        // my own clock, when not following
      this.speed = 1;
      this.sim = { paused: false, done: !config.live, asked: 1, reached: 0, tick: 0, time: this.end };   // as reported
      this.pausing = null;         // true or false while the simulation was asked to pause or go on, and has not yet
      this.link_state = "connecting";
      this.selection = null;
      this.marks = [];
      this.frames = [];
      this.pulseNumber = 0;
      this.pulseAsked = 0;
      this.pulseAnswered = 0;
      this.planner = null;
      this._readAddress();
    }

    async start() {
      const host = await wl.found("map");
      if (!host || this.gone) return;
      this.host = host;
      host.replaceChildren();
      host.classList.add("wl-map");
      this._buildStatus();
      this._buildTransport();
      let floor;
      try {
        floor = await wl.fetchJson(wl.runPath(this.config.run, "/floor"));
      } catch (problem) {
        if (!this.gone) this._fail(problem.message);
        return;
      }
      if (this.gone) return;
      this._buildMap(floor);
      this.link = new wl.Link(this.config.run, { width: floor.width_m || floor.width * floor.cell_m, height: floor.height_m || floor.height * floor.cell_m }, {
        frame: (frame, bytes) => this._frame(frame, bytes),
        status: (status) => this._status(status),
        state: (state, age) => this._linkState(state, age),
      });
      this.link.start();
      if (!this.follow) this.seek(this.startAt ?? (this.config.page === "replay" ? 0 : this.end), true);
      if (this.selection) this.select(this.selection, { centre: true, quiet: true });
      this.beat = setInterval(() => this._beat(), 100);
      this._loop = this._loop.bind(this);
      this.dirty = true;
      this._showTab();
    }

    destroy() {
      this.gone = true;
      clearInterval(this.beat);
      cancelAnimationFrame(this.raf);
      if (this.link) this.link.stop();
      if (this.map) this.map.destroy();
      closeMenu();
      for (const id of ["wl-status", "transport"]) { const node = document.getElementById(id); if (node) node.replaceChildren(); }
    }

    _fail(reason) {
      this.host.replaceChildren(el("div", { class: "wl-empty", role: "alert" },
        el("h2", {}, "The floor could not be loaded"), el("p", {}, reason),
        el("button", { type: "button", class: "wl-button primary", onclick: () => wl.bind(this.config) }, "Try again")));
    }

    // ---- the link

    _frame(frame, bytes) {
      if (this.gone) return;
      this.frames.push(performance.now());
      if (!frame.replay) {
        if (frame.paused === this.pausing) this.pausing = null;
        this.sim = { paused: frame.paused, done: frame.done, asked: frame.asked, reached: frame.reached, tick: frame.tick, time: frame.time };
        this.end = Math.max(this.end, frame.time);
        if (!this.follow) return;
        const jump = Math.abs(frame.time - this.time) > Math.max(5, frame.asked || 64);
        this.time = frame.time;
        this.map.push(frame, jump);
      } else {
        if (this.follow) return;
        this.map.push(frame, this.snapNext);
        this.snapNext = false;
      }
      this.bytes = bytes;
      this.dirty = true;
      this.host.dataset.frames = String(Number(this.host.dataset.frames || 0) + 1);
    }

    _status(status) {
      const error = status.error || (status.type === "error" && status.text);
      if (error) {
        if (error !== this.lastError) wl.notify("The live link reports", String(error), "warning");
        this.lastError = error;
        return;
      }
      this._phase(status);
      if (typeof status.planner_p95_ms === "number") this.planner = status.planner_p95_ms;
      if (typeof status.sim_s === "number") this.end = Math.max(this.end, status.sim_s);
      if (!this.follow) {   // then no frame says it
        if (typeof status.paused === "boolean") this.sim.paused = status.paused;
        if (typeof status.speed === "number") this.sim.reached = status.speed;
        if (typeof status.asked === "number") this.sim.asked = status.asked;
      }
      if (status.done === true) this.sim.done = true;
      if (status.alive === false && this.config.live && !this.deadShown) {
        this.deadShown = true;
        this.sim.paused = true;
        this.pulseSoon();
        wl.setProps("runs-changed", { data: Date.now() });
      }
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

    // ---- time

    /** Shows a moment of the past, in seconds; leaves LIVE. */
    seek(time, snap = false) {
      const clamped = Math.max(0, Math.min(this.end, time));
      this.follow = false;
      this.pausing = null;
      this.snapNext = this.snapNext || snap || Math.abs(clamped - this.time) > 4;
      this.time = clamped;
      this.dirty = true;
      if (this.link) { this.link.watchLive(false); this.link.ask(clamped); }
      this._writeAddress();
    }

    toLive() {
      if (this.config.page !== "operate" || !this.config.live) { this.playing = false; this.seek(this.end); return; }
      this.follow = true;
      this.pausing = null;
      this.link.watchLive(true);
      this.playing = false;
      this.time = this.sim.time;
      this.dirty = true;
      this._writeAddress();
    }

    step(ticks) {
      if (this.follow && ticks > 0) {
        wl.control(this.config.run, "step", { ticks });   // which also pauses
        return;
      }
      this.playing = false;
      const tick = Math.round(this.time / this.config.tick_s) + ticks;
      this.seek(tick * this.config.tick_s);
    }

    toggle() {
      if (this.follow) {
        if (this.sim.done) { wl.notify("The run is finished", "Look back with the time ruler, or start another run.", "info"); return; }
        const pause = this._goesOn();
        this.pausing = pause;
        wl.control(this.config.run, pause ? "pause" : "play").then((done) => {
          setTimeout(() => { if (this.pausing === pause) this.pausing = null; }, done ? ASKED_MS : 0);
        });
        return;
      }
      this.playing = !this.playing;
      if (this.playing && this.time >= this.end - 1e-9) this.seek(0, true);
      this.lastLoop = performance.now();
      if (this.playing) this.raf = requestAnimationFrame(this._loop);
    }

    /** Whether the live simulation runs, or will in a moment: what its button offers to change. */
    _goesOn() { return !this.sim.done && !(this.pausing ?? this.sim.paused); }

    setSpeed(speed) {
      if (this.follow) { wl.control(this.config.run, "speed", { speed }); this.sim.asked = speed; this.speedHeld = performance.now(); }
      else this.speed = speed || 64;
    }

    faster(by) {
      const now = this.follow ? this.sim.asked : this.speed;
      const at = now === 0 ? SPEEDS.length : SPEEDS.findIndex((s) => s >= now - 1e-6);
      const next = (at < 0 ? SPEEDS.length - 1 : at) + by;
      if (next >= SPEEDS.length) { if (this.follow) this.setSpeed(0); return; }
      this.setSpeed(SPEEDS[Math.max(0, next)]);
    }

    toEvent(way) {
      const times = this.marks.map((m) => m.t).sort((a, b) => a - b);
      const next = way > 0 ? times.find((t) => t > this.time + 1e-6) : times.reverse().find((t) => t < this.time - 1e-6);
      if (next !== undefined) { this.playing = false; this.seek(next); }
    }

    _loop(now) {
      if (this.gone || !this.playing || this.follow) return;
      const passed = Math.max(0, Math.min(0.25, (now - this.lastLoop) / 1000));   // the first frame may have begun before
      this.lastLoop = now;
      this.time += passed * this.speed;
      if (this.time >= this.end) { this.time = this.end; this.playing = false; }
      if (now - (this.lastAsk || 0) >= ASK_MS || !this.playing) { this.lastAsk = now; this.link.ask(this.time); }
      this.dirty = true;
      if (this.playing) this.raf = requestAnimationFrame(this._loop);
      else this._writeAddress();
    }

    // ---- ten times a second: texts, ruler, side requests

    _beat() {
      if (this.gone) return;
      if (!this.host.isConnected) { wl.bind(null); return; }   // another page has come
      const now = performance.now();
      this._showStatus(now);
      this._showTransport();
      this.ruler.draw(this);
      const moved = this.time !== this.routesTime || this.routesFor !== this._routesKey();
      if (moved && now - (this.routesAt || 0) > ROUTES_MS && !this.routesBusy) this._fetchRoutes(now);
      if (this.map.layers.colour === "power" && now - (this.powerAt || 0) > POWER_MS && this.powerTime !== this.time) this._fetchPower(now);
      if (this.map.layers.heat && now - (this.heatAt || 0) > HEAT_MS && (this.heatTime !== this.time || this.heatKey !== this._heatKey())) this._fetchHeat(now);
      this._pulse(now);
    }

    _routesKey() { return this.map.layers.paths ? "all" : this.selection && this.selection.kind === "vehicle" ? `v${this.selection.id}` : ""; }

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

    async _fetchPower(now) {
      this.powerAt = now;
      this.powerTime = this.time;
      try {
        const answer = await wl.fetchJson(wl.runPath(this.config.run, this.follow ? "/power" : `/power?t=${this.time}`));
        if (!this.gone && this.map.setPower(answer.values)) wl.legend(this.legendHost, this.map);
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
        this._showHeatScale();
      } catch (problem) { this.heatNote.textContent = problem.message; }
    }

    /** Asks Dash for what the open tab shows, when something changed and the last answer is in. */
    _pulse(now) {
      const busy = this.pulseAnswered < this.pulseNumber && now - this.pulseAsked < PULSE_GIVE_UP_MS;
      if (!this.dirty || busy || now - this.pulseAsked < PULSE_MS || document.hidden || this.link_state === "down") return;
      this.dirty = false;
      this.pulseAsked = now;
      this.pulseNumber += 1;
      wl.setProps("pulse", { data: { n: this.pulseNumber, run: this.config.run, page: this.config.page,
        t: this.follow ? null : this.time, live: this.config.live, follow: this.follow, scheme: wl.scheme() } });
    }

    pulseSoon() { this.dirty = true; this.pulseAsked = Math.min(this.pulseAsked, performance.now() - PULSE_MS + 250); }

    acknowledge(number) { this.pulseAnswered = Math.max(this.pulseAnswered, number); }

    /** What Dash adds to the map and the ruler: blocked places, chargers out of order, event ticks, levels. */
    extra(data) {
      if (!data || data.run !== this.config.run || !this.map) return;
      if (data.blocked) this.map.setBlocked(data.blocked, data.chargers_out || []);
      if (data.events) { this.marks = data.events; this.ruler.stale = true; }
      if (typeof data.t_end === "number") this.end = Math.max(this.end, data.t_end);
    }

    // ---- selection, commands

    select(selection, options = {}) {
      if (selection && selection.kind === "vehicle" && this.map && this.map.n && selection.id >= this.map.n) {
        wl.notify("Not found", `There is no vehicle ${selection.id}.`, "warning");
        return;
      }
      if (selection && selection.place === undefined && this.floor) {
        const list = { station: this.floor.stations, charger: this.floor.chargers }[selection.kind];
        const item = list && list.find((i) => i.number === selection.id);
        if (item) selection = { ...selection, place: item.place };
      }
      this.selection = selection;
      this.routesFor = null;
      if (this.map) {
        this.map.setSelection(selection);
        if (options.centre && selection) this.map.centreOn(selection);
      }
      wl.setProps("selection", { data: selection });
      const ids = selection && selection.kind === "vehicle" ? [String(selection.id)] : [];
      if (options.from !== "table") wl.setProps("fleet-grid", { selectedRows: { ids }, ...(ids.length ? { scrollTo: { rowId: ids[0] } } : {}) });
      this.followButton.setAttribute("aria-pressed", String(this.map ? this.map.follow : false));
      this._writeAddress();
    }

    toggleFollow() {
      if (!this.selection || this.selection.kind !== "vehicle") {
        wl.notify("Follow", "Select a vehicle first, on the map or in the fleet table.", "info");
        return;
      }
      const on = this.map.setFollow(!this.map.follow);
      this.followButton.setAttribute("aria-pressed", String(on));
    }

    /** Buttons that Dash renders and that concern this stage. */
    act(data) {
      if (data.action === "follow") { this.select({ kind: "vehicle", id: data.vehicle }, { centre: true }); if (!this.map.follow) this.toggleFollow(); }
      else if (data.action === "send") this.send(data.vehicle);
      else if (data.action === "why") this.why(data.vehicle);
      else if (data.action === "goto") { this.playing = false; this.seek(data.t); if (data.select) this.select(data.select, { centre: true }); }
      else if (data.action === "live") this.toLive();
      else if (data.action === "fold") { const box = document.getElementById("tabs-box"); if (box) box.classList.toggle("closed"); }
    }

    send(vehicle) {
      wl.notify("Send to…", `Click a cell for vehicle ${vehicle}; Esc cancels.`, "info");
      this.map.beginSend((place) => wl.command({ do: "send", vehicle, place }));
    }

    async fleetRow(vehicle) {
      const query = this.follow ? "" : `&t=${this.time}`;
      const view = await wl.fetchJson(wl.runPath(this.config.run, `/view?parts=fleet${query}`));
      return (view.fleet || []).find((row) => row.vehicle === vehicle);
    }

    async why(vehicle) {
      try {
        const row = await this.fleetRow(vehicle);
        const doing = row ? row.why || `It is not waiting: ${row.state}.` : "This vehicle is not known.";
        wl.notify(`Vehicle ${vehicle}`, doing, "info");
      } catch (problem) { wl.notify(`Vehicle ${vehicle}`, problem.message, "error"); }
    }

    async withdrawOf(vehicle) {
      try {
        const row = await this.fleetRow(vehicle);
        if (row && row.order !== null && row.order !== undefined && row.order >= 0) wl.command({ do: "withdraw", order: row.order });
        else wl.notify("Withdraw", `Vehicle ${vehicle} has no order.`, "info");
      } catch (problem) { wl.notify("Withdraw", problem.message, "error"); }
    }

    menu(target, x, y) {
      const live = this.config.live && this.follow && !this.sim.done, items = [];   // the past takes no commands
      const add = (label, run) => items.push({ label, run });
      if (target.kind === "vehicle") {
        this.select(target, { from: "map" });
        add(this.map.follow ? "Stop following" : "Follow", () => this.toggleFollow());
        this._vehicleMenu(add, target.id, live);
      } else {
        const label = this.map.cellName(target.place);
        add("Centre here", () => this.map.centreOn(target));
        if (live) {
          if (target.kind === "charger") {
            const charger = this.map.chargerAt.get(target.place), out = this.map.chargersOut.has(charger.place);
            const index = this.floor.chargers.indexOf(charger);
            if (out) add("Charger back in order", () => wl.command({ do: "charger back", charger: index, label: charger.name }));
            else add("Charger out of order…", () => wl.command({ do: "charger out", charger: index, label: charger.name }));
          }
          if (target.kind === "station") {
            add("New order from here", () => { wl.setProps("order-from", { value: String(target.id) }); wl.notify("New order", "Choose where to, at the left.", "info"); });
            add("New order to here", () => { wl.setProps("order-to", { value: String(target.id) }); wl.notify("New order", "Choose where from, at the left.", "info"); });
          }
          if (this.map.blocked.has(target.place)) add("Unblock this cell", () => wl.command({ do: "unblock", place: target.place, label }));
          else add("Block this cell…", () => wl.command({ do: "block", place: target.place, label }));
        }
      }
      openMenu(this.map.describe(target), items, x, y);
    }

    /** What can be done with a vehicle in its present state; the engine has the last word, and says why not. */
    _vehicleMenu(add, v, live) {
      const { state, flags, soc } = this.map.frame, is = (...states) => states.includes(state[v]);
      const { WAITING, LOADING, TO_CHARGER, CHARGING, FAULT, PAUSED, TASK_SHIFT, TO_PICK, TO_DROP, FULL_SOC } = wl.marks;
      const task = flags[v] >> TASK_SHIFT, command = (label, what) => add(label, () => wl.command({ do: what, vehicle: v }));
      if (is(WAITING, FAULT, PAUSED)) add("Why waiting?", () => this.why(v));
      if (!live) return;
      if (!is(FAULT, PAUSED) && task !== TO_PICK && task !== TO_DROP) add("Send to…", () => this.send(v));
      if (is(PAUSED)) command("Continue", "continue");
      else if (!is(FAULT)) command("Pause", "pause");
      if (!is(TO_CHARGER, CHARGING, FAULT) && soc[v] !== FULL_SOC) command("Charge now", "charge");
      if (task === TO_PICK && !is(LOADING)) add("Withdraw its order…", () => this.withdrawOf(v));
      command(...(is(FAULT) ? ["Repair", "repair"] : ["Break down…", "fail"]));
    }

    find(text) {
      const word = text.trim().toLowerCase();
      if (!word) return;
      const item = [...(this.floor.stations || []).map((s) => ["station", s]), ...(this.floor.chargers || []).map((c) => ["charger", c])]
        .find(([, i]) => i.name.toLowerCase() === word);
      const spot = (this.floor.parking || []).find((p) => p.name.toLowerCase() === word);
      const number = /^(?:v|vehicle|agv)?\s*(\d+)$/.exec(word);
      if (item) this.select({ kind: item[0], id: item[1].number, place: item[1].place }, { centre: true });
      else if (spot) this.select({ kind: "place", id: spot.place, place: spot.place }, { centre: true });
      else if (number) this.select({ kind: "vehicle", id: Number(number[1]) }, { centre: true });
      else wl.notify("Not found", `“${text}” is no vehicle number, station, charger or parking name.`, "warning");
    }

    // ---- the address

    _readAddress() {
      const query = new URLSearchParams(location.search);
      const t = query.get("t");
      if (t !== null && t !== "" && Number.isFinite(Number(t))) { this.startAt = Number(t); this.follow = false; this.time = this.startAt; this.end = Math.max(this.end, 0); }
      const sel = /^([vscp])(\d+)$/.exec(query.get("sel") || "");
      if (sel) this.selection = { kind: Object.keys(LETTER).find((k) => LETTER[k] === sel[1]), id: Number(sel[2]) };
      if (this.selection && this.selection.kind === "place") this.selection.place = this.selection.id;
      this.layersWanted = {};
      const layers = query.get("layers");
      if (layers === null) return;
      const words = new Set(layers.split(","));
      for (const name of ["grid", "ids", "paths", "log"]) this.layersWanted[name] = words.has(name);
      for (const word of words) {
        if (word.startsWith("heat-") && word.slice(5) in HEATS) this.layersWanted.heat = word.slice(5);
        if (word.startsWith("by-") && word.slice(3) in wl.COLOURINGS) this.layersWanted.colour = word.slice(3);
        if (/^w\d+$/.test(word)) this.layersWanted.window = Number(word.slice(1));
      }
    }

    _writeAddress() {
      if (this.gone || !this.map) return;
      const query = new URLSearchParams(location.search);
      query.set("run", this.config.run);
      if (this.follow) query.delete("t"); else query.set("t", String(Math.round(this.time * 100) / 100));
      if (this.selection && LETTER[this.selection.kind]) query.set("sel", LETTER[this.selection.kind] + this.selection.id); else query.delete("sel");
      const l = this.map.layers;
      const words = ["grid", "ids", "paths", "log"].filter((name) => l[name]);
      if (l.heat) words.push(`heat-${l.heat}`, `w${l.window}`);
      if (l.colour !== "state") words.push(`by-${l.colour}`);
      query.set("layers", words.join(","));
      if (this.tab) query.set("tab", this.tab);
      history.replaceState(history.state, "", `${location.pathname}?${query}`);
    }

    _showTab() {
      const tab = new URLSearchParams(location.search).get("tab");
      if (tab && /^[a-z]+$/.test(tab)) wl.setProps("tabs", { value: tab });
    }

    setTab(tab) { this.tab = tab; this.dirty = true; this.pulseSoon(); this._writeAddress(); }

    // ---- building

    _buildStatus() {
      const host = document.getElementById("wl-status");
      if (!host) return;
      this.chip = el("span", { class: "wl-chip", role: "status" }, "…");
      this.clockText = el("span", { class: "wl-clock", title: "Simulated time" }, "--:--:--");
      this.rates = el("span", { class: "wl-rates" });
      host.replaceChildren(this.chip, this.clockText, this.rates);
    }

    _showStatus(now) {
      const mode = this.link_state === "down" || this.link_state === "connecting" && now - this.begun > 3000 ? "DISCONNECTED"
        : !this.follow ? "REPLAY" : this.sim.paused || this.sim.done ? "PAUSED" : "LIVE";
      if (this.chip.dataset.mode !== mode) { this.chip.dataset.mode = mode; this.chip.textContent = mode; }
      this.clockText.textContent = wl.clock(this.time);
      this.clockText.title = `Simulated time, tick ${Math.floor(this.time / this.config.tick_s + 1e-6)}`;
      while (this.frames.length && this.frames[0] < now - 2000) this.frames.shift();
      const rate = this.frames.length / 2;
      const lag = this.frames.length ? now - this.frames[this.frames.length - 1] : null;
      const parts = rate > 0 || mode === "LIVE" ? [`${rate.toFixed(rate < 10 ? 1 : 0)} updates/s`] : [];
      if (lag !== null && rate > 0.5 && mode === "LIVE") parts.push(`lag ${Math.round(lag)} ms`);
      if (this.planner !== null) parts.push(`planner p95 ${this.planner.toFixed(1)} ms`);
      const text = parts.join(" · ");
      if (now - (this.ratesAt || 0) > 500) { this.rates.textContent = text; this.ratesAt = now; }
    }

    _buildTransport() {
      this.begun = performance.now();
      const bar = document.getElementById("transport");
      const text = (label, name, onclick) => el("button", { type: "button", class: "wl-tool wide", "aria-label": name, title: name, onclick }, label);
      this.playButton = el("button", { type: "button", class: "wl-tool play", id: "play", onclick: () => this.toggle() }, icon("pause"));
      this.speedChoice = el("select", { class: "wl-select", id: "speed", "aria-label": "Speed" },
        ...SPEEDS.map((s) => el("option", { value: s }, `${s}×`)), el("option", { value: 0 }, "max"));
      this.speedChoice.addEventListener("change", () => this.setSpeed(Number(this.speedChoice.value)));
      this.reached = el("span", { class: "wl-reached" });
      this.timeBox = el("input", { type: "text", class: "wl-time", id: "time", "aria-label": "Time, as 00:12:30 or a tick", autocomplete: "off", spellcheck: "false" });
      const goTo = () => {
        const t = wl.parseTime(this.timeBox.value, this.config.tick_s);
        if (t === null) { this.timeBox.setAttribute("aria-invalid", "true"); wl.notify("Not a time", "Type 00:12:30, 12:30, 90s or a tick such as 750.", "warning"); return; }
        this.timeBox.removeAttribute("aria-invalid");
        this.playing = false;
        this.seek(t, true);
        this.timeBox.blur();
      };
      this.timeBox.addEventListener("keydown", (event) => { if (event.key === "Enter") goTo(); else if (event.key === "Escape") this.timeBox.blur(); });
      this.timeBox.addEventListener("blur", () => this.timeBox.removeAttribute("aria-invalid"));
      this.endText = el("span", { class: "wl-end" });
      this.note = el("button", { type: "button", class: "wl-note", hidden: true, onclick: () => this.toLive() });
      const rulerHost = el("div", { class: "wl-ruler" });
      bar.replaceChildren(
        el("div", { class: "wl-buttons", role: "group", "aria-label": "Time" },
          button("first", "To the start (Home)", () => { this.playing = false; this.seek(0, true); }),
          text("−10", "Ten ticks back (Shift+←)", () => this.step(-10)),
          text("−1", "One tick back (←)", () => this.step(-1)),
          this.playButton,
          text("+1", "One tick on (→)", () => this.step(1)),
          text("+10", "Ten ticks on (Shift+→)", () => this.step(10)),
          button("last", "To the end, or to live (End)", () => this.toLive())),
        el("div", { class: "wl-pace" }, this.speedChoice, this.reached),
        el("div", { class: "wl-when" }, this.timeBox, this.endText),
        this.note, rulerHost);
      this.ruler = new wl.Ruler(rulerHost, { seek: (t) => { this.playing = false; this.seek(t); } });
      this.bar = bar;
    }

    _showTransport() {
      const running = this.follow ? this._goesOn() : this.playing;
      const label = this.follow ? (running ? "Pause the simulation, for everyone (Space)" : "Continue the simulation, for everyone (Space)")
        : (running ? "Pause my view (Space)" : "Play my view (Space)");
      if (this.playButton.title !== label) {
        this.playButton.title = label;
        this.playButton.setAttribute("aria-label", label);
        this.playButton.replaceChildren(icon(running ? "pause" : "play"));
      }
      this.bar.classList.toggle("mine", !this.follow);
      const asked = this.follow ? this.sim.asked : this.speed;
      if (document.activeElement !== this.speedChoice && performance.now() - (this.speedHeld || 0) > 800) {
        const value = String(asked);
        if (this.speedChoice.value !== value && [...this.speedChoice.options].some((o) => o.value === value)) this.speedChoice.value = value;
      }
      this.speedChoice.lastElementChild.hidden = !this.follow;
      const reached = this.follow ? (running ? `reached ${this.sim.reached >= 10 ? this.sim.reached.toFixed(0) : this.sim.reached.toFixed(2)}×` : this.sim.done ? "finished" : "paused") : "my view";
      if (this.reached.textContent !== reached) this.reached.textContent = reached;
      if (document.activeElement !== this.timeBox) this.timeBox.value = wl.clock(this.time);
      const end = `/ ${wl.clock(this.end)}`;
      if (this.endText.textContent !== end) this.endText.textContent = end;
      const back = !this.follow && this.config.page === "operate" && this.config.live;
      this.note.hidden = !back;
      if (back) this.note.textContent = `You look ${wl.span(Math.max(0, this.end - this.time))} back. Return to LIVE (End)`;
    }

    _buildMap(floor) {
      this.floor = floor;
      const canvasHost = el("div", { class: "wl-map-host" });
      this.veilText = el("p", {});
      this.veil = el("div", { class: "wl-veil", hidden: true, role: "alert" }, this.veilText);
      this.followButton = button("follow", "Follow the selected vehicle (F)", () => this.toggleFollow(), { "aria-pressed": "false" });
      this.findBox = el("input", { type: "search", class: "wl-find", id: "find", placeholder: "Find: 4, R7, C2", "aria-label": "Find a vehicle, station or charger" });
      this.findBox.addEventListener("keydown", (event) => {
        if (event.key === "Enter") { this.find(this.findBox.value); this.findBox.blur(); }
        if (event.key === "Escape") { this.findBox.value = ""; this.findBox.blur(); }
      });
      this.phase = el("div", { class: "wl-phase", role: "status", hidden: true });
      this.legendHost = el("div", { class: "wl-legend" });
      this.host.append(el("div", { class: "wl-map-view" }, canvasHost,
        el("div", { class: "wl-map-tools", role: "toolbar", "aria-label": "Map" },
          button("plus", "Zoom in (+)", () => this.map.zoom(1.4)), button("minus", "Zoom out (−)", () => this.map.zoom(1 / 1.4)),
          button("fit", "Fit the floor (R)", () => this.map.fit()), this.followButton, this._buildLayers()),
        el("div", { class: "wl-map-find" }, this.findBox),
        this.phase, this.veil),
        el("details", { class: "wl-map-legend", open: matchMedia("(min-width: 901px)").matches }, el("summary", {}, "Legend"), this.legendHost));
      this.map = new wl.FleetMap(canvasHost, { select: (s, o) => this.select(s, o), menu: (t, x, y) => this.menu(t, x, y) });
      this.map.setFloor(floor);
      // Hundreds of routes at once hide the floor: then only that of the selected vehicle, unless the address says more.
      this.setLayers({ paths: (this.config.fleet || 0) <= ROUTES_UP_TO, ...this.layersWanted }, true);
    }

    _buildLayers() {
      const box = (name, label) => {
        const input = el("input", { type: "checkbox", dataset: { layer: name } });
        input.addEventListener("change", () => this.setLayers({ [name]: input.checked }));
        return el("label", {}, input, label);
      };
      const choice = (name, label, options) => {
        const select = el("select", { class: "wl-select", dataset: { layer: name } }, ...options.map(([value, word]) => el("option", { value }, word)));
        select.addEventListener("change", () => this.setLayers({ [name]: name === "window" ? Number(select.value) : select.value }));
        return el("label", {}, el("span", {}, label), select);
      };
      this.heatNote = el("div", { class: "wl-heat-scale" });
      this.layerPanel = el("div", { class: "wl-layers" },
        box("paths", "Routes (P)"), box("ids", "Numbers (I)"), box("grid", "Grid (G)"),
        choice("colour", "Colour by", Object.entries(wl.COLOURINGS)),
        choice("heat", "Heat map (H)", Object.entries(HEATS)),
        choice("window", "over the last", [[600, "10 min"], [3600, "1 h"], [28800, "8 h"], [0, "whole run"]]),
        box("log", "logarithmic scale"), this.heatNote);
      return el("details", { class: "wl-layer-menu" }, el("summary", { class: "wl-tool", "aria-label": "Layers", title: "Layers" }, icon("layers")), this.layerPanel);
    }

    setLayers(change, quiet = false) {
      this.map.setLayers(change);
      if ("colour" in change) this.powerTime = null;
      if ("heat" in change || "window" in change) { this.map.setHeat(null); this.heatAt = 0; this.heatTime = null; }
      for (const input of this.layerPanel.querySelectorAll("[data-layer]")) {
        const value = this.map.layers[input.dataset.layer];
        if (input.type === "checkbox") input.checked = value; else input.value = String(value);
      }
      wl.legend(this.legendHost, this.map);
      this._showHeatScale();
      this.routesFor = null;
      if (!quiet) this._writeAddress();
    }

    toggleLayer(name) {
      if (name === "heat") {
        const kinds = Object.keys(HEATS), at = kinds.indexOf(this.map.layers.heat);
        this.setLayers({ heat: kinds[(at + 1) % kinds.length] });
      } else this.setLayers({ [name]: !this.map.layers[name] });
    }

    _showHeatScale() {
      const { heat, log } = this.map.layers;
      if (!heat || !this.map.heat) { this.heatNote.replaceChildren(); return; }
      this.heatNote.replaceChildren(el("span", {}, "0"), el("span", { class: "wl-heat-bar" }),
        el("span", {}, `${wl.heatText(heat, this.map.heatTop())}${log ? " (log)" : ""}`));
    }

    setTheme() {
      if (!this.map) return;
      this.map.setTheme();
      wl.legend(this.legendHost, this.map);
      this.ruler.stale = true;
      this.dirty = true;
    }
  }

  // ---- menu

  let menuOpen = null;
  const closeMenu = () => { if (menuOpen) { menuOpen.remove(); menuOpen = null; } };
  const openMenu = (title, items, x, y) => {
    closeMenu();
    const menu = el("div", { class: "wl-menu", role: "menu", "aria-label": title }, el("div", { class: "wl-menu-title" }, title));
    for (const { label, run } of items) {
      menu.append(el("button", { type: "button", role: "menuitem", onclick: () => { closeMenu(); run(); } }, label));
    }
    document.body.append(menu);
    const box = menu.getBoundingClientRect();
    menu.style.left = `${Math.max(4, Math.min(x, innerWidth - box.width - 4))}px`;
    menu.style.top = `${Math.max(4, Math.min(y, innerHeight - box.height - 4))}px`;
    menu.addEventListener("keydown", (event) => {
      const buttons = [...menu.querySelectorAll("button")], at = buttons.indexOf(document.activeElement);
      if (event.key === "ArrowDown") buttons[(at + 1) % buttons.length].focus();
      else if (event.key === "ArrowUp") buttons[(at - 1 + buttons.length) % buttons.length].focus();
      else if (event.key === "Escape") closeMenu();
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    menuOpen = menu;
    const first = menu.querySelector("button");
    if (first) first.focus();
  };
  document.addEventListener("pointerdown", (event) => { if (menuOpen && !menuOpen.contains(event.target)) closeMenu(); }, true);
  wl.closeMenu = () => { const was = !!menuOpen; closeMenu(); return was; };

  // ---- the height of the tabs

  document.addEventListener("pointerdown", (event) => {
    if (event.target.id !== "tabs-grip") return;
    const grip = event.target, box = document.getElementById("tabs-box"), from = event.clientY, high = box.offsetHeight;
    grip.setPointerCapture(event.pointerId);
    const drag = (move) => box.style.setProperty("--wl-tabs-high", `${Math.max(120, Math.min(innerHeight * 0.7, high + from - move.clientY))}px`);
    grip.addEventListener("pointermove", drag);
    grip.addEventListener("pointerup", () => grip.removeEventListener("pointermove", drag), { once: true });
  });

  // ---- binding

  /** Puts a run on the stage, or clears it. */
  wl.bind = (config) => {
    if (wl.stage) { wl.stage.destroy(); wl.stage = null; }
    if (!config || !config.run) return;
    wl.stage = new Stage(config);
    wl.stage.start();
  };
})();
