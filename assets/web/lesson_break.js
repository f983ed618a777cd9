/* Break it: the thesis's reservation table and the corrected planner on the same small floor, side by side. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;

  const SIDES = { thesis: "As the thesis describes", corrected: "Corrected" };

  class BreakLesson extends wl.Lesson {
    build() {
      this.grid = el("div", { class: "wl-lesson-grid wl-break" });
      this.said = el("dl", { class: "wl-lesson-said" });
      this.stage.replaceChildren(this.said, this.grid);
      this.player.speed = 5;
      this.player.pace.value = "5";
      this.sides = Object.entries(SIDES).map(([side, word]) => this.panel(side, word));
      this.grid.replaceChildren(...this.sides.map((each) => each.host));
      this.controls.replaceChildren(
        this.group("What breaks", el("div", { class: "wl-row" }, ...this.examples)),
        this.group("Link", el("div", { class: "wl-row" }, this.linkButton()), (this.open = el("p", { class: "wl-hint" }))),
        this.group("Marks", el("div", { class: "wl-lesson-marks" },
          el("div", { class: "wl-lesson-mark" }, el("span", { class: "wl-lesson-swatch vehicle" }, "0"), "vehicle; the square of its colour is its goal"),
          el("div", { class: "wl-lesson-mark" }, el("span", { class: "wl-lesson-swatch broken" }), "here a rule is broken"),
          el("p", { class: "wl-hint" }, "Four steps of the playback are one tick."))));
    }

    views() { return this.sides.map((each) => each.view); }
    steps() { return this.options.parts * Math.max(...Object.values(this.data.sides).map((side) => side.ticks)); }
    cleanup() { for (const view of this.views()) view.destroy(); }

    panel(side, word) {
      const verdict = el("div", { class: "wl-lesson-verdict", "aria-live": "off" });
      const each = { side, word, verdict };
      const view = (each.view = new wl.FloorView(`${word}: the vehicles at the step of the playback`, {
        cells: (ctx, g, colours) => this.letters(ctx, g, colours),
        paint: (ctx, g, colours) => this.paint(each, ctx, g, colours),
        hover: (cell) => { view.draw(); view.hint(cell, cell === null || !this.data ? null : this.lines(each, cell)); },
        press: () => null, key: () => false, home: () => 0,
      }));
      each.host = el("div", { class: "wl-lesson-panel" }, el("header", {}, el("h3", {}, word)), view.host, verdict);
      return each;
    }

    take(answer) {
      delete this.state.map; // a case says which floor it has
      this.grid.dataset.panels = "2";
      if (answer.width > 3 * answer.height) this.grid.dataset.stack = "2"; else delete this.grid.dataset.stack;
      const pair = (word, text) => [el("dt", {}, word), el("dd", {}, text)];
      this.said.replaceChildren(...pair("The thesis", answer.said), ...pair("What happens", answer.broken), ...pair("What prevents it", answer.rule));
      this.open.replaceChildren("Scenario: ", el("code", {}, answer.scenario));
      for (const view of this.views()) view.set(this.floor);
    }

    get time() { return this.player.step / this.options.parts; }

    /** How a side ended: the judge's word, and its sentence. */
    verdict(told) {
      const n = told.breaches.length, capital = (text) => text[0].toUpperCase() + text.slice(1);
      if (n) return ["bad", `${n} breach${n > 1 ? "es" : ""}`, `${capital(told.breaches[0].text)}${n > 1 ? `, and ${n - 1} more` : ""}.`];
      if (told.no_way.length) return ["bad", "no way", `No rule is broken, but ${told.no_way[0]}.`];
      return ["ok", "0 breaches", `The judge finds nothing; everybody is done after ${told.ticks} s.`];
    }

    show() {
      const { time } = this;
      for (const each of this.sides) {
        const told = this.data.sides[each.side], [kind, word, text] = this.verdict(told);
        const first = told.breaches[0], due = first && time < first.tick + 0.5;
        each.verdict.replaceChildren(el("span", { class: `wl-badge ${kind}` }, word), due ? `${text} (still to come)` : text);
        each.view.draw();
      }
      this.tell();
    }

    /** Where a vehicle is: its cell, the next, and the part of the way between. */
    position(way, time) {
      const at = Math.min(Math.floor(time), way.cells.length - 1), next = Math.min(at + 1, way.cells.length - 1);
      return [way.cells[at], way.cells[next], at === next ? 0 : time - at];
    }

    letters(ctx, g, colours) {
      if (!this.data) return;
      const arrows = { ">": "→", "<": "←", "^": "↑", v: "↓" };
      ctx.fillStyle = colours.chain;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.font = `600 ${Math.max(8, Math.min(18, Math.round(g.size * 0.4)))}px system-ui, sans-serif`;
      [...this.data.letters].forEach((letter, cell) => {
        if (letter === "." || letter === "#" || g.size < 9) return;
        const [x, y] = g.middle(cell);
        ctx.fillText(arrows[letter] || letter, x, y);
      });
    }

    paint(each, ctx, g, colours) {
      if (!this.data) return;
      const told = this.data.sides[each.side], colour = (k) => colours[`v${k % 5}`], { time } = this;
      this.data.goals.forEach((goal, k) => {
        const [x, y] = g.middle(goal), r = g.size * 0.4;
        ctx.strokeStyle = colour(k);
        ctx.lineWidth = Math.max(1.5, g.size * 0.05);
        ctx.strokeRect(x - r, y - r, 2 * r, 2 * r);
      });
      const now = told.breaches.filter((breach) => breach.cell >= 0 && time >= breach.tick && time <= breach.tick + 1.5);
      const spots = told.ways.map((way) => {
        const [from, to, part] = this.position(way, time), [ax, ay] = g.middle(from), [bx, by] = g.middle(to);
        return [ax + (bx - ax) * part, ay + (by - ay) * part];
      });
      spots.forEach(([x0, y0], k) => {
        // those in one spot are drawn side by side, or a collision would show one vehicle
        const same = spots.flatMap(([x, y], j) => (Math.hypot(x - x0, y - y0) < g.size * 0.2 ? [j] : [])), many = same.length > 1;
        const r = Math.max(5, g.size * (many ? 0.2 : 0.29)), x = x0 + (many ? (same.indexOf(k) - (same.length - 1) / 2) * 2.1 * r : 0);
        ctx.fillStyle = colour(k);
        ctx.beginPath(); ctx.roundRect(x - r, y0 - r, 2 * r, 2 * r, r * 0.4); ctx.fill();
        ctx.fillStyle = colours["mark-text"];
        ctx.font = `700 ${Math.max(8, Math.round(r))}px system-ui, sans-serif`;
        ctx.textAlign = "center"; ctx.textBaseline = "middle";
        ctx.fillText(String(k), x, y0 + 1);
      });
      if (this.data.battery) this.charge(told, ctx, g, colours);
      ctx.strokeStyle = colours.conflict;
      for (const breach of now) {
        ctx.lineWidth = Math.max(2, Math.min(4, g.size * 0.08));
        const at = breach.vehicles.map((v) => spots[v]), x = at.reduce((sum, p) => sum + p[0], 0) / at.length, y = at.reduce((sum, p) => sum + p[1], 0) / at.length, r = g.size * 0.62;
        ctx.beginPath(); ctx.arc(x, y, r, 0, 2 * Math.PI); ctx.stroke();
      }
    }

    /** The charge of vehicle 0 as a bar above the floor; below zero in the colour of a conflict. */
    charge(told, ctx, g, colours) {
      const { soc } = told.ways[0], share = soc[Math.min(Math.floor(this.time), soc.length - 1)];
      const wide = Math.min(240, g.size * g.width), high = 16, x = g.x0 + (g.size * g.width - wide) / 2, y = g.y0 - 54, zero = x + wide * 0.3;
      ctx.strokeStyle = colours.text;
      ctx.lineWidth = 1;
      ctx.strokeRect(x, y, wide, high);
      ctx.fillStyle = share < 0 ? colours.conflict : colours["open-edge"];
      ctx.fillRect(Math.min(zero, zero + wide * 0.7 * share), y, Math.abs(wide * 0.7 * share), high);
      ctx.beginPath(); ctx.moveTo(zero, y - 4); ctx.lineTo(zero, y + high + 4); ctx.stroke();
      ctx.fillStyle = share < 0 ? colours.conflict : colours.text;
      ctx.font = "700 14px system-ui, sans-serif";
      ctx.textAlign = "center"; ctx.textBaseline = "bottom";
      ctx.fillText(`charge ${Math.round(100 * share)} %`.replace("-", "−"), x + wide / 2, y - 6);
    }

    lines(each, cell) {
      const told = this.data.sides[each.side], lines = [`(${cell % this.floor.width}, ${Math.floor(cell / this.floor.width)})`];
      this.data.goals.forEach((goal, k) => { if (goal === cell) lines.push(`goal of vehicle ${k}`); });
      told.ways.forEach((way, k) => { const when = way.cells.flatMap((at, t) => (at === cell ? [t] : [])); if (when.length) lines.push(`vehicle ${k} at tick ${when.slice(0, 6).join(", ")}${when.length > 6 ? " …" : ""}`); });
      return lines;
    }

    /** Both records at the present tick, as a table: where everybody is, and how much charge is left. */
    tell() {
      const tick = Math.floor(this.time), name = (cell) => `(${cell % this.floor.width}, ${Math.floor(cell / this.floor.width)})`;
      const percent = (way) => `${Math.round(100 * way.soc[Math.min(tick, way.soc.length - 1)])} %`;
      const at = (way) => name(way.cells[Math.min(tick, way.cells.length - 1)]) + (this.data.battery ? `, ${percent(way)}` : "");
      const { thesis, corrected } = this.data.sides;
      const rows = thesis.ways.map((way, k) => el("tr", {}, el("td", {}, el("span", { class: "wl-dot", style: `background: var(--wl-learn-v${k % 5})` }), ` ${k}`), el("td", {}, at(way)), el("td", {}, at(corrected.ways[k]))));
      this.now.replaceChildren(el("h2", {}, `Tick ${tick}`),
        el("table", { class: "wl-lesson-table" }, el("thead", {}, el("tr", {}, ...["vehicle", "thesis", "corrected"].map((word) => el("th", {}, word)))), el("tbody", {}, ...rows)),
        el("p", { class: "wl-hint" }, "The judge on the thesis: ", this.verdict(thesis)[2]));
    }
  }

  wl.lessons = wl.lessons || {};
  wl.lessons["break-it"] = BreakLesson;
})();
