/* Heuristics matrix: heuristics and connectivities of A* side by side; a playback like search, counted in cells. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;

  class HeuristicsLesson extends wl.SearchLesson {
    build() {
      super.build();
      this.grid.classList.add("matrix");
    }

    newPanel(index) { return new HeuristicsPanel(this, index); }

    /** All searches as a table: what each has expanded, and how long its way is. */
    idle() {
      const row = (panel) => {
        const { trace } = panel, [mode, heuristic] = panel.spec(), known = panel.ended && trace.solved;
        const word = `${this.options.algorithms[mode].word}, ${this.options.heuristics[heuristic]}${trace.admissible ? "" : " *"}`;
        return el("tr", {}, el("td", {}, word), el("td", {}, wl.number(panel.done)), el("td", {}, known ? wl.number(trace.cost / 1000, 2) : "–"));
      };
      const head = ["search", "expanded", "length"].map((word) => el("th", {}, word));
      return [el("h2", {}, "The matrix"), el("table", { class: "wl-lesson-table matrix" }, el("thead", {}, el("tr", {}, ...head)), el("tbody", {}, ...this.panels.map(row))),
        el("p", { class: "wl-hint" }, `${this.panels.some((panel) => !panel.trace.admissible) ? "* not admissible with these neighbours. " : ""}Point at a cell of a map: its g, h and f in every search.`)];
    }
  }

  class HeuristicsPanel extends wl.SearchPanel {
    constructor(lesson, index) {
      super(lesson, index);
      this.digits = 2;
      this.algorithm.title = "Connectivity";
      this.algorithm.setAttribute("aria-label", `Connectivity of search ${index + 1}`);
    }

    totals(last) {
      const { trace, rows } = this, solved = this.ended && trace.solved;
      const length = solved ? trace.cost : last >= 0 ? rows.g[last] : 0;
      const nodes = 1 + (solved ? trace.length : last >= 0 ? rows.steps[last] : 0);
      return [this.item(wl.number(length / 1000, 2), "long"), this.item(wl.number(nodes), nodes === 1 ? "node" : "nodes")];
    }

    mark() {
      const more = this.trace.longer;
      return more < 0.00005 ? el("span", { class: "wl-badge ok" }, "shortest") : el("span", { class: "wl-badge warn" }, `+${wl.number(100 * more, 1)} %`);
    }
  }

  wl.lessons.heuristics = HeuristicsLesson;
})();
