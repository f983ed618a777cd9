/* Scenarios: previews drawn from the floor, what the checks found on them, import by file, rename and delete. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const el = wl.el;
  const PREVIEW_WAIT_MS = 350, LINES_UP_TO = 60, NUMBER_FROM_PX = 14, PAN = 0.15;
  const FILL = { "#": "wall", S: "shelf", R: "rack", I: "inbound", O: "outbound", C: "charger", P: "parking", E: "inbound" };
  const WORD = { "#": "wall", S: "shelf", R: "rack", I: "inbound", O: "outbound", C: "charger", P: "parking", E: "entrance" };
  const SIGN = { ok: "✓", warning: "!", error: "✕" };
  const LEVEL = { ok: "fine", warning: "warning", error: "error" };

  const path = (name, rest) => `/api/scenarios/${encodeURIComponent(name)}${rest}`;
  const kind = (name) => name.toLowerCase().replace(/^.*\./, "");
  const megabytes = (bytes) => (bytes / 2 ** 20).toFixed(1);

  // ---- the large preview: the live map's floor, with starts, goals and findings on it

  class Preview extends wl.FleetMap {
    constructor(host, title, onPlace) {
      super(host, { select: (target) => onPlace && onPlace(target), menu: () => {} });
      this.trips = [];
      this.findings = [];
      this.canvas.setAttribute("aria-label", `${title}. Arrow keys move it, plus and minus zoom, R fits it.`);
      this.canvas.addEventListener("keydown", (event) => this._key(event));
      const tool = (icon, label, act) => el("button", { type: "button", class: "wl-tool", title: label, "aria-label": label, onclick: act },
        el("span", { class: `wl-icon wl-icon-${icon}`, "aria-hidden": "true" }));
      host.append(el("div", { class: "wl-map-tools" }, tool("plus", "Zoom in", () => this.zoom(1.4)),
        tool("minus", "Zoom out", () => this.zoom(1 / 1.4)), tool("fit", "Fit the floor", () => this.fit())));
    }

    /** trips: [x, y, goal x, goal y] in metres, or [x, y] · findings: {level, x, y, place}. */
    show(floor, trips, findings = []) {
      this.trips = trips;
      this.findings = findings.filter((f) => f.x !== undefined && f.level !== "ok");
      this.chosen = null;
      this.layers.veil = false;   // the ground as it is
      this.setFloor(floor);
    }

    clear() {
      this.floor = null;
      this.ctx.setTransform(1, 0, 0, 1, 0, 0);
      this.ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    }

    mark(findings) {
      this.findings = findings.filter((f) => f.x !== undefined && f.level !== "ok");
      this._stale();
    }

    choose(finding) {
      this.chosen = finding;
      this.centre(finding.x, finding.y, Math.max(this.view.scale, this.ground ? 22 : 22 / this.floor.cell_m));
    }

    /** Unlike the live map's, it shows the whole of a very large floor too. */
    fit() {
      super.fit();
      if (!this.floor || !this.cssW) return;
      this.view.scale = Math.min(this.view.scale, (this.cssW - 16) / this.widthM, (this.cssH - 56) / this.heightM);
      this.view.y = this.heightM / 2 + 20 / this.view.scale;
      this._stale();
    }

    _key(event) {
      const step = (PAN * Math.min(this.cssW, this.cssH)) / this.view.scale;
      const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (move) { this.view.x += move[0]; this.view.y += move[1]; this._moved(); }
      else if (event.key === "+" || event.key === "=") this.zoom(1.25);
      else if (event.key === "-") this.zoom(0.8);
      else if (event.key === "r" || event.key === "R") this.fit();
      else return;
      event.preventDefault();
    }

    _drawStill() {
      super._drawStill();
      const ctx = this.still.getContext("2d"), cell = this.ground ? this.ground.robotPx() : this.floor.cell_m * this.view.scale;
      if (!this.ground) this._drawTrips(ctx, cell);
      else for (const trip of this.trips) this._drawGroundTrip(ctx, trip, cell);
      for (const finding of this.findings) this._drawFinding(ctx, finding, cell);
      this.host.dataset.marks = this.findings.length;
    }

    /** The robot's start and goal on terrain, with the marks of the live map. */
    _drawGroundTrip(ctx, [x, y, gx, gy], size) {
      const { colours } = this.ground, [sx, sy] = this.toScreen(x, y), [tx, ty] = this.toScreen(gx, gy);
      for (const [style, width] of [[colours.halo, 4], [colours.way, 1.8]]) {
        ctx.strokeStyle = style;
        ctx.lineWidth = width;
        ctx.setLineDash([7, 6]);
        ctx.beginPath(); ctx.moveTo(sx, sy); ctx.lineTo(tx, ty); ctx.stroke();
      }
      ctx.setLineDash([]);
      wl.marks.vehicle(ctx, sx, sy, size, { state: 1, flags: 0, colour: this.palette.state[1], palette: this.palette, heading: 0 });
      wl.terrain.goal(ctx, tx, ty, 9, colours);
    }

    _drawTrips(ctx, cell) {
      const { palette, trips } = this, size = Math.max(3, 0.72 * cell), few = trips.length <= LINES_UP_TO;
      const colour = (i) => wl.marks.bodyColour(palette, "id", { id: i });
      ctx.lineCap = "round";
      trips.forEach((trip, i) => {
        if (trip.length < 4) return;
        const [sx, sy] = this.toScreen(trip[0], trip[1]), [gx, gy] = this.toScreen(trip[2], trip[3]);
        ctx.strokeStyle = colour(i);
        if (few) {
          ctx.globalAlpha = 0.55;
          ctx.lineWidth = Math.max(1, cell * 0.07);
          ctx.beginPath(); ctx.moveTo(sx, sy); ctx.lineTo(gx, gy); ctx.stroke();
          ctx.globalAlpha = 1;
        }
        ctx.lineWidth = Math.max(1.5, cell * 0.13);
        ctx.beginPath(); ctx.arc(gx, gy, size * 0.42, 0, 2 * Math.PI); ctx.stroke();
      });
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      trips.forEach((trip, i) => {
        const [sx, sy] = this.toScreen(trip[0], trip[1]), fill = colour(i);
        ctx.fillStyle = fill;
        wl.marks.roundRect(ctx, sx - size / 2, sy - size / 2, size, size, size * 0.22);
        ctx.fill();
        ctx.strokeStyle = palette.outline;
        ctx.lineWidth = 1;
        ctx.stroke();
        if (size < NUMBER_FROM_PX) return;
        ctx.font = `700 ${Math.round(size * (i > 99 ? 0.4 : 0.5))}px system-ui, sans-serif`;
        ctx.fillStyle = wl.marks.ink(fill);
        ctx.fillText(String(i), sx, sy);
        if (trip.length < 4) return;
        const [gx, gy] = this.toScreen(trip[2], trip[3]);
        ctx.fillStyle = palette.label;
        ctx.fillText(String(i), gx, gy);
      });
    }

    _drawFinding(ctx, finding, cell) {
      const { palette } = this, [x, y] = this.toScreen(finding.x, finding.y), half = Math.max(6, cell * 0.62);
      const colour = finding.level === "error" ? palette.blocked : palette.low;
      ctx.strokeStyle = colour;
      ctx.lineWidth = Math.max(2, cell * 0.1);
      ctx.strokeRect(x - half, y - half, 2 * half, 2 * half);
      if (finding === this.chosen) { ctx.lineWidth = 2; ctx.strokeRect(x - half - 5, y - half - 5, 2 * half + 10, 2 * half + 10); }
      const r = Math.max(6, Math.min(11, cell * 0.3));
      ctx.beginPath(); ctx.arc(x + half, y - half, r, 0, 2 * Math.PI);
      ctx.fillStyle = colour; ctx.fill();
      ctx.strokeStyle = palette.surface; ctx.lineWidth = 1.5; ctx.stroke();
      ctx.font = `800 ${Math.round(r * 1.3)}px system-ui, sans-serif`;
      ctx.textAlign = "center"; ctx.textBaseline = "middle";
      ctx.fillStyle = wl.marks.ink(colour);
      ctx.fillText(SIGN[finding.level], x + half, y - half + 0.5);
    }
  }
  wl.FloorPreview = Preview;

  /** What the letters and marks mean, of those that this floor has. */
  const legend = (host, floor, trips, map) => {
    const ground = floor.kind === "terrain" && map.ground, network = floor.kind === "network", node = { entrance: "E", inbound: "I", outbound: "O", rack: "R" };
    const letters = network ? [...floor.nodes.map((n) => node[n.kind]), ...(floor.chargers.length ? "C" : "")] : floor.cells;
    const palette = wl.marks.readPalette(host), there = new Set(network ? letters : letters.join("")), dpr = Math.min(3, window.devicePixelRatio || 1);
    const mark = (draw, word) => {
      const canvas = el("canvas", { width: 18 * dpr, height: 18 * dpr, "aria-hidden": "true" });
      canvas.style.width = canvas.style.height = "18px";
      const ctx = canvas.getContext("2d");
      ctx.scale(dpr, dpr);
      draw(ctx);
      return el("span", { class: "wl-legend-row" }, canvas, word);
    };
    const rows = Object.keys(FILL).filter((letter) => there.has(letter)).map((letter) => mark((ctx) => {
      ctx.fillStyle = palette[FILL[letter]];
      wl.marks.roundRect(ctx, 2, 2, 14, 14, 2);
      ctx.fill();
      if (letter === "C") wl.marks.bolt(ctx, 9, 9, 10, palette.bolt, null);
    }, WORD[letter]));
    if ((floor.one_way || []).length) rows.push(mark((ctx) => {
      ctx.strokeStyle = palette.arrow; ctx.lineWidth = 1.6; ctx.lineCap = ctx.lineJoin = "round";
      ctx.beginPath(); ctx.moveTo(3, 9); ctx.lineTo(14, 9); ctx.moveTo(10, 5); ctx.lineTo(14, 9); ctx.lineTo(10, 13); ctx.stroke();
    }, "one-way"));
    if (ground) rows.splice(0, rows.length, ...wl.terrain.marks(map).map(([draw, word]) => mark((ctx) => draw(ctx, 9, 9), word)));
    if (trips.length && ground) {
      const { colours } = ground;
      rows.push(mark((ctx) => wl.marks.vehicle(ctx, 9, 9, 13, { state: 1, flags: 0, colour: palette.state[1], palette, heading: 0 }), "start"),
        mark((ctx) => wl.terrain.goal(ctx, 9, 9, 6, colours), "goal"));
    } else if (trips.length) {
      const colour = wl.marks.bodyColour(palette, "id", { id: 0 });
      rows.push(mark((ctx) => { ctx.fillStyle = colour; wl.marks.roundRect(ctx, 3, 3, 12, 12, 3); ctx.fill(); }, "start"));
      if (trips[0].length > 2) rows.push(mark((ctx) => { ctx.strokeStyle = colour; ctx.lineWidth = 2; ctx.beginPath(); ctx.arc(9, 9, 5, 0, 7); ctx.stroke(); }, "its goal"));
    }
    host.replaceChildren(...rows);
  };

  // ---- the small previews

  const thumbs = new Map();

  const drawNetwork = (canvas, floor, palette, wide, high) => {
    canvas.width = wide; canvas.height = high;
    const ctx = canvas.getContext("2d"), scale = Math.min(wide / floor.width, high / floor.height);
    const at = (x, y) => [(wide - scale * floor.width) / 2 + x * scale, (high + scale * floor.height) / 2 - y * scale];
    ctx.strokeStyle = palette.arrow;
    ctx.lineWidth = Math.max(1, scale * 0.1);
    ctx.beginPath();
    for (const [ax, ay, bx, by] of floor.arcs) { ctx.moveTo(...at(ax, ay)); ctx.lineTo(...at(bx, by)); }
    ctx.stroke();
    const fill = { entrance: palette.inbound, inbound: palette.inbound, outbound: palette.outbound, rack: palette.rack };
    const side = Math.max(2, Math.min(10, scale * 0.34));
    for (const [x, y, kind] of floor.nodes) {
      const [sx, sy] = at(x, y);
      ctx.fillStyle = fill[kind] || palette.shelf;
      ctx.fillRect(sx - side / 2, sy - side / 2, side, side);
    }
    canvas.dataset.drawn = canvas.dataset.thumb;
  };

  const drawThumb = (canvas, floor) => {
    const palette = wl.marks.readPalette(canvas), dpr = Math.min(3, window.devicePixelRatio || 1);
    const wide = canvas.clientWidth * dpr, high = canvas.clientHeight * dpr;
    if (!wide || !high) return;
    if (floor.heights) { wl.terrain.thumb(canvas, floor, Math.round(wide), Math.round(high)); canvas.dataset.drawn = canvas.dataset.thumb; return; }
    if (floor.nodes) { drawNetwork(canvas, floor, palette, Math.round(wide), Math.round(high)); return; }
    const image = document.createElement("canvas");
    image.width = floor.width; image.height = floor.height;
    const ctx = image.getContext("2d");
    floor.cells.forEach((row, y) => {
      for (let x = 0; x < row.length; x++) {
        ctx.fillStyle = palette[FILL[row[x]]] || palette.aisle;
        ctx.fillRect(x, floor.height - 1 - y, 1, 1);
      }
    });
    canvas.width = Math.round(wide); canvas.height = Math.round(high);
    const paper = canvas.getContext("2d"), scale = Math.min(canvas.width / floor.width, canvas.height / floor.height);
    paper.imageSmoothingEnabled = scale < 1;
    const w = floor.width * scale, h = floor.height * scale;
    paper.drawImage(image, (canvas.width - w) / 2, (canvas.height - h) / 2, w, h);
    canvas.dataset.drawn = canvas.dataset.thumb;
  };

  const fillThumbs = () => {
    for (const canvas of document.querySelectorAll("[data-thumb]")) {
      const key = `${canvas.dataset.thumb} ${canvas.dataset.revision}`;
      if (!thumbs.has(key)) thumbs.set(key, wl.fetchJson(path(canvas.dataset.thumb, "/thumb")));
      thumbs.get(key).then((floor) => drawThumb(canvas, floor), () => thumbs.delete(key));
    }
  };

  // ---- the page

  /** The library on the screen: one chosen scenario, or an import. */
  class Page {
    constructor(config) {
      this.config = config;
      this.files = [];
      this.values = {};
    }

    async start() {
      const drop = await wl.found("scenarios-drop");
      if (!drop || this.gone) return;
      this.importHost = document.getElementById("scenarios-import");
      this.detail = document.getElementById("scenarios-detail");
      this._buildDrop(drop);
      fillThumbs();
      this.scheme = new MutationObserver(() => this._theme());
      this.scheme.observe(document.documentElement, { attributes: true, attributeFilter: ["data-mantine-color-scheme"] });
      const current = document.querySelector(".wl-scn-cards .current a");
      if (current) {
        current.scrollIntoView({ block: "nearest", inline: "nearest" });
        if (Page.byCard) current.focus({ preventScroll: true });
      }
      Page.byCard = false;
      if (this.config.name) await this._show(this.config.name);
    }

    destroy() {
      this.gone = true;
      clearTimeout(this.later);
      if (this.scheme) this.scheme.disconnect();
      for (const map of [this.map, this.importMap]) if (map) map.destroy();
    }

    _theme() {
      fillThumbs();
      for (const [map, host] of [[this.map, "scenarios-legend"], [this.importMap, "scenarios-import-legend"]]) {
        if (!map || !map.floor) continue;
        map.setTheme();
        map.host.dataset.scheme = wl.scheme();
        legend(document.getElementById(host), map.floor, map.trips, map);
      }
    }

    async _show(name) {
      const host = document.getElementById("scenarios-map"), list = document.getElementById("scenarios-findings");
      if (!host) return;
      host.replaceChildren();
      let floor;
      try {
        floor = await wl.fetchJson(path(name, "/floor"));
      } catch (problem) {
        if (!this.gone) host.replaceChildren(el("div", { class: "wl-error wl-scn-broken", role: "alert" }, `The floor can't be drawn: ${problem.message}`));
        if (!this.gone) list.replaceChildren(el("li", {}, "Not checked: the floor can't be built."));
        return;
      }
      if (this.gone) return;
      this.map = new Preview(host, `Preview of the floor of ${name}`);
      this.map.show(floor, floor.trips);
      legend(document.getElementById("scenarios-legend"), floor, floor.trips, this.map);
      host.dataset.shown = name;
      try {
        const { findings } = await wl.fetchJson(path(name, "/checks"));
        if (!this.gone) this._findings(list, findings);
      } catch (problem) {
        if (!this.gone) list.replaceChildren(el("li", { class: "error" }, `The checks could not be made: ${problem.message}`));
      }
    }

    _findings(list, findings) {
      const order = ["error", "warning", "ok"];
      this.map.mark(findings);
      list.replaceChildren(...[...findings].sort((a, b) => order.indexOf(a.level) - order.indexOf(b.level)).map((finding) => {
        const where = finding.x === undefined ? null : el("button", { type: "button", class: "wl-link",
          onclick: () => { this.map.choose(finding); document.getElementById("scenarios-map").scrollIntoView({ block: "nearest" }); } }, "Show on the map");
        return el("li", { class: finding.level }, el("span", { class: "wl-scn-sign", "aria-hidden": "true" }, SIGN[finding.level]),
          el("span", {}, el("b", {}, `${finding.check}: `), el("span", { class: "wl-scn-level" }, `${LEVEL[finding.level]} — `), finding.text, where && " ", where));
      }));
      const errors = findings.filter((f) => f.level === "error").length, caution = document.getElementById("scenarios-caution");
      caution.hidden = !errors;
      caution.textContent = errors ? `The checks found ${errors} error${errors === 1 ? "" : "s"}: a run may be refused, or stall.` : "";
      list.dataset.done = "true";
    }

    // ---- import

    _buildDrop(host) {
      this.picker = el("input", { type: "file", multiple: true, accept: ".toml,.map,.scen", id: "scenarios-files", class: "wl-scn-picker",
        "aria-label": "Files to import: one TOML, or a map with its scen file", onchange: () => { this.take([...this.picker.files]); this.picker.value = ""; } });
      const zone = el("div", { class: "wl-scn-drop" },
        el("p", {}, "Import: drop a ", el("b", {}, ".toml"), " here, or a ", el("b", {}, ".map"), " with or without its ", el("b", {}, ".scen"), "."),
        el("label", { class: "wl-button small", for: "scenarios-files" }, "Choose files…"), this.picker);
      host.replaceChildren(zone);
      const page = document.querySelector(".wl-scenarios");
      const over = (event) => { if ([...(event.dataTransfer.types || [])].includes("Files")) { event.preventDefault(); zone.classList.add("over"); } };
      page.addEventListener("dragover", over);
      page.addEventListener("dragleave", (event) => { if (!page.contains(event.relatedTarget)) zone.classList.remove("over"); });
      page.addEventListener("drop", (event) => { event.preventDefault(); zone.classList.remove("over"); this.take([...event.dataTransfer.files]); });
    }

    /** New files: a map and a scen chosen one after the other belong together, anything else begins anew. */
    async take(files) {
      if (!files.length) return;
      const size = files.reduce((sum, file) => sum + file.size, 0);
      const kinds = files.map((f) => kind(f.name)), had = this.files.map((f) => kind(f.name));
      const joins = kinds.length === 1 && had.length === 1 && [kinds[0], had[0]].sort().join() === "map,scen";
      const kept = joins ? this.files : [];
      this._open();
      if (size > this.config.limit_bytes) {
        this.files = kept;
        this._listFiles();
        this._refuse(`${files.map((f) => f.name).join(", ")}: at most ${megabytes(this.config.limit_bytes)} MB can be imported; got ${megabytes(size)} MB`);
        return;
      }
      const read = [];
      for (const file of files) {
        try {
          const text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(await file.arrayBuffer());
          read.push({ name: file.name, text });
        } catch {
          this._refuse(`${file.name}: UTF-8 text was expected`);
          return;
        }
      }
      if (!joins) for (const key of ["agents", "planner"]) delete this.values[key];
      this.files = [...kept, ...read];
      this._listFiles();
      await this.look();
    }

    _open() {
      this.detail.hidden = true;
      this.importHost.hidden = false;
      if (this.form) return;
      const keep = (name) => (event) => { this.values[name] = event.target.value; };
      const again = (name) => (event) => { this.values[name] = event.target.value; clearTimeout(this.later); this.later = setTimeout(() => this.look(), PREVIEW_WAIT_MS); };
      const field = (name, label, control) => {
        this.fields[name] = control;
        control.id = `scenarios-import-${name}`;
        return el("div", { class: "wl-scn-field", dataset: { field: name } }, el("label", { for: control.id }, label), control);
      };
      this.fields = {};
      this.problem = el("div", { class: "wl-error", role: "alert", id: "scenarios-import-error" });
      this.fileList = el("ul", { class: "wl-scn-files" });
      this.facts = el("p", { class: "wl-hint", id: "scenarios-import-facts" });
      this.importButton = el("button", { type: "submit", class: "wl-button primary" }, "Import");
      this.form = el("form", { class: "wl-scn-form", novalidate: true, onsubmit: (event) => { event.preventDefault(); this.send(); } },
        this.fileList, el("label", { class: "wl-button small", for: "scenarios-files" }, "Choose other files…"), this.facts,
        field("name", "Name", el("input", { type: "text", maxlength: 80, autocomplete: "off", spellcheck: "false", oninput: keep("name") })),
        field("agents", "Vehicles", el("input", { type: "number", min: 1, step: 1, inputmode: "numeric", oninput: again("agents") })),
        field("planner", "Planner", el("select", { class: "wl-select", onchange: again("planner") })),
        field("objective", "Objective", el("select", { class: "wl-select", onchange: again("objective") })),
        field("seed", "Seed of starts and goals", el("input", { type: "number", min: 0, step: 1, value: 1, inputmode: "numeric", oninput: again("seed") })),
        this.problem,
        el("div", { class: "wl-row" }, this.importButton, el("button", { type: "button", class: "wl-button", onclick: () => this.cancel() }, "Cancel")));
      const mapHost = el("div", { class: "wl-scn-map", id: "scenarios-import-map" });
      this.importHost.replaceChildren(el("h2", {}, "Import"),
        el("div", { class: "wl-scn-body" }, el("div", { class: "wl-scn-stage" }, mapHost, el("div", { class: "wl-legend wl-scn-legend", id: "scenarios-import-legend" })),
          el("div", { class: "wl-scn-side" }, this.form)));
      this.importMap = new Preview(mapHost, "Preview of the floor to import");
      this._fieldsFor(null);
    }

    _listFiles() {
      this.fileList.replaceChildren(...this.files.map((file) => el("li", {}, file.name, " ", el("small", {}, `${(file.text.length / 1000).toFixed(1)} kB`))));
    }

    _fieldsFor(seen) {
      const instance = this.files.some((file) => kind(file.name) === "map");
      const random = instance && !this.files.some((file) => kind(file.name) === "scen");
      const shown = { name: true, agents: instance, planner: instance, objective: instance, seed: random };
      for (const [name, on] of Object.entries(shown)) this.form.querySelector(`[data-field=${name}]`).hidden = !on;
      if (!seen) return;   // a file that is wrong changes no value
      const { fields, values } = this;
      if (values.name === undefined) fields.name.value = seen.name;
      if (!instance) return;
      fields.agents.max = seen.most;
      if (values.agents === undefined) fields.agents.value = seen.fleet;
      const options = (select, names, value) => { select.replaceChildren(...names.map((name) => el("option", { value: name }, name))); select.value = value; };
      options(fields.planner, Object.keys(seen.planners), seen.planner);
      options(fields.objective, seen.planners[seen.planner] || ["time", "energy"], seen.objective);
      this.form.querySelector("[data-field=agents] label").textContent = `Vehicles (of ${seen.most})`;
    }

    _asked() {
      const { fields, values } = this, asked = { files: this.files };
      const number = (name) => { const text = String(fields[name].value).trim(); return /^-?\d+$/.test(text) ? Number(text) : null; };
      for (const name of ["agents", "seed"]) if (values[name] !== undefined) asked[name] = number(name);
      for (const name of ["planner", "objective"]) if (values[name]) asked[name] = values[name];
      return asked;
    }

    _refuse(sentence) {
      this.problem.textContent = sentence;
      this.importButton.disabled = !this.files.length;
      this.importHost.scrollIntoView({ block: "nearest" });
    }

    /** Asks what an import would make of the files, and shows it. */
    async look() {
      const number = (this.asked = (this.asked || 0) + 1);
      this.problem.textContent = "";
      this.facts.textContent = "Reading…";
      this.importHost.dataset.seen = "";
      let seen;
      try {
        seen = await wl.fetchJson("/api/scenarios/preview", { method: "POST", body: JSON.stringify(this._asked()) });
      } catch (problem) {
        if (this.gone || number !== this.asked) return;
        this.facts.textContent = "";
        this._fieldsFor(null);
        this.importMap.clear();
        document.getElementById("scenarios-import-legend").replaceChildren();
        this._refuse(problem.message);
        return;
      }
      if (this.gone || number !== this.asked) return;
      this.importButton.disabled = false;
      this._fieldsFor(seen);
      this.facts.textContent = `${seen.title} · ${seen.size}`;
      this.importMap.show(seen.floor, seen.trips);
      legend(document.getElementById("scenarios-import-legend"), seen.floor, seen.trips, this.importMap);
      this.importHost.dataset.seen = seen.name;
      this.importHost.dataset.looks = number;
    }

    async send() {
      this.problem.textContent = "";
      clearTimeout(this.later);
      this.importButton.disabled = true;
      try {
        const { name } = await wl.fetchJson("/api/scenarios", { method: "POST",
          body: JSON.stringify({ ...this._asked(), name: this.fields.name.value.trim() || null }) });
        wl.notify("Imported", name, "ok");
        wl.go(`/scenarios?scenario=${encodeURIComponent(name)}`);
      } catch (problem) {
        this._refuse(problem.message);
      }
      this.importButton.disabled = false;
    }

    cancel() {
      this.asked = (this.asked || 0) + 1;
      clearTimeout(this.later);
      if (this.importMap) this.importMap.destroy();
      this.importMap = this.form = null;
      this.files = [];
      this.values = {};
      this.importHost.replaceChildren();
      this.importHost.hidden = true;
      this.detail.hidden = false;
      this.picker.focus();
    }
  }

  // ---- rename and delete

  const CHANGES = {
    async rename(name) {
      const wanted = await wl.prompt("Rename the scenario", "Name: lower-case letters, digits, - _ .", name);
      if (wanted === null || wanted === name) return;
      try {
        const made = await wl.fetchJson(path(name, ""), { method: "PATCH", body: JSON.stringify({ name: wanted }) });
        wl.notify("Renamed", made.name, "ok");
        wl.go(`/scenarios?scenario=${encodeURIComponent(made.name)}`);
      } catch (problem) { wl.notify("Not renamed", problem.message, "error"); }
    },
    async delete(name) {
      if (!(await wl.confirm(`Delete ${name}?`, "The scenario and the files it was imported from are gone for good. Runs of it stay: each has its own copy.", "Delete"))) return;
      try {
        await wl.fetchJson(path(name, ""), { method: "DELETE" });
        wl.notify("Deleted", name, "ok");
        wl.go("/scenarios");
      } catch (problem) { wl.notify("Not deleted", problem.message, "error"); }
    },
  };

  document.addEventListener("click", (event) => {
    const target = event.target.closest && event.target.closest("[data-scenario], .wl-scn-cards a");
    if (!target) return;
    if (!target.dataset.scenario) { Page.byCard = true; return; }
    const { do: what, name } = JSON.parse(target.dataset.scenario);
    CHANGES[what](name);
  });

  window.dash_clientside = window.dash_clientside || {};
  window.dash_clientside.wattlane = Object.assign(window.dash_clientside.wattlane || {}, {
    /** Puts the library's page to work; called whenever it is laid out anew. */
    scenarios(config) {
      if (wl.stage) wl.bind(null);   // its keys would command a run that is not on the screen
      if (wl.library) wl.library.destroy();
      wl.library = config ? new Page(config) : null;
      if (wl.library) wl.library.start();
      return window.dash_clientside.no_update;
    },
    /** The objectives that a planner serves, and the one asked for where it does. */
    objectives(planner, table, value) {
      const served = (table || {})[planner] || ["time", "energy"];
      return [served, served.includes(value) ? value : served[0]];
    },
  });
})();
