/* Ants: the pheromone of up to four colonies iteration by iteration, and their best ways against A*. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el, svg } = wl;
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

  class AntsLesson extends wl.DrawnLesson {
    build() {
      this.panels = [];
      this.grid = el("div", { class: "wl-lesson-grid" });
      this.same = el("p", { class: "wl-lesson-same", role: "status" });
      this.stage.replaceChildren(this.same, this.grid);
      this.tool = matchMedia("(pointer: coarse)").matches ? "look" : "draw";
      const { numbers, panels } = this.options;
      const number = (label, value, min, max, step = 1) => el("input", { type: "number", class: "wl-time", "aria-label": label, value, min, max, step });
      const labelled = (word, field) => el("label", {}, el("span", {}, word), field);
      this.numbers = Object.fromEntries(Object.entries(numbers).map(([name, { letter, low, high, own }]) => {
        const whole = Number.isInteger(low) && high >= 100;
        const field = number(letter, own, low, high, whole ? 1 : 0.05);
        field.addEventListener("change", () => { this.state[name] = field.value; this.anew(); });
        return [name, field];
      }));
      this.seed = number("Seed of the colonies", 1, 0, 999999);
      this.seed.addEventListener("change", () => { this.state.seed = this.seed.value; this.anew(); });
      this.fields = { width: number("Columns", 24, 2, 60), height: number("Rows", 18, 2, 60), density: number("Obstacles in per cent", 25, 0, 35), seed: number("Seed of the floor", 1, 0, 999999) };
      this.add = el("button", { type: "button", class: "wl-button small", onclick: () => this.setKinds([...this.kinds(), "exponent"].slice(0, panels)) }, "Add a colony");
      this.toggle = el("button", { type: "button", class: "wl-button small", onclick: () => this.switchFactor() }, "Printed inducement");
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.group("Colonies", el("div", { class: "wl-row" }, this.toggle, this.add),
          el("p", { class: "wl-hint" }, "The first button switches the printed factor of the first colony on and off."),
          el("div", { class: "wl-lesson-fields" }, ...Object.entries(this.numbers).map(([name, field]) => labelled(numbers[name].letter, field)), labelled("Seed", this.seed))),
        this.group("Floor", el("div", { class: "wl-row" }, ...this.toolButtons()),
          el("div", { class: "wl-lesson-fields" }, labelled("Columns", this.fields.width), labelled("Rows", this.fields.height), labelled("Obstacles %", this.fields.density), labelled("Seed", this.fields.seed)),
          el("div", { class: "wl-row" }, el("button", { type: "button", class: "wl-button small", onclick: () => this.random() }, "Random floor"),
            el("button", { type: "button", class: "wl-button small", onclick: () => this.clear() }, "Clear"), this.linkButton()),
          el("p", { class: "wl-hint" }, "Drag over cells to draw or erase, drag S and G to move them.")),
        this.group("Marks", el("div", { class: "wl-lesson-marks" },
          el("div", { class: "wl-lesson-ramp", role: "img", "aria-label": "Pheromone from little to much" }), el("span", {}, "pheromone of a cell's strongest way out, 0.05 to 8"),
          el("div", { class: "wl-lesson-mark" }, el("span", { class: "wl-lesson-swatch path" }), "best way so far"),
          el("div", { class: "wl-lesson-mark" }, el("span", { class: "wl-lesson-swatch dashes" }, "┄"), "A*: the shortest"))));
      this.setTool(this.tool);
    }

    views() { return this.panels.map((panel) => panel.view); }
    steps() { return this.data.iterations; }
    cleanup() { for (const panel of this.panels) panel.view.destroy(); }
    kinds() { return this.state.panels.split("~"); }

    anew() { this.player.pause(); this.ask(); }

    setKinds(kinds) { this.state.panels = kinds.join("~"); this.anew(); }

    switchFactor() {
      const kinds = this.kinds();
      kinds[0] = kinds[0] === "literal" ? "off" : "literal";
      this.setKinds(kinds);
    }

    // ---- editing the floor

    size() {
      for (const field of Object.values(this.fields)) field.value = String(Math.max(Number(field.min), Math.min(Number(field.max), Math.round(Number(field.value) || 0))));
      const [width, height] = [Number(this.fields.width.value), Number(this.fields.height.value)];
      const inside = (text) => { const [x, y] = text.split(".").map(Number); return x < width && y < height; };
      if (!inside(this.state.start) || !inside(this.state.goal)) Object.assign(this.state, { start: "0.0", goal: `${width - 1}.${height - 1}` });
      return [width, height];
    }

    random() {
      const [width, height] = this.size();
      this.state.map = `${width}x${height}r${this.fields.density.value}s${this.fields.seed.value}`;
      this.fields.seed.value = String(Number(this.fields.seed.value) + 1);
      this.anew();
    }

    clear() { const [width, height] = this.size(); this.state.map = `${width}x${height}`; this.anew(); }

    // ---- what the server answered

    take(answer) {
      for (const [name, field] of Object.entries(this.numbers)) if (document.activeElement !== field) field.value = String(Math.round(answer.parameters[name] * 1000) / 1000);
      this.seed.value = String(answer.seed);
      if (document.activeElement !== this.fields.width) this.fields.width.value = String(answer.width);
      if (document.activeElement !== this.fields.height) this.fields.height.value = String(answer.height);
      this.add.disabled = answer.panels.length >= this.options.panels;
      this.toggle.setAttribute("aria-pressed", String(this.kinds()[0] === "literal"));
      for (const old of this.panels) old.view.destroy();
      this.panels = answer.panels.map((told, index) => this.panel(told, index));
      this.grid.dataset.panels = String(this.panels.length);
      this.grid.replaceChildren(...this.panels.map((panel) => panel.host));
      const pairs = answer.panels.flatMap((told, i) => (told.same > i ? [`Colonies ${i + 1} and ${told.same + 1} are identical: every choice of every ant, every pheromone to the last bit.`] : []));
      this.same.textContent = pairs.join(" ");
      for (const panel of this.panels) panel.view.set(this.floor);
    }

    panel(told, index) {
      const columns = wl.unpack(told.columns), tau = bytes(told.tau), counts = el("div", { class: "wl-lesson-counts" });
      const select = el("select", { class: "wl-select", "aria-label": `Colony ${index + 1}`, onchange: () => { const kinds = this.kinds(); kinds[index] = select.value; this.setKinds(kinds); } },
        ...Object.entries(this.options.kinds).map(([value, word]) => el("option", { value, selected: value === told.kind }, word)));
      const remove = el("button", { type: "button", class: "wl-tool", title: `Remove colony ${index + 1}`, "aria-label": `Remove colony ${index + 1}`, disabled: this.data.panels.length < 2,
        onclick: () => this.setKinds(this.kinds().filter((_, i) => i !== index)) }, "×");
      const view = new wl.FloorView(`Colony ${index + 1}: ${told.word}; arrows move a cursor, Enter sets an obstacle, S the start, G the goal`, {
        cells: (ctx, g, colours) => this.cells(panel, ctx, g, colours),
        paint: (ctx, g, colours) => this.paint(panel, ctx, g, colours),
        hover: (cell) => { view.draw(); view.hint(cell, cell === null ? null : this.lines(panel, cell)); },
        press: (cell) => this.press(cell),
        key: (cell, key) => this.key(cell, key),
        home: () => this.cell("start"),
      });
      const dot = el("span", { class: "wl-dot", style: `background: var(--wl-learn-v${index}); align-self: center` });
      const panel = { told, index, columns, tau, counts, view, host: el("div", { class: "wl-lesson-panel" }, el("header", {}, dot, select, remove), view.host, counts) };
      return panel;
    }

    /** The best way after so many iterations, or null. */
    way(panel, step) {
      let found = null;
      for (const [at, cells] of panel.told.ways) if (at <= step) found = cells;
      return found;
    }

    show(step) {
      for (const panel of this.panels) {
        const { told, columns } = panel, k = step - 1;
        const best = k >= 0 && columns.best[k] >= 0 ? columns.best[k] : null;
        const fact = (word, value) => el("div", {}, el("dt", {}, word), el("dd", {}, value));
        const over = best !== null && this.data.astar.steps > 0 ? ` (+${wl.number(100 * (best / this.data.astar.steps - 1), 1)} %)` : "";
        panel.counts.replaceChildren(el("dl", {}, fact("best", best === null ? "–" : `${best} steps${over}`),
          fact("lost", k < 0 ? "–" : `${columns.lost[k]} of ${this.data.ants}`),
          fact("choices", wl.number(told.choices)), fact("retreats", wl.number(told.retreats)),
          ...(told.same >= 0 ? [el("div", {}, el("dd", { class: "wl-lesson-end" }, `= colony ${told.same + 1}`))] : [])));
        panel.view.draw();
      }
      this.tell(step);
    }

    cells(panel, ctx, g, colours) {
      const k = this.player.step - 1;
      if (k < 0) return;
      ctx.fillStyle = colours.pheromone;
      for (let cell = 0; cell < panel.told.cells; cell++) {
        const level = panel.tau[k * panel.told.cells + cell];
        if (!level) continue;
        ctx.globalAlpha = 0.9 * Math.sqrt(level / 255);
        ctx.fillRect(g.left(cell), g.top(cell), g.size, g.size);
      }
      ctx.globalAlpha = 1;
    }

    line(ctx, g, cells, colour, width, dash = []) {
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.lineJoin = "round";
      ctx.setLineDash(dash);
      ctx.beginPath();
      cells.forEach((cell, i) => { const [x, y] = g.middle(cell); ctx[i ? "lineTo" : "moveTo"](x, y); });
      ctx.stroke();
      ctx.setLineDash([]);
    }

    paint(panel, ctx, g, colours) {
      const way = this.way(panel, this.player.step), wide = Math.max(2, g.size * 0.16);
      if (way) { this.line(ctx, g, way, colours["path-edge"], wide + 2); this.line(ctx, g, way, colours.path, wide); }
      this.line(ctx, g, this.data.astar.cells, colours.text, 1.5, [5, 4]);
      wl.badgeOn(ctx, g.middle(this.cell("start")), g.size, colours.start, "S", colours["mark-text"]);
      wl.badgeOn(ctx, g.middle(this.cell("goal")), g.size, colours.goal, "G", colours["mark-text"], true);
    }

    lines(panel, cell) {
      const k = this.player.step - 1, at = `(${cell % this.floor.width}, ${Math.floor(cell / this.floor.width)})`;
      if (k < 0 || this.floor.walls[cell]) return [at];
      return [at, `τ ≈ ${wl.number(0.05 + (7.95 * panel.tau[k * panel.told.cells + cell]) / 255, 2)}`];
    }

    /** The curve of the best ways so far, and the table of the colonies. */
    tell(step) {
      const { iterations, astar } = this.data, wide = 300, high = 150, left = 30, low = high - 22;
      const known = this.panels.flatMap(({ columns }) => [...columns.best].filter((n) => n >= 0)).concat(astar.steps >= 0 ? [astar.steps] : []);
      const top = Math.max(...known, 1), bottom = Math.max(0, Math.min(...known, top) - 1);
      const x = (k) => left + ((k - 1) / Math.max(1, iterations - 1)) * (wide - left - 8), y = (n) => low - ((n - bottom) / Math.max(1, top - bottom)) * (low - 12);
      const chart = svg("svg", { class: "wl-lesson-curve", viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": `Best way so far by iteration; A* needs ${astar.steps} steps` },
        svg("line", { class: "axis", x1: left, x2: wide - 8, y1: low, y2: low }), svg("line", { class: "axis", x1: left, x2: left, y1: 8, y2: low }));
      const word = (tx, ty, text, anchor) => { const node = svg("text", { x: tx, y: ty, "text-anchor": anchor }); node.textContent = text; chart.append(node); };
      word(left - 4, y(top) + 4, String(top), "end");
      if (astar.steps >= 0) { chart.append(svg("line", { class: "reference", x1: left, x2: wide - 8, y1: y(astar.steps), y2: y(astar.steps) })); word(left - 4, y(astar.steps) + 4, String(astar.steps), "end"); }
      word(left, high - 6, "1", "start"); word(wide - 8, high - 6, `iteration ${iterations}`, "end");
      this.panels.forEach(({ columns, told }, i) => {
        const points = [...columns.best].flatMap((n, k) => (n >= 0 ? [[x(k + 1), y(n)]] : []));
        // identical curves would hide each other: the later one is drawn dashed
        const dash = told.same >= 0 && told.same < i ? "6 5" : "none";
        if (points.length) chart.append(svg("path", { d: `M${points.map(([a, b]) => `${a.toFixed(1)} ${b.toFixed(1)}`).join("L")}`, style: `stroke: var(--wl-learn-v${i}); stroke-dasharray: ${dash}` }));
      });
      if (step > 0) chart.append(svg("line", { class: "at", x1: x(step), x2: x(step), y1: 8, y2: low }));
      const cell = (text) => el("td", {}, text);
      const rows = this.panels.map(({ told, columns }, i) => el("tr", {}, el("td", {}, el("span", { class: "wl-dot", style: `background: var(--wl-learn-v${i})` }), ` ${i + 1}`),
        cell(columns.best[iterations - 1] >= 0 ? String(columns.best[iterations - 1]) : "none"), cell(told.found_at ? String(told.found_at) : "–"), cell(wl.number(columns.lost.reduce((a, b) => a + b, 0)))));
      this.now.replaceChildren(el("figure", {}, el("figcaption", {}, "Best way so far, steps"), chart),
        el("table", { class: "wl-lesson-table" }, el("thead", {}, el("tr", {}, ...["colony", "steps", "found in", "lost"].map((text) => el("th", {}, text)))),
          el("tbody", {}, ...rows, el("tr", {}, cell("A*"), cell(astar.steps >= 0 ? String(astar.steps) : "none"), cell("–"), cell(`${wl.number(astar.expanded)} expansions`)))));
    }
  }

  wl.lessons = wl.lessons || {};
  wl.lessons.ants = AntsLesson;
})();
