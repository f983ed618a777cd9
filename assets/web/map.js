/* The live map: one 2-D canvas with the floor, the fleet, its routes and heat, used by Operate and Replay alike. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const { WORDS, TASKS, LOADED, LOW, TASK_SHIFT, UNKNOWN_SOC, FULL_SOC } = wl.marks;
  const el = wl.el;
  const BUCKETS = 32;            // headings for which a sprite is kept
  const VEHICLE_SHARE = 0.78;    // of a cell's side
  const NETWORK_SHARE = 0.42;    // of the mean arc, so that two pass each other
  const LEAST_PX = 7;
  const LABEL_FROM_PX = 6;       // a station's name in smaller letters would lie over the next
  const NUMBER_FROM_PX = 15;     // a vehicle narrower than this shows no number
  const SUBPIXEL_BELOW = 250;    // larger fleets snap to whole pixels: half the drawing time
  const LONG_PRESS_MS = 550;
  const TELEPORT_CELLS = 10, TELEPORT_M = 3;   // on terrain cells are small
  const CELL_MARK_PX = 12;       // a chosen cell of terrain is marked at least so large
  const CLOSE_UP_PX = 18, CLOSE_UP_GROUND = 40;   // px per cell, on terrain per metre, when something is centred
  const COLOURINGS = { state: "state", id: "number", soc: "state of charge", task: "task", power: "energy rate", thesis: "thesis colours" };

  wl.FleetMap = class {
    /** host: an empty element · hooks: select(selection, options), menu(target, x, y), place(place), layers(). */
    constructor(host, hooks) {
      this.host = host;
      this.hooks = hooks;
      this.canvas = el("canvas", { class: "wl-map-canvas", tabindex: 0, role: "img",
        "aria-label": "Map of the floor with its vehicles. The fleet table below lists the same vehicles." });
      this.tip = el("div", { class: "wl-tip", role: "status", hidden: true });
      host.append(this.canvas, this.tip);
      this.ctx = this.canvas.getContext("2d");
      this.still = document.createElement("canvas");
      this.paths = document.createElement("canvas");
      this.layers = { grid: false, ids: true, paths: true, heat: "", log: false, window: 3600, colour: "state",
        contours: true, veil: true, frontier: false };   // the last three: of terrain
      this.view = { x: 0, y: 0, scale: 20 };
      this.selection = null;
      this.follow = false;
      this.routes = [];
      this.power = [];               // W per vehicle, over the last minute
      this.powerTop = 0;
      this.blocked = new Set();
      this.chargersOut = new Set();
      this.frame = null;
      this.n = 0;
      this.stats = { ms: 0, worst: 0, draws: 0, fps: 0 };
      this.reduced = matchMedia("(prefers-reduced-motion: reduce)");
      this.sendMode = null;
      this._draw = this._draw.bind(this);
      this._listen();
      this.sizeWatch = new ResizeObserver(() => this._resize());
      this.sizeWatch.observe(host);
      this.setTheme();
    }

    destroy() {
      this.gone = true;
      this.sizeWatch.disconnect();
      cancelAnimationFrame(this.raf);
      this.host.replaceChildren();
    }

    // ---- what is shown

    setFloor(floor) {
      this.floor = floor;
      this.network = floor.kind === "network";
      this.widthM = this.network ? floor.width_m : floor.width * floor.cell_m;
      this.heightM = this.network ? floor.height_m : floor.height * floor.cell_m;
      this.ground = floor.kind === "terrain" ? new wl.Ground(this, floor) : null;
      if (this.ground) {
        this.ground.theme(this.host);
        this.canvas.setAttribute("aria-label", "Map of the ground with the robot. The panel beside it tells of its search, the tab Ways of each way.");
      }
      this.placeAt = new Map();
      if (!this.ground) floor.places.forEach(([x, y], place) => this.placeAt.set(this._cellKey(x, y), place));
      this.stationAt = new Map((floor.stations || []).map((s) => [s.place, s]));
      this.chargerAt = new Map((floor.chargers || []).map((c) => [c.place, c]));
      this.parkingAt = new Map((floor.parking || []).map((p) => [p.place, p]));
      this.oneWayAt = new Map((floor.one_way || []).map((o) => [o.place, o]));
      this.laneAt = new Map((floor.lanes || []).map((l) => [l.place, l]));
      this.arcs = null;
      this._resize();
      this.fit();
    }

    setTheme() {
      this.palette = wl.marks.readPalette(this.host);
      if (this.ground) this.ground.theme(this.host);
      this.sprites = null;
      this._stale();
    }

    setLayers(change) {
      Object.assign(this.layers, change);
      this.sprites = null;
      this._stale();
    }

    setSelection(selection) {
      this.selection = selection;
      if (!selection || selection.kind !== "vehicle") this.follow = false;
      this.pathsStale = true;
      this._wake();
    }

    setFollow(on) {
      this.follow = !!on && !!this.selection && this.selection.kind === "vehicle";
      this._wake();
      return this.follow;
    }

    setRoutes(routes) { this.routes = routes; this.pathsStale = true; this._wake(); }

    /** watts: mean power of every vehicle, null where it is unknown. Returns true when the scale's top changed. */
    setPower(watts) {
      const most = Math.max(0, ...watts), before = this.powerTop;
      this.power = watts;
      if (most > before) {   // the scale only grows, in steps that a legend can show
        const ten = 10 ** Math.floor(Math.log10(most));
        this.powerTop = [1, 2, 5, 10].map((s) => s * ten).find((top) => top >= most);
      }
      this._wake();
      return this.powerTop !== before;
    }

    setBlocked(places, chargersOut) {
      const same = places.length === this.blocked.size && places.every((p) => this.blocked.has(p)) &&
        chargersOut.length === this.chargersOut.size && chargersOut.every((c) => this.chargersOut.has(c));
      if (same) return;
      this.blocked = new Set(places);
      this.chargersOut = new Set(chargersOut);
      this._stale();
    }

    /** values: one number per place, or null. */
    setHeat(values) {
      this.heat = values;
      if (values) this.heatEnds = this._heatEnds();
      this._stale();
    }

    /** arcs: by place `expected_s`, `passages` and `occupancy`, told of the lane that is pointed at. */
    setArcs(arcs) {
      this.arcs = arcs;
      if (!this.tip.hidden && this.pointed) this._hover(...this.pointed);
    }

    /** The newest frame. What is on the screen now moves to it within the usual gap between two frames. */
    push(frame, snap = false) {
      const now = performance.now();
      const first = !this.frame || this.n !== frame.n;
      if (first) {
        this.n = frame.n;
        for (const name of ["fromX", "fromY", "fromH", "nowX", "nowY", "nowH"]) this[name] = new Float32Array(frame.n);
        this.gap = 60;
      } else {
        const gap = now - this.arrived;
        if (gap < 400) this.gap += (Math.min(250, Math.max(16, gap)) - this.gap) * 0.15;
        this._place(now);
      }
      if (first || snap || this.reduced.matches) {
        this.fromX.set(frame.x); this.fromY.set(frame.y); this.fromH.set(frame.heading);
      } else {
        this.fromX.set(this.nowX); this.fromY.set(this.nowY); this.fromH.set(this.nowH);
        const far = this.ground ? TELEPORT_M : TELEPORT_CELLS * this.floor.cell_m;
        for (let i = 0; i < frame.n; i++) {
          if (Math.abs(frame.x[i] - this.fromX[i]) + Math.abs(frame.y[i] - this.fromY[i]) > far) {
            this.fromX[i] = frame.x[i]; this.fromY[i] = frame.y[i]; this.fromH[i] = frame.heading[i];
          }
        }
      }
      this.frame = frame;
      this.arrived = now;
      this.moving = true;
      this._wake();
    }

    // ---- where things are

    _cellKey(x, y) { return Math.floor(y / this.floor.cell_m) * 65536 + Math.floor(x / this.floor.cell_m); }

    _place(now) {
      const frame = this.frame;
      const part = this.reduced.matches ? 1 : Math.min(1, (now - this.arrived) / this.gap);
      const { fromX, fromY, fromH, nowX, nowY, nowH } = this;
      const turn = 2 * Math.PI;
      for (let i = 0; i < this.n; i++) {
        nowX[i] = fromX[i] + (frame.x[i] - fromX[i]) * part;
        nowY[i] = fromY[i] + (frame.y[i] - fromY[i]) * part;
        let by = frame.heading[i] - fromH[i];
        if (by > Math.PI) by -= turn; else if (by < -Math.PI) by += turn;
        nowH[i] = fromH[i] + by * part;
      }
      if (part >= 1) this.moving = false;
    }

    toScreen(x, y) {
      return [(x - this.view.x) * this.view.scale + this.cssW / 2, this.cssH / 2 - (y - this.view.y) * this.view.scale];
    }

    toFloor(px, py) {
      return [(px - this.cssW / 2) / this.view.scale + this.view.x, (this.cssH / 2 - py) / this.view.scale + this.view.y];
    }

    /** CSS pixels of a vehicle inside the canvas, as drawn last. */
    vehicleScreen(vehicle) { return this.toScreen(this.nowX[vehicle], this.nowY[vehicle]); }

    placeScreen(place) { return this.toScreen(...this.floor.places[place]); }

    /** Vehicle, charger, station or cell under a point of the canvas; null outside the floor. */
    pick(px, py) {
      if (!this.floor) return null;
      const [x, y] = this.toFloor(px, py);
      const reach = Math.max(0.45 * this.floor.cell_m, 12 / this.view.scale);
      let best = -1, least = reach * reach;
      for (let i = 0; i < this.n; i++) {
        const dx = this.nowX[i] - x, dy = this.nowY[i] - y, d = dx * dx + dy * dy;
        if (d < least) { least = d; best = i; }
      }
      if (best >= 0) return { kind: "vehicle", id: best };
      const place = this._placeAtPoint(x, y);
      if (place === undefined) return null;
      if (this.chargerAt.has(place)) return { kind: "charger", id: this.chargerAt.get(place).number, place };
      if (this.stationAt.has(place)) return { kind: "station", id: this.stationAt.get(place).number, place };
      return { kind: "place", id: place, place };
    }

    _placeAtPoint(x, y) {
      if (x < 0 || y < 0 || x >= this.widthM || y >= this.heightM) return undefined;
      if (this.ground) return Math.floor(y / this.floor.cell_m) * this.floor.width + Math.floor(x / this.floor.cell_m);
      return this.network ? wl.network.pick(this, x, y) : this.placeAt.get(this._cellKey(x, y));
    }

    // ---- the view

    fit() {
      if (!this.floor || !this.cssW) return;
      const margin = 8, top = 48;   // the tools lie over the upper edge
      this.view.scale = Math.max(2, Math.min((this.cssW - 2 * margin) / this.widthM, (this.cssH - margin - top) / this.heightM));
      this.view.x = this.widthM / 2;
      this.view.y = this.heightM / 2 + (top - margin) / 2 / this.view.scale;
      this.fitted = true;
      this._stale();
    }

    zoom(factor, px = this.cssW / 2, py = this.cssH / 2) {
      const [x, y] = this.toFloor(px, py);
      this.view.scale = Math.min(240, Math.max(2, this.view.scale * factor));
      const [nx, ny] = this.toFloor(px, py);
      this.view.x += x - nx;
      this.view.y += y - ny;
      this._moved();
    }

    centre(x, y, scale) {
      this.view.x = x;
      this.view.y = y;
      if (scale) this.view.scale = scale;
      this._moved();
    }

    centreOn(selection) {
      if (!selection || !this.floor) return;
      const least = this.ground ? CLOSE_UP_GROUND : CLOSE_UP_PX / this.floor.cell_m;
      if (selection.kind === "vehicle" && selection.id < this.n) {
        this.centre(this.nowX[selection.id], this.nowY[selection.id], Math.max(this.view.scale, least));
      } else if (selection.place !== undefined && this.floor.places[selection.place]) {
        this.centre(...this.floor.places[selection.place], Math.max(this.view.scale, least));
      }
    }

    _moved() {
      this.fitted = false;
      this._stale();
      if (this.hooks.zoomed) this.hooks.zoomed();
    }

    _resize() {
      const box = this.host.getBoundingClientRect();
      this.cssW = Math.max(1, Math.floor(box.width));
      this.cssH = Math.max(1, Math.floor(box.height));
      this.dpr = Math.min(3, window.devicePixelRatio || 1);
      for (const canvas of [this.canvas, this.still, this.paths]) {
        canvas.width = Math.round(this.cssW * this.dpr);
        canvas.height = Math.round(this.cssH * this.dpr);
      }
      this.canvas.style.width = `${this.cssW}px`;
      this.canvas.style.height = `${this.cssH}px`;
      if (this.fitted) this.fit();
      this._stale();
    }

    _stale() { this.stillStale = true; this.pathsStale = true; this._wake(); }

    _wake() {
      if (!this.raf && !this.gone) this.raf = requestAnimationFrame(this._draw);
    }

    // ---- drawing

    _draw() {
      this.raf = 0;
      if (!this.floor || this.gone || this.cssW < 2) return;
      const begin = performance.now();
      if (this.frame) this._place(begin);
      if (this.follow && this.frame) {
        const id = this.selection.id, x = this.nowX[id], y = this.nowY[id];
        if (Math.hypot(x - this.view.x, y - this.view.y) * this.view.scale > 0.4) {
          this.view.x = x; this.view.y = y; this.fitted = false; this.stillStale = this.pathsStale = true;
        }
      }
      if (this.ground && this.ground.follow(this.frame ? this.frame.time : 0)) this.stillStale = true;
      if (this.stillStale) { this._drawStill(); this.stillStale = false; }
      const ctx = this.ctx;
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.drawImage(this.still, 0, 0);
      this._drawPaths(ctx);
      if (this.frame) this._drawFleet(ctx);
      if (this.sendMode) this._drawSend(ctx);
      const took = performance.now() - begin;
      this.stats.ms += (took - this.stats.ms) * 0.1;
      this.stats.worst = Math.max(this.stats.worst * 0.995, took);
      this.stats.draws += 1;
      const since = begin - (this.lastDraw || begin);
      this.lastDraw = begin;
      if (since > 0 && since < 500) this.stats.fps += (1000 / since - this.stats.fps) * 0.1;
      if (this.moving || this.follow && this.moving) this._wake();
    }

    _drawStill() {
      const ctx = this.still.getContext("2d"), { palette, floor } = this;
      const cell = floor.cell_m * this.view.scale;
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.fillStyle = palette.floor;
      ctx.fillRect(0, 0, this.still.width, this.still.height);
      ctx.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
      if (this.network) {
        wl.network.draw(this, ctx, cell);
        this._drawFittings(ctx, cell, { x0: -1, x1: Infinity, y0: -1, y1: Infinity });
        this._drawBlocked(ctx, cell);
        return;
      }
      const [left, bottom] = this.toFloor(0, this.cssH), [right, top] = this.toFloor(this.cssW, 0);
      const range = { x0: Math.max(0, Math.floor(left / floor.cell_m)), x1: Math.min(floor.width - 1, Math.floor(right / floor.cell_m)),
        y0: Math.max(0, Math.floor(bottom / floor.cell_m)), y1: Math.min(floor.height - 1, Math.floor(top / floor.cell_m)) };
      if (this.ground) {
        this.ground.draw(ctx, cell);
        if (this.layers.grid && cell >= 5) this._drawGrid(ctx, range);
        return;
      }
      this._drawCells(ctx, cell, range);
      if (this.layers.heat && this.heat) this._drawHeat(ctx);
      if (this.layers.grid && cell >= 5) this._drawGrid(ctx, range);
      this._drawFittings(ctx, cell, range);
      this._drawBlocked(ctx, cell);
    }

    _drawCells(ctx, cell, { x0, x1, y0, y1 }) {
      const { palette, floor } = this;
      const fill = { "#": palette.wall, S: palette.shelf, R: palette.rack, I: palette.inbound, O: palette.outbound,
        C: palette.charger, P: palette.parking };
      const inset = cell >= 8 ? Math.max(0.5, cell * 0.04) : 0;
      for (let cy = y0; cy <= y1; cy++) {
        const row = floor.cells[cy];
        for (let cx = x0; cx <= x1;) {
          const letter = row[cx];
          const colour = fill[letter] || palette.aisle;
          let end = cx + 1;
          while (end <= x1 && (fill[row[end]] || palette.aisle) === colour && (letter === "#" || !fill[letter] || !inset)) end++;
          const [px, py] = this.toScreen(cx * floor.cell_m, (cy + 1) * floor.cell_m);
          ctx.fillStyle = colour;
          if (fill[letter] && letter !== "#" && inset) {
            ctx.fillStyle = palette.aisle;
            ctx.fillRect(px - 0.25, py - 0.25, cell + 0.5, cell + 0.5);
            ctx.fillStyle = colour;
            wl.marks.roundRect(ctx, px + inset, py + inset, cell - 2 * inset, cell - 2 * inset, cell * 0.1);
            ctx.fill();
          } else ctx.fillRect(px - 0.25, py - 0.25, (end - cx) * cell + 0.5, cell + 0.5);
          cx = end;
        }
      }
    }

    _drawGrid(ctx, { x0, x1, y0, y1 }) {
      const c = this.floor.cell_m;
      ctx.strokeStyle = this.palette.gridLine;
      ctx.lineWidth = 1;
      ctx.beginPath();
      for (let x = x0; x <= x1 + 1; x++) {
        const [px, top] = this.toScreen(x * c, (y1 + 1) * c), [, low] = this.toScreen(0, y0 * c);
        ctx.moveTo(Math.round(px) + 0.5, top); ctx.lineTo(Math.round(px) + 0.5, low);
      }
      for (let y = y0; y <= y1 + 1; y++) {
        const [from, py] = this.toScreen(x0 * c, y * c), [to] = this.toScreen((x1 + 1) * c, 0);
        ctx.moveTo(from, Math.round(py) + 0.5); ctx.lineTo(to, Math.round(py) + 0.5);
      }
      ctx.stroke();
    }

    _drawFittings(ctx, cell, range) {
      const { palette, floor } = this, c = floor.cell_m;
      const inside = (p) => p.x / c >= range.x0 - 1 && p.x / c <= range.x1 + 2 && p.y / c >= range.y0 - 1 && p.y / c <= range.y1 + 2;
      if (cell >= 9) {
        ctx.strokeStyle = palette.arrow;
        ctx.lineWidth = Math.max(1, cell * 0.07);
        ctx.lineCap = ctx.lineJoin = "round";
        ctx.beginPath();
        for (const way of floor.one_way || []) {
          if (!inside(way)) continue;
          const a = (way.heading_deg * Math.PI) / 180, dx = Math.cos(a), dy = -Math.sin(a);
          const [sx, sy] = this.toScreen(way.x, way.y);
          const tx = sx + dx * cell * 0.5, ty = sy + dy * cell * 0.5, s = cell * 0.16;
          ctx.moveTo(tx - dx * s * 2, ty - dy * s * 2);
          ctx.lineTo(tx, ty);
          ctx.moveTo(tx - (dx + dy) * s, ty - (dy - dx) * s);
          ctx.lineTo(tx, ty);
          ctx.lineTo(tx - (dx - dy) * s, ty - (dy + dx) * s);
        }
        ctx.stroke();
      }
      if (cell < 7) return;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      const text = (item, size, colour) => {
        const [sx, sy] = this.toScreen(item.x, item.y);
        ctx.font = `600 ${Math.round(Math.min(15, Math.max(8, cell * size)))}px system-ui, sans-serif`;
        if (this.layers.heat && this.heat) {
          const plain = this.network && !(this.heat[item.place] > 0);   // a node without heat keeps its colour
          ctx.lineWidth = 3;
          ctx.strokeStyle = plain ? wl.network.colourOf(palette, item.kind) : palette.surface;
          ctx.strokeText(item.name, sx, sy);
          if (!plain) colour = palette.text;
        }
        ctx.fillStyle = colour;
        ctx.fillText(item.name, sx, sy);
      };
      if (cell >= 15) {
        const size = this.network ? 0.19 : 0.36;
        for (const station of floor.stations || []) if (inside(station) && cell * size >= LABEL_FROM_PX) text(station, size, palette.label);
        for (const spot of this.network ? [] : floor.parking || []) if (inside(spot)) text(spot, 0.3, palette.label);
      }
      for (const charger of floor.chargers || []) {
        if (!inside(charger)) continue;
        const [sx, sy] = this.toScreen(charger.x, charger.y);
        wl.marks.bolt(ctx, sx, sy, cell * 0.62, palette.bolt, null);
        if (this.chargersOut.has(charger.place)) {
          wl.marks.cross(ctx, sx, sy, cell * 0.34, palette.blocked, Math.max(1.5, cell * 0.1));
        }
      }
    }

    _drawBlocked(ctx, cell) {
      const { palette, floor } = this;
      ctx.lineWidth = Math.max(1, cell * 0.08);
      for (const place of this.blocked) {
        if (!floor.places[place]) continue;
        const [sx, sy] = this.toScreen(...floor.places[place]), h = (this._markSize() * this.view.scale) / 2;
        ctx.save();
        ctx.beginPath();
        ctx.rect(sx - h, sy - h, cell, cell);
        ctx.clip();
        ctx.strokeStyle = palette.blocked;
        ctx.beginPath();
        for (let d = -cell; d <= cell; d += Math.max(3, cell / 4)) { ctx.moveTo(sx - h + d, sy + h); ctx.lineTo(sx - h + d + cell, sy - h); }
        ctx.rect(sx - h, sy - h, cell, cell);
        ctx.stroke();
        ctx.restore();
      }
    }

    _drawHeat(ctx) {
      const { floor, heat } = this;
      const image = document.createElement("canvas");
      image.width = floor.width;
      image.height = floor.height;
      const pixels = image.getContext("2d").createImageData(floor.width, floor.height);
      floor.places.forEach(([x, y], place) => {
        if (!(heat[place] > 0)) return;
        const column = Math.floor(x / floor.cell_m), row = floor.height - 1 - Math.floor(y / floor.cell_m);
        pixels.data.set([...wl.marks.viridis(this._heatShare(heat[place])), 225], (row * floor.width + column) * 4);
      });
      image.getContext("2d").putImageData(pixels, 0, 0);
      const [px, py] = this.toScreen(0, this.heightM);
      ctx.imageSmoothingEnabled = false;
      ctx.drawImage(image, px, py, this.widthM * this.view.scale, this.heightM * this.view.scale);
      ctx.imageSmoothingEnabled = true;
    }

    /** Ends of the scale. At the top the largest value in the aisles: chargers and parking, where vehicles stand for
     *  hours, would drown the rest. Expected times begin at the least of them: no arc takes nothing. */
    _heatEnds() {
      let aisles = 0, all = 0, least = Infinity;
      for (let place = 0; place < this.heat.length; place++) {
        const value = this.heat[place];
        if (value > all) all = value;
        if (value > 0 && value < least) least = value;
        if (value > aisles && !this.chargerAt.has(place) && !this.parkingAt.has(place) && !this.stationAt.has(place)) aisles = value;
      }
      return this.layers.heat === "expected" ? [Math.min(least, all), all] : [0, aisles || all];
    }

    _heatShare(value) {
      const [low, top] = this.heatEnds, share = top > low ? Math.min(1, (value - low) / (top - low)) : 0;
      return this.layers.log ? Math.log1p(share * 999) / Math.log(1000) : share;
    }

    /** One scale for several maps: the widest ends of their heat, and the largest power. */
    static share(maps) {
      const hot = maps.filter((map) => map.heat), ends = hot.map((map) => map._heatEnds());
      for (const map of hot) {
        map.heatEnds = [Math.min(...ends.map(([low]) => low)), Math.max(...ends.map(([, top]) => top))];
        map._stale();
      }
      wl.Ground.share(maps.map((map) => map.ground).filter((ground) => ground && ground.watts.length));
      const most = Math.max(...maps.map((map) => map.powerTop));
      for (const map of maps) { map.powerTop = most; map._wake(); }
    }

    heatColour(place) { return `rgb(${wl.marks.viridis(this._heatShare(this.heat[place])).join(",")})`; }

    _drawPaths(ctx) {
      if (this.ground) { this.ground.drawWays(ctx); return; }
      const chosen = this.selection && this.selection.kind === "vehicle" ? this.selection.id : -1;
      const all = this.layers.paths;
      if (!this.routes.length || (!all && chosen < 0)) return;
      if (this.routes.length <= 60 || !all) {
        ctx.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
        for (const route of this.routes) if (all || route.vehicle === chosen) this._strokeRoute(ctx, route, route.vehicle === chosen);
        ctx.setTransform(1, 0, 0, 1, 0, 0);
        return;
      }
      if (this.pathsStale) {
        const layer = this.paths.getContext("2d");
        layer.setTransform(1, 0, 0, 1, 0, 0);
        layer.clearRect(0, 0, this.paths.width, this.paths.height);
        layer.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
        for (const route of this.routes) this._strokeRoute(layer, route, route.vehicle === chosen);
        this.pathsStale = false;
      }
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.drawImage(this.paths, 0, 0);
    }

    /** The plan ahead thin; as far as nobody else is before it, thick; a ring at its end. */
    _strokeRoute(ctx, route, chosen) {
      const { floor, frame } = this, v = route.vehicle;
      if (!frame || v >= this.n || !route.places.length) return;
      const colour = chosen ? this.palette.select : this.palette.state[frame.state[v]] || this.palette.route;
      const first = this._nextPlace(route, this.nowX[v], this.nowY[v]);
      if (first < 0) return;
      const points = [[this.nowX[v], this.nowY[v]]];
      let held = 0;
      for (let k = first; k < route.places.length; k++) {
        const spot = floor.places[route.places[k]];
        if (!spot) continue;
        points.push(spot);
        if (k < route.held) held = points.length - 1;
      }
      if (points.length < 2) return;
      const line = (from, to, width, alpha) => {
        ctx.globalAlpha = alpha;
        ctx.lineWidth = width;
        ctx.lineCap = ctx.lineJoin = "round";
        ctx.strokeStyle = colour;
        ctx.beginPath();
        for (let k = from; k <= to; k++) { const [sx, sy] = this.toScreen(...points[k]); k === from ? ctx.moveTo(sx, sy) : ctx.lineTo(sx, sy); }
        ctx.stroke();
      };
      const cell = floor.cell_m * this.view.scale;
      line(0, points.length - 1, Math.max(1, cell * 0.05) * (chosen ? 1.6 : 1), chosen ? 1 : 0.75);
      if (held > 0) line(0, held, Math.max(2.5, cell * 0.16) * (chosen ? 1.3 : 1), chosen ? 0.95 : 0.6);
      const [ex, ey] = this.toScreen(...points[points.length - 1]);
      ctx.globalAlpha = chosen ? 1 : 0.75;
      ctx.lineWidth = Math.max(1, cell * 0.06);
      ctx.beginPath();
      ctx.arc(ex, ey, Math.max(2, cell * 0.16), 0, 2 * Math.PI);
      ctx.stroke();
      ctx.globalAlpha = 1;
    }

    /** Index of the place of a route that a vehicle at (x, y) comes to next; -1 when it is not on it: routes are
     *  fetched less often than frames, and may be of an earlier plan. */
    _nextPlace(route, x, y) {
      const { places } = this.floor;
      let nearest = 0, least = Infinity;
      for (let k = 0; k < Math.min(route.places.length, 60); k++) {
        const [px, py] = places[route.places[k]], d = (px - x) ** 2 + (py - y) ** 2;
        if (d < least - 1e-6) { least = d; nearest = k; }
        else if (least < 0.3 * this.floor.cell_m ** 2 && d > 9 * this.floor.cell_m ** 2) break;
      }
      if (least > (1.5 * this.floor.cell_m) ** 2) return -1;
      if (nearest + 1 >= route.places.length) return nearest;
      const [ax, ay] = places[route.places[nearest]], [bx, by] = places[route.places[nearest + 1]];
      return (x - ax) * (bx - ax) + (y - ay) * (by - ay) >= -1e-3 ? nearest + 1 : nearest;
    }

    _drawFleet(ctx) {
      const { frame, palette, layers, dpr } = this;
      const share = this.network ? NETWORK_SHARE : VEHICLE_SHARE;
      const size = (this.ground ? this.ground.robotPx() : Math.max(LEAST_PX, Math.min(64, share * this.floor.cell_m * this.view.scale))) * dpr;
      const slot = Math.ceil(size * 1.9) + 2;
      if (!this.sprites || this.sprites.slot !== slot) { this.sprites = new wl.marks.Atlas(slot); this.numbers = null; }
      const numbers = layers.ids && !this.ground && size >= NUMBER_FROM_PX * dpr;
      if (numbers && !this.numbers) this.numbers = new wl.marks.Atlas(slot);
      const scale = this.view.scale * dpr, whole = this.n > SUBPIXEL_BELOW;
      const ox = (this.cssW / 2) * dpr - this.view.x * scale, oy = (this.cssH / 2) * dpr + this.view.y * scale;
      const right = this.canvas.width + slot / 2, low = this.canvas.height + slot / 2;
      const toBucket = BUCKETS / (2 * Math.PI);
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      for (let i = 0; i < this.n; i++) {
        let x = ox + this.nowX[i] * scale, y = oy - this.nowY[i] * scale;
        if (x < -slot || y < -slot || x > right || y > low) continue;
        if (whole) { x = Math.round(x); y = Math.round(y); }
        const state = frame.state[i], flags = frame.flags[i] & (LOADED | LOW);
        const bucket = ((Math.round(this.nowH[i] * toBucket) % BUCKETS) + BUCKETS) % BUCKETS;
        const colour = this._bodyColour(i);
        const key = `${colour}${state}|${flags}|${bucket}`;
        const at = this.sprites.at(key, (c, cx, cy) =>
          wl.marks.vehicle(c, cx, cy, size, { state, flags, colour, palette, heading: (bucket / BUCKETS) * 2 * Math.PI }));
        this.sprites.draw(ctx, at, x, y);
        if (numbers) {
          const paper = flags & LOADED ? palette.box : colour;
          this.numbers.draw(ctx, this.numbers.at(`${i}|${wl.marks.ink(paper)}`, (c, cx, cy) => {
            c.font = `700 ${Math.round(size * (i > 99 ? 0.34 : 0.42))}px system-ui, sans-serif`;
            c.textAlign = "center";
            c.textBaseline = "middle";
            c.fillStyle = wl.marks.ink(paper);
            c.fillText(String(i), cx, cy + size * 0.03);
          }), x, y);
        }
      }
      this._drawSelection(ctx, size, scale, ox, oy);
    }

    _bodyColour(i) {
      const { frame, power } = this, watts = power[i];
      const share = watts === null || watts === undefined ? null : this.powerTop > 0 ? watts / this.powerTop : 0;
      return wl.marks.bodyColour(this.palette, this.layers.colour,
        { id: i, state: frame.state[i], soc: frame.soc[i], flags: frame.flags[i], power: share });
    }

    _drawSelection(ctx, size, scale, ox, oy) {
      const chosen = this.selection;
      if (!chosen) return;
      ctx.strokeStyle = this.palette.select;
      ctx.lineWidth = 2.5 * this.dpr;
      ctx.beginPath();
      if (chosen.kind === "vehicle" && chosen.id < this.n) {
        ctx.arc(ox + this.nowX[chosen.id] * scale, oy - this.nowY[chosen.id] * scale, size * 0.92, 0, 2 * Math.PI);
      } else if (chosen.place !== undefined && this.floor.places[chosen.place]) {
        const [x, y] = this.floor.places[chosen.place], c = this._markSize() * scale;
        ctx.rect(ox + x * scale - c / 2, oy - y * scale - c / 2, c, c);
      }
      ctx.stroke();
    }

    /** Side of the square round a place, in metres. */
    _markSize() {
      if (this.ground) return Math.max(this.floor.cell_m, CELL_MARK_PX / this.view.scale);
      return this.floor.cell_m * (this.network ? NETWORK_SHARE : 1);
    }

    _drawSend(ctx) {
      const target = this.sendAt;
      if (target === undefined || !this.floor.places[target]) return;
      const [sx, sy] = this.placeScreen(target), c = this._markSize() * this.view.scale * this.dpr;
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.strokeStyle = this.palette.select;
      ctx.setLineDash([6 * this.dpr, 4 * this.dpr]);
      ctx.lineWidth = 2 * this.dpr;
      ctx.strokeRect(sx * this.dpr - c / 2, sy * this.dpr - c / 2, c, c);
      ctx.setLineDash([]);
    }

    // ---- hands

    _listen() {
      const canvas = this.canvas, points = new Map();
      let dragged = false, press = 0, pinch = 0;
      const at = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
      canvas.addEventListener("pointerdown", (event) => {
        if (event.button === 2) return;
        canvas.setPointerCapture(event.pointerId);
        points.set(event.pointerId, at(event));
        dragged = points.size > 1;
        this._hideTip();
        clearTimeout(press);
        if (event.pointerType === "touch" && points.size === 1) {
          press = setTimeout(() => { dragged = true; this._menu(event.clientX, event.clientY, ...at(event)); }, LONG_PRESS_MS);
        }
        if (points.size === 2) { const [a, b] = [...points.values()]; pinch = Math.hypot(a[0] - b[0], a[1] - b[1]); }
      });
      canvas.addEventListener("pointermove", (event) => {
        const here = at(event), before = points.get(event.pointerId);
        if (!before) { this._hover(...here); return; }
        const dx = here[0] - before[0], dy = here[1] - before[1];
        if (points.size === 1) {
          if (!dragged && Math.hypot(dx, dy) < 4) return;
          dragged = true;
          clearTimeout(press);
          this.follow = false;
          this.view.x -= dx / this.view.scale;
          this.view.y += dy / this.view.scale;
          this._moved();
        }
        points.set(event.pointerId, here);
        if (points.size === 2) {
          const [a, b] = [...points.values()], wide = Math.hypot(a[0] - b[0], a[1] - b[1]);
          if (pinch > 0) this.zoom(wide / pinch, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
          pinch = wide;
        }
      });
      const end = (event) => {
        clearTimeout(press);
        if (!points.delete(event.pointerId)) return;
        if (event.type === "pointerup" && !dragged && event.button !== 2) this._click(...at(event));
      };
      canvas.addEventListener("pointerup", end);
      canvas.addEventListener("pointercancel", end);
      canvas.addEventListener("pointerleave", () => this._hideTip());
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        const step = event.deltaMode === 1 ? event.deltaY * 16 : event.deltaY;
        this.zoom(Math.exp(-Math.max(-200, Math.min(200, step)) * 0.0022), ...at(event));
      }, { passive: false });
      canvas.addEventListener("dblclick", (event) => {
        const [x, y] = this.toFloor(...at(event));
        this.centre(x, y);
      });
      canvas.addEventListener("contextmenu", (event) => {
        event.preventDefault();
        const byKey = event.button !== 2 && this.selection && this.selection.kind === "vehicle";
        const here = byKey ? this.vehicleScreen(this.selection.id) : at(event);
        const box = canvas.getBoundingClientRect();
        this._menu(box.left + here[0], box.top + here[1], ...here);
      });
    }

    _click(px, py) {
      const target = this.pick(px, py);
      if (this.sendMode) {
        const place = this._placeUnder(px, py);
        if (place !== undefined) { const send = this.sendMode; this.endSend(); send(place); }
        return;
      }
      this.hooks.select(target && target.kind === "place" ? { ...target } : target, { from: "map" });
    }

    _placeUnder(px, py) {
      const [x, y] = this.toFloor(px, py);
      return this._placeAtPoint(x, y);
    }

    _menu(clientX, clientY, px, py) {
      this._hideTip();
      const target = this.pick(px, py);
      if (target) this.hooks.menu(target, clientX, clientY);
    }

    /** The next click on a cell chooses the place to which a vehicle is sent. */
    beginSend(done) {
      this.sendMode = done;
      this.sendAt = undefined;
      this.canvas.classList.add("aiming");
    }

    endSend() {
      this.sendMode = null;
      this.canvas.classList.remove("aiming");
      this._wake();
    }

    _hover(px, py) {
      if (this.sendMode) {
        const place = this._placeUnder(px, py);
        if (place !== this.sendAt) { this.sendAt = place; this._wake(); }
      }
      const target = this.pick(px, py);
      this.pointed = [px, py];
      this.onArc = !!target && this.laneAt.has(target.place);
      this.canvas.classList.toggle("over", !!target && target.kind !== "place" && !this.sendMode);
      if (!target) { this._hideTip(); return; }
      this.tip.textContent = this.describe(target);
      this.tip.hidden = false;
      const wide = this.tip.offsetWidth, high = this.tip.offsetHeight;
      this.tip.style.left = `${Math.min(px + 14, this.cssW - wide - 4)}px`;
      this.tip.style.top = `${py + 18 + high > this.cssH ? py - high - 10 : py + 18}px`;
    }

    _hideTip() { this.tip.hidden = true; this.onArc = false; }

    cellName(place) {
      if (this.network) return wl.network.name(this, place);
      const [x, y] = this.floor.places[place];
      return `(${Math.floor(x / this.floor.cell_m)}, ${Math.floor(y / this.floor.cell_m)})`;
    }

    describe(target) {
      if (target.kind === "vehicle") {
        const { frame } = this, i = target.id, soc = frame.soc[i];
        const parts = [this.ground ? "Robot" : `Vehicle ${i}`, WORDS[frame.state[i]] || "?"];
        const task = frame.flags[i] >> TASK_SHIFT;
        if (task && !this.ground) parts.push(TASKS[task]);
        if (this.layers.colour === "power" && !this.ground && typeof this.power[i] === "number") parts.push(`${Math.round(this.power[i])} W`);
        if (soc !== UNKNOWN_SOC) parts.push(`SoC ${Math.round((100 * soc) / FULL_SOC)} %${frame.flags[i] & LOW ? " (low)" : ""}`);
        if (frame.flags[i] & LOADED) parts.push("loaded");
        return parts.join(" · ");
      }
      if (this.ground) return [`cell ${this.cellName(target.place)}`, ...this.ground.facts(target.place)].join(" · ");
      const parts = [], lane = this.laneAt.get(target.place);
      const station = this.stationAt.get(target.place), charger = this.chargerAt.get(target.place), spot = this.parkingAt.get(target.place);
      const way = this.oneWayAt.get(target.place);
      if (station) parts.push(`${station.kind} ${station.name} · station ${station.number}`);
      if (charger) parts.push(`charger ${charger.name}${this.chargersOut.has(charger.place) ? " · out of order" : ""}`);
      if (lane) parts.push(`${lane.kerb ? "kerb" : "lane"} ${this.cellName(target.place)}`);
      else if (spot) parts.push(`parking ${spot.name}`);
      if (!parts.length) parts.push(this.network ? "node" : way ? "one-way aisle" : "aisle");
      if (lane && this.arcs) parts.push(...wl.network.facts(this.arcs, target.place, this.layers.window));
      else if (!lane) parts.push(`${this.cellName(target.place)} · place ${target.place}`);
      if (this.blocked.has(target.place)) parts.push("blocked");
      const told = lane && this.arcs && ["expected", "occupancy"].includes(this.layers.heat);
      if (this.layers.heat && this.heat && !told && !(this.layers.heat === "expected" && !this.heat[target.place])) {
        parts.push(`${wl.HEATS[this.layers.heat]} ${wl.heatText(this.layers.heat, this.heat[target.place])}`);
      }
      return parts.join(" · ");
    }
  };

  wl.HEATS = { "": "no heat map", occupancy: "occupancy", waiting: "waiting", energy: "energy", expected: "expected time" };

  wl.heatText = (kind, value) => {
    if (!(value > 0)) return "0";
    if (kind === "expected") return `${value.toFixed(2)} s`;
    if (kind === "energy") return value >= 1e6 ? `${(value / 1e6).toFixed(2)} MJ` : value >= 1e3 ? `${(value / 1e3).toFixed(1)} kJ` : `${value.toFixed(0)} J`;
    if (kind === "occupancy" && value <= 1) return `${(100 * value).toFixed(1)} %`;
    return wl.span(value);
  };

  wl.COLOURINGS = COLOURINGS;

  const rowsInto = (host, rows) => host.replaceChildren(...rows.map(([canvas, word]) => el("span", { class: "wl-legend-row" }, canvas, word)));

  /** The legend of a map, drawn with the map's own marks. */
  wl.legend = (host, map) => {
    const { palette, layers, powerTop, network, chargerAt } = map;
    const dpr = Math.min(3, window.devicePixelRatio || 1), px = 20;
    const mark = (draw) => {
      const canvas = el("canvas", { width: px * dpr, height: px * dpr, "aria-hidden": "true" });
      canvas.style.width = canvas.style.height = `${px}px`;
      const ctx = canvas.getContext("2d");
      ctx.scale(dpr, dpr);
      draw(ctx, px / 2, px / 2);
      return canvas;
    };
    const vehicle = ({ id = 0, state = 1, flags = 0, soc = 200, power = 0 }) => mark((ctx, x, y) => wl.marks.vehicle(ctx, x, y,
      flags & LOW ? 11 : 14, { state, flags: flags & (LOADED | LOW), heading: 0, palette,
        colour: wl.marks.bodyColour(palette, layers.colour, { id, state, flags, soc, power }) }));
    const signs = [[{ flags: LOADED }, "loaded"], [{ flags: LOW }, "low battery"]];
    const watts = (share) => (powerTop > 0 ? `${(share * powerTop).toPrecision(2) * 1} W` : share ? "most" : "none");
    const looks = {
      state: [1, 3, 2, 4, 5, 0, 7, 6].map((state) => [{ state }, WORDS[state]]).concat(signs),
      id: [[{ id: 0 }, "0"], [{ id: 1 }, "1"], [{ id: 2 }, "2"], [{ id: 3 }, "3, and so on"], ...signs],
      soc: [0, 25, 50, 75, 100].map((percent) => [{ soc: (percent / 100) * FULL_SOC }, `${percent} %`]).concat(signs),
      task: TASKS.map((word, task) => [{ flags: task << TASK_SHIFT }, task ? word : "no task"]).concat(signs),
      power: [0, 0.25, 0.5, 1].map((power) => [{ power }, watts(power)]).concat([[{ state: 5, power: -1 }, "charging"], ...signs]),
      thesis: [[{}, "empty"], [{ flags: LOADED }, "loaded"], [{ flags: LOW }, "low"], [{ state: 5 }, "charged to 50 %"], [{ state: 6 }, "fault"]],
    };
    if (map.ground) {
      const states = [1, 2, 7, 6, 0].map((state) => [vehicle({ state }), WORDS[state]]);
      rowsInto(host, [...(layers.colour === "power" ? [] : states), ...wl.terrain.marks(map).map(([draw, word]) => [mark(draw), word])]);
      return;
    }
    const rows = looks[layers.colour].map(([look, word]) => [vehicle(look), word]);
    if (network) rows.push(...wl.network.marks(palette).map(([draw, word]) => [mark(draw), word]));
    if (!network || chargerAt.size) rows.push(
      [mark((ctx, x, y) => { ctx.fillStyle = palette.charger; wl.marks.roundRect(ctx, x - 8, y - 8, 16, 16, 2); ctx.fill(); wl.marks.bolt(ctx, x, y, 12, palette.bolt, null); }), "charger"]);
    rows.push(
      [mark((ctx, x, y) => { ctx.strokeStyle = palette.blocked; ctx.lineWidth = 1.5; ctx.beginPath(); ctx.rect(x - 8, y - 8, 16, 16); ctx.clip(); for (let d = -16; d <= 16; d += 4) { ctx.moveTo(x - 8 + d, y + 8); ctx.lineTo(x + 8 + d, y - 8); } ctx.rect(x - 8, y - 8, 16, 16); ctx.stroke(); }), "blocked"],
      [mark((ctx, x, y) => { ctx.strokeStyle = palette.route; ctx.lineCap = "round"; ctx.lineWidth = 4; ctx.globalAlpha = 0.7; ctx.beginPath(); ctx.moveTo(x - 10, y); ctx.lineTo(x - 1, y); ctx.stroke(); ctx.globalAlpha = 1; ctx.lineWidth = 1.4; ctx.beginPath(); ctx.moveTo(x - 10, y); ctx.lineTo(x + 10, y); ctx.stroke(); }), "route: reserved, planned"]);
    rowsInto(host, rows);
  };
})();
