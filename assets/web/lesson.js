/* What all lessons share: playing step by step, the address, asking the server, and a floor that can be drawn on. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { el } = wl;

  /** Lesson name → class with the constructor (config); added to by the lessons' own files. */
  wl.lessons = wl.lessons || {};

  const SPEEDS = [1, 2, 5, 10, 25, 50, 100, 250];
  const ADDRESS_MS = 250, SLOW_MS = 1500;
  /** What of a state only says where one is looking: an example stays one while it changes. */
  const MOMENT = new Set(["step", "node", "time", "show", "scale"]);

  wl.number = (value, digits = 0) => value.toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "negative" });
  wl.joules = (mj) => `${wl.number(mj / 1000, 1)} J`;

  /** Columns of 32-bit integers as the server packs them. */
  wl.unpack = (columns) => Object.fromEntries(Object.entries(columns).map(([name, text]) => {
    const raw = atob(text), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return [name, new Int32Array(bytes.buffer)];
  }));

  /** A floor as its address holds it: sides, and obstacles as bits in base64url, row by row from the bottom. */
  wl.floorText = (floor) => {
    const sides = `${floor.width}x${floor.height}`;
    if (!floor.walls.includes(1)) return sides;
    const bytes = new Uint8Array(Math.ceil(floor.walls.length / 8));
    floor.walls.forEach((wall, i) => { if (wall) bytes[i >> 3] |= 1 << (i & 7); });
    return `${sides}b${btoa(String.fromCharCode(...bytes)).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "")}`;
  };

  /** Colours of the lessons, from the style sheet. */
  wl.learnColours = () => {
    const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue(`--wl-learn-${name}`).trim();
    return Object.fromEntries(["free", "wall", "line", "open", "open-edge", "closed", "path", "path-edge", "chain", "now", "start", "goal", "text",
      "mark-text", "pruned", "conflict", "pheromone", "v0", "v1", "v2", "v3", "v4"].map((name) => [name, read(name)]));
  };

  // ---- transport

  /** The bar below a lesson: step, play, speed, scrub. `show(step)` is called for every new step. */
  class Player {
    constructor(host, show) {
      this.show = show;
      this.step = 0;
      this.last = 0;
      this.playing = false;
      this.speed = 10;
      this.loop = this.loop.bind(this);
      const tool = (content, label, act, extra = "") => el("button", { type: "button", class: `wl-tool ${extra}`, title: label, "aria-label": label, onclick: act }, content);
      const icon = (name) => el("span", { class: `wl-icon wl-icon-${name}`, "aria-hidden": "true" });
      this.play = tool(icon("play"), "Play (Space)", () => this.toggle(), "play");
      this.slider = el("input", { type: "range", min: 0, max: 0, value: 0, class: "wl-lesson-scrub", "aria-label": "Step", oninput: () => { this.pause(); this.seek(Number(this.slider.value)); } });
      this.field = el("input", { type: "number", min: 0, value: 0, class: "wl-time", "aria-label": "Step number", onchange: () => { this.pause(); this.seek(Number(this.field.value) || 0); } });
      this.total = el("span", {}, "/ 0");
      this.pace = el("select", { class: "wl-select", "aria-label": "Steps per second", onchange: () => { this.speed = Number(this.pace.value); } },
        ...SPEEDS.map((speed) => el("option", { value: speed, selected: speed === this.speed }, `${speed}/s`)));
      this.note = el("span", { class: "wl-lesson-note", role: "status" });
      host.replaceChildren(
        el("div", { class: "wl-buttons" },
          tool(icon("first"), "To the start (Home)", () => { this.pause(); this.seek(0); }),
          tool("−10", "Ten steps back (Shift ←)", () => { this.pause(); this.seek(this.step - 10); }),
          tool("−1", "One step back (←)", () => { this.pause(); this.seek(this.step - 1); }),
          this.play,
          tool("+1", "One step on (→)", () => { this.pause(); this.seek(this.step + 1); }),
          tool("+10", "Ten steps on (Shift →)", () => { this.pause(); this.seek(this.step + 10); }),
          tool(icon("last"), "To the end (End)", () => { this.pause(); this.seek(this.last); })),
        el("div", { class: "wl-pace" }, this.pace),
        el("div", { class: "wl-when" }, this.field, this.total),
        this.slider, this.note);
    }

    /** A new number of steps; the step is kept where it can be. */
    length(last) {
      this.last = last;
      this.slider.max = String(last);
      this.field.max = String(last);
      this.total.textContent = `/ ${wl.number(last)}`;
      this.seek(this.step);
    }

    seek(step) {
      this.step = Math.max(0, Math.min(this.last, Math.round(step)));
      this.slider.value = String(this.step);
      if (document.activeElement !== this.field) this.field.value = String(this.step);
      else if (Number(this.field.value) !== this.step) this.field.value = String(this.step);
      this.show(this.step);
    }

    toggle() {
      if (this.playing) { this.pause(); return; }
      if (this.step >= this.last) this.seek(0);
      this.playing = true;
      this.due = 0;
      this.before = performance.now();
      this._mark();
      requestAnimationFrame(this.loop);
    }

    pause() { this.playing = false; this._mark(); }

    faster(way) {
      const at = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.speed) + way));
      this.speed = SPEEDS[at];
      this.pace.value = String(this.speed);
    }

    loop(now) {
      if (!this.playing) return;
      if (!this.slider.isConnected) { this.playing = false; return; }
      this.due += (Math.min(now - this.before, 500) / 1000) * this.speed;
      this.before = now;
      const whole = Math.floor(this.due);
      if (whole > 0) { this.due -= whole; this.seek(this.step + whole); }
      if (this.step >= this.last) this.pause();
      else requestAnimationFrame(this.loop);
    }

    _mark() {
      this.play.firstChild.className = `wl-icon wl-icon-${this.playing ? "pause" : "play"}`;
      this.play.setAttribute("aria-label", this.playing ? "Pause (Space)" : "Play (Space)");
      this.play.title = this.play.getAttribute("aria-label");
    }
  }
  wl.Player = Player;

  // ---- a lesson

  /** State, address, questions to the server. A lesson's own class adds `build`, `take(answer)`, `show(step)`. */
  class Lesson {
    constructor(config) {
      this.config = config;
      this.options = config.options;
      this.state = { ...config.state };
      this.stage = document.getElementById("lesson");
      this.controls = document.getElementById("lesson-controls");
      this.now = document.getElementById("lesson-now");
      this.player = new Player(document.getElementById("lesson-transport"), (step) => { if (this.data) { this.state.step = String(step); this.show(step); this.writeSoon(); } });
      this.asked = 0;
      this.examples = config.presets.map((preset) => el("button", { type: "button", class: "wl-button small", onclick: () => this.begin(preset) }, preset.word));
      this.build();
      this._markExample();
      this.ask();
    }

    get alive() { return this.stage.isConnected; }

    close() { this.gone = true; this.player.pause(); clearTimeout(this.writing); if (this.cleanup) this.cleanup(); }

    /** Starts from an example. */
    begin(preset) {
      this.player.pause();
      this.state = { ...preset.state };
      this.player.step = 0;
      this.begun();
      this.ask();
    }

    begun() {}

    _markExample() {
      const { state } = this;
      let look = "";
      this.config.presets.forEach((preset, i) => {
        const keys = new Set([...Object.keys(state), ...Object.keys(preset.state)]);
        const same = [...keys].every((key) => MOMENT.has(key) || (state[key] || "") === (preset.state[key] || ""));
        this.examples[i].setAttribute("aria-pressed", String(same));
        if (same) look = preset.look;
      });
      const host = document.getElementById("lesson-look");
      if (look) this.lastLook = look; // an example stays one while things in it are changed
      if (host) host.replaceChildren(el("b", {}, "What to look at. "), this.lastLook || "Change one thing at a time and compare the counts; the examples show where.");
    }

    /** Asks the server for the traces of the present state; only the newest answer counts. */
    async ask() {
      if (this.asking) { this.again = true; return; }
      this.asking = true;
      const turn = ++this.asked;
      const slow = setTimeout(() => this.say("Planning … the first time the planners are compiled, which can take a minute."), SLOW_MS);
      this.stage.setAttribute("aria-busy", "true");
      try {
        const answer = await wl.fetchJson(`/learn/${this.config.lesson}`, { method: "POST", body: JSON.stringify(this.question()) });
        if (this.gone) return;
        this.problem("");
        this.say("");
        if (!this.takeAll(answer)) return;
        this.player.step = Number(this.state.step || 0);
        this.player.length(this.steps());
        this.write();
      } catch (problem) {
        if (!this.gone) { this.say(""); this.problem(problem.message); }
      } finally {
        clearTimeout(slow);
        this.asking = false;
        if (!this.gone) {
          this._markExample();
          if (this.again) { this.again = false; this.ask(); }
          else { this.stage.removeAttribute("aria-busy"); this.stage.dataset.answers = String(turn); }
        }
      }
    }

    /** What the server is asked: the state without what only this page knows. */
    question() {
      const { step: _, ...question } = this.state;
      return question;
    }

    /** Takes an answer with its floor; false when the floor has other sides by now. */
    takeAll(answer) {
      // edited while it was on its way: what was drawn since stays, if the answer still fits it
      const kept = this.again ? this.floor : null;
      if (kept && (kept.width !== answer.width || kept.height !== answer.height)) return false;
      this.data = answer;
      if (!kept && !/r\d+s\d+$/.test(this.state.map)) this.state.map = answer.map;
      this.floor = kept || { width: answer.width, height: answer.height, walls: Uint8Array.from(answer.walls, Number) };
      this.take(answer, Boolean(kept));
      return true;
    }

    say(text) { this.player.note.textContent = text; }

    problem(text) {
      const host = document.getElementById("lesson-problem");
      // what was wrong with the address stays until something else is asked for
      if (!host || (!text && this.asked <= 1)) return;
      host.textContent = text;
      host.hidden = !text;
    }

    writeSoon() {
      clearTimeout(this.writing);
      this.writing = setTimeout(() => this.write(), ADDRESS_MS);
    }

    write() {
      clearTimeout(this.writing);
      if (this.gone || !this.alive) return;
      const query = new URLSearchParams();
      for (const key of this.config.keys) if (this.state[key] && !(key === "step" && this.state[key] === "0")) query.set(key, this.state[key]);
      history.replaceState(history.state, "", `${location.pathname}?${String(query).replaceAll("%7E", "~")}`);
    }

    async copyLink() {
      this.write();
      try {
        await navigator.clipboard.writeText(location.href);
        wl.notify("Link copied", "It opens this lesson as you see it.", "ok");
      } catch {
        await wl.prompt("Copy this link", "Address", location.href);
      }
    }

    /** A titled group of controls. */
    group(title, ...children) { return el("section", { class: "wl-lesson-group" }, el("h2", {}, title), ...children); }

    /** One that stands right below the stage on a narrow screen. */
    early(title, ...children) {
      const group = this.group(title, ...children);
      group.classList.add("early");
      return group;
    }

    linkButton() { return el("button", { type: "button", class: "wl-button small", onclick: () => this.copyLink() }, "Copy link"); }

    toolButtons() {
      const buttons = ["draw", "look"].map((tool) => el("button", { type: "button", class: "wl-button small", onclick: () => this.setTool(tool),
        title: tool === "draw" ? "Drag over cells to set or clear obstacles" : "Drag scrolls; tap a cell to read its values" }, tool === "draw" ? "Draw" : "Look only"));
      this.setTool = (tool) => {
        this.tool = tool;
        buttons.forEach((button, i) => button.setAttribute("aria-pressed", String(["draw", "look"][i] === tool)));
        for (const view of this.views()) view.canvas.style.touchAction = tool === "draw" ? "none" : "pan-y";
      };
      return buttons;
    }
  }
  wl.Lesson = Lesson;

  /** A lesson on a floor that people draw, with one start and one goal. It has `tool`, `floor` and views(). */
  class DrawnLesson extends Lesson {
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
  }
  wl.DrawnLesson = DrawnLesson;

  // ---- a floor to draw on

  /** A canvas with one floor. `on`: paint(ctx, geometry), hover(cell or null), press(cell) → drag(cell) or null, key(cell, key). */
  class FloorView {
    constructor(label, on) {
      this.on = on;
      this.label = label;
      this.cursor = null;
      this.canvas = el("canvas", { class: "wl-lesson-canvas", tabindex: 0, role: "img", "aria-label": label });
      this.tip = el("div", { class: "wl-tip", hidden: true });
      this.host = el("div", { class: "wl-lesson-floor" }, this.canvas, this.tip);
      this.size = new ResizeObserver(() => this.draw());
      this.size.observe(this.host);
      const c = this.canvas;
      c.addEventListener("pointerdown", (event) => this._down(event));
      c.addEventListener("pointermove", (event) => this._move(event));
      c.addEventListener("pointerup", () => this._up());
      c.addEventListener("pointercancel", () => this._up());
      c.addEventListener("pointerleave", () => { if (!this.drag && !this.touched) this._hover(null); });
      c.addEventListener("keydown", (event) => this._key(event));
      c.addEventListener("blur", () => this._hover(null));
    }

    destroy() { this.size.disconnect(); }

    set(floor) { this.floor = floor; this.draw(); }

    draw() {
      const floor = this.floor;
      if (!floor || !this.host.isConnected) return;
      const wide = this.host.clientWidth, high = this.host.clientHeight;
      if (!wide || !high) return;
      const ratio = window.devicePixelRatio || 1;
      const size = Math.max(2, Math.floor(Math.min((wide - 2) / floor.width, (high - 2) / floor.height) * ratio)) / ratio;
      const x0 = Math.round((wide - size * floor.width) / 2), y0 = Math.round((high - size * floor.height) / 2);
      const c = this.canvas;
      if (c.width !== Math.round(wide * ratio) || c.height !== Math.round(high * ratio)) {
        c.width = Math.round(wide * ratio); c.height = Math.round(high * ratio);
        c.style.width = `${wide}px`; c.style.height = `${high}px`;
      }
      const ctx = c.getContext("2d");
      ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
      ctx.clearRect(0, 0, wide, high);
      const g = this.geometry = { size, x0, y0, width: floor.width, height: floor.height,
        left: (cell) => x0 + (cell % floor.width) * size, top: (cell) => y0 + (floor.height - 1 - Math.floor(cell / floor.width)) * size,
        middle: (cell) => [x0 + (cell % floor.width + 0.5) * size, y0 + (floor.height - 0.5 - Math.floor(cell / floor.width)) * size] };
      const colours = wl.learnColours();
      ctx.fillStyle = colours.free;
      ctx.fillRect(x0, y0, size * floor.width, size * floor.height);
      if (this.on.cells) this.on.cells(ctx, g, colours);
      ctx.fillStyle = colours.wall;
      floor.walls.forEach((wall, cell) => { if (wall) ctx.fillRect(g.left(cell), g.top(cell), size, size); });
      ctx.strokeStyle = colours.line;
      ctx.lineWidth = 1;
      ctx.beginPath();
      if (size >= 5 && !floor.plain) {
        for (let x = 0; x <= floor.width; x++) { ctx.moveTo(x0 + x * size, y0); ctx.lineTo(x0 + x * size, y0 + floor.height * size); }
        for (let y = 0; y <= floor.height; y++) { ctx.moveTo(x0, y0 + y * size); ctx.lineTo(x0 + floor.width * size, y0 + y * size); }
      } else ctx.rect(x0, y0, size * floor.width, size * floor.height);
      ctx.stroke();
      this.on.paint(ctx, g, colours);
      if (this.cursor !== null) {
        ctx.strokeStyle = colours.text;
        ctx.lineWidth = 2;
        ctx.setLineDash([4, 3]);
        ctx.strokeRect(g.left(this.cursor) + 1, g.top(this.cursor) + 1, size - 2, size - 2);
        ctx.setLineDash([]);
      }
    }

    /** The cell below a point of the page, or null. */
    at(event) {
      const g = this.geometry;
      if (!g) return null;
      const box = this.canvas.getBoundingClientRect();
      const x = Math.floor((event.clientX - box.left - g.x0) / g.size), y = g.height - 1 - Math.floor((event.clientY - box.top - g.y0) / g.size);
      return x < 0 || y < 0 || x >= g.width || y >= g.height ? null : x + y * g.width;
    }

    /** Where a cell's middle is on the page, for tests and for tips. */
    place(cell) {
      const [x, y] = this.geometry.middle(cell), box = this.canvas.getBoundingClientRect();
      return [box.left + x, box.top + y];
    }

    _down(event) {
      if (event.button) return;
      event.preventDefault(); // the keys stay with the transport bar
      this.touched = event.pointerType === "touch";
      const cell = this.at(event);
      if (cell === null) return;
      this.drag = this.on.press(cell, event);
      if (this.drag) { this.canvas.setPointerCapture(event.pointerId); this.last = cell; this._hover(null); } else this._hover(cell);
    }

    _move(event) {
      const cell = this.at(event);
      if (!this.drag) { if (!this.touched || event.pointerType !== "touch") { this.touched = false; this._hover(cell); } return; }
      if (cell === null || cell === this.last) return;
      // a fast pointer skips cells: those between are taken as well
      const w = this.floor.width, steps = Math.max(Math.abs(cell % w - this.last % w), Math.abs(Math.floor(cell / w) - Math.floor(this.last / w)));
      const from = [this.last % w, Math.floor(this.last / w)], to = [cell % w, Math.floor(cell / w)];
      for (let i = 1; i <= steps; i++) this.drag(Math.round(from[0] + ((to[0] - from[0]) * i) / steps) + w * Math.round(from[1] + ((to[1] - from[1]) * i) / steps));
      this.last = cell;
    }

    _up() { this.drag = null; if (this.on.drop) this.on.drop(); }

    _hover(cell) {
      this.cursor = cell;
      this.on.hover(cell);
    }

    _key(event) {
      const floor = this.floor;
      if (!floor || event.ctrlKey || event.altKey || event.metaKey) return;
      const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (move) {
        const at = this.cursor === null ? this.on.home() : this.cursor;
        const x = Math.max(0, Math.min(floor.width - 1, at % floor.width + (this.cursor === null ? 0 : move[0])));
        const y = Math.max(0, Math.min(floor.height - 1, Math.floor(at / floor.width) + (this.cursor === null ? 0 : move[1])));
        this._hover(x + y * floor.width);
      } else if (event.key === "Escape") {
        this._hover(null);
        this.canvas.blur();
      } else if (this.cursor === null || !this.on.key(this.cursor, event.key)) return;
      event.preventDefault();
      event.stopPropagation();
    }

    /** A small text at a cell. */
    hint(cell, text) {
      this.tip.hidden = cell === null || !text;
      if (this.tip.hidden) return;
      this.tip.replaceChildren(...text.map((line) => el("div", {}, line)));
      const [x, y] = this.geometry.middle(cell), below = y < this.host.clientHeight / 2;
      this.tip.style.left = `${Math.max(2, Math.min(this.host.clientWidth - this.tip.offsetWidth - 2, x - this.tip.offsetWidth / 2))}px`;
      this.tip.style.top = `${below ? y + this.geometry.size * 0.7 : y - this.geometry.size * 0.7 - this.tip.offsetHeight}px`;
    }
  }
  wl.FloorView = FloorView;

  /** A round or square mark with a letter. */
  wl.badgeOn = (ctx, [x, y], size, colour, text, ink, square = false) => {
    const r = Math.max(3, Math.min(20, size * 0.4));
    ctx.fillStyle = colour;
    ctx.beginPath();
    if (square) ctx.rect(x - r, y - r, 2 * r, 2 * r); else ctx.arc(x, y, r, 0, 2 * Math.PI);
    ctx.fill();
    if (size < 11) return;
    ctx.fillStyle = ink;
    ctx.font = `700 ${Math.round(Math.min(size * 0.5, 20))}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillText(text, x, y + 0.5);
  };

  // ---- binding

  wl.bindLesson = (config) => {
    if (wl.lesson) { wl.lesson.close(); wl.lesson = null; }
    wl.bind(null); // a run that was on the stage must not take the keys
    const make = config && wl.lessons[config.lesson];
    if (make) wl.found("lesson-transport").then((host) => { if (host) wl.lesson = new make(config); });
  };
  window.dash_clientside = window.dash_clientside || {};
  window.dash_clientside.wattlane = window.dash_clientside.wattlane || {};
  window.dash_clientside.wattlane.lesson = (config) => { wl.bindLesson(config); return window.dash_clientside.no_update; };

  new MutationObserver(() => { if (wl.lesson && wl.lesson.data) wl.lesson.show(wl.lesson.player.step); })
    .observe(document.documentElement, { attributes: true, attributeFilter: ["data-mantine-color-scheme"] });

  document.addEventListener("keydown", (event) => {
    const lesson = wl.lesson;
    if (!lesson || !lesson.alive || event.defaultPrevented || event.altKey || event.metaKey || event.ctrlKey) return;
    const target = event.target.closest ? event.target : document.body;
    const field = target.closest("input, textarea, select, dialog, [role=dialog], .wl-menu");
    if (field && !(field.type === "range" && event.key === " ")) return;
    if ((event.key === " " || event.key === "Enter") && target.closest("button, a, summary, [role=button]")) return;
    const player = lesson.player, step = event.shiftKey ? 10 : 1;
    const act = {
      " ": () => player.toggle(),
      ArrowLeft: () => { player.pause(); player.seek(player.step - step); },
      ArrowRight: () => { player.pause(); player.seek(player.step + step); },
      Home: () => { player.pause(); player.seek(0); },
      End: () => { player.pause(); player.seek(player.last); },
      ArrowUp: () => player.faster(1),
      ArrowDown: () => player.faster(-1),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
})();
