/* A clock of one's own, with the transport bar and the status that show it. A stage says what time means to it. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 32, 64];
  const ASK_MS = 30;

  wl.Player = class {
    /** config: t_end (s), tick_s. A subclass has show(time, snap): draw a moment, and written(): keep it in the address. */
    constructor(config) {
      this.config = config;
      this.time = 0;               // seconds shown
      this.end = config.t_end || 0;
      this.playing = false;
      this.speed = 1;
      this.marks = [];
      this.frames = [];            // when the last ones came
    }

    /** The moment that an address asks for, or null. */
    static startIn(query) {
      const t = query.get("t");
      return t !== null && t !== "" && Number.isFinite(Number(t)) ? Number(t) : null;
    }

    destroy() {
      this.gone = true;
      clearInterval(this.beat);
      cancelAnimationFrame(this.raf);
      for (const id of ["wl-status", "transport"]) { const node = document.getElementById(id); if (node) node.replaceChildren(); }
    }

    // ---- time

    seek(time, snap = false) {
      const clamped = Math.max(0, Math.min(this.end, time)), far = Math.abs(clamped - this.time) > 4;
      this.time = clamped;
      this.dirty = true;
      this.show(clamped, snap || far);
      this.written();
    }

    toEnd() { this.playing = false; this.seek(this.end); }

    step(ticks) {
      this.playing = false;
      const tick = Math.round(this.time / this.config.tick_s) + ticks;
      this.seek(tick * this.config.tick_s);
    }

    toggle() {
      this.playing = !this.playing;
      if (this.playing && this.time >= this.end - 1e-9) this.seek(0, true);
      this.lastLoop = performance.now();
      if (this.playing) this.raf = requestAnimationFrame((now) => this._loop(now));
      else this.show(this.time, false);   // what was asked for last may be a moment older
    }

    get asked() { return this.speed; }

    setSpeed(speed) { this.speed = speed || 64; }

    faster(by) {
      const now = this.asked;
      const at = now === 0 ? SPEEDS.length : SPEEDS.findIndex((s) => s >= now - 1e-6);
      const next = (at < 0 ? SPEEDS.length - 1 : at) + by;
      if (next >= SPEEDS.length) { this.beyond(); return; }
      this.setSpeed(SPEEDS[Math.max(0, next)]);
    }

    /** Faster than the fastest: one's own clock has nothing there. */
    beyond() {}

    toEvent(way) {
      const times = this.marks.map((m) => m.t).sort((a, b) => a - b);
      const next = way > 0 ? times.find((t) => t > this.time + 1e-6) : times.reverse().find((t) => t < this.time - 1e-6);
      if (next !== undefined) { this.playing = false; this.seek(next); }
    }

    _loop(now) {
      if (this.gone || !this.playing) return;
      const passed = Math.max(0, Math.min(0.25, (now - this.lastLoop) / 1000));   // the first frame may have begun before
      this.lastLoop = now;
      this.time += passed * this.speed;
      if (this.time >= this.end) { this.time = this.end; this.playing = false; }
      if (now - (this.lastAsk || 0) >= ASK_MS || !this.playing) { this.lastAsk = now; this.show(this.time, false); }
      this.dirty = true;
      if (this.playing) this.raf = requestAnimationFrame((next) => this._loop(next));
      else this.written();
    }

    // ---- what Dash tells a stage with tabs, also when the answer comes after the page has changed

    extra() {}

    acknowledge() {}

    setTab() {}

    // ---- the status in the top bar

    buildStatus() {
      const host = document.getElementById("wl-status");
      if (!host) return;
      this.chip = el("span", { class: "wl-chip", role: "status" }, "…");
      this.clockText = el("span", { class: "wl-clock", title: "Simulated time" }, "--:--:--");
      this.rates = el("span", { class: "wl-rates" });
      host.replaceChildren(this.chip, this.clockText, this.rates);
    }

    /** mode: the chip's word · more: what else the rates say. */
    showStatus(now, mode, more = []) {
      if (this.chip.dataset.mode !== mode) { this.chip.dataset.mode = mode; this.chip.textContent = mode; }
      this.clockText.textContent = wl.clock(this.time);
      this.clockText.title = `Simulated time, tick ${Math.floor(this.time / this.config.tick_s + 1e-6)}`;
      while (this.frames.length && this.frames[0] < now - 2000) this.frames.shift();
      const rate = this.frames.length / 2;
      const lag = this.frames.length ? now - this.frames[this.frames.length - 1] : null;
      const parts = rate > 0 || mode === "LIVE" ? [`${rate.toFixed(rate < 10 ? 1 : 0)} updates/s`] : [];
      if (lag !== null && rate > 0.5 && mode === "LIVE") parts.push(`lag ${Math.round(lag)} ms`);
      const text = [...parts, ...more].join(" · ");
      if (now - (this.ratesAt || 0) > 500) { this.rates.textContent = text; this.ratesAt = now; }
    }

    // ---- the transport bar

    /** last: what the button at the end does. */
    buildTransport(last) {
      this.begun = performance.now();
      const bar = document.getElementById("transport");
      const text = (label, name, onclick) => el("button", { type: "button", class: "wl-tool wide", "aria-label": name, title: name, onclick }, label);
      this.playButton = el("button", { type: "button", class: "wl-tool play", id: "play", onclick: () => this.toggle() }, wl.icon("pause"));
      this.speedChoice = el("select", { class: "wl-select", id: "speed", "aria-label": "Speed" },
        ...SPEEDS.map((s) => el("option", { value: s }, `${s}×`)), el("option", { value: 0 }, "max"));
      this.speedChoice.addEventListener("change", () => this.setSpeed(Number(this.speedChoice.value)));
      this.reached = el("span", { class: "wl-reached" });
      this.timeBox = el("input", { type: "text", class: "wl-time", id: "time", "aria-label": "Time, as 00:12:30 or a tick", autocomplete: "off", spellcheck: "false" });
      const goTo = () => {
        const t = wl.parseTime(this.timeBox.value, this.config.tick_s);
        if (t === null) { this.timeBox.setAttribute("aria-invalid", "true"); wl.notify("Not a time", "Type 00:12:30, 12:30, 90s or a tick such as 750.", "warning"); return; }
        this.timeBox.removeAttribute("aria-invalid");
        this.playing = false;
        this.seek(t, true);
        this.timeBox.blur();
      };
      this.timeBox.addEventListener("keydown", (event) => { if (event.key === "Enter") goTo(); else if (event.key === "Escape") this.timeBox.blur(); });
      this.timeBox.addEventListener("blur", () => this.timeBox.removeAttribute("aria-invalid"));
      this.endText = el("span", { class: "wl-end" });
      this.note = el("button", { type: "button", class: "wl-note", hidden: true });
      const rulerHost = el("div", { class: "wl-ruler" });
      bar.replaceChildren(
        el("div", { class: "wl-buttons", role: "group", "aria-label": "Time" },
          wl.toolButton("first", "To the start (Home)", () => { this.playing = false; this.seek(0, true); }),
          text("−10", "Ten ticks back (Shift+←)", () => this.step(-10)),
          text("−1", "One tick back (←)", () => this.step(-1)),
          this.playButton,
          text("+1", "One tick on (→)", () => this.step(1)),
          text("+10", "Ten ticks on (Shift+→)", () => this.step(10)),
          wl.toolButton("last", last, () => this.toLive())),
        el("div", { class: "wl-pace" }, this.speedChoice, this.reached),
        el("div", { class: "wl-when" }, this.timeBox, this.endText),
        this.note, rulerHost);
      this.ruler = new wl.Ruler(rulerHost, { seek: (t) => { this.playing = false; this.seek(t); } });
      this.bar = bar;
    }

    toLive() { this.toEnd(); }

    /** running: what the play button offers to stop · label: what it is called · mine: the clock is one's own · reached: beside the speed. */
    showTransport({ running = this.playing, label, mine = true, reached = "my view" } = {}) {
      const name = label || (running ? "Pause my view (Space)" : "Play my view (Space)");
      if (this.playButton.title !== name) {
        this.playButton.title = name;
        this.playButton.setAttribute("aria-label", name);
        this.playButton.replaceChildren(wl.icon(running ? "pause" : "play"));
      }
      this.bar.classList.toggle("mine", mine);
      if (document.activeElement !== this.speedChoice && performance.now() - (this.speedHeld || 0) > 800) {
        const value = String(this.asked);
        if (this.speedChoice.value !== value && [...this.speedChoice.options].some((o) => o.value === value)) this.speedChoice.value = value;
      }
      this.speedChoice.lastElementChild.hidden = mine;
      if (this.reached.textContent !== reached) this.reached.textContent = reached;
      if (document.activeElement !== this.timeBox) this.timeBox.value = wl.clock(this.time);
      const end = `/ ${wl.clock(this.end)}`;
      if (this.endText.textContent !== end) this.endText.textContent = end;
      this.ruler.draw(this);
    }
  };
})();
