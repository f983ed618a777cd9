/* The stage: one run on the screen. It owns the clock, the link, the map, the transport bar and the address. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const PULSE_MS = 700, PULSE_GIVE_UP_MS = 8000;
  const PATHS = { operate: ["/", "/operate"], replay: ["/replay"] };
  const BOULDER_M = 0.8;   // radius of what an operator drops on terrain
  const ASKED_MS = 1500;   // how long a button shows what was asked for, until a frame shows that it is so

  class Stage extends wl.Player {
    /** config: run, page ("operate" | "replay"), live, t_end (s), tick_s, status, title. */
    constructor(config) {
      super(config);
      this.follow = config.page === "operate" && config.live;
      this.sim = { paused: false, done: !config.live, asked: 1, reached: 0, tick: 0, time: this.end };   // as reported
      this.pausing = null;         // true or false while the simulation was asked to pause or go on, and has not yet
      this.pulseNumber = 0;
      this.pulseAsked = 0;
      this.pulseAnswered = 0;
      this.planner = null;
      const query = new URLSearchParams(location.search), view = wl.readView(query);
      this.selection = view.selection;
      this.layersWanted = view.layers;
      this.startAt = wl.Player.startIn(query);
      if (this.startAt !== null) { this.follow = false; this.time = this.startAt; }
    }

    async start() {
      const host = await wl.found("map");
      if (!host || this.gone) return;
      this.host = host;
      this.buildStatus();
      this.buildTransport("To the end, or to live (End)");
      this.note.addEventListener("click", () => this.toLive());
      this.panel = new wl.Panel(host, this.config, {
        frame: (frame, bytes) => this._frame(frame, bytes),
        status: (status) => this._status(status),
        select: (selection, options) => this.select(selection, options),
        menu: (target, x, y) => this.menu(target, x, y),
        follow: () => this.toggleFollow(),
        layers: (change) => this.setLayers(change),
        fit: () => this.fit(),
        zoomed: () => {},
        scaled: () => {},
        again: () => wl.bind(this.config),
        tools: (floor) => (floor.kind === "terrain" ? [wl.ground3d.button()] : []),
      });
      if (!await this.panel.start(this.layersWanted)) return;
      this.map = this.panel.map;
      this.floor = this.panel.floor;
      this.findBox = this.panel.findBox;
      this.findBox.id = "find";
      this.panel.legendIn(host);
      if (!this.follow) this.seek(this.startAt ?? (this.config.page === "replay" ? 0 : this.end), true);
      if (this.selection) this.select(this.selection, { centre: true, quiet: true });
      this.beat = setInterval(() => this._beat(), 100);
      this.dirty = true;
      this._showTab();
    }

    destroy() {
      super.destroy();
      if (this.panel) this.panel.destroy();
      closeMenu();
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
        this.panel.counted();
      } else {
        if (this.follow) return;
        this.panel.shown(frame);
      }
      this.bytes = bytes;
      this.dirty = true;
    }

    _status(status) {
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

    // ---- time

    show(time, snap) { this.panel.show(time, snap); }

    written() { this._writeAddress(); }

    /** Shows a moment of the past, in seconds; leaves LIVE. */
    seek(time, snap = false) {
      this.follow = false;
      this.pausing = null;
      super.seek(time, snap);
    }

    toLive() {
      if (this.config.page !== "operate" || !this.config.live) { this.toEnd(); return; }
      this.follow = true;
      this.pausing = null;
      this.panel.link.watchLive(true);
      this.playing = false;
      this.time = this.sim.time;
      this.dirty = true;
      this._writeAddress();
    }

    step(ticks) {
      if (this.follow && ticks > 0) wl.control(this.config.run, "step", { ticks });   // which also pauses
      else super.step(ticks);
    }

    toggle() {
      if (!this.follow) { super.toggle(); return; }
      if (this.sim.done) { wl.notify("The run is finished", "Look back with the time ruler, or start another run.", "info"); return; }
      const pause = this._goesOn();
      this.pausing = pause;
      wl.control(this.config.run, pause ? "pause" : "play").then((done) => {
        setTimeout(() => { if (this.pausing === pause) this.pausing = null; }, done ? ASKED_MS : 0);
      });
    }

    /** Whether the live simulation runs, or will in a moment: what its button offers to change. */
    _goesOn() { return !this.sim.done && !(this.pausing ?? this.sim.paused); }

    get asked() { return this.follow ? this.sim.asked : this.speed; }

    setSpeed(speed) {
      if (this.follow) { wl.control(this.config.run, "speed", { speed }); this.sim.asked = speed; this.speedHeld = performance.now(); }
      else super.setSpeed(speed);
    }

    beyond() { if (this.follow) this.setSpeed(0); }

    // ---- ten times a second: texts, ruler, side requests

    _beat() {
      if (this.gone) return;
      if (!this.mounted(PATHS[this.config.page], wl.bind)) return;
      const now = performance.now();
      this._showStatus(now);
      this._showTransport();
      this.panel.beat(now, this.time, this.follow);
      this._pulse(now);
    }

    /** Asks Dash for what the open tab shows, when something changed and the last answer is in. */
    _pulse(now) {
      const busy = this.pulseAnswered < this.pulseNumber && now - this.pulseAsked < PULSE_GIVE_UP_MS;
      if (!this.dirty || busy || now - this.pulseAsked < PULSE_MS || document.hidden || this.panel.link_state === "down") return;
      this.dirty = false;
      this.pulseAsked = now;
      this.pulseNumber += 1;
      wl.setProps("pulse", { data: { n: this.pulseNumber, run: this.config.run, page: this.config.page,
        t: this.follow ? null : this.time, live: this.config.live, follow: this.follow, scheme: wl.scheme() } });
    }

    pulseSoon() { this.dirty = true; if (this.panel) this.panel.anew(); this.pulseAsked = Math.min(this.pulseAsked, performance.now() - PULSE_MS + 250); }

    acknowledge(number) { this.pulseAnswered = Math.max(this.pulseAnswered, number); }

    /** What Dash adds to the map and the ruler: blocked places, chargers out of order, event ticks, levels. */
    extra(data) {
      if (!data || data.run !== this.config.run || !this.map) return;
      if (data.blocked && !this.map.ground) this.map.setBlocked(data.blocked, data.chargers_out || []);
      if (data.events) { this.marks = data.events; this.ruler.stale = true; }
      if (typeof data.t_end === "number") this.end = Math.max(this.end, data.t_end);
    }

    // ---- selection, commands

    select(selection, options = {}) {
      if (selection && selection.kind === "vehicle" && this.map && this.map.n && selection.id >= this.map.n) {
        wl.notify("Not found", `There is no vehicle ${selection.id}.`, "warning");
        return;
      }
      selection = this.panel ? this.panel.placed(selection) : selection;
      this.selection = selection;
      if (this.panel) this.panel.select(selection, options.centre);
      wl.setProps("selection", { data: selection });
      const ids = selection && selection.kind === "vehicle" ? [String(selection.id)] : [];
      if (options.from !== "table") wl.setProps("fleet-grid", { selectedRows: { ids }, ...(ids.length ? { scrollTo: { rowId: ids[0] } } : {}) });
      this._writeAddress();
    }

    toggleFollow() {
      if (this.map.ground && !this.map.follow) this.select({ kind: "vehicle", id: 0 });   // there is only one
      if (!this.selection || this.selection.kind !== "vehicle") {
        wl.notify("Follow", "Select a vehicle first, on the map or in the fleet table.", "info");
        return;
      }
      this.panel.setFollow(!this.map.follow);
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
      wl.notify("Send to…", `Click a ${this.map.network ? "node or lane" : "cell"} for vehicle ${vehicle}; Esc cancels.`, "info");
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
        const label = this.map.cellName(target.place), spot = !this.map.network ? "cell" : this.map.laneAt.has(target.place) ? "lane" : "node";
        add("Centre here", () => this.map.centreOn(target));
        if (this.map.ground) {
          if (live) this._groundMenu(add, target.place, label);
        } else if (live) {
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
          if (this.map.blocked.has(target.place)) add(`Unblock this ${spot}`, () => wl.command({ do: "unblock", place: target.place, label }));
          else add(`Block this ${spot}…`, () => wl.command({ do: "block", place: target.place, label }));
        }
      }
      openMenu(this.map.describe(target), items, x, y);
    }

    /** Another goal, and obstacles: dropped and removed while the robot drives. */
    _groundMenu(add, place, label) {
      add("Send the robot here", () => wl.command({ do: "send", vehicle: 0, place }));
      if (this.map.ground.obstacleAt(place)) { add("Remove the obstacle", () => wl.command({ do: "unblock", place, whole: 1, label })); return; }
      add("Drop an obstacle here, one cell", () => wl.command({ do: "block", place, label }));
      add(`Drop an obstacle here, ${2 * BOULDER_M} m wide`, () => wl.command({ do: "block", place, radius_m: BOULDER_M, label }));
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
      if (!this.map.ground && !is(TO_CHARGER, CHARGING, FAULT) && soc[v] !== FULL_SOC) command("Charge now", "charge");
      if (task === TO_PICK && !is(LOADING)) add("Withdraw its order…", () => this.withdrawOf(v));
      command(...(is(FAULT) ? ["Repair", "repair"] : ["Break down…", "fail"]));
    }

    // ---- the address

    _writeAddress() {
      if (this.gone || !this.map) return;
      const query = new URLSearchParams(location.search);
      query.set("run", this.config.run);
      if (this.follow) query.delete("t"); else query.set("t", String(Math.round(this.time * 100) / 100));
      wl.writeView(query, this.selection, this.map.layers);
      if (this.tab) query.set("tab", this.tab);
      history.replaceState(history.state, "", `${location.pathname}?${query}`);
    }

    _showTab() {
      const tab = new URLSearchParams(location.search).get("tab");
      if (tab && /^[a-z]+$/.test(tab)) wl.setProps("tabs", { value: tab });
    }

    setTab(tab) { this.tab = tab; this.dirty = true; this.pulseSoon(); this._writeAddress(); }

    // ---- what the bars show

    _showStatus(now) {
      const link = this.panel.link_state;
      const mode = link === "down" || link === "connecting" && now - this.begun > 3000 ? "DISCONNECTED"
        : !this.follow ? "REPLAY" : this.sim.paused || this.sim.done ? "PAUSED" : "LIVE";
      this.showStatus(now, mode, this.planner === null ? [] : [`planner p95 ${this.planner.toFixed(1)} ms`]);
    }

    _showTransport() {
      const back = !this.follow && this.config.page === "operate" && this.config.live;
      this.note.hidden = !back;
      if (back) this.note.textContent = `You look ${wl.span(Math.max(0, this.end - this.time))} back. Return to LIVE (End)`;
      if (!this.follow) { this.showTransport(); return; }
      const running = this._goesOn(), { reached, done } = this.sim;
      this.showTransport({ running, mine: false,
        label: running ? "Pause the simulation, for everyone (Space)" : "Continue the simulation, for everyone (Space)",
        reached: running ? `reached ${reached >= 10 ? reached.toFixed(0) : reached.toFixed(2)}×` : done ? "finished" : "paused" });
    }

    // ---- layers, theme

    setLayers(change) {
      this.panel.setLayers(change);
      this._writeAddress();
    }

    toggleLayer(name) { this.setLayers(this.panel.toggled(name)); }

    setTheme() {
      if (!this.map) return;
      this.panel.setTheme();
      this.ruler.stale = true;
      this.dirty = true;
    }

    fit() { this.map.fit(); }

    zoom(factor) { this.map.zoom(factor); }
  }

  // ---- menu

  let menuOpen = null;
  const closeMenu = () => { if (menuOpen) { menuOpen.remove(); menuOpen = null; } };
  /** items: [{label, run}] · x, y: where on the page. */
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
  wl.openMenu = openMenu;
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
