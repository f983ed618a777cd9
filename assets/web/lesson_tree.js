/* The constraint tree: its nodes in the order of their expansion, and the plan of the chosen one on the floor. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el, svg } = wl;

  const WIDE = 122, HIGH = 40, GAP_X = 12, GAP_Y = 34;
  const PRUNED = 2, ANSWER = 3;
  const STEP_MS = 700, EASY = 0.6;

  class TreeLesson extends wl.Lesson {
    build() {
      this.begun();
      this.tree = new TreeView((node) => this.choose(node, true));
      this.floorView = new wl.FloorView("Floor with the plan of the chosen node: arrows move a cursor, Enter sets an obstacle", {
        paint: (ctx, g, colours) => this.paint(ctx, g, colours),
        hover: (cell) => { this.floorView.draw(); this.floorView.hint(cell, cell === null ? null : this.lines(cell)); },
        press: (cell) => this.press(cell),
        key: (cell, key) => { if (key !== "Enter") return false; this.setWall(cell, this.floor.walls[cell] ? 0 : 1); return true; },
        home: () => this.ends[0][0],
      });
      this.clock = el("input", { type: "range", min: 0, max: 0, step: 0.05, value: 0, class: "wl-lesson-scrub", "aria-label": "Time of the plan in steps", oninput: () => { this.moving = false; this.setTime(Number(this.clock.value)); } });
      this.clockText = el("output", { class: "wl-lesson-clock" }, "0");
      this.drive = el("button", { type: "button", class: "wl-button small", onclick: () => this.animate() }, "Drive");
      this.showAnswer = el("button", { type: "button", class: "wl-button small", onclick: () => this.choose(-1, true) }, "Plan found");
      this.status = el("p", { class: "wl-lesson-status", role: "status" });
      this.stage.replaceChildren(this.status, el("div", { class: "wl-lesson-tree" }, this.tree.host,
        el("div", { class: "wl-lesson-plan" }, this.floorView.host, el("div", { class: "wl-lesson-clockbar" }, this.drive, this.clock, this.clockText))));
      this.tool = matchMedia("(pointer: coarse)").matches ? "look" : "draw";
      const { options } = this;
      const choose = (label, words, key) => {
        const select = el("select", { class: "wl-select", "aria-label": label, onchange: () => this.change(key, select.value) },
          ...Object.entries(words).map(([value, word]) => el("option", { value }, word)));
        return select;
      };
      this.selects = { planner: choose("Planner", options.planners, "planner"), rule: choose("Priority rule", options.rules, "rule"), mass: choose("Masses", options.masses, "mass"),
        w: choose("Factor w", Object.fromEntries(options.factors.map((w) => [w, w])), "w") };
      this.checks = Object.fromEntries(Object.entries(options.switches).map(([name]) => [name, el("input", { type: "checkbox", onchange: () => this.switched() })]));
      const number = (label, value, min, max) => el("input", { type: "number", class: "wl-time", "aria-label": label, value, min, max });
      this.fields = { width: number("Columns", 6, 2, options.side), height: number("Rows", 6, 2, options.side), density: number("Obstacles in per cent", 10, 0, 35), seed: number("Seed", 1, 0, 999999) };
      const labelled = (word, field) => el("label", {}, el("span", {}, word), field);
      this.fewer = el("button", { type: "button", class: "wl-button small", onclick: () => this.fleet(-1) }, "One vehicle less");
      this.more = el("button", { type: "button", class: "wl-button small", onclick: () => this.fleet(1) }, "One more");
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.group("Planner", el("div", { class: "wl-lesson-fields one" }, labelled("Planner", this.selects.planner)),
          el("div", { class: "wl-lesson-checks" }, ...Object.entries(options.switches).map(([name, word]) => el("label", {}, this.checks[name], word))),
          el("div", { class: "wl-lesson-fields" }, labelled("Factor w", this.selects.w), labelled("Masses", this.selects.mass)),
          el("div", { class: "wl-lesson-fields one" }, labelled("Priority rule (E-CBS)", this.selects.rule))),
        this.group("Floor and vehicles", el("div", { class: "wl-row" }, ...this.toolButtons()),
          el("div", { class: "wl-row" }, this.fewer, this.more),
          el("div", { class: "wl-lesson-fields" }, labelled("Columns", this.fields.width), labelled("Rows", this.fields.height), labelled("Obstacles %", this.fields.density), labelled("Seed", this.fields.seed)),
          el("div", { class: "wl-row" }, el("button", { type: "button", class: "wl-button small", onclick: () => this.random() }, "Random floor"),
            el("button", { type: "button", class: "wl-button small", onclick: () => this.clear() }, "Clear"), this.linkButton()),
          el("p", { class: "wl-hint" }, "Drag a start (circle) or goal (square); drag over cells to draw or erase.")),
        this.group("Marks", legend()));
      this.setTool(this.tool);
    }

    /** Node and time as the state has them; without them they follow the step. */
    begun() {
      this.node = this.state.node === "plan" ? -1 : this.state.node ? Number(this.state.node) : null;
      this.time = this.state.time ? Number(this.state.time) : null;
      this.moving = false;
    }
    views() { return [this.floorView]; }
    steps() { return this.order.length + (this.data.answer ? 1 : 0); }
    cleanup() { this.moving = false; this.floorView.destroy(); this.tree.destroy(); }

    // ---- asking for something else

    change(key, value) {
      this.state[key] = value;
      this.anew();
    }

    switched() {
      const on = Object.keys(this.checks).filter((name) => this.checks[name].checked);
      this.state.on = on.length ? on.join(".") : "none";
      this.anew();
    }

    anew() {
      this.player.pause();
      this.moving = false;
      this.player.step = 0;
      Object.assign(this.state, { step: "0", node: "", time: "" });
      this.begun();
      this.ask();
    }

    trips() { return this.state.vehicles.split("~").map((trip) => trip.split("-")); }

    fleet(change) {
      const trips = this.trips();
      if (change < 0) trips.pop();
      else {
        const taken = [0, 1].map((which) => new Set(trips.map((trip) => trip[which])));
        const free = [...this.floor.walls.keys()].filter((cell) => !this.floor.walls[cell]).map((cell) => `${cell % this.floor.width}.${Math.floor(cell / this.floor.width)}`);
        const start = free.find((cell) => !taken[0].has(cell)), goal = free.reverse().find((cell) => !taken[1].has(cell) && cell !== start);
        if (!start || !goal) return;
        trips.push([start, goal]);
      }
      if (trips.length < this.options.fleet[0] || trips.length > this.options.fleet[1]) return;
      this.state.vehicles = trips.map((trip) => trip.join("-")).join("~");
      this.anew();
    }

    /** Starts and goals outside a new floor, or doubled by it, go along its border. */
    fitted(width, height) {
      const corners = [[0, 0], [width - 1, height - 1], [width - 1, 0], [0, height - 1], [0, Math.floor(height / 2)], [width - 1, Math.floor(height / 2)], [Math.floor(width / 2), 0], [Math.floor(width / 2), height - 1]].map((cell) => cell.join("."));
      const trips = this.trips(), inside = (text) => { const [x, y] = text.split(".").map(Number); return x < width && y < height; };
      for (const which of [0, 1]) {
        const used = new Set(trips.map((trip) => trip[which]).filter(inside));
        for (const trip of trips) {
          if (inside(trip[which])) continue;
          trip[which] = corners.find((cell) => !used.has(cell) && cell !== trip[1 - which]) || corners.find((cell) => !used.has(cell)) || corners[0];
          used.add(trip[which]);
        }
      }
      this.state.vehicles = trips.map((trip) => trip.join("-")).join("~");
    }

    size() {
      for (const field of Object.values(this.fields)) field.value = String(Math.max(Number(field.min), Math.min(Number(field.max), Math.round(Number(field.value) || 0))));
      return [Number(this.fields.width.value), Number(this.fields.height.value)];
    }

    random() {
      const [width, height] = this.size();
      this.fitted(width, height);
      this.state.map = `${width}x${height}r${this.fields.density.value}s${this.fields.seed.value}`;
      this.fields.seed.value = String(Number(this.fields.seed.value) + 1);
      this.anew();
    }

    clear() {
      const [width, height] = this.size();
      this.fitted(width, height);
      this.state.map = `${width}x${height}`;
      this.anew();
    }

    press(cell) {
      for (const which of [0, 1]) {
        const vehicle = this.ends.findIndex((ends) => ends[which] === cell);
        if (vehicle >= 0) return (to) => this.moveEnd(vehicle, which, to);
      }
      if (this.tool !== "draw") return null;
      const value = this.floor.walls[cell] ? 0 : 1, set = (at) => this.setWall(at, value);
      set(cell);
      return set;
    }

    moveEnd(vehicle, which, cell) {
      if (this.floor.walls[cell] || this.ends.some((ends) => ends[which] === cell)) return;
      this.ends[vehicle][which] = cell;
      const trips = this.trips();
      trips[vehicle][which] = `${cell % this.floor.width}.${Math.floor(cell / this.floor.width)}`;
      this.state.vehicles = trips.map((trip) => trip.join("-")).join("~");
      this.state.map = wl.floorText(this.floor);
      this.anew();
      this.floorView.draw();
    }

    setWall(cell, value) {
      if (this.floor.walls[cell] === value || this.ends.some((ends) => ends.includes(cell))) return;
      this.floor.walls[cell] = value;
      this.state.map = wl.floorText(this.floor);
      this.anew();
      this.floorView.draw();
    }

    // ---- what the server answered

    take(answer, kept) {
      if (!kept) this.ends = answer.vehicles.map((trip) => trip.map(([x, y]) => x + y * answer.width));
      this.order = answer.nodes.filter((node) => node.turn >= 0).sort((a, b) => a.turn - b.turn).map((node) => node.node);
      this.cost = answer.unit === "J" ? (value) => wl.joules(value) : (value) => `${value} steps`;
      for (const [key, select] of Object.entries(this.selects)) select.value = this.state[key];
      const on = (this.state.on || "").split(".");
      for (const [name, box] of Object.entries(this.checks)) box.checked = on.includes(name);
      this.selects.rule.disabled = this.state.planner !== "ecbs";
      this.fields.width.value = String(answer.width);
      this.fields.height.value = String(answer.height);
      this.fewer.disabled = answer.vehicles.length <= this.options.fleet[0];
      this.more.disabled = answer.vehicles.length >= this.options.fleet[1];
      this.status.replaceChildren(el("b", {}, `${wl.number(answer.nodes.length)} nodes`), `, ${wl.number(answer.expanded)} expanded, ${wl.number(answer.searches)} single-vehicle expansions. ${answer.status[0].toUpperCase()}${answer.status.slice(1)}. `,
        answer.answer ? this.showAnswer : "");
      this.status.classList.toggle("bad", !answer.solved);
      this.tree.take(answer.nodes, answer.unit);
      this.floorView.floor = this.floor;
      if (this.node !== null && this.node >= answer.nodes.length) this.node = null;
      this.shown = null;
    }

    /** The node that a step is about: the one just expanded, in the end the answer (-1: no node, but its plan). */
    nodeOf(step) {
      if (step > this.order.length) return this.data.nodes.findIndex((node) => node.status === ANSWER);
      return step > 0 ? this.order[step - 1] : 0;
    }

    /** After so many expansions: which nodes exist, and what they are. */
    show(step) {
      const nodes = this.data.nodes;
      const states = nodes.map((node) => {
        const born = node.parent < 0 ? 0 : nodes[node.parent].turn + 1;
        if (born > step) return "";
        if (node.status === ANSWER && step > this.order.length) return "answer";
        if (node.turn >= 0 && node.turn < step) return "expanded";
        return node.status === PRUNED && node.pruned <= step ? "pruned" : "open";
      });
      const current = step > 0 && step <= this.order.length ? this.order[step - 1] : -1;
      const moved = this.shown !== null && this.shown !== step;
      this.shown = step;
      let node = moved || this.node === null ? this.nodeOf(step) : this.node;
      if (node >= 0 && !states[node]) node = this.nodeOf(step);
      this.tree.show(states, current, node);
      this.choose(node, false);
    }

    /** Shows a node's plan; -1 is the plan that the search returned. */
    choose(node, asked) {
      if (!this.data) return;
      const nodes = this.data.nodes, changed = node !== this.node || this.time === null;
      if (asked) {
        this.player.pause();
        const born = node > 0 ? nodes[nodes[node].parent].turn + 1 : 0;
        if (this.player.step < born) this.player.seek(born);
      }
      this.node = node;
      this.state.node = node === this.nodeOf(this.player.step) ? "" : node < 0 ? "plan" : String(node);
      this.plan = node < 0 ? this.data.answer : this.data.plans[node] ? this.data.plans[node].map((way) => this.data.ways[way]) : null;
      const last = this.plan ? Math.max(...this.plan.map((way) => way.cells.length - 1)) : 0;
      this.clock.max = String(last);
      if (changed && !(this.time !== null && this.first === undefined)) {
        this.moving = false;
        const conflict = node >= 0 && nodes[node] && nodes[node].conflict;
        this.time = conflict ? conflict.tick : 0;
      }
      this.first = false;
      this.setTime(Math.min(this.time, last));
      this.tree.mark(node);
      this.tell();
    }

    setTime(time) {
      this.time = time;
      this.state.time = String(Math.round(time));
      this.clock.value = String(time);
      this.clockText.textContent = `step ${time.toFixed(time % 1 ? 1 : 0)} / ${this.clock.max}`;
      this.drive.textContent = this.moving ? "Stop" : "Drive";
      this.floorView.draw();
      this.writeSoon();
    }

    animate() {
      if (this.moving) { this.moving = false; this.setTime(this.time); return; }
      const last = Number(this.clock.max);
      if (this.time >= last) this.time = 0;
      this.moving = true;
      let before = performance.now();
      const loop = (now) => {
        if (!this.moving || this.gone || !this.alive) return;
        const next = Math.min(last, this.time + Math.min(now - before, 300) / STEP_MS);
        before = now;
        if (next >= last) this.moving = false;
        this.setTime(next);
        if (this.moving) requestAnimationFrame(loop);
      };
      this.setTime(this.time);
      requestAnimationFrame(loop);
    }

    // ---- the floor

    position(way, time) {
      const at = Math.min(Math.floor(time), way.cells.length - 1), next = Math.min(at + 1, way.cells.length - 1), part = Math.min(1, time - at);
      return [way.cells[at], way.cells[next], at === next ? 0 : part];
    }

    paint(ctx, g, colours) {
      const nodes = this.data && this.data.nodes, colour = (k) => colours[`v${k}`];
      if (!this.ends) return;
      this.ends.forEach(([start, goal], k) => {
        const [sx, sy] = g.middle(start), [gx, gy] = g.middle(goal), r = g.size * 0.36;
        ctx.strokeStyle = colour(k);
        ctx.lineWidth = Math.max(1.5, g.size * 0.05);
        ctx.beginPath(); ctx.arc(sx, sy, r, 0, 2 * Math.PI); ctx.stroke();
        ctx.strokeRect(gx - r, gy - r, 2 * r, 2 * r);
        if (g.size >= 24) {
          ctx.fillStyle = colour(k);
          ctx.font = `700 ${Math.max(9, Math.min(14, Math.round(g.size * 0.2)))}px system-ui, sans-serif`;
          ctx.textAlign = "left"; ctx.textBaseline = "bottom";
          ctx.fillText(`G${k}`, gx - r + 3, gy + r - 1);
        }
      });
      if (!this.plan || !nodes) return;
      const spread = (k) => (k - (this.plan.length - 1) / 2) * g.size * 0.09;
      this.plan.forEach((way, k) => {
        ctx.strokeStyle = colour(k);
        ctx.globalAlpha = 0.75;
        ctx.lineWidth = Math.max(2, g.size * 0.07);
        ctx.lineJoin = "round";
        ctx.beginPath();
        way.cells.forEach((cell, i) => { const [x, y] = g.middle(cell); ctx[i ? "lineTo" : "moveTo"](x + spread(k), y + spread(k)); });
        ctx.stroke();
        ctx.globalAlpha = 1;
      });
      const conflict = this.node >= 0 && nodes[this.node] && nodes[this.node].conflict;
      if (conflict) {
        ctx.strokeStyle = colours.conflict;
        ctx.lineWidth = Math.max(2, Math.min(4, g.size * 0.08));
        const cross = g.size * 0.09;
        for (const cell of conflict.cells) {
          ctx.strokeRect(g.left(cell) + 2, g.top(cell) + 2, g.size - 4, g.size - 4);
          const [x, y] = [g.left(cell) + g.size - cross * 1.9, g.top(cell) + cross * 1.9];
          ctx.beginPath(); ctx.moveTo(x - cross, y - cross); ctx.lineTo(x + cross, y + cross); ctx.moveTo(x + cross, y - cross); ctx.lineTo(x - cross, y + cross); ctx.stroke();
        }
      }
      const spots = this.plan.map((way) => {
        const [from, to, part] = this.position(way, this.time), [ax, ay] = g.middle(from), [bx, by] = g.middle(to);
        return [ax + (bx - ax) * part, ay + (by - ay) * part];
      });
      spots.forEach(([x0, y0], k) => {
        // those in one spot are drawn side by side, or a collision would show one vehicle
        const same = spots.flatMap(([x, y], j) => (Math.hypot(x - x0, y - y0) < g.size * 0.2 ? [j] : [])), many = same.length > 1;
        const r = g.size * (many ? 0.2 : 0.27), x = x0 + (many ? (same.indexOf(k) - (same.length - 1) / 2) * 2.1 * r : 0), y = y0;
        ctx.fillStyle = colour(k);
        ctx.beginPath(); ctx.roundRect(x - r, y - r, 2 * r, 2 * r, r * 0.4); ctx.fill();
        ctx.fillStyle = colours["mark-text"];
        ctx.font = `700 ${Math.max(9, Math.round(r))}px system-ui, sans-serif`;
        ctx.textAlign = "center"; ctx.textBaseline = "middle";
        ctx.fillText(String(k), x, y + 1);
      });
    }

    lines(cell) {
      const lines = [`(${cell % this.floor.width}, ${Math.floor(cell / this.floor.width)})`];
      this.ends.forEach(([start, goal], k) => { if (start === cell) lines.push(`start of vehicle ${k}`); if (goal === cell) lines.push(`goal of vehicle ${k}`); });
      if (this.plan) this.plan.forEach((way, k) => { const when = way.cells.flatMap((at, i) => (at === cell ? [i] : [])); if (when.length) lines.push(`vehicle ${k} at step ${when.join(", ")}`); });
      return lines;
    }

    // ---- the chosen node in words

    tell() {
      const { nodes } = this.data, cell = (text) => el("td", {}, text);
      const plan = this.plan && el("table", { class: "wl-lesson-table" }, el("thead", {}, el("tr", {}, ...["vehicle", "steps", "energy"].map((word) => el("th", {}, word)))),
        el("tbody", {}, ...this.plan.map((way, k) => el("tr", {}, el("td", {}, el("span", { class: "wl-dot", style: `background: var(--wl-learn-v${k})` }), String(k)), cell(String(way.cells.length - 1)), cell(wl.joules(way.energy_mj)))),
          el("tr", {}, cell("sum"), cell(String(this.plan.reduce((sum, way) => sum + way.cells.length - 1, 0))), cell(wl.joules(this.plan.reduce((sum, way) => sum + way.energy_mj, 0))))));
      if (this.node < 0 || !nodes[this.node]) {
        this.now.replaceChildren(el("h2", {}, this.node < 0 ? "The plan found" : "No tree"), plan || el("p", {}, this.data.status));
        return;
      }
      const node = nodes[this.node], children = nodes.filter((each) => each.parent === this.node);
      const link = (other, text) => el("button", { type: "button", class: "wl-link", onclick: () => this.choose(other, true) }, text);
      const fact = (word, ...value) => [el("dt", {}, word), el("dd", {}, ...value)];
      const word = ["open when the search ended", "expanded", "pruned", "its plan is the answer"][node.status];
      this.now.replaceChildren(el("h2", {}, `Node ${node.node}`),
        el("dl", { class: "wl-facts" },
          ...fact("State", word),
          ...fact("Cost", this.cost(node.cost), node.bound !== node.cost ? ` (at least ${this.cost(node.bound)})` : ""),
          ...(node.h ? fact("f", `${this.cost(node.f)}: h adds ${this.cost(node.h)}`) : []),
          ...fact("Conflicts", String(node.conflicts)),
          ...(node.parent >= 0 ? fact("Parent", link(node.parent, `node ${node.parent}`)) : []),
          ...(children.length ? fact("Children", ...children.flatMap((child, i) => [i ? ", " : "", link(child.node, `node ${child.node}`)]),
            children.length < 2 && !(this.state.planner === "ecbs" && this.state.rule === "B") ? "; the other has no plan, or none better than the best known" : "") : [])),
        el("h3", {}, "Constraint"), el("p", {}, node.constraint),
        el("h3", {}, node.turn >= 0 ? `Why it came as number ${node.turn + 1}` : "Why it was not expanded"), el("p", {}, node.why),
        ...(node.conflict ? [el("h3", {}, "Conflict"), el("p", {}, node.conflict.text), el("p", {}, node.conflict.priority)] : []),
        el("h3", {}, "Plan"), plan || "");
    }
  }

  function legend() {
    const mark = (kind, text, sign = "") => el("div", { class: "wl-lesson-mark" }, el("span", { class: `wl-lesson-swatch ${kind}` }, sign), text);
    return el("div", { class: "wl-lesson-marks" }, mark("open", "open: waits with its f"), mark("closed", "expanded"), mark("now", "expanded last"), mark("pruned", "pruned: can't beat a known plan", "×"), mark("answer", "★ its plan is the answer; ✓ no conflict"),
      el("p", { class: "wl-hint" }, "0 ≠ (2,2) @2: vehicle 0 not at (2,2) at step 2; = must be there; ↛ not driving to; ⇒ must drive to."));
  }

  /** The tree as SVG: drag to move, wheel to zoom, arrows to walk from node to node. */
  class TreeView {
    constructor(chosen) {
      this.chosen = chosen;
      this.view = { x: 0, y: 0, scale: 1 };
      this.world = svg("g");
      this.svg = svg("svg", { class: "wl-lesson-svg", tabindex: 0, role: "application", "aria-label": "Constraint tree: arrows walk from node to node" }, this.world);
      const tool = (text, label, act) => el("button", { type: "button", class: "wl-tool", title: label, "aria-label": label, onclick: act }, text);
      this.host = el("div", { class: "wl-lesson-forest" }, this.svg, el("div", { class: "wl-map-tools" },
        tool("+", "Zoom in", () => this.zoom(1.3)), tool("−", "Zoom out", () => this.zoom(1 / 1.3)), tool("Fit", "Show the whole tree", () => this.fit())));
      this.svg.addEventListener("wheel", (event) => { event.preventDefault(); const box = this.svg.getBoundingClientRect(); this.zoom(Math.exp(-event.deltaY * 0.0015), event.clientX - box.left, event.clientY - box.top); }, { passive: false });
      this.svg.addEventListener("pointerdown", (event) => this._down(event));
      this.svg.addEventListener("keydown", (event) => this._key(event));
      this.size = new ResizeObserver(() => { if (!this.moved) this.fit(EASY); if (this.current >= 0) this.reveal(this.current); });
      this.size.observe(this.svg);
    }

    destroy() { this.size.disconnect(); }

    take(nodes, unit) {
      this.nodes = nodes;
      this.children = nodes.map(() => []);
      for (const node of nodes) if (node.parent >= 0) this.children[node.parent].push(node.node);
      this._place();
      const edges = svg("g"), marks = svg("g");
      this.edges = nodes.map((node) => {
        if (node.parent < 0) return null;
        const [x1, y1] = this.at[node.parent], [x2, y2] = this.at[node.node];
        return edges.appendChild(svg("path", { class: `wl-lesson-edge${node.positive ? " positive" : ""}`, d: `M${x1} ${y1 + HIGH / 2} C${x1} ${y1 + HIGH / 2 + 18} ${x2} ${y2 - HIGH / 2 - 18} ${x2} ${y2 - HIGH / 2}` }));
      });
      this.marks = nodes.map((node) => {
        const [x, y] = this.at[node.node], value = unit === "J" ? wl.number(node.f / 1000, 0) : String(node.f);
        const mark = svg("g", { class: "wl-lesson-node", transform: `translate(${x} ${y})`, "data-node": node.node },
          svg("rect", { x: -WIDE / 2, y: -HIGH / 2, width: WIDE, height: HIGH, rx: 7 }),
          svg("text", { y: -4, class: "name" }, document.createTextNode("")), svg("text", { y: 12, class: "short" }, node.short));
        mark.label = `${node.node}  f ${value}`;
        mark.append(svg("title", {}, `Node ${node.node}: ${node.constraint}`));
        return marks.appendChild(mark);
      });
      this.world.replaceChildren(edges, marks);
      this.moved = false;
      this.current = -1;
      this.fit(EASY);
    }

    /** Each subtree as far to the left as the outlines of those before it allow; a parent above the middle of its children. */
    _place() {
      const order = [0], depth = this.nodes.map(() => 0), offset = this.nodes.map(() => 0), outline = this.nodes.map(() => null);
      for (let i = 0; i < order.length; i++) for (const child of this.children[order[i]]) { depth[child] = depth[order[i]] + 1; order.push(child); }
      for (const node of [...order].reverse()) {
        const kids = this.children[node], left = [], right = [];
        for (const kid of kids) {
          let shift = 0;
          outline[kid].left.forEach((x, row) => { if (row < right.length) shift = Math.max(shift, right[row] + WIDE + GAP_X - x); });
          offset[kid] = shift;
          outline[kid].left.forEach((x, row) => { if (row >= left.length) left.push(x + shift); });
          outline[kid].right.forEach((x, row) => { right[row] = x + shift; });
          outline[kid] = null;
        }
        const middle = kids.length ? (offset[kids[0]] + offset[kids[kids.length - 1]]) / 2 : 0;
        for (const kid of kids) offset[kid] -= middle;
        outline[node] = { left: [0, ...left.map((x) => x - middle)], right: [0, ...right.map((x) => x - middle)] };
      }
      this.at = this.nodes.map(() => [0, 0]);
      for (const node of order) for (const kid of this.children[node]) this.at[kid] = [this.at[node][0] + offset[kid], depth[kid] * (HIGH + GAP_Y)];
    }

    show(states, current, chosen) {
      this.states = states;
      this.marks.forEach((mark, k) => {
        const state = states[k], [name] = mark.getElementsByClassName("name");
        mark.setAttribute("class", `wl-lesson-node ${state || "hidden"}${k === current ? " now" : ""}${k === chosen ? " chosen" : ""}`);
        name.textContent = `${state === "answer" ? "★ " : state === "pruned" ? "× " : this.nodes[k].conflicts ? "" : "✓ "}${mark.label}`;
        if (this.edges[k]) this.edges[k].classList.toggle("hidden", !state);
      });
      if (current >= 0 && this.current !== current) this.reveal(current);
      this.current = current;
    }

    mark(chosen) {
      this.picked = chosen;
      if (this.marks) this.marks.forEach((mark, k) => mark.classList.toggle("chosen", k === chosen));
      if (chosen >= 0 && this.marks && this.marks[chosen]) this.svg.setAttribute("aria-description", `Chosen: node ${chosen}`);
    }

    _apply() { this.world.setAttribute("transform", `translate(${this.view.x} ${this.view.y}) scale(${this.view.scale})`); }

    /** The whole tree, or its top where it would be smaller than `least`. */
    fit(least = 0.03) {
      if (!this.at || !this.at.length) { this.world.replaceChildren(); return; }
      const wide = this.svg.clientWidth, high = this.svg.clientHeight;
      if (!wide || !high) return;
      const xs = this.at.map(([x]) => x), ys = this.at.map(([, y]) => y);
      const left = Math.min(...xs) - WIDE / 2 - 12, right = Math.max(...xs) + WIDE / 2 + 12, top = -HIGH / 2 - 48, bottom = Math.max(...ys) + HIGH / 2 + 12;
      const whole = Math.min(wide / (right - left), high / (bottom - top), 1.25);
      const scale = Math.max(whole, least), middle = whole < least ? this.at[0][0] : (left + right) / 2;
      this.view = { scale, x: wide / 2 - scale * middle, y: scale * (bottom - top) < high ? (high - scale * (bottom + top)) / 2 : -scale * top };
      this._apply();
    }

    zoom(factor, x = this.svg.clientWidth / 2, y = this.svg.clientHeight / 2) {
      const scale = Math.max(0.03, Math.min(3, this.view.scale * factor)), by = scale / this.view.scale;
      this.view = { scale, x: x - (x - this.view.x) * by, y: y - (y - this.view.y) * by };
      this.moved = true;
      this._apply();
    }

    /** Moves the view just so far that a node is in it. */
    reveal(node) {
      const [x, y] = this.at[node], { scale } = this.view, sx = this.view.x + x * scale, sy = this.view.y + y * scale;
      const dx = (WIDE / 2) * scale + 8, dy = (HIGH / 2) * scale + 8, wide = this.svg.clientWidth, high = this.svg.clientHeight;
      if (sx - dx < 0 || sx + dx > wide) this.view.x += wide / 2 - sx;
      if (sy - dy < 0 || sy + dy > high) this.view.y += high / 2 - sy;
      this._apply();
    }

    _down(event) {
      if (event.button) return;
      const hit = event.target.closest && event.target.closest("[data-node]");
      const from = [event.clientX, event.clientY, this.view.x, this.view.y];
      let far = false;
      const move = (next) => {
        const dx = next.clientX - from[0], dy = next.clientY - from[1];
        if (!far && Math.hypot(dx, dy) < 4) return;
        if (!far) this.svg.setPointerCapture(event.pointerId);
        far = this.moved = true;
        this.view.x = from[2] + dx;
        this.view.y = from[3] + dy;
        this._apply();
      };
      const up = () => {
        this.svg.removeEventListener("pointermove", move);
        this.svg.removeEventListener("pointerup", up);
        this.svg.removeEventListener("pointercancel", up);
        if (!far && hit) this.chosen(Number(hit.dataset.node));
      };
      this.svg.addEventListener("pointermove", move);
      this.svg.addEventListener("pointerup", up);
      this.svg.addEventListener("pointercancel", up);
      event.preventDefault();
    }

    _key(event) {
      if (!this.nodes || !this.nodes.length || event.ctrlKey || event.altKey || event.metaKey) return;
      const here = Math.max(0, this.picked || 0), parent = this.nodes[here].parent, kin = parent >= 0 ? this.children[parent] : [0], at = kin.indexOf(here);
      const there = { ArrowUp: parent, ArrowDown: this.children[here][0], ArrowLeft: kin[at - 1], ArrowRight: kin[at + 1] }[event.key];
      if (event.key === "Escape") this.svg.blur();
      else if (/^Arrow/.test(event.key)) { if (there !== undefined && there >= 0) { this.chosen(there); this.reveal(there); } } else if (event.key === "+") this.zoom(1.3);
      else if (event.key === "-") this.zoom(1 / 1.3);
      else return;
      event.preventDefault();
      event.stopPropagation();
    }
  }

  wl.lessons.tree = TreeLesson;
})();
