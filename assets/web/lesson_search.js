/* Search playback: the traces of several searches on one floor, in step. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;

  const SMALL_TEXT = 46;

  class SearchLesson extends wl.Lesson {
    build() {
      this.panels = [];
      this.grid = el("div", { class: "wl-lesson-grid" });
      this.stage.replaceChildren(this.grid);
      this.tool = matchMedia("(pointer: coarse)").matches ? "look" : "draw";
      const number = (label, value, min, max) => el("input", { type: "number", class: "wl-time", "aria-label": label, title: label, value, min, max });
      this.fields = { width: number("Columns", 20, 2, 60), height: number("Rows", 20, 2, 60), density: number("Obstacles in per cent", 20, 0, 35), seed: number("Seed", 1, 0, 999999) };
      const labelled = (word, field) => el("label", {}, el("span", {}, word), field);
      this.add = el("button", { type: "button", class: "wl-button small", onclick: () => this.addPanel() }, "Add a search");
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.group("Floor",
          el("div", { class: "wl-row" }, ...this.toolButtons()),
          el("div", { class: "wl-lesson-fields" }, labelled("Columns", this.fields.width), labelled("Rows", this.fields.height),
            labelled("Obstacles %", this.fields.density), labelled("Seed", this.fields.seed)),
          el("div", { class: "wl-row" },
            el("button", { type: "button", class: "wl-button small", onclick: () => this.random(false) }, "Random floor"),
            el("button", { type: "button", class: "wl-button small", onclick: () => this.random(true) }, "Next seed"),
            el("button", { type: "button", class: "wl-button small", onclick: () => this.clear() }, "Clear")),
          el("p", { class: "wl-hint" }, "Drag over cells to draw or erase, drag S and G to move them. With the keyboard: Tab to a map, arrows, Enter, S, G; Esc gives the arrows back to the steps.")),
        this.group("Searches", el("div", { class: "wl-row" }, this.add, this.linkButton())),
        this.group("Marks", legend()));
      this.setTool(this.tool);
    }

    newPanel(index) { return new Panel(this, index); }
    views() { return this.panels.map((panel) => panel.view); }
    steps() { return Math.max(...this.panels.map((panel) => panel.trace.expanded + 1)); }
    cleanup() { for (const panel of this.panels) panel.view.destroy(); }

    // ---- editing

    specs() { return this.state.panels.split("~"); }

    change(index, text) {
      const specs = this.specs();
      if (text === null) specs.splice(index, 1); else specs[index] = text;
      this.state.panels = specs.join("~");
      this.player.pause();
      this.ask();
    }

    addPanel() {
      if (this.specs().length >= this.options.panels) return;
      this.change(this.specs().length, this.options.first);
    }

    size() {
      const whole = (field) => Math.max(Number(field.min), Math.min(Number(field.max), Math.round(Number(field.value) || 0)));
      for (const field of Object.values(this.fields)) field.value = String(whole(field));
      return [whole(this.fields.width), whole(this.fields.height)];
    }

    /** Start and goal stay where they can; else they go to the corners. */
    ends(width, height) {
      const inside = (text) => { const [x, y] = text.split(".").map(Number); return x < width && y < height; };
      if (!inside(this.state.start)) this.state.start = "0.0";
      if (!inside(this.state.goal)) this.state.goal = `${width - 1}.${height - 1}`;
      if (this.state.start === this.state.goal) { this.state.start = "0.0"; this.state.goal = `${width - 1}.${height - 1}`; }
    }

    random(next) {
      if (next) this.fields.seed.value = String((Number(this.fields.seed.value) || 0) + 1);
      const [width, height] = this.size();
      this.ends(width, height);
      this.state.map = `${width}x${height}r${this.fields.density.value}s${this.fields.seed.value}`;
      this.restart();
    }

    clear() {
      const [width, height] = this.size();
      this.ends(width, height);
      this.state.map = `${width}x${height}`;
      this.restart();
    }

    restart() {
      this.player.pause();
      this.state.step = "0";
      this.player.step = 0;
      this.ask();
    }

    /** What pressing on a cell begins: moving the start or goal, or drawing. */
    press(cell) {
      const floor = this.floor;
      for (const which of ["start", "goal"]) {
        if (cell === this.cell(which)) return (to) => this.moveEnd(which, to);
      }
      if (this.tool !== "draw") return null;
      const value = floor.walls[cell] ? 0 : 1;
      const set = (at) => this.setWall(at, value);
      set(cell);
      return set;
    }

    cell(which) { const [x, y] = this.state[which].split(".").map(Number); return x + y * this.floor.width; }

    setWall(cell, value) {
      if (this.floor.walls[cell] === value || cell === this.cell("start") || cell === this.cell("goal")) return;
      this.floor.walls[cell] = value;
      this.edited();
    }

    moveEnd(which, cell) {
      const other = this.cell(which === "start" ? "goal" : "start");
      if (this.floor.walls[cell] || cell === other || cell === this.cell(which)) return;
      this.state[which] = `${cell % this.floor.width}.${Math.floor(cell / this.floor.width)}`;
      this.edited();
    }

    edited() {
      this.state.map = wl.floorText(this.floor);
      for (const view of this.views()) view.draw();
      this.ask();
    }

    key(cell, key) {
      if (key === "Enter") this.setWall(cell, this.floor.walls[cell] ? 0 : 1);
      else if (key === "s" || key === "S") this.moveEnd("start", cell);
      else if (key === "g" || key === "G") this.moveEnd("goal", cell);
      else return false;
      return true;
    }

    // ---- what the server answered

    take(answer) {
      if (document.activeElement !== this.fields.width) this.fields.width.value = String(answer.width);
      if (document.activeElement !== this.fields.height) this.fields.height.value = String(answer.height);
      const random = /r(\d+)s(\d+)$/.exec(this.state.map);
      if (random) { this.fields.density.value = random[1]; this.fields.seed.value = random[2]; }
      while (this.panels.length > answer.panels.length) { const gone = this.panels.pop(); gone.view.destroy(); gone.host.remove(); }
      while (this.panels.length < answer.panels.length) {
        const panel = this.newPanel(this.panels.length);
        this.panels.push(panel);
        this.grid.append(panel.host);
      }
      this.grid.dataset.panels = String(this.panels.length);
      const solved = answer.panels.filter((trace) => trace.solved).map((trace) => trace.energy_mj);
      this.least = solved.length > 1 ? Math.min(...solved) : null;
      this.panels.forEach((panel, i) => panel.take(answer.panels[i], this.floor));
      this.add.disabled = this.panels.length >= this.options.panels;
      this.setTool(this.tool);
    }

    show(step) {
      for (const panel of this.panels) panel.show(step);
      this.tell();
    }

    hover(cell) {
      this.hovered = cell;
      this.tell();
      for (const panel of this.panels) { if (panel.view.cursor !== cell) panel.view.cursor = cell; panel.view.draw(); }
    }

    /** What is told while no cell is pointed at. */
    idle() {
      return [el("h2", {}, "A cell"), el("p", { class: "wl-hint" }, "Point at a cell of a map: g, h and f of its states, heading, parent and order of expansion in every search.")];
    }

    /** The cell under the pointer in every panel, in words. */
    tell() {
      const cell = this.hovered;
      for (const panel of this.panels) panel.view.hint(this.hintIn === panel ? cell : null, this.hintIn === panel && cell !== null && cell !== undefined ? panel.lines(cell) : null);
      if (cell === null || cell === undefined || !this.floor) {
        this.now.replaceChildren(...this.idle());
        return;
      }
      const x = cell % this.floor.width, y = Math.floor(cell / this.floor.width);
      this.now.replaceChildren(el("h2", {}, `Cell (${x}, ${y})`), ...this.panels.map((panel) => panel.table(cell)));
    }
  }

  function legend() {
    const mark = (kind, text, sign = "") => el("div", { class: "wl-lesson-mark" }, el("span", { class: `wl-lesson-swatch ${kind}` }, sign), text);
    return el("div", { class: "wl-lesson-marks" }, mark("open", "open: waits with its f"), mark("closed", "closed: expanded"), mark("both", "closed; other states of the cell open"),
      mark("path", "path"), mark("now", "expanded last, and its way"), mark("start", "start", "S"), mark("goal", "goal", "G"), mark("wall", "obstacle"));
  }

  /** One search: its choices, its map, its counters. */
  class Panel {
    constructor(lesson, index) {
      this.lesson = lesson;
      this.index = index;
      this.digits = 1;
      this.arrows = lesson.options.arrows;
      const choose = (label, act) => el("select", { class: "wl-select", "aria-label": `${label} of search ${index + 1}`, title: label, onchange: act });
      this.algorithm = choose("Algorithm", () => {
        const [name] = this.spec(), choice = lesson.options.algorithms[this.algorithm.value];
        const old = this.trace.panel.split(".");
        if (name !== this.algorithm.value) this.choose(this.algorithm.value, choice.heuristics.includes(old[1]) ? old[1] : choice.heuristics[0], choice.ties.includes(old[2]) ? old[2] : choice.ties[0]);
      });
      this.heuristic = choose("Heuristic", () => this.choose(this.spec()[0], this.heuristic.value, this.spec()[2]));
      this.tie = choose("Tie rule", () => this.choose(this.spec()[0], this.spec()[1], this.tie.value));
      this.seed = el("input", { type: "number", min: 0, max: 999, class: "wl-time", "aria-label": `Seed of the random ties of search ${index + 1}`, title: "Seed of the random ties", onchange: () => this.choose(this.spec()[0], this.spec()[1], "random") });
      this.remove = el("button", { type: "button", class: "wl-tool", "aria-label": `Remove search ${index + 1}`, title: "Remove", onclick: () => lesson.change(lesson.panels.indexOf(this), null) }, "×");
      this.view = new wl.FloorView(`Floor of search ${index + 1}: arrows move a cursor, Enter sets an obstacle, S the start, G the goal`, {
        cells: (ctx, g, colours) => this.cells(ctx, g, colours),
        paint: (ctx, g, colours) => this.paint(ctx, g, colours),
        hover: (cell) => { lesson.hintIn = this; lesson.hover(cell); },
        press: (cell) => lesson.press(cell),
        key: (cell, key) => lesson.key(cell, key),
        home: () => lesson.cell("start"),
      });
      this.counts = el("div", { class: "wl-lesson-counts" });
      this.host = el("section", { class: "wl-lesson-panel", "aria-label": `Search ${index + 1}` },
        el("header", {}, this.algorithm, this.heuristic, this.tie, this.seed, this.remove), this.view.host, this.counts);
    }

    spec() {
      const [algorithm, heuristic, tie] = this.trace.panel.split(".");
      return [algorithm, heuristic, tie.startsWith("random") ? "random" : tie, Number(tie.replace("random", "")) || 0];
    }

    choose(algorithm, heuristic, tie) {
      const seed = tie === "random" ? String(Math.max(0, Math.min(999, Number(this.seed.value) || 0))) : "";
      this.lesson.change(this.lesson.panels.indexOf(this), `${algorithm}.${heuristic}.${tie}${seed}`);
    }

    take(trace, floor) {
      this.trace = trace;
      this.rows = wl.unpack(trace.rows);
      this.entries = wl.unpack(trace.entries);
      this.path = wl.unpack(trace.path);
      const digits = (value) => (value % 1000 ? this.digits : 0);
      this.unit = trace.unit === "J" ? (value) => wl.joules(value) : (value) => `${wl.number(value / 1000, digits(value))} ${trace.unit}`;
      this.bare = trace.unit === "J" ? (value) => wl.number(Math.round(value / 1000)) : (value) => wl.number(value / 1000, digits(value));
      this.ofCell = new Map();
      this.entries.cell.forEach((cell, i) => { if (!this.ofCell.has(cell)) this.ofCell.set(cell, []); this.ofCell.get(cell).push(i); });
      const { options } = this.lesson, [algorithm, heuristic, tie, seed] = this.spec(), choice = options.algorithms[algorithm];
      const fill = (select, names, words, value) => select.replaceChildren(...names.map((name) => el("option", { value: name, selected: name === value }, words(name))));
      fill(this.algorithm, Object.keys(options.algorithms), (name) => options.algorithms[name].word, algorithm);
      fill(this.heuristic, choice.heuristics, (name) => options.heuristics[name], heuristic);
      fill(this.tie, choice.ties, (name) => options.ties[name], tie);
      this.seed.hidden = tie !== "random";
      this.seed.value = String(seed);
      this.remove.disabled = this.lesson.specs().length < 2;
      this.floor = floor;
      this.view.floor = floor;
    }

    /** Cells with what is open and closed after some expansions. */
    show(step) {
      const { entries, trace } = this;
      this.done = Math.min(step, trace.expanded);
      this.ended = step > trace.expanded;
      const size = this.floor.width * this.floor.height;
      this.closed = new Uint8Array(size);
      this.open = new Uint8Array(size);
      this.best = new Int32Array(size).fill(-1);
      this.opened = 0;
      for (let i = 0; i < entries.at.length && entries.at[i] < this.done; i++) {
        const cell = entries.cell[i], state = this.stateOf(i);
        if (state === "closed") this.closed[cell] = 1;
        else if (state === "open") { this.open[cell] = 1; this.opened++; } else continue;
        const best = this.best[cell];
        if (best < 0 || this.f(i) < this.f(best) || (this.f(i) === this.f(best) && entries.g[i] > entries.g[best])) this.best[cell] = i;
      }
      this.view.draw();
      this.count();
    }

    f(i) { return this.entries.g[i] + this.entries.h[i]; }

    stateOf(i) {
      const { at, until, row } = this.entries;
      if (at[i] >= this.done) return "";
      if (row[i] >= 0 && row[i] < this.done) return "closed";
      return until[i] < 0 || until[i] >= this.done ? "open" : "";
    }

    /** The way to the expansion shown last, as cells from the start. */
    way() {
      if (this.ended && this.trace.solved) return [...this.path.cell];
      const cells = [];
      for (let i = this.done - 1; i >= 0; i = this.rows.by[i]) cells.push(this.rows.cell[i]);
      return cells.reverse();
    }

    cells(ctx, g, colours) {
      if (!this.best || this.best.length !== g.width * g.height) return;
      for (let cell = 0; cell < this.best.length; cell++) {
        if (this.best[cell] < 0) continue;
        ctx.fillStyle = this.closed[cell] ? colours.closed : colours.open;
        ctx.fillRect(g.left(cell), g.top(cell), g.size, g.size);
        if (g.size < 7) continue;
        if (!this.closed[cell]) {
          ctx.strokeStyle = colours["open-edge"];
          ctx.lineWidth = g.size > 20 ? 2 : 1;
          ctx.strokeRect(g.left(cell) + 1.5, g.top(cell) + 1.5, g.size - 3, g.size - 3);
        } else if (this.open[cell]) {
          const corner = Math.min(14, g.size * 0.38), right = g.left(cell) + g.size, top = g.top(cell);
          ctx.fillStyle = colours["open-edge"];
          ctx.beginPath();
          ctx.moveTo(right, top);
          ctx.lineTo(right, top + corner);
          ctx.lineTo(right - corner, top);
          ctx.fill();
        }
      }
    }

    paint(ctx, g, colours) {
      if (!this.best || this.best.length !== g.width * g.height) return;
      const way = this.way(), solved = this.ended && this.trace.solved;
      const stroke = (colour, wide) => {
        ctx.strokeStyle = colour;
        ctx.lineWidth = wide;
        ctx.lineJoin = ctx.lineCap = "round";
        ctx.beginPath();
        way.forEach((cell, i) => ctx[i ? "lineTo" : "moveTo"](...g.middle(cell)));
        ctx.stroke();
      };
      if (solved) { stroke(colours["path-edge"], Math.max(4, Math.min(16, g.size * 0.36))); stroke(colours.path, Math.max(2.5, Math.min(11, g.size * 0.24))); } else if (way.length > 1) stroke(colours.chain, Math.max(1.5, Math.min(5, g.size * 0.09)));
      if (this.done > 0 && !solved) {
        const cell = this.rows.cell[this.done - 1];
        ctx.strokeStyle = colours.now;
        ctx.lineWidth = Math.max(2, Math.min(4, g.size * 0.1));
        ctx.strokeRect(g.left(cell) + 2, g.top(cell) + 2, g.size - 4, g.size - 4);
      }
      wl.badgeOn(ctx, g.middle(this.lesson.cell("start")), g.size, colours.start, "S", colours["mark-text"]);
      wl.badgeOn(ctx, g.middle(this.lesson.cell("goal")), g.size, colours.goal, "G", colours["mark-text"], true);
      if (g.size >= SMALL_TEXT) this.numbers(ctx, g, colours);
    }

    /** f large, g and h small, where cells are large enough. */
    numbers(ctx, g, colours) {
      ctx.fillStyle = colours.text;
      ctx.textBaseline = "alphabetic";
      const small = Math.max(10, Math.min(13, g.size / 6.5)), large = Math.max(11, Math.min(17, g.size / 4.5));
      for (let cell = 0; cell < this.best.length; cell++) {
        const i = this.best[cell];
        if (i < 0) continue;
        const left = g.left(cell) + 4, right = g.left(cell) + g.size - 4, low = g.top(cell) + g.size - 5;
        ctx.font = `700 ${large}px system-ui, sans-serif`;
        ctx.textAlign = "left";
        ctx.fillText(this.bare(this.f(i)), left, g.top(cell) + large + 1);
        ctx.font = `${small}px system-ui, sans-serif`;
        ctx.fillText(`g ${this.bare(this.entries.g[i])}`, left, low);
        ctx.textAlign = "right";
        if (g.size >= 80) ctx.fillText(`h ${this.bare(this.entries.h[i])}`, right, low);
      }
    }

    count() {
      const { trace, done } = this, last = done - 1;
      const mark = this.ended && trace.solved ? this.mark() : null;
      this.counts.dataset.done = String(done);
      this.counts.dataset.open = String(this.opened);
      this.counts.replaceChildren(
        el("dl", {}, this.item(`${wl.number(done)} / ${wl.number(trace.expanded)}`, "expanded"), this.item(wl.number(this.opened), "open"), ...this.totals(last)),
        el("p", { class: this.ended ? "wl-lesson-end" : "wl-hint" }, ...(this.ended ? [mark || "", mark ? " " : "", trace.status] : [ last >= 0 ? this.step(last) : "The start is open. Step on."])));
    }

    item(value, word) { return el("div", {}, el("dd", {}, value), " ", el("dt", {}, word)); }

    /** What the way to the expansion shown last takes, or the way found. */
    totals(last) {
      const { trace, rows } = this, solved = this.ended && trace.solved;
      const metres = solved ? trace.length : last >= 0 ? rows.steps[last] : 0;
      const turns = solved ? trace.turns : last >= 0 ? rows.turns[last] : 0;
      const energy = solved ? trace.energy_mj : last >= 0 ? rows.energy[last] : 0;
      return [this.item(wl.number(metres), "m"), this.item(wl.number(turns), turns === 1 ? "turn" : "turns"), this.item(wl.number(energy / 1000, 1), "J")];
    }

    /** How good the way found is among those of the other searches. */
    mark() {
      if (!this.lesson.least) return null;
      const more = this.trace.energy_mj / this.lesson.least - 1;
      return more < 0.00005 ? el("span", { class: "wl-badge ok" }, "least energy") : el("span", { class: "wl-badge warn" }, `+${wl.number(100 * more, 1)} %`);
    }

    /** An expansion in words. */
    step(i) {
      const { rows } = this, x = rows.cell[i] % this.floor.width, y = Math.floor(rows.cell[i] / this.floor.width);
      return `#${i + 1}: (${x}, ${y})${rows.heading[i] >= 0 ? ` ${this.arrows[rows.heading[i]]}` : ""}  f ${this.unit(rows.g[i] + rows.h[i])} = g ${this.bare(rows.g[i])} + h ${this.bare(rows.h[i])}`;
    }

    /** The states of a cell, the best first. */
    states(cell) {
      const known = (this.ofCell.get(cell) || []).filter((i) => this.stateOf(i));
      return known.sort((a, b) => this.f(a) - this.f(b) || this.entries.g[b] - this.entries.g[a]);
    }

    parent(i) {
      const by = this.entries.at[i];
      return by < 0 ? "–" : `(${this.rows.cell[by] % this.floor.width}, ${Math.floor(this.rows.cell[by] / this.floor.width)}) #${by + 1}`;
    }

    lines(cell) {
      const states = this.states(cell);
      if (!states.length) return null;
      const i = states[0], { g, h, heading, row } = this.entries;
      const when = this.stateOf(i) === "closed" ? `closed as #${row[i] + 1}` : "open";
      return [`f ${this.unit(this.f(i))} = g ${this.bare(g[i])} + h ${this.bare(h[i])}`,
        `${heading[i] >= 0 ? `heading ${this.lesson.options.headings[heading[i]]}, ` : ""}${when}${states.length > 1 ? `; ${states.length} states` : ""}`];
    }

    table(cell) {
      const title = `${this.algorithm.selectedOptions[0].textContent}, ${this.lesson.options.heuristics[this.spec()[1]]}`;
      const states = this.states(cell);
      if (this.floor.walls[cell]) return el("p", { class: "wl-hint" }, `${title}: an obstacle.`);
      if (!states.length) return el("p", { class: "wl-hint" }, `${title}: not reached yet.`);
      const { g, h, heading, row } = this.entries, cellOf = (text) => el("td", {}, text);
      const body = states.slice(0, 9).map((i) => el("tr", {}, cellOf(heading[i] >= 0 ? this.arrows[heading[i]] : "·"), cellOf(this.bare(g[i])), cellOf(this.bare(h[i])), cellOf(this.bare(this.f(i))),
        cellOf(this.stateOf(i) === "closed" ? `#${row[i] + 1}` : "open"), cellOf(this.parent(i))));
      return el("figure", {}, el("figcaption", {}, `${title} [${this.trace.unit}]`),
        el("table", { class: "wl-lesson-table" }, el("thead", {}, el("tr", {}, ...["", "g", "h", "f", "order", "parent"].map((word) => el("th", {}, word)))), el("tbody", {}, ...body)));
    }
  }

  Object.assign(wl, { SearchLesson, SearchPanel: Panel });
  wl.lessons.search = SearchLesson;
})();
