/* Learned time: the network coloured by expected arc times, refresh by refresh, and one request routed by each method. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;
  const COLOURS = ["wl-learn-v4", "wl-learn-v2", "wl-learn-v1", "wl-learn-v0"];
  const SPREAD_PX = 3.5;     // routes over the same arcs lie so far beside each other
  const STEPS_PER_S = 2;

  const seconds = (ms) => `${wl.number(ms / 1000, 1)} s`;
  const metres = (mm) => `${wl.number(mm / 1000, 1)} m`;

  /** The live map's network without a fleet; on top of it what `paint(ctx)` draws. Its base is loaded after this file. */
  const networkMap = () => class extends wl.FleetMap {
    constructor(host, choose, paint) {
      super(host, { select: (target) => choose(target), menu: () => {} });
      this.paint = paint;
      this.canvas.setAttribute("aria-label", "Network with its arcs coloured by expected time. The lists at the left choose start and goal.");
      const tool = (icon, label, act) => el("button", { type: "button", class: "wl-tool", title: label, "aria-label": label, onclick: act },
        el("span", { class: `wl-icon wl-icon-${icon}`, "aria-hidden": "true" }));
      host.append(el("div", { class: "wl-map-tools" }, tool("plus", "Zoom in", () => this.zoom(1.4)),
        tool("minus", "Zoom out", () => this.zoom(1 / 1.4)), tool("fit", "Fit the network", () => this.fit())));
    }

    _drawPaths(ctx) {
      ctx.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
      this.paint(ctx);
      ctx.setTransform(1, 0, 0, 1, 0, 0);
    }
  };

  class LearnedLesson extends wl.Lesson {
    build() {
      const names = Object.keys(this.options.methods);
      this.colour = Object.fromEntries(names.map((name, i) => [name, COLOURS[i]]));
      this.view = el("div", { class: "wl-lesson-map" });
      this.scale = el("div", { class: "wl-heat-scale wl-lesson-scale" });
      this.status = el("p", { class: "wl-lesson-status", role: "status" });
      this.plot = new wl.Plot({ title: "Expected time of each method's route", unit: "s", x: "h", digits: 1, zero: false, pick: (step) => { this.player.pause(); this.player.seek(step); },
        lines: names.map((name, i) => ({ key: name, name, colour: COLOURS[i], dash: name !== "stochastic" })) });
      this.plot.host.classList.add("wl-lesson-below");
      this.stage.replaceChildren(this.status, this.view, this.scale, this.plot.host);
      this.map = new (networkMap())(this.view, (target) => this.clicked(target), (ctx) => this.paint(ctx));
      this.map.setLayers({ heat: "expected", window: 1800 });
      this.player.speed = STEPS_PER_S;
      this.player.pace.value = String(STEPS_PER_S);
      const list = (key, label) => el("select", { class: "wl-select", "aria-label": label, onchange: (event) => this.request({ [key]: event.target.value }) });
      this.lists = { start: list("start", "Start"), goal: list("goal", "Goal") };
      const labelled = (word, field) => el("label", {}, el("span", {}, word), field);
      this.aim = "start";
      this.aims = ["start", "goal"].map((which) => el("button", { type: "button", class: "wl-button small", onclick: () => this.aimAt(which) }, `Click sets the ${which}`));
      this.checks = Object.fromEntries(names.map((name) => [name, el("input", { type: "checkbox", onchange: () => this.showMethods() })]));
      const swatch = (name) => { const mark = el("i", { class: "wl-plot-key", "aria-hidden": "true" }); mark.style.color = `var(--${this.colour[name]})`; return mark; };
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.early("Request", el("div", { class: "wl-lesson-fields" }, labelled("Start", this.lists.start), labelled("Goal", this.lists.goal)),
          el("div", { class: "wl-row" }, ...this.aims),
          el("div", { class: "wl-row" }, el("button", { type: "button", class: "wl-button small", onclick: () => this.request({ start: this.state.goal, goal: this.state.start }) }, "Swap"), this.linkButton())),
        this.group("Routes", el("div", { class: "wl-lesson-checks" }, ...names.map((name) => el("label", {}, this.checks[name], swatch(name), this.options.methods[name])))));
      this.log = el("input", { type: "checkbox", onchange: () => { this.state.scale = this.log.checked ? "log" : ""; this._markExample(); this.show(this.player.step); this.writeSoon(); } });
      this.controls.append(this.group("Colours", el("div", { class: "wl-lesson-checks" }, el("label", {}, this.log, "logarithmic scale"))));
      this.aimAt("start");
    }

    views() { return []; }
    steps() { return this.seconds.length - 1; }
    cleanup() { this.map.destroy(); this.plot.destroy(); }

    question() { return { ...super.question(), have: this.expected ? "1" : "" }; }

    // ---- asking

    request(change) {
      Object.assign(this.state, change);
      this.ask();
    }

    aimAt(which) {
      this.aim = which;
      this.aims.forEach((button, i) => button.setAttribute("aria-pressed", String(["start", "goal"][i] === which)));
    }

    clicked(target) {
      if (!target) return;
      const station = this.map.stationAt.get(target.place);
      if (!station) { this.map._hover(...this.map.placeScreen(target.place)); return; }   // a finger does not hover
      const which = this.aim;
      this.aimAt(which === "start" ? "goal" : "start");
      this.request({ [which]: station.name });
    }

    showMethods() {
      const on = Object.keys(this.checks).filter((name) => this.checks[name].checked);
      this.state.show = on.length === Object.keys(this.checks).length ? "" : on.join(".") || "none";
      this._markExample();
      this.show(this.player.step);
      this.writeSoon();
    }

    // ---- what the server answered

    takeAll(answer) {
      if (answer.floor) this.takeRun(answer);
      this.data = answer;
      const names = this.state.show ? this.state.show.split(".") : Object.keys(this.checks);
      for (const [name, box] of Object.entries(this.checks)) box.checked = names.includes(name);
      for (const [key, select] of Object.entries(this.lists)) select.value = this.state[key];
      this.log.checked = this.state.scale === "log";
      return true;
    }

    /** What doesn't change from request to request: the network, and the run's arc times. */
    takeRun(answer) {
      const [expected, samples, busy] = [answer.expected, answer.samples, answer.busy].map(wl.unpack);
      this.seconds = answer.seconds;
      this.expected = expected;
      const first = answer.floor.nodes.length, places = answer.floor.places.length;
      const spread = (lanes, scale) => { const all = new Array(places).fill(0); if (lanes) lanes.forEach((value, i) => { all[first + i] = value * scale; }); return all; };
      this.arcs = this.seconds.map((_, k) => ({ expected_s: spread(expected[k], 1e-3), passages: spread(samples[k], 1), occupancy: spread(busy[k], 1e-3) }));
      this.ends = [Infinity, 0];
      for (const { expected_s } of this.arcs) for (const value of expected_s) if (value > 0) this.ends = [Math.min(this.ends[0], value), Math.max(this.ends[1], value)];
      this.map.setFloor(answer.floor);
      this.about = answer.about;
      for (const [key, select] of Object.entries(this.lists)) {
        const option = ({ name }) => el("option", { value: name }, name);
        const of = (kind) => answer.floor.stations.filter((station) => station.kind === kind).map(option);
        select.replaceChildren(el("optgroup", { label: "Entrances" }, ...of("entrance")), el("optgroup", { label: "Nodes" }, ...of("rack")));
        select.value = this.state[key];
      }
      this.scale.replaceChildren(el("b", {}, "Expected time of an arc"), el("span", {}, seconds(1000 * this.ends[0])), el("span", { class: "wl-heat-bar" }), el("span", {}, seconds(1000 * this.ends[1])));
    }

    shown() { return this.data.methods.filter(({ name }) => this.checks[name].checked); }

    /** After so many refreshes. */
    show(step) {
      const hours = this.seconds.map((s) => s / 3600), shown = this.shown();
      this.map.setLayers({ log: this.log.checked });
      this.map.setHeat(this.arcs[step].expected_s);
      this.map.heatEnds = this.ends;   // one scale for all refreshes, so that colours can be compared
      this.map.setArcs(step > 0 ? this.arcs[step] : null);
      this.map.setTheme();
      if (this.plotted !== this.data || this.plottedNames !== this.state.show) {
        this.plot.set(hours, Object.fromEntries(shown.map((method) => [method.name, method.expected_ms.map((ms) => ms / 1000)])));
        this.plotted = this.data;
        this.plottedNames = this.state.show;
      }
      this.plot.cursor(step);
      const when = step > 0 ? `after refresh ${step} of ${this.steps()}, ${wl.clock(this.seconds[step])}` : "before the first refresh: every arc is expected to take its own time";
      this.status.replaceChildren(el("b", {}, `${this.state.start} → ${this.state.goal}`), ` ${when}. `,
        `Times of a run of ${this.about.hours} h, ${this.about.vehicles} AGVs, ${this.about.planner}, seed ${this.about.seed}.`);
      this.tell(step);
    }

    tell(step) {
      const best = Math.min(...this.data.methods.map((method) => method.expected_ms[step]));
      const rows = this.data.methods.map((method) => {
        const way = method.ways[method.taken[step]], ms = method.expected_ms[step];
        const dot = el("i", { class: "wl-plot-key", "aria-hidden": "true" });
        dot.style.color = `var(--${this.colour[method.name]})`;
        const more = ms > best ? `+${wl.number((100 * (ms - best)) / best, 0)} %` : "least";
        return el("tr", {}, el("td", {}, dot, method.name), el("td", {}, metres(way.mm)), el("td", {}, wl.number(way.turns, way.turns % 1 ? 1 : 0)), el("td", {}, seconds(ms)), el("td", {}, more));
      });
      const before = step > 0 ? this.data.methods.filter((method) => method.taken[step] !== method.taken[step - 1]).map(({ name }) => name) : [];
      this.now.replaceChildren(el("h2", {}, `${this.state.start} → ${this.state.goal}`),
        el("table", { class: "wl-lesson-table" }, el("thead", {}, el("tr", {}, ...["method", "length", "turns", "time", ""].map((word) => el("th", {}, word)))), el("tbody", {}, ...rows)),
        el("p", { class: "wl-hint" }, step === 0 ? "" : before.length ? `New route since the last refresh: ${before.join(", ")}.` : "No route changed with this refresh."));
    }

    // ---- over the network

    paint(ctx) {
      if (!this.data || !this.seconds) return;
      const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(`--${name}`).trim();
      const shown = this.shown(), { places } = this.map.floor, step = this.player.step;
      ctx.lineJoin = ctx.lineCap = "round";
      shown.forEach((method, j) => {
        const shift = (j - (shown.length - 1) / 2) * SPREAD_PX;
        const trace = () => {
          ctx.beginPath();
          method.ways[method.taken[step]].places.forEach((place, i) => { const [x, y] = this.map.toScreen(...places[place]); ctx[i ? "lineTo" : "moveTo"](x + shift, y + shift); });
          ctx.stroke();
        };
        ctx.strokeStyle = colour("wl-map-aisle");
        ctx.lineWidth = 5;
        trace();
        ctx.strokeStyle = colour(this.colour[method.name]);
        ctx.lineWidth = 3;
        trace();
      });
      const size = Math.max(22, this.map.floor.cell_m * this.map.view.scale * 0.5), ink = colour("wl-learn-mark-text");
      wl.badgeOn(ctx, this.map.placeScreen(this.data.start), size, colour("wl-learn-start"), "S", ink);
      wl.badgeOn(ctx, this.map.placeScreen(this.data.goal), size, colour("wl-learn-goal"), "G", ink, true);
    }
  }

  wl.lessons["learned-time"] = LearnedLesson;
})();
