/* A small chart of a lesson: lines or stacked areas over one axis, with a cursor that follows the lesson's step. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el, svg } = wl;
  const LEFT = 46, RIGHT = 10, TOP = 6, BOTTOM = 20;

  /** Round numbers from low to high, at least about `many` of them. */
  const ticksOf = (low, high, many) => {
    const raw = (high - low) / many, ten = 10 ** Math.floor(Math.log10(raw)), step = [5, 2, 1].map((s) => s * ten).find((s) => s <= raw * (1 + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return { at: found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  };

  wl.Plot = class {
    /** title · unit of the values · x: unit of the axis · lines: {key, name, colour (a custom property's name), dash, area}
     *  · digits of the values · pick(index): a point of the axis was chosen · zero: the values' axis begins at 0. */
    constructor({ title, unit, x, lines, digits = 1, pick = null, zero = true }) {
      Object.assign(this, { title, unit, xUnit: x, lines, digits, pick, zero });
      this.values = Object.fromEntries(lines.map(({ key }) => [key, el("b", {}, "–")]));
      this.keys = el("span", { class: "wl-plot-keys" }, ...lines.map((line) => {
        const swatch = el("i", { class: `wl-plot-key${line.area ? " area" : ""}`, "aria-hidden": "true" });
        swatch.style.color = `var(--${line.colour})`;
        if (line.dash) swatch.style.borderTopStyle = "dashed";
        return el("span", {}, swatch, `${line.name} `, this.values[line.key]);
      }));
      this.svg = svg("svg", { role: "img", "aria-label": `${title} in ${unit}` });
      this.box = el("div", { class: "wl-plot-box" }, this.svg);
      this.host = el("figure", { class: "wl-plot" }, el("figcaption", {}, el("b", {}, title), ` ${unit}`, this.keys), this.box);
      this.size = new ResizeObserver(() => this.draw());
      this.size.observe(this.box);
      if (pick) {
        const choose = (event) => { if (this.xs && event.buttons & 1) this.pick(this._nearest(event)); };
        this.svg.addEventListener("pointerdown", (event) => { this.svg.setPointerCapture(event.pointerId); choose(event); });
        this.svg.addEventListener("pointermove", choose);
      }
    }

    destroy() { this.size.disconnect(); }

    /** xs ascending · series: by key, as long as xs; a line without one is not drawn. */
    set(xs, series) {
      this.xs = xs;
      this.series = series;
      for (const { key } of this.lines) this.values[key].parentElement.hidden = !series[key];
      this.draw();
    }

    /** Marks one index and tells its values. */
    cursor(index) {
      this.index = index;
      if (!this.xs) return;
      for (const { key } of this.lines) if (this.series[key]) this.values[key].textContent = wl.number(this.series[key][index], this.digits);
      if (this.mark) this.mark.setAttribute("d", this._upright(index));
    }

    _upright(index) { const x = this.toX(this.xs[index]).toFixed(1); return `M${x} ${TOP}V${this.high - BOTTOM}`; }

    _nearest(event) {
      const x = event.clientX - this.svg.getBoundingClientRect().left;
      let best = 0;
      this.xs.forEach((value, i) => { if (Math.abs(this.toX(value) - x) < Math.abs(this.toX(this.xs[best]) - x)) best = i; });
      return best;
    }

    /** Lower and upper edge of each line: areas stand on one another, those below zero hang from it. */
    _edges() {
      const n = this.xs.length, above = new Float64Array(n), below = new Float64Array(n), edges = {};
      for (const { key, area } of this.lines) {
        const values = this.series[key];
        if (!values) continue;
        if (!area) { edges[key] = [null, values]; continue; }
        const from = new Float64Array(n), to = new Float64Array(n);
        values.forEach((value, i) => { const base = value < 0 ? below : above; from[i] = base[i]; base[i] += value; to[i] = base[i]; });
        edges[key] = [from, to];
      }
      return edges;
    }

    draw() {
      const wide = this.box.clientWidth, high = this.box.clientHeight;
      if (!this.xs || !wide || !high) return;
      this.high = high;
      const edges = this._edges(), all = Object.values(edges).flatMap(([from, to]) => [...to, ...(from || [])]);
      let low = Math.min(...all, this.zero ? 0 : Infinity), top = Math.max(...all, this.zero ? 0 : -Infinity);
      if (top - low < 1e-9) top = low + 1;
      const room = 0.06 * (top - low);
      top += room;
      if (low < 0 || !this.zero) low -= room;
      const first = this.xs[0], last = this.xs[this.xs.length - 1];
      this.toX = (x) => LEFT + ((x - first) / (last - first || 1)) * (wide - LEFT - RIGHT);
      const toY = (y) => TOP + ((top - y) / (top - low)) * (high - TOP - BOTTOM);
      const path = (ys, back = false) => [...this.xs.keys()].map((_, i, { length }) => {
        const k = back ? length - 1 - i : i;
        return `${i || back ? "L" : "M"}${this.toX(this.xs[k]).toFixed(1)} ${toY(ys[k]).toFixed(1)}`;
      }).join("");
      const grid = [], label = (x, y, text, anchor) => svg("text", { x, y, "text-anchor": anchor }, text);
      const rows = ticksOf(low, top, Math.max(2, Math.floor(high / 45))), columns = ticksOf(first, last, Math.max(3, Math.floor(wide / 90)));
      for (const y of rows.at) grid.push(svg("path", { class: "wl-plot-grid", d: `M${LEFT} ${toY(y).toFixed(1)}H${wide - RIGHT}` }), label(LEFT - 5, toY(y) + 4, wl.number(y, rows.digits), "end"));
      for (const x of columns.at) grid.push(label(this.toX(x), high - 6, `${wl.number(x, columns.digits)}${x === columns.at[columns.at.length - 1] ? ` ${this.xUnit}` : ""}`, x > last - 0.06 * (last - first) ? "end" : "middle"));
      const drawn = this.lines.filter(({ key }) => edges[key]).map(({ key, colour, dash, area }) => {
        const [from, to] = edges[key];
        const shape = svg("path", { class: `wl-plot-line${area ? " area" : ""}${dash ? " dash" : ""}`, d: area ? `${path(to)}${path(from, true)}Z` : path(to) });
        shape.style.color = `var(--${colour})`;
        return shape;
      });
      this.mark = svg("path", { class: "wl-plot-cursor" });
      this.svg.setAttribute("viewBox", `0 0 ${wide} ${high}`);
      this.svg.replaceChildren(...grid, ...drawn, this.mark);
      if (this.index !== undefined) this.cursor(Math.min(this.index, this.xs.length - 1));
    }
  };
})();
