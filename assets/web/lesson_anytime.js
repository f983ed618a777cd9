/* Anytime and repair: the passes of AD* over a terrain that people shape, and what each change touches. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el, svg } = wl;

  const FRESH = 1, BEFORE = 2, OPEN = 4, INCONS = 8, COUNTED = 16;
  const DRIVE = 8, LONGEST = 1900, CONTOURS = 12;
  const TOOLS = { r: ["Raise", "Drag over the ground to raise a hill"], l: ["Lower", "Drag over the ground to lower it"],
    o: ["Obstacle", "Drag over cells to drop obstacles"], x: ["Remove", "Drag over obstacles to remove them"], look: ["Look only", "Drag scrolls; tap a cell to read its values"] };
  const HAPPENED = { r: "ground raised", l: "ground lowered", o: "obstacles dropped", x: "obstacles removed" };

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--wl-anytime-${name}`).trim();
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const count = (value, word) => `${wl.number(value)} ${word}${value === 1 ? "" : "s"}`;
  const epsilon = (value) => `ε = ${wl.number(value, value % 0.1 > 1e-9 && value % 0.1 < 0.1 - 1e-9 ? 2 : 1)}`;
  /** Times the least, without rounding a small excess away. */
  const ratio = (value) => (value > 1 && value < 1.0005 ? "above 1.000" : wl.number(value, 3));

  class AnytimeLesson extends wl.DrawnLesson {
    build() {
      this.status = el("p", { class: "wl-lesson-status wl-anytime-status", role: "status" });
      this.traits = el("div", { class: "wl-lesson-limits", role: "alert", hidden: true });
      this.counts = el("div", { class: "wl-lesson-counts wl-anytime-counts" });
      this.view = new wl.FloorView("Ground with the search: arrows move a cursor, Enter uses the tool, S sets the start, G the goal", {
        cells: (ctx, g, colours) => this.cells(ctx, g, colours),
        paint: (ctx, g, colours) => this.paint(ctx, g, colours),
        hover: (cell) => { this.view.draw(); this.view.hint(cell, cell === null ? null : this.lines(cell)); },
        press: (cell) => this.press(cell),
        drop: () => { this.stroke = null; },
        key: (cell, key) => this.key(cell, key),
        home: () => this.cell("start"),
      });
      this.stage.replaceChildren(this.traits, this.status, el("div", { class: "wl-lesson-grid", dataset: { panels: "1" } },
        el("div", { class: "wl-lesson-panel" }, this.view.host, this.counts)));
      this.tool = matchMedia("(pointer: coarse)").matches ? "look" : "r";
      this.sizes = { r: 4, l: 4, o: 1, x: 2 };
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.early("ε", this.buildSlider()),
        this.early("Change the ground", ...this.buildTools()),
        this.group("Planner", ...this.buildPlanner()),
        this.group("Ground", ...this.buildGround()),
        this.group("Marks", legend()));
      this.setTool(this.tool);
    }

    /** The passes of the phase that is shown, from the first ε down. */
    buildSlider() {
      this.shownEpsilon = el("output", {}, "");
      const seek = () => { if (this.at) { this.player.pause(); this.player.seek(this.endOf(this.at.phase, Number(this.slider.value))); } };
      this.slider = el("input", { type: "range", min: 0, max: 0, step: 1, value: 0, class: "wl-lesson-scrub", "aria-label": "ε of the pass that is shown", oninput: seek, onclick: seek });
      this.ends = el("div", { class: "wl-anytime-ends", "aria-hidden": "true" });
      return el("label", { class: "wl-lesson-slider" }, el("span", {}, "Pass with"), this.shownEpsilon, this.slider, this.ends);
    }

    buildTools() {
      const buttons = Object.entries(TOOLS).map(([tool, [word, title]]) => el("button", { type: "button", class: "wl-button small", title, dataset: { tool }, onclick: () => this.setTool(tool) }, word));
      this.brush = el("input", { type: "range", min: 0, max: 8, step: 1, class: "wl-lesson-scrub", "aria-label": "Radius of the brush in cells", oninput: () => this.setBrush() });
      this.shownBrush = el("output", {}, "");
      this.setTool = (tool) => {
        this.tool = tool;
        for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
        this.view.canvas.style.touchAction = tool === "look" ? "pan-y" : "none";
        this.brush.disabled = tool === "look";
        if (tool !== "look") { this.brush.value = String(this.sizes[tool]); this.setBrush(); }
      };
      const act = (word, title, what) => el("button", { type: "button", class: "wl-button small", title, onclick: what }, word);
      this.list = el("ol", { class: "wl-anytime-changes" });
      this.back = act("Take back", "The last change", () => this.setChanges(this.changes().slice(0, -1)));
      this.wipe = act("Clear", "All changes", () => this.setChanges([]));
      this.drive = act("Drive on", `The robot drives ${DRIVE} trajectories along its way`, () => this.happen({ kind: "d", size: DRIVE, cells: [] }));
      return [el("div", { class: "wl-row" }, ...buttons), el("label", { class: "wl-lesson-slider" }, el("span", {}, "Brush, radius in cells"), this.shownBrush, this.brush),
        el("div", { class: "wl-row" }, this.drive, this.back, this.wipe), this.list,
        el("p", { class: "wl-hint" }, "What you change happens after the pass that is shown. Drag S and G to move the ends. With the keyboard: Tab to the ground, arrows, Enter, S, G; Esc gives the arrows back to the steps.")];
    }

    setBrush() {
      this.sizes[this.tool] = Number(this.brush.value);
      this.shownBrush.textContent = this.brush.value;
    }

    buildPlanner() {
      const field = (key, label, low, high, step) => el("input", { type: "number", class: "wl-time", "aria-label": label, min: low, max: high, step, onchange: (event) => this.set(key, event.target.value) });
      const check = (key, label) => el("input", { type: "checkbox", "aria-label": label, onchange: (event) => this.set(key, event.target.checked ? "1" : "") });
      const labelled = (word, control) => el("label", {}, el("span", {}, word), control);
      this.fields = { epsilon: field("epsilon", "First ε", 1, 10, 0.5), lower: field("lower", "ε is lowered by", 0.05, 5, 0.05), share: field("share", "Anew above so many per cent", 0, 100, 5) };
      this.checks = { raised: check("raised", "Raise ε again after a change"), anew: check("anew", "Anew on every change, as printed"), printed: check("printed", "Height sign of h as printed") };
      this.objective = el("select", { class: "wl-select", "aria-label": "Least", onchange: () => this.set("objective", this.objective.value) }, ...["energy", "distance"].map((name) => el("option", { value: name }, name)));
      return [el("div", { class: "wl-lesson-fields" }, labelled("Least", this.objective), labelled("First ε", this.fields.epsilon), labelled("ε lowered by", this.fields.lower), labelled("Anew above %", this.fields.share)),
        el("div", { class: "wl-lesson-checks" }, el("label", {}, this.checks.raised, "raise ε again after a change")),
        el("h2", {}, "As the paper prints it"),
        el("div", { class: "wl-lesson-checks" }, el("label", {}, this.checks.anew, "anew on every change"), el("label", {}, this.checks.printed, "height sign of h"))];
    }

    buildGround() {
      this.classOf = el("select", { class: "wl-select", "aria-label": "Class of ground", onchange: () => this.newGround() }, ...Object.entries(this.options.relief).map(([name, word]) => el("option", { value: name }, word)));
      const number = (label, low, high) => el("input", { type: "number", class: "wl-time", "aria-label": label, min: low, max: high, onchange: () => this.newGround() });
      this.ground = { columns: number("Columns", 20, 60), rows: number("Rows", 20, 60), seed: number("Seed of the ground", 0, 999999) };
      const labelled = (word, control) => el("label", {}, el("span", {}, word), control);
      return [el("div", { class: "wl-lesson-fields" }, labelled("Class", this.classOf), labelled("Seed", this.ground.seed), labelled("Columns", this.ground.columns), labelled("Rows", this.ground.rows)),
        el("div", { class: "wl-row" }, el("button", { type: "button", class: "wl-button small", onclick: () => { this.ground.seed.value = String(Number(this.ground.seed.value) + 1); this.newGround(); } }, "Next seed"), this.linkButton())];
    }

    views() { return [this.view]; }
    steps() { return this.moments.length - 1; }
    cleanup() { this.view.destroy(); }

    // ---- what is asked for

    changes() { return this.state.changes ? this.state.changes.split("~") : []; }

    /** Changes one thing of the state; the same pass is shown again. */
    set(key, value) {
      this.state[key] = value;
      this.player.pause();
      this.follow = this.at ? [this.at.phase, Math.max(0, this.at.pass)] : null;
      this.ask();
    }

    setChanges(changes) {
      this.stroke = null;
      this.set("changes", changes.join("~"));
      this.back.disabled = this.wipe.disabled = !changes.length;
      this.follow = [changes.length, 0];
    }

    /** Adds something that happens after the pass that is shown, and shows what it touches. */
    happen({ kind, size, cells }) {
      const changes = this.changes();
      if (changes.length >= this.options.changes) { this.say(`At most ${this.options.changes} changes: take one back, or clear them.`); return null; }
      const last = this.at && this.at.phase === this.data.phases.length - 1 && this.at.pass >= 0 ? this.data.phases[this.at.phase].passes[this.at.pass].epsilon : 1;
      const stroke = { kind, size, cells, after: last > 1 ? `e${Math.round(1000 * last)}` : "", index: changes.length };
      return this.put(stroke) ? stroke : null;
    }

    put(stroke) {
      const changes = this.changes(), w = this.floor.width;
      changes[stroke.index] = stroke.kind === "d" ? `d${stroke.size}${stroke.after}`
        : `${stroke.kind}${stroke.size}${stroke.after}_${stroke.cells.map((cell) => `${cell % w}.${Math.floor(cell / w)}`).join("-")}`;
      if (changes.join("~").length > LONGEST || stroke.cells.length > this.options.dabs) { this.say("An address holds no more: begin another change, or take some back."); return false; }
      this.setChanges(changes);
      return true;
    }

    newGround() {
      const { columns, rows, seed } = this.ground;
      for (const field of Object.values(this.ground)) field.value = String(Math.max(Number(field.min), Math.min(Number(field.max), Math.round(Number(field.value) || 0))));
      const inside = (text) => { const [x, y] = text.split(".").map(Number); return x < Number(columns.value) && y < Number(rows.value); };
      if (!inside(this.state.start) || !inside(this.state.goal)) Object.assign(this.state, { start: "4.4", goal: `${columns.value - 5}.${rows.value - 5}` });
      this.state.changes = "";
      this.set("ground", `${this.classOf.value}${columns.value}x${rows.value}s${seed.value}`);
      this.follow = [0, 0];
    }

    // ---- the ground under the pointer

    press(cell) {
      for (const which of ["start", "goal"]) if (cell === this.cell(which)) return (to) => this.moveEnd(which, to);
      if (this.tool === "look" || !this.data) return null;
      let stroke = this.happen({ kind: this.tool, size: this.sizes[this.tool], cells: [cell] });
      if (!stroke) return null;
      this.stroke = stroke;
      const w = this.floor.width, apart = Math.max(1, stroke.size * 0.75);
      return (to) => {
        const last = stroke && stroke.cells[stroke.cells.length - 1];
        if (!stroke || Math.hypot(to % w - last % w, Math.floor(to / w) - Math.floor(last / w)) < apart) return;
        const longer = { ...stroke, cells: [...stroke.cells, to] };
        stroke = this.put(longer) ? longer : null;
        this.stroke = stroke;
      };
    }

    edited() {
      this.view.draw();
      this.set("ground", this.state.ground);
    }

    key(cell, key) {
      if (key === "Enter" && this.tool !== "look") this.happen({ kind: this.tool, size: this.sizes[this.tool], cells: [cell] });
      else if (key === "s" || key === "S") this.moveEnd("start", cell);
      else if (key === "g" || key === "G") this.moveEnd("goal", cell);
      else return false;
      return true;
    }

    // ---- what the server answered

    takeAll(answer) {
      this.data = answer;
      const size = answer.width * answer.height;
      this.moments = [];
      answer.phases.forEach((phase, number) => {
        phase.bits = bytes(phase.frames);
        phase.counts = wl.unpack(phase.columns);
        phase.height = new Int16Array(bytes(phase.heights).buffer);
        phase.closed = Uint8Array.from(phase.shut, Number);
        phase.first = this.moments.length;
        for (let frame = 0; frame < phase.bits.length / size; frame++) this.moments.push({ phase: number, frame });
      });
      this.floor = { width: answer.width, height: answer.height, walls: Uint8Array.from(answer.phases[0].walls, Number), plain: true };
      this.view.floor = this.floor;
      this.traits.replaceChildren(...answer.traits.map((sentence) => el("p", {}, sentence)));
      this.traits.hidden = !answer.traits.length;
      if (this.follow) {
        this.state.step = String(this.endOf(...this.follow));
        if (!this.again) this.follow = null;
      }
      this.sync();
      return true;
    }

    /** Controls as the state is. */
    sync() {
      const { state } = this, quiet = (field, value) => { if (document.activeElement !== field) field.value = value; };
      const [, relief, columns, rows, seed] = /^([a-z]+)(\d+)x(\d+)s(\d+)$/.exec(state.ground);
      this.classOf.value = relief;
      Object.entries({ columns, rows, seed }).forEach(([key, value]) => quiet(this.ground[key], value));
      this.objective.value = state.objective || "energy";
      quiet(this.fields.epsilon, state.epsilon || "2.5");
      quiet(this.fields.lower, state.lower || "0.25");
      quiet(this.fields.share, state.share || "50");
      for (const [key, box] of Object.entries(this.checks)) box.checked = state[key] === "1";
      this.listChanges();
    }

    listChanges() {
      const changes = this.data.phases.slice(1).map(({ change }) => change);
      this.list.replaceChildren(...changes.map(({ kind, cells, after, size }, i) => {
        const what = kind === "d" ? `${count(size, "trajectory").replace("trajectorys", "trajectories")} driven` : `${HAPPENED[kind]} at (${cells[0].join(", ")})`;
        return el("li", {}, el("button", { type: "button", class: "wl-anytime-jump", onclick: () => { this.player.pause(); this.player.seek(this.endOf(i + 1, 0)); } }, `${what}, ${epsilon(after / 1000)}`),
          el("button", { type: "button", class: "wl-tool", title: `Remove change ${i + 1}`, "aria-label": `Remove change ${i + 1}`, onclick: () => this.setChanges(this.changes().filter((_, j) => j !== i)) }, "×"));
      }));
      this.back.disabled = this.wipe.disabled = !changes.length;
    }

    /** The step at which a pass of a phase has published its way. */
    endOf(number, pass) {
      const phase = this.data.phases[Math.min(number, this.data.phases.length - 1)];
      return phase.first + phase.passes[Math.min(pass, phase.passes.length - 1)].frame;
    }

    show(step) {
      const { phase: number, frame } = this.moments[step], phase = this.data.phases[number], column = (name) => phase.counts[name][frame];
      const pass = column("pass");
      // what is published: the way of this pass once it is done, until then that of the one before
      let published = -1;
      phase.passes.forEach((each, i) => { if (each.frame <= frame) published = i; });
      this.at = { phase: number, frame, pass, published, done: published === pass, expanded: column("expanded"), open: column("open"), incons: column("incons") };
      this.floor.walls = Uint8Array.from(phase.walls, Number);
      this.slider.max = String(phase.passes.length - 1);
      this.slider.value = String(Math.max(0, pass));
      const value = phase.passes[Math.max(0, pass)].epsilon;
      this.shownEpsilon.textContent = epsilon(value);
      this.slider.setAttribute("aria-valuetext", epsilon(value));
      this.ends.replaceChildren(...phase.passes.map((each) => el("span", {}, wl.number(each.epsilon, 2).replace(/0$/, ""))));
      this.drive.disabled = !phase.passes[phase.passes.length - 1].found;
      this.view.draw();
      if (this.view.cursor !== null) this.view.hint(this.view.cursor, this.lines(this.view.cursor));
      this.tell();
    }

    // ---- the picture

    bitsAt() {
      const size = this.floor.width * this.floor.height, { phase, frame } = this.at;
      return this.data.phases[phase].bits.subarray(frame * size, (frame + 1) * size);
    }

    /** Relief of a phase's ground, one pixel per cell, and its contours. */
    relief(phase) {
      const dark = document.documentElement.dataset.mantineColorScheme === "dark";
      if (phase.relief && phase.relief.dark === dark) return phase.relief;
      const { width, height } = this.floor, { shaded, contours, interval } = wl.terrain, metres = Float32Array.from(phase.height, (mm) => mm / 1000);
      const [low, top] = metres.reduce(([a, b], h) => [Math.min(a, h), Math.max(b, h)], [Infinity, -Infinity]);
      const pixels = shaded(metres, width, height, this.data.cell_m, [low, top], Object.fromEntries(["low", "mid", "high"].map((name) => [name, colour(name)])));
      const step = interval(top - low, CONTOURS), canvas = el("canvas", { width, height }), ctx = canvas.getContext("2d"), image = ctx.createImageData(width, height);
      for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
        const to = 4 * ((height - 1 - y) * width + x), from = 3 * (y * width + x);
        image.data.set([pixels[from], pixels[from + 1], pixels[from + 2], 255], to);
      }
      ctx.putImageData(image, 0, 0);
      phase.relief = { dark, canvas, lines: contours(metres.map((h) => h - low - step / 2), width, height, 1, step).ends };
      return phase.relief;
    }

    cells(ctx, g, colours) {
      if (!this.at) return;
      const phase = this.data.phases[this.at.phase], bits = this.bitsAt(), { canvas, lines } = this.relief(phase);
      ctx.drawImage(canvas, g.x0, g.y0, g.size * g.width, g.size * g.height);
      ctx.strokeStyle = colour("contour");
      ctx.lineWidth = 1;
      ctx.beginPath();
      for (let i = 0; i < lines.length; i += 4) {
        ctx.moveTo(g.x0 + lines[i] * g.size, g.y0 + (g.height - lines[i + 1]) * g.size);
        ctx.lineTo(g.x0 + lines[i + 2] * g.size, g.y0 + (g.height - lines[i + 3]) * g.size);
      }
      ctx.stroke();
      const fresh = colour("fresh"), before = colour("before"), later = colour("incons");
      for (let cell = 0; cell < bits.length; cell++) {
        if (phase.closed[cell]) { ctx.globalAlpha = 0.4; ctx.fillStyle = colours.wall; ctx.fillRect(g.left(cell), g.top(cell), g.size, g.size); }
        if (bits[cell] & FRESH) { ctx.globalAlpha = 0.38 + (0.4 * (bits[cell] >> 4)) / 15; ctx.fillStyle = fresh; } else if (bits[cell] & BEFORE) { ctx.globalAlpha = 0.42; ctx.fillStyle = before; } else continue;
        ctx.fillRect(g.left(cell), g.top(cell), g.size, g.size);
      }
      ctx.globalAlpha = 1;
      for (let cell = 0; cell < bits.length; cell++) if (bits[cell] & (OPEN | INCONS)) this.waiting(ctx, g, cell, bits[cell], colours, later);
      this.outline(ctx, g, phase.touched, colour("changed"));
    }

    /** A square for OPEN, only a corner where other states of the cell have been expanded; a cross for INCONS. */
    waiting(ctx, g, cell, bits, colours, later) {
      const left = g.left(cell), top = g.top(cell), inset = g.size * 0.28, small = g.size - 2 * inset;
      if (bits & OPEN && bits & (FRESH | BEFORE)) {
        const corner = Math.max(2.5, g.size * 0.3);
        ctx.fillStyle = colours["open-edge"];
        ctx.beginPath();
        ctx.moveTo(left + g.size, top);
        ctx.lineTo(left + g.size, top + corner);
        ctx.lineTo(left + g.size - corner, top);
        ctx.fill();
      } else if (bits & OPEN) {
        ctx.fillStyle = colours.open;
        ctx.fillRect(left + inset, top + inset, small, small);
        ctx.strokeStyle = colours["open-edge"];
        ctx.lineWidth = 1;
        ctx.strokeRect(left + inset, top + inset, small, small);
      }
      if (!(bits & INCONS)) return;
      const out = g.size * 0.2;
      ctx.strokeStyle = later;
      ctx.lineWidth = Math.max(1.2, g.size * 0.15);
      ctx.beginPath();
      ctx.moveTo(left + out, top + out);
      ctx.lineTo(left + g.size - out, top + g.size - out);
      ctx.moveTo(left + g.size - out, top + out);
      ctx.lineTo(left + out, top + g.size - out);
      ctx.stroke();
    }

    /** A dashed line around cells. */
    outline(ctx, g, cells, colour) {
      if (!cells.length) return;
      const inside = new Set(cells);
      ctx.strokeStyle = colour;
      ctx.lineWidth = 2;
      ctx.setLineDash([5, 3]);
      ctx.beginPath();
      for (const cell of cells) {
        const x = cell % g.width, left = g.left(cell), top = g.top(cell), right = left + g.size, low = top + g.size;
        if (x === 0 || !inside.has(cell - 1)) { ctx.moveTo(left, top); ctx.lineTo(left, low); }
        if (x === g.width - 1 || !inside.has(cell + 1)) { ctx.moveTo(right, top); ctx.lineTo(right, low); }
        if (!inside.has(cell + g.width)) { ctx.moveTo(left, top); ctx.lineTo(right, top); }
        if (!inside.has(cell - g.width)) { ctx.moveTo(left, low); ctx.lineTo(right, low); }
      }
      ctx.stroke();
      ctx.setLineDash([]);
    }

    /** The way that holds at the moment, and whether it is that of before a change. */
    way() {
      const { phase, published } = this.at;
      if (published >= 0) return [this.data.phases[phase].passes[published], false];
      if (phase === 0) return [null, false];
      const { passes } = this.data.phases[phase - 1];
      return [passes[passes.length - 1], true];
    }

    paint(ctx, g, colours) {
      if (!this.at) return;
      const phase = this.data.phases[this.at.phase], [way, old] = this.way(), wide = Math.max(2.5, Math.min(6, g.size * 0.34));
      const point = ([x, y]) => [g.x0 + (x + 0.5) * g.size, g.y0 + (g.height - 0.5 - y) * g.size];
      const stroke = (points, colour, width, dash = []) => {
        ctx.strokeStyle = colour;
        ctx.lineWidth = width;
        ctx.lineJoin = ctx.lineCap = "round";
        ctx.setLineDash(dash);
        ctx.beginPath();
        points.forEach((each, i) => ctx[i ? "lineTo" : "moveTo"](...point(each)));
        ctx.stroke();
        ctx.setLineDash([]);
      };
      if (way && way.found) {
        stroke(way.way, colours["path-edge"], wide + 2, old ? [7, 7] : []);
        stroke(way.way, colours.path, wide, old ? [7, 7] : []);
      }
      if (this.at.done && way && way.found && way.ratio > 1.0000005) stroke(phase.least_way, colours.text, 1.5, [2, 5]);
      const [x, y, heading] = phase.start, [sx, sy] = point([x, y]), angle = (heading * Math.PI) / 8, far = Math.max(9, g.size * 0.95);
      ctx.strokeStyle = colours.start;
      ctx.lineWidth = 3;
      ctx.beginPath();
      ctx.moveTo(sx, sy);
      ctx.lineTo(sx + far * Math.cos(angle), sy - far * Math.sin(angle));
      ctx.stroke();
      const mark = Math.max(g.size, 22);
      wl.badgeOn(ctx, [sx, sy], mark, colours.start, x + y * g.width === this.cell("start") ? "S" : "R", colours["mark-text"]);
      if (x + y * g.width !== this.cell("start")) wl.badgeOn(ctx, g.middle(this.cell("start")), mark * 0.7, colours.start, "S", colours["mark-text"]);
      wl.badgeOn(ctx, g.middle(this.cell("goal")), mark, colours.goal, "G", colours["mark-text"], true);
      if (this.view.cursor !== null && this.tool !== "look") {
        ctx.strokeStyle = colours.text;
        ctx.lineWidth = 1.5;
        ctx.beginPath();
        ctx.arc(...g.middle(this.view.cursor), (this.sizes[this.tool] + 0.5) * g.size, 0, 2 * Math.PI);
        ctx.stroke();
      }
    }

    lines(cell) {
      const { width } = this.floor, phase = this.data.phases[this.at.phase], bits = this.bitsAt()[cell], headings = Math.floor(bits / COUNTED);
      const said = [`(${cell % width}, ${Math.floor(cell / width)}), ${wl.number(phase.height[cell] / 1000, 2)} m high`];
      if (this.floor.walls[cell]) said.push("obstacle");
      else if (phase.closed[cell]) said.push("too steep, or too near to an obstacle for the body");
      if (bits & FRESH) said.push(`${headings === 15 ? "15 or 16" : headings} of 16 headings expanded in this pass`);
      else if (bits & BEFORE) said.push("expanded before");
      if (bits & OPEN) said.push("waits in OPEN");
      if (bits & INCONS) said.push("put off in INCONS");
      return said;
    }

    // ---- in words

    amount(value) { return this.data.objective === "energy" ? wl.joules(value) : `${wl.number(value / 1000, 2)} m`; }

    /** At most two lines: the ground below must not jump while it plays. */
    sentence() {
      const { phase: number, frame, pass, done, expanded } = this.at, phase = this.data.phases[number];
      if (frame === 0 && number === 0) return "Nothing is planned yet: only the goal waits in OPEN. Play, or move ε.";
      if (frame === 0) return this.happenedAt(number);
      const each = phase.passes[pass];
      if (!done) return `${epsilon(each.epsilon)}: ${count(expanded, "state")} expanded of ${wl.number(each.expanded)} in this pass.`;
      if (!each.found) return "There is no way. Nothing in OPEN can reach the start: the body needs 0.4 m beside obstacles, and slopes above 30° are closed.";
      const found = `${epsilon(each.epsilon)}: after ${count(each.expanded, "expansion")} a way for ${this.amount(each.cost)}`;
      if (each.broken) return `${found}, said to cost at most ${wl.number(each.epsilon, 2)} times the least; but it costs ${ratio(each.ratio)} times the least: the bound is broken.`;
      if (each.epsilon === 1) return `${found}, and it is proven to be the least.`;
      return `${found}, proven to cost at most ${wl.number(each.epsilon, 2)} times the least; ${each.ratio <= 1 ? "it is the least, which isn't proven yet" : `in truth it costs ${ratio(each.ratio)} times the least`}.`;
    }

    happenedAt(number) {
      const { change, states, anew } = this.data.phases[number], word = `Change ${number}`;
      if (change.kind === "d") return `${word}: the robot has driven on. What states cost to the goal stays right; only keys change.`;
      if (!states) return `${word}: nothing has become different.`;
      const next = anew ? "The search begins anew." : "Those that are no longer right wait in OPEN.";
      return `${word}: ${HAPPENED[change.kind]}, which touches ${count(states, "state")} (outlined). ${next}`;
    }

    tell() {
      const { phase: number, pass, published, expanded, open, incons } = this.at, phase = this.data.phases[number], way = published >= 0 ? phase.passes[published] : null;
      this.status.textContent = this.sentence();
      this.status.classList.toggle("bad", Boolean(way && (way.broken || !way.found)));
      const fact = (word, value) => el("div", {}, el("dt", {}, word), el("dd", {}, value));
      const shown = way && way.found;
      this.counts.replaceChildren(el("dl", {}, fact("expanded in this pass", pass < 0 ? "–" : `${wl.number(expanded)} of ${wl.number(phase.passes[pass].expanded)}`), fact("OPEN", wl.number(open)), fact("INCONS", wl.number(incons)),
        fact("cost", shown ? this.amount(way.cost) : "–"), fact("at most", shown ? `${wl.number(way.epsilon, 2)} × least` : "–"), fact("in truth", shown ? `${ratio(way.ratio)} ×` : "–"),
        fact("length", shown ? `${wl.number(way.length_m, 2)} m` : "–"), fact("energy", shown ? wl.joules(way.energy_mj) : "–"), fact("climbs", shown ? `${wl.number(way.climb_m, 2)} m` : "–")));
      this.now.replaceChildren(...(this.at.phase ? [...this.verdicts(), ...this.figure(), this.table()] : [...this.figure(), this.table(), ...this.verdicts()]));
    }

    /** Bound and truth of the published ways over the expansions of the phase, on a logarithmic axis. */
    figure() {
      const { phase: number, frame } = this.at, { passes, counts } = this.data.phases[number];
      if (passes.length < 2) return [];
      const wide = 300, high = 170, left = 34, low = high - 34, right = wide - 8;
      const ends = [];
      passes.reduce((sum, each) => { ends.push(sum + each.expanded); return sum + each.expanded; }, 0);
      const total = Math.max(10, ends[ends.length - 1]), top = Math.max(1.1, ...passes.filter((each) => each.found).flatMap((each) => [each.epsilon, each.ratio]));
      const x = (n) => left + (Math.log10(Math.max(1, n)) / Math.log10(total)) * (right - left), y = (value) => low - ((value - 1) / (top - 1)) * (low - 12);
      const text = (tx, ty, word, anchor) => svg("text", { x: tx, y: ty, "text-anchor": anchor }, word);
      const chart = svg("svg", { class: "wl-lesson-curve", viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": "Proven bound and real cost of the published ways over expansions" },
        svg("line", { class: "reference", x1: left, x2: right, y1: low, y2: low }), svg("line", { class: "axis", x1: left, x2: left, y1: 8, y2: low }),
        text(left - 5, y(1) + 4, "1", "end"), text(left - 5, y(top) + 4, wl.number(top, 1), "end"), text(right, high - 4, "expansions", "end"));
      for (let n = 1; n <= total; n *= 10) if (x(n) < right - 12 || n === total) chart.append(text(x(n), high - 18, n >= 1000 ? `${n / 1000}k` : String(n), "middle"));
      const stairs = (value, colour, dash) => {
        let d = "";
        passes.forEach((each, i) => {
          if (!each.found) return;
          const until = i + 1 < passes.length ? ends[i + 1] : total;
          d += `${d ? "L" : "M"}${x(ends[i]).toFixed(1)} ${y(value(each)).toFixed(1)}L${x(until).toFixed(1)} ${y(value(each)).toFixed(1)}`;
        });
        if (d) chart.append(svg("path", { d, style: `stroke: var(--wl-learn-${colour}); stroke-dasharray: ${dash}` }));
      };
      stairs((each) => each.epsilon, "v1", "6 4");
      stairs((each) => each.ratio, "v0", "none");
      const pass = counts.pass[frame], here = pass < 0 ? 0 : (pass ? ends[pass - 1] : 0) + counts.expanded[frame];
      chart.append(svg("line", { class: "at", x1: x(here), x2: x(here), y1: 8, y2: low }));
      const key = (colour, word, dash) => { const line = el("i", { class: "wl-plot-key", "aria-hidden": "true" }); line.style.color = `var(--wl-learn-${colour})`; if (dash) line.style.borderTopStyle = "dashed"; return el("span", {}, line, word); };
      return [el("figure", {}, el("figcaption", {}, number ? `After change ${number}: times the least` : "Cost of the way, times the least", el("span", { class: "wl-plot-keys" }, key("v1", "proven bound", true), key("v0", "real"))), chart)];
    }

    table() {
      const cell = (text) => el("td", {}, text);
      const rows = this.data.phases.flatMap((phase, number) => [
        ...(number ? [el("tr", {}, el("th", { colspan: 4 }, `Change ${number}`))] : []),
        ...phase.passes.map((each, i) => el("tr", { class: number === this.at.phase && i === this.at.pass ? "current" : null }, cell(epsilon(each.epsilon)), cell(each.found ? this.amount(each.cost) : "no way"),
          el("td", { class: each.broken ? "wl-anytime-broken" : null }, each.found ? `${ratio(each.ratio)}${each.broken ? " !" : ""}` : "–"), cell(wl.number(each.expanded)))),
      ]);
      return el("table", { class: "wl-lesson-table wl-anytime-table" }, el("thead", {}, el("tr", {}, ...["pass", "cost", "× least", "expanded"].map((word) => el("th", {}, word)))), el("tbody", {}, ...rows));
    }

    /** Repair against planning anew, as bars, for every change; the one that is shown comes first. */
    verdicts() {
      const bars = (phase, at, word) => {
        const most = Math.max(phase.repair[at], phase.fresh[at], 1);
        const bar = (name, value, chosen) => {
          const fill = el("i", {});
          fill.style.width = `${(100 * value) / most}%`;
          return el("div", { class: `wl-anytime-bar${chosen ? " chosen" : ""}` }, el("span", {}, name), el("b", {}, fill), el("span", {}, wl.number(value)));
        };
        return [word ? el("p", { class: "wl-hint" }, word) : null, bar("repair", phase.repair[at], !phase.anew), bar("anew", phase.fresh[at], phase.anew)].filter(Boolean);
      };
      const told = this.data.phases.slice(1).map((phase, i) => {
        const both = phase.repair[0] !== phase.repair[1] || phase.fresh[0] !== phase.fresh[1];
        return el("div", { class: "wl-anytime-verdict" }, el("h2", {}, `Change ${i + 1}: repair or anew`), ...(both ? bars(phase, 0, "expansions until there is a way again") : []),
          ...bars(phase, 1, both ? "until it is the least" : ""), el("p", {}, phase.verdict));
      });
      const shown = this.at.phase - 1;
      return shown > 0 ? [told[shown], ...told.filter((_, i) => i !== shown)] : told;
    }
  }

  function legend() {
    const mark = (kind, text, sign = "") => el("div", { class: "wl-lesson-mark" }, el("span", { class: `wl-lesson-swatch ${kind}` }, sign), text);
    return el("div", { class: "wl-lesson-marks" }, mark("fresh", "expanded in this pass; the stronger, the more headings"), mark("before", "expanded before"), mark("open", "waits in OPEN"), mark("both", "expanded; other headings wait in OPEN"),
      mark("incons", "put off to the next pass: INCONS", "×"), mark("changed", "costs have changed here"), mark("path", "way; dashed: of before the change"), mark("dashes", "the least", "┄"),
      mark("start", "start; R the robot on its way", "S"), mark("goal", "goal", "G"), mark("wall", "obstacle"), mark("shut", "too steep, or too near to an obstacle"));
  }

  wl.lessons = wl.lessons || {};
  wl.lessons.anytime = AnytimeLesson;
})();
