/* Motor to battery: sliders for one drive, its curves over time, and its energy by component. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;
  const LEFT = "wl-learn-v0", RIGHT = "wl-learn-v1";
  const STEPS_PER_S = 25;

  const sides = (name) => [{ key: `${name}_l`, name: "left", colour: LEFT }, { key: `${name}_r`, name: "right", colour: RIGHT, dash: true }];
  const CHARTS = [
    { title: "Speed", unit: "m/s", digits: 2, lines: [{ key: "v", name: "", colour: LEFT }] },
    { title: "Wheels", unit: "rad/s", digits: 1, lines: sides("wheel") },
    { title: "Torque at the wheels", unit: "N·m", digits: 1, lines: sides("torque") },
    { title: "Current of the motors", unit: "A", digits: 1, lines: sides("current") },
    { title: "Voltage of the motors", unit: "V", digits: 1, lines: [...sides("voltage"), { key: "terminal", name: "battery gives", colour: "wl-learn-goal" }] },
    { title: "Power", unit: "W", digits: 0, lines: ["copper", "rolling", "inertia", "standby", "recovered"].map((key) => ({ key, name: key, colour: `wl-energy-${key}`, area: true })) },
    { title: "Energy", unit: "J", digits: 0, lines: [{ key: "ours", name: "drawn", colour: LEFT }, { key: "paper", name: "paper's formula", colour: RIGHT }, { key: "kinetic", name: "kinetic", colour: "wl-muted", dash: true }] },
    { title: "State of charge", unit: "%", digits: 2, zero: false, lines: [{ key: "soc", name: "", colour: "wl-learn-v3" }] },
  ];
  const PARTS = { copper: "copper R i²", rolling: "rolling", starting: "speeding up", turning: "turning", standby: "standby", recovered: "recovered" };
  const OF_CHART = { starting: "inertia", turning: "inertia" };

  class MotorLesson extends wl.Lesson {
    build() {
      this.limits = el("div", { class: "wl-lesson-limits", role: "alert", hidden: true });
      this.status = el("p", { class: "wl-lesson-status", role: "status" });
      const pick = (step) => { this.player.pause(); this.player.seek(step); };
      this.plots = CHARTS.map((chart) => new wl.Plot({ ...chart, x: "s", pick }));
      this.stage.replaceChildren(this.status, this.limits, el("div", { class: "wl-lesson-plots" }, ...this.plots.map((plot) => plot.host)));
      this.player.speed = STEPS_PER_S;
      this.player.pace.value = String(STEPS_PER_S);
      this.sliders = {};
      this.shownValues = {};
      const rows = Object.entries(this.options.sliders).map(([key, { word, unit, low, high, step }]) => {
        const slider = el("input", { type: "range", min: low, max: high, step, "aria-label": `${word} in ${unit}`, class: "wl-lesson-scrub", oninput: () => this.set(key, slider.value) });
        this.sliders[key] = slider;
        this.shownValues[key] = el("output", {}, "");
        return el("label", { class: "wl-lesson-slider" }, el("span", {}, word), this.shownValues[key], slider);
      });
      this.controls.replaceChildren(
        this.group("Examples", el("div", { class: "wl-row" }, ...this.examples)),
        this.early("The drive", ...rows, el("div", { class: "wl-row" }, this.linkButton())));
    }

    views() { return []; }
    steps() { return this.data.curves.t.length - 1; }
    cleanup() { for (const plot of this.plots) plot.destroy(); }

    set(key, value) {
      const { step } = this.options.sliders[key];
      this.state[key] = Number(value).toFixed(step < 1 ? 1 : 0);
      this.told(key);
      this.ask();
    }

    told(key) {
      const { unit } = this.options.sliders[key], value = this.state[key];
      this.shownValues[key].textContent = `${value}${unit === "°" ? "" : " "}${unit}`;
      this.sliders[key].setAttribute("aria-valuetext", `${value} ${unit}`);
    }

    takeAll(answer) {
      this.data = answer;
      for (const [key, slider] of Object.entries(this.sliders)) {
        if (document.activeElement !== slider) slider.value = this.state[key];
        this.told(key);
      }
      const { t } = answer.curves;
      for (const plot of this.plots) plot.set(t, answer.curves);
      this.limits.replaceChildren(...answer.limits.map((sentence) => el("p", {}, sentence)));
      this.limits.hidden = !answer.limits.length;
      const share = `${wl.number(100 * answer.share, 1)} %`;
      this.status.replaceChildren(el("b", {}, `${wl.number(answer.total, 0)} J`), ` in ${wl.number(answer.duration, 1)} s, of which the motors take `, el("b", {}, share), ". ",
        answer.drives ? `${wl.number(100 * answer.used, 2)} % of the charge: ${wl.number(answer.drives)} such drives on a full battery.` : "");
      this.status.classList.toggle("bad", answer.limits.length > 0);
      return true;
    }

    show(step) {
      for (const plot of this.plots) plot.cursor(step);
      this.tell(step);
    }

    tell(step) {
      const { curves, energy, paper, total } = this.data, at = (name, digits) => (curves[name] ? wl.number(curves[name][step], digits) : "–");
      const pair = (name, digits, unit) => `${at(`${name}_l`, digits)} / ${at(`${name}_r`, digits)} ${unit}`;
      const fact = (word, value) => [el("dt", {}, word), el("dd", {}, value)];
      const row = (name, ...cells) => el("tr", {}, name, ...cells.map((text) => el("td", {}, text)));
      const word = (key) => {
        const mark = el("i", { class: "wl-plot-key area", "aria-hidden": "true" });
        mark.style.color = `var(--wl-energy-${OF_CHART[key] || key})`;
        return el("td", {}, mark, PARTS[key]);
      };
      const percent = (value) => `${wl.number((100 * value) / total, 0)} %`, joules = (value) => `${wl.number(value, 0)} J`;
      const others = energy.standby, motion = paper.corrected - others;
      this.now.replaceChildren(
        el("h2", {}, `At ${wl.number(curves.t[step], 1)} s: ${this.data.doing[step]}`),
        el("dl", { class: "wl-facts" }, ...fact("Wheels, left / right", pair("wheel", 1, "rad/s")), ...fact("Torque at the wheels", pair("torque", 1, "N·m")),
          ...fact("Motor current", pair("current", 1, "A")), ...fact("Motor voltage", pair("voltage", 1, "V")),
          ...fact("Battery", `${at("terminal", 1)} V, ${at("drawn", 1)} A`)),
        el("h2", {}, "Energy of the drive"),
        el("table", { class: "wl-lesson-table" },
          el("tbody", {}, ...Object.keys(PARTS).filter((key) => energy[key]).map((key) => row(word(key), joules(energy[key]), total ? `${wl.number((100 * energy[key]) / total, 1)} %` : "")),
            row(el("td", {}, el("b", {}, "together")), joules(total), "100 %"))),
        el("h2", {}, "The paper's formula, in % of ours"),
        el("table", { class: "wl-lesson-table" },
          el("tbody", {}, row(el("td", {}, `½ m v² of ${this.state.turn !== "0" ? "both starts" : "the start"}`), joules(motion), ""), row(el("td", {}, "others P·t"), joules(others), ""),
            row(el("td", {}, el("b", {}, "together")), joules(paper.corrected), percent(paper.corrected)),
            row(el("td", {}, "as ¼ m (v_l + v_r)², printed"), joules(paper.quarter), percent(paper.quarter)), row(el("td", {}, "as ¼ m r (ω_l + ω_r)², printed"), joules(paper.radius), percent(paper.radius)))));
    }
  }

  wl.lessons.motor = MotorLesson;
})();
