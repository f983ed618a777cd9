/* Ground on the live map: hillshade, contours, obstacles, what the robot knows of it, its way, track and goal. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const LIGHT = [-0.5, 0.5, 0.7071];   // from the north-west, 45 degrees high
  const STEEPER = 2.2;                 // relief is drawn so much steeper than it is
  const CONTOURS = 14, BOLD_EVERY = 4; // about so many levels, of which every fourth is bold and may be labelled
  const LABELS = 14, LABEL_GAP_PX = 120, LABEL_EDGE = 0.03, ANCHORS = 500;   // of the side: there a label would lie outside
  const MINOR_FROM = 5;                // px/m: farther away only bold contours are drawn
  const CONTOURS_MS = 300;             // while the known area grows, contours follow so often at most
  const CASING = "rgba(255,255,255,.85)";   // under the colours of power, whose low end is dark
  const LEAST_ROBOT_PX = 17, WATTS_STEP = 10;
  const FREE = 0, SEEN = 1, UNSEEN = 2, GONE = 3;   // of an obstacle in a cell: GONE was removed, and the robot doesn't know

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const metres = ({ low_m: low, unit_m: unit, data }) => Float32Array.from(new Uint16Array(bytes(data)), (n) => low + unit * n);
  const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  const mix = (a, b, part) => a.map((c, i) => c + (b[i] - c) * part);
  const rgba = (hex, alpha) => `rgba(${channels(hex).join(",")},${alpha})`;

  const COLOURS = ["low", "mid", "high", "veil", "contour", "obstacle", "rough", "steep", "way", "track", "goal", "halo", "sensor", "open", "incons"];
  const readColours = (host) => {
    const style = getComputedStyle(host);
    return Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--wl-ground-${name}`).trim() || "#888888"]));
  };

  /** Red, green and blue of relief, three numbers per cell, row 0 at the bottom. */
  const shaded = (heights, columns, rows, cellM, [low, top], colours) => {
    const out = new Uint8ClampedArray(3 * columns * rows), ramp = ["low", "mid", "high"].map((name) => channels(colours[name]));
    for (let y = 0; y < rows; y++) {
      const south = Math.max(y - 1, 0), north = Math.min(y + 1, rows - 1);
      for (let x = 0; x < columns; x++) {
        const west = Math.max(x - 1, 0), east = Math.min(x + 1, columns - 1), at = y * columns + x;
        const dx = (STEEPER * (heights[y * columns + east] - heights[y * columns + west])) / ((east - west) * cellM);
        const dy = (STEEPER * (heights[north * columns + x] - heights[south * columns + x])) / ((north - south) * cellM);
        const light = Math.max(0, (-dx * LIGHT[0] - dy * LIGHT[1] + LIGHT[2]) / Math.sqrt(dx * dx + dy * dy + 1)) / LIGHT[2];
        const share = top > low ? Math.min(1, Math.max(0, (heights[at] - low) / (top - low))) : 0.3;
        const tint = share < 0.5 ? mix(ramp[0], ramp[1], 2 * share) : mix(ramp[1], ramp[2], 2 * share - 1);
        const factor = 0.45 + 0.55 * Math.min(light, 1.12);
        for (let i = 0; i < 3; i++) out[3 * at + i] = tint[i] * factor;
      }
    }
    return out;
  };

  /** A distance between levels that reads well, for about `wanted` of them. */
  const interval = (range, wanted) => {
    const raw = Math.max(range, 0.01) / wanted, ten = 10 ** Math.floor(Math.log10(raw));
    return [1, 2.5, 5, 10].map((s) => s * ten).find((step) => step >= raw * 0.999);
  };

  /** Contour lines by marching squares: flat arrays of ends in metres, of levels, and of the cells they lie in. */
  const contours = (heights, columns, rows, cellM, step) => {
    const ends = [], levels = [], cells = [];
    const cross = (level, ax, ay, a, bx, by, b) => {
      const part = (level - a) / (b - a);
      return [(ax + (bx - ax) * part + 0.5) * cellM, (ay + (by - ay) * part + 0.5) * cellM];
    };
    for (let y = 0; y + 1 < rows; y++) {
      for (let x = 0; x + 1 < columns; x++) {
        const at = y * columns + x, a = heights[at], b = heights[at + 1], c = heights[at + columns + 1], d = heights[at + columns];
        const low = Math.min(a, b, c, d), top = Math.max(a, b, c, d);
        for (let n = Math.ceil(low / step); n * step <= top; n++) {
          const level = n * step + 1e-6, points = [];
          if (a < level !== b < level) points.push(cross(level, x, y, a, x + 1, y, b));
          if (b < level !== c < level) points.push(cross(level, x + 1, y, b, x + 1, y + 1, c));
          if (d < level !== c < level) points.push(cross(level, x, y + 1, d, x + 1, y + 1, c));
          if (a < level !== d < level) points.push(cross(level, x, y, a, x, y + 1, d));
          for (let i = 0; i + 1 < points.length; i += 2) {
            ends.push(...points[i], ...points[i + 1]);
            levels.push(n);
            cells.push(at);
          }
        }
      }
    }
    return { ends: Float32Array.from(ends), levels: Int16Array.from(levels), cells: Int32Array.from(cells) };
  };

  wl.Ground = class {
    /** map: the FleetMap that it lies under; its floor is of kind "terrain", and gets its `places`. */
    constructor(map, floor) {
      this.map = map;
      this.columns = floor.width;
      this.rows = floor.height;
      this.cellM = floor.cell_m;
      this.cluster = floor.cluster;
      this.sensorM = floor.sensor_m;
      this.bodyM = floor.body_m;
      this.steepest = Math.tan((floor.slope_limit_deg * Math.PI) / 180);
      this.height = metres(floor.heights);
      this.prior = floor.prior && metres(floor.prior);
      this.friction = Float32Array.from(new Uint16Array(bytes(floor.friction)), (part) => part / 100);
      this.stone = new Uint8Array(this.columns * this.rows);
      floor.cells.forEach((row, y) => { for (let x = 0; x < this.columns; x++) this.stone[y * this.columns + x] = row[x] === "#" ? 1 : 0; });
      floor.places = Array.from(this.height, (_, at) => [((at % this.columns) + 0.5) * this.cellM, (Math.floor(at / this.columns) + 0.5) * this.cellM]);
      const [low, top] = this.height.reduce(([a, b], h) => [Math.min(a, h), Math.max(b, h)], [Infinity, -Infinity]);
      this.ends = [low, top];
      this.step = interval(top - low, CONTOURS);
      this.lines = [this.height, this.prior].map((heights) => heights && contours(heights, this.columns, this.rows, this.cellM, this.step));
      this.anchors = this.lines.map((lines) => lines && this._anchors(lines));
      this.rough = this._runs((at) => this.friction[at] > 1.02);
      this.steep = this._runs((at) => this.slope(at) > this.steepest);
      this.disc = this._disc();
      this.image = document.createElement("canvas");
      this.image.width = this.columns;
      this.image.height = this.rows;
      this.known = new Uint8Array(this.columns * this.rows);
      this.changes = new Map();      // place → [there, seen]
      this.track = { t0_s: [], t1_s: [], place: [], to: [], heading: [], k: [], watts: [], next: 0 };
      this.shown = -1;               // so many looks around are in `known`
      this.way = [];
      this.wayRow = -2;
      this.watts = [];               // ends of the scale of power
    }

    // ---- what is known of it

    _disc() {
      const n = Math.floor(this.sensorM / this.cellM + 1e-9), out = [], r = (this.sensorM / this.cellM) ** 2;
      for (let y = -n; y <= n; y++) for (let x = -n; x <= n; x++) if (x * x + y * y <= r) out.push([x, y]);
      return out;
    }

    /** Runs [x from, x to, y] of cells, row by row. */
    _runs(wanted) {
      const runs = [];
      for (let y = 0; y < this.rows; y++) {
        for (let x = 0; x < this.columns; x++) {
          if (!wanted(y * this.columns + x)) continue;
          const from = x;
          while (x + 1 < this.columns && wanted(y * this.columns + x + 1)) x++;
          runs.push([from, x, y]);
        }
      }
      return runs;
    }

    /** What the server tells of a moment. Returns true when the scale of power has changed. */
    told(told) {
      const { track } = told;
      if (track.from !== this.track.next) {   // anew
        this.track = { ...track };
        this.shown = -1;
      } else {
        for (const name of ["t0_s", "t1_s", "place", "to", "heading", "k", "watts"]) this.track[name].push(...track[name]);
        this.track.next = track.next;
      }
      this.track.start = track.start;
      this.veilable = true;
      this.goal = told.goal;
      this.search = told.search;
      this.frontier = told.frontier;
      if (told.way) { this.way = told.way; this.wayRow = told.way_row; this.wayAt = 0; }
      const changes = new Map(told.obstacles.map(([place, there, seen]) => [place, [there, seen]]));
      const same = changes.size === this.changes.size && [...changes].every(([place, [there, seen]]) => {
        const old = this.changes.get(place);
        return old && old[0] === there && old[1] === seen;
      });
      this.changes = changes;
      if (!same) { this.solidStale = true; this.map._stale(); }
      const before = this.watts.join(), sorted = [...this.track.watts].sort((a, b) => a - b);
      const at = (share) => sorted[Math.round(share * (sorted.length - 1))] / WATTS_STEP;
      if (sorted.length) this.watts = [Math.floor(at(0.02)) * WATTS_STEP, Math.ceil(at(0.98)) * WATTS_STEP];
      this.map.power = [told.watts === null ? null : this._powerShare(told.watts)];
      this.map.powerTop = 1;
      this.map.pathsStale = true;
      this.map._wake();
      return before !== this.watts.join();
    }

    /** One scale of power for several. */
    static share(grounds) {
      const ends = [Math.min(...grounds.map(({ watts }) => watts[0])), Math.max(...grounds.map(({ watts }) => watts[1]))];
      for (const ground of grounds) ground.watts = ends;
    }

    /** So many of the track's motions have ended by a time. */
    _ended(time) {
      const { t1_s: ends } = this.track;
      let low = 0, high = ends.length;
      while (low < high) { const mid = (low + high) >> 1; if (ends[mid] <= time + 1e-6) low = mid + 1; else high = mid; }
      return low;
    }

    /** Lets what is known follow the clock, in seconds; true when it has changed. */
    follow(time) {
      const { veil } = this.map.layers, looks = veil && this.track.start !== undefined ? this._ended(time) + 1 : 0;
      if (looks === this.shown && veil === this.veiled) return false;
      const grows = veil && this.veiled && this.shown >= 0 && looks > this.shown;
      if (!grows) this.known.fill(veil && this.prior ? 0 : 1);
      const boxes = [];
      for (let i = grows ? this.shown : 0; i < looks; i++) boxes.push(this._see(i ? this.track.to[i - 1] : this.track.start));
      this.shown = looks;
      this.veiled = veil;
      this.solidStale = true;
      this.linesStale = true;
      if (grows) for (const box of boxes) this._paint(...box);
      else this.imageStale = true;
      return true;
    }

    _see(place) {
      const cx = place % this.columns, cy = Math.floor(place / this.columns), n = Math.floor(this.sensorM / this.cellM);
      for (const [dx, dy] of this.disc) {
        const x = cx + dx, y = cy + dy;
        if (x >= 0 && y >= 0 && x < this.columns && y < this.rows) this.known[y * this.columns + x] = 1;
      }
      return [Math.max(0, cx - n), Math.max(0, cy - n), Math.min(this.columns, cx + n + 1), Math.min(this.rows, cy + n + 1)];
    }

    slope(at) {
      const x = at % this.columns, y = Math.floor(at / this.columns), { height, columns, rows, cellM } = this;
      const west = Math.max(x - 1, 0), east = Math.min(x + 1, columns - 1), south = Math.max(y - 1, 0), north = Math.min(y + 1, rows - 1);
      return Math.hypot((height[y * columns + east] - height[y * columns + west]) / ((east - west) * cellM),
        (height[north * columns + x] - height[south * columns + x]) / ((north - south) * cellM));
    }

    /** Whether an obstacle stands in a cell, as things are. */
    obstacleAt(place) {
      const change = this.changes.get(place);
      return change ? !!change[0] : !!this.stone[place];
    }

    _solid(at) {
      const change = this.changes.get(at), known = this.known[at];
      if (!change) return this.stone[at] ? (known ? SEEN : UNSEEN) : FREE;
      const [there, noticed] = change, before = this.stone[at] && known;
      if (there) return (noticed && known) || before ? SEEN : UNSEEN;
      return before && !noticed ? GONE : FREE;
    }

    /** What a cell is, in a few words. */
    facts(place) {
      const parts = [], known = this.known[place], change = this._solid(place);
      if (known) parts.push(`${this.height[place].toFixed(2)} m`);
      else parts.push(`about ${this.prior[place].toFixed(1)} m, not seen yet`);
      if (known) parts.push(`slope ${Math.round((Math.atan(this.slope(place)) * 180) / Math.PI)}°`);
      if (known && this.friction[place] > 1.02) parts.push(`friction × ${this.friction[place].toFixed(2)}`);
      if (change === SEEN) parts.push("obstacle");
      if (change === UNSEEN) parts.push("obstacle that the robot doesn't know");
      if (change === GONE) parts.push("obstacle removed, the robot doesn't know");
      return parts;
    }

    // ---- drawing what stands still

    theme(host) {
      this.colours = readColours(host);
      this.shades = [this.height, this.prior].map((heights) => heights && shaded(heights, this.columns, this.rows, this.cellM, this.ends, this.colours));
      this.patterns = null;
      this.imageStale = true;
    }

    /** Writes cells of a box into the image: as they are where known, else the prior relief under a veil. */
    _paint(x0, y0, x1, y1) {
      const ctx = this.image.getContext("2d"), data = ctx.createImageData(x1 - x0, y1 - y0), veil = channels(this.colours.veil);
      for (let y = y0; y < y1; y++) {
        for (let x = x0; x < x1; x++) {
          const at = y * this.columns + x, to = 4 * ((y1 - 1 - y) * (x1 - x0) + x - x0), known = this.known[at];
          const from = this.shades[known || !this.prior ? 0 : 1], grey = known ? 0 : (from[3 * at] + from[3 * at + 1] + from[3 * at + 2]) / 3;
          for (let i = 0; i < 3; i++) data.data[to + i] = known ? from[3 * at + i] : grey * 0.55 + veil[i] * 0.45;
          data.data[to + 3] = 255;
        }
      }
      ctx.putImageData(data, x0, this.rows - y1);
    }

    draw(ctx, cell) {
      const { map } = this, [px, py] = map.toScreen(0, map.heightM);
      if (this.imageStale) { this._paint(0, 0, this.columns, this.rows); this.imageStale = false; }
      ctx.imageSmoothingEnabled = true;
      ctx.imageSmoothingQuality = "high";
      ctx.drawImage(this.image, px, py, map.widthM * map.view.scale, map.heightM * map.view.scale);
      this._fill(ctx, cell, this.rough, this._pattern("rough"), 0.75);
      this._fill(ctx, cell, this.steep, this._pattern("steep"), 0.8);
      if (map.layers.contours) this._drawContours(ctx);
      this._drawObstacles(ctx, cell);
    }

    _fill(ctx, cell, runs, style, alpha) {
      if (!runs.length) return;
      ctx.globalAlpha = alpha;
      ctx.fillStyle = style;
      ctx.beginPath();
      for (const [from, to, y] of runs) {
        const [px, py] = this.map.toScreen(from * this.cellM, (y + 1) * this.cellM);
        ctx.rect(px - 0.2, py - 0.2, (to - from + 1) * cell + 0.4, cell + 0.4);
      }
      ctx.fill();
      ctx.globalAlpha = 1;
    }

    /** Dots for rough ground, lines for steep ground and for obstacles that the robot doesn't know. */
    _pattern(name) {
      if (!this.patterns) this.patterns = {};
      if (!this.patterns[name]) {
        const tile = document.createElement("canvas"), side = name === "rough" ? 7 : 6;
        tile.width = tile.height = side;
        const ctx = tile.getContext("2d"), colour = this.colours[name];
        ctx.fillStyle = ctx.strokeStyle = colour;
        if (name === "rough") { ctx.beginPath(); ctx.arc(2, 2, 1.1, 0, 7); ctx.arc(5.5, 5.5, 1.1, 0, 7); ctx.fill(); }
        else {
          ctx.lineWidth = 1.4;
          ctx.beginPath();
          for (const d of [-side, 0, side]) { ctx.moveTo(d - 1, side + 1); ctx.lineTo(d + side + 1, -1); }
          ctx.stroke();
        }
        this.patterns[name] = ctx.createPattern(tile, "repeat");
      }
      return this.patterns[name];
    }

    _drawObstacles(ctx, cell) {
      if (this.solidStale || !this.solid) {
        this.solid = [SEEN, UNSEEN, GONE].map((wanted) => this._runs((at) => (this.stone[at] || this.changes.has(at)) && this._solid(at) === wanted));
        this.solidStale = false;
      }
      const [seen, unseen, gone] = this.solid;
      this._fill(ctx, cell, seen, this.colours.obstacle, 1);
      this._fill(ctx, cell, unseen, this.colours.obstacle, 0.18);
      this._fill(ctx, cell, unseen, this._pattern("obstacle"), 0.75);
      this._fill(ctx, cell, gone, this.colours.obstacle, 0.4);
    }

    /** Places for labels of bold contours, in an order of their own so that neighbours don't come first. */
    _anchors({ ends, levels }) {
      const found = [];
      levels.forEach((level, i) => {
        if (level % BOLD_EVERY) return;
        const [ax, ay, bx, by] = ends.subarray(4 * i, 4 * i + 4), edge = LABEL_EDGE * Math.min(this.map.widthM, this.map.heightM);
        if (ax < edge || ay < edge || ax > this.map.widthM - edge || ay > this.map.heightM - edge) return;
        found.push({ i, level, x: (ax + bx) / 2, y: (ay + by) / 2, angle: Math.atan2(by - ay, bx - ax), rank: (i * 7919) % 10007 });
      });
      return found.sort((a, b) => a.rank - b.rank).slice(0, ANCHORS);
    }

    _linePaths() {
      const minor = new Path2D(), bold = new Path2D();
      this.lines.forEach((lines, prior) => {
        if (!lines) return;
        const { ends, levels, cells } = lines;
        for (let i = 0; i < levels.length; i++) {
          if (!this.known[cells[i]] !== !!prior) continue;
          const path = levels[i] % BOLD_EVERY ? minor : bold;
          path.moveTo(ends[4 * i], ends[4 * i + 1]);
          path.lineTo(ends[4 * i + 2], ends[4 * i + 3]);
        }
      });
      return [minor, bold];
    }

    _drawContours(ctx) {
      const { map } = this, { scale } = map.view, now = performance.now();
      if (!this.paths || this.linesStale && now - this.linesAt > CONTOURS_MS) { this.paths = this._linePaths(); this.linesStale = false; this.linesAt = now; }
      else if (this.linesStale && !this.linesLater) {
        this.linesLater = setTimeout(() => { this.linesLater = 0; map._stale(); }, CONTOURS_MS);
      }
      const [minor, bold] = this.paths, [ox, oy] = map.toScreen(0, 0);
      ctx.save();
      ctx.transform(scale, 0, 0, -scale, ox, oy);
      ctx.lineCap = "round";
      ctx.strokeStyle = this.colours.contour;
      ctx.globalAlpha = 0.3;
      ctx.lineWidth = 0.8 / scale;
      if (scale >= MINOR_FROM) ctx.stroke(minor);
      ctx.globalAlpha = 0.6;
      ctx.lineWidth = 1.3 / scale;
      ctx.stroke(bold);
      ctx.restore();
      this._drawLabels(ctx);
    }

    _drawLabels(ctx) {
      const { map } = this, placed = [], text = (level) => `${Number((level * this.step).toFixed(3))} m`;
      ctx.font = "600 10.5px system-ui, sans-serif";
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.lineJoin = "round";
      this.anchors.forEach((anchors, prior) => {
        for (const anchor of anchors || []) {
          if (placed.length >= LABELS) return;
          if (!this.known[this.lines[prior].cells[anchor.i]] !== !!prior) continue;
          const [x, y] = map.toScreen(anchor.x, anchor.y);
          if (x < 30 || y < 60 || x > map.cssW - 30 || y > map.cssH - 20) continue;
          if (placed.some(([ox, oy]) => Math.hypot(ox - x, oy - y) < LABEL_GAP_PX)) continue;
          placed.push([x, y]);
          let angle = -anchor.angle;
          if (angle > Math.PI / 2) angle -= Math.PI; else if (angle < -Math.PI / 2) angle += Math.PI;
          ctx.save();
          ctx.translate(x, y);
          ctx.rotate(angle);
          ctx.lineWidth = 3;
          ctx.strokeStyle = rgba(this.colours.halo, 0.75);
          ctx.strokeText(text(anchor.level), 0, 0);
          ctx.fillStyle = this.colours.contour;
          ctx.fillText(text(anchor.level), 0, 0);
          ctx.restore();
        }
      });
    }

    // ---- drawing what moves

    robotPx() { return Math.max(LEAST_ROBOT_PX, Math.min(64, 2 * this.bodyM * this.map.view.scale)); }

    /** Track, search frontier, way, sensor and goal; ctx in device pixels. */
    drawWays(ctx) {
      const { map } = this, { dpr } = map, time = map.frame ? map.frame.time : 0, ended = this._ended(time);
      const shown = map.layers.paths || map.selection && map.selection.kind === "vehicle";
      if (map.pathsStale || this.trackShown !== ended) {
        const layer = map.paths.getContext("2d");
        layer.setTransform(1, 0, 0, 1, 0, 0);
        layer.clearRect(0, 0, map.paths.width, map.paths.height);
        layer.setTransform(dpr, 0, 0, dpr, 0, 0);
        if (map.layers.frontier && this.frontier) this._drawFrontier(layer);
        if (shown) this._drawTrack(layer, ended);
        map.pathsStale = false;
        this.trackShown = ended;
      }
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.drawImage(map.paths, 0, 0);
      ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
      ctx.lineCap = ctx.lineJoin = "round";
      if (map.frame && map.n) {
        const here = [map.nowX[0], map.nowY[0]];
        if (shown) this._drawTail(ctx, ended, here);
        if (shown && this.way.length) this._drawWay(ctx, here);
        this._drawSensor(ctx, here);
      }
      if (this.goal !== undefined) this._drawGoal(ctx, map.floor.places[this.goal]);
      ctx.setTransform(1, 0, 0, 1, 0, 0);
    }

    _drawFrontier(ctx) {
      const cell = Math.max(1.5, this.cellM * this.map.view.scale * 0.7), { places } = this.map.floor;
      for (const name of ["open", "incons"]) {
        ctx.fillStyle = rgba(this.colours[name], 0.7);
        ctx.beginPath();
        for (const place of this.frontier[name]) { const [x, y] = this.map.toScreen(...places[place]); ctx.rect(x - cell / 2, y - cell / 2, cell, cell); }
        ctx.fill();
      }
    }

    /** Points of motion i of the track, on the screen. */
    _points(i) {
      const { place, heading, k } = this.track, [x, y] = this.map.floor.places[place[i]];
      if (k[i] < 0) return [this.map.toScreen(x, y), this.map.toScreen(...this.map.floor.places[this.track.to[i]])];
      return this.cluster.points[heading[i]][k[i]].map(([dx, dy]) => this.map.toScreen(x + dx * this.cellM, y + dy * this.cellM));
    }

    _powerShare(watts) { const [low, top] = this.watts; return top > low ? Math.min(1, Math.max(0, (watts - low) / (top - low))) : 0; }

    _powerColour(watts) { return `rgb(${wl.marks.viridis(this._powerShare(watts)).join(",")})`; }

    _drawTrack(ctx, ended) {
      const coloured = this.map.layers.colour === "power", width = this._width();
      ctx.lineCap = ctx.lineJoin = "round";
      const line = (from, to, style, wide) => {
        ctx.beginPath();
        for (let i = from; i < to; i++) this._points(i).forEach(([x, y], j) => (j || i > from ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
        ctx.strokeStyle = style;
        ctx.lineWidth = wide;
        ctx.stroke();
      };
      if (!ended) return;
      line(0, ended, coloured ? CASING : rgba(this.colours.halo, 0.6), width + 2.5);
      if (!coloured) { line(0, ended, this.colours.track, width); return; }
      for (let i = 0; i < ended; i++) line(i, i + 1, this._powerColour(this.track.watts[i]), width + 1);
    }

    _drawTail(ctx, ended, here) {
      const { to, t0_s: begins } = this.track, from = ended ? to[ended - 1] : this.track.start;
      if (from === undefined) return;
      const [x, y] = this.map.floor.places[from], time = this.map.frame.time;
      if (Math.hypot(x - here[0], y - here[1]) > 3) return;   // the log is behind the frames
      const open = ended < begins.length && begins[ended] <= time;
      ctx.strokeStyle = this.map.layers.colour === "power" && open ? this._powerColour(this.track.watts[ended]) : this.colours.track;
      ctx.lineWidth = this._width();
      ctx.beginPath();
      ctx.moveTo(...this.map.toScreen(x, y));
      ctx.lineTo(...this.map.toScreen(...here));
      ctx.stroke();
    }

    _width() { return Math.max(2, Math.min(5, 0.14 * this.map.view.scale)); }

    /** What is left of the way: from the point that the robot is nearest to, looked for near the last one. */
    _drawWay(ctx, [x, y]) {
      const { way } = this, n = way.length / 2, last = Math.min(this.wayAt || 0, n - 1);
      let nearest = last, least = Infinity;
      for (let i = 0; i < n; i++) {
        const d = (way[2 * i] - x) ** 2 + (way[2 * i + 1] - y) ** 2;
        if (d < least - 1e-9) { least = d; nearest = i; }
      }
      this.wayAt = nearest;
      const points = [[x, y]];
      for (let i = nearest + (nearest ? 1 : 0); i < n; i++) points.push([way[2 * i], way[2 * i + 1]]);
      if (points.length < 2) return;
      const stroke = (style, width) => {
        ctx.strokeStyle = style;
        ctx.lineWidth = width;
        ctx.beginPath();
        points.forEach((point, i) => { const [px, py] = this.map.toScreen(...point); i ? ctx.lineTo(px, py) : ctx.moveTo(px, py); });
        ctx.stroke();
      };
      stroke(rgba(this.colours.halo, 0.75), this._width() + 3);
      stroke(this.colours.way, this._width() + 0.5);
    }

    _drawSensor(ctx, here) {
      const [x, y] = this.map.toScreen(...here);
      ctx.strokeStyle = rgba(this.colours.sensor, 0.75);
      ctx.lineWidth = 1.3;
      ctx.setLineDash([5, 4]);
      ctx.beginPath();
      ctx.arc(x, y, this.sensorM * this.map.view.scale, 0, 2 * Math.PI);
      ctx.stroke();
      ctx.setLineDash([]);
    }

    _drawGoal(ctx, at) { wl.terrain.goal(ctx, ...this.map.toScreen(...at), 9, this.colours); }
  };

  /** A ring with a dot. */
  const goal = (ctx, x, y, size, colours) => {
    for (const [style, width] of [[colours.halo, size * 0.55], [colours.goal, size * 0.3]]) {
      ctx.strokeStyle = style;
      ctx.lineWidth = width;
      ctx.beginPath();
      ctx.arc(x, y, size, 0, 2 * Math.PI);
      ctx.stroke();
    }
    ctx.fillStyle = colours.goal;
    ctx.beginPath();
    ctx.arc(x, y, size * 0.35, 0, 2 * Math.PI);
    ctx.fill();
  };

  /** The marks of terrain in the legend: [draw on a small canvas, word]. */
  const marks = ({ ground, layers }) => {
    const { colours } = ground;
    const line = (colour, casing = colours.halo) => (ctx, x, y) => {
      for (const [style, width] of [[casing, 6], [colour, 3]]) { ctx.strokeStyle = style; ctx.lineWidth = width; ctx.beginPath(); ctx.moveTo(x - 9, y + 3); ctx.quadraticCurveTo(x, y - 5, x + 9, y); ctx.stroke(); }
    };
    const box = (draw) => (ctx, x, y) => { ctx.beginPath(); ctx.rect(x - 8, y - 8, 16, 16); draw(ctx, x, y); };
    const filled = (colour, alpha = 1) => box((ctx) => { ctx.globalAlpha = alpha; ctx.fillStyle = colour; ctx.fill(); ctx.globalAlpha = 1; });
    const relief = box((ctx, x, y) => {
      const fill = ctx.createLinearGradient(x - 8, y, x + 8, y);
      ["low", "mid", "high"].forEach((name, i) => fill.addColorStop(i / 2, colours[name]));
      ctx.fillStyle = fill;
      ctx.fill();
    });
    const patterned = (name, under) => box((ctx) => { ctx.fillStyle = under; ctx.fill(); ctx.fillStyle = ground._pattern(name); ctx.fill(); });
    const bold = ground.step * BOLD_EVERY;
    const rows = [[relief, `${ground.ends[0].toFixed(1)} to ${ground.ends[1].toFixed(1)} m high`]];
    if (layers.contours) rows.push([(ctx, x, y) => { ctx.strokeStyle = colours.contour; ctx.lineWidth = 1.3; ctx.beginPath(); ctx.arc(x, y + 9, 14, 3.8, 5.6); ctx.stroke(); ctx.lineWidth = 0.8; ctx.beginPath(); ctx.arc(x, y + 14, 14, 3.8, 5.6); ctx.stroke(); },
      `contours every ${Number(ground.step.toFixed(3))} m, bold every ${Number(bold.toFixed(3))} m`]);
    if (ground.prior && layers.veil && ground.veilable) rows.push([filled(colours.veil), "not seen yet: as known beforehand"]);
    rows.push([filled(colours.obstacle), "obstacle"]);
    if (ground.veilable) rows.push([patterned("obstacle", rgba(colours.obstacle, 0.18)), "obstacle unknown to the robot"]);
    if (ground.rough.length) rows.push([patterned("rough", colours.mid), "rough ground"]);
    if (ground.steep.length) rows.push([patterned("steep", colours.mid), "too steep"]);
    if (!ground.veilable) return rows;
    rows.push([line(colours.way), "way ahead"]);
    if (layers.colour !== "power") rows.push([line(colours.track), "driven"]);
    else if (!ground.watts.length) rows.push([line(ground._powerColour(0)), "driven"]);
    else for (const share of [0, 0.5, 1]) {
      const watts = ground.watts[0] + share * (ground.watts[1] - ground.watts[0]);
      rows.push([line(ground._powerColour(watts), CASING), `driven at ${watts} W`]);
    }
    rows.push([(ctx, x, y) => { ctx.strokeStyle = colours.sensor; ctx.lineWidth = 1.3; ctx.setLineDash([4, 3]); ctx.beginPath(); ctx.arc(x, y, 8, 0, 7); ctx.stroke(); }, "reach of the sensor"]);
    rows.push([(ctx, x, y) => goal(ctx, x, y, 6, colours), "goal"]);
    if (layers.frontier) rows.push([filled(colours.open), "OPEN"], [filled(colours.incons), "INCONS"]);
    return rows;
  };

  /** Relief on a small canvas; floor: heights, cells, width, height, cell_m. */
  const thumb = (canvas, floor, wide, high) => {
    const colours = readColours(canvas), heights = metres(floor.heights);
    const ends = heights.reduce(([a, b], h) => [Math.min(a, h), Math.max(b, h)], [Infinity, -Infinity]);
    const pixels = shaded(heights, floor.width, floor.height, floor.cell_m, ends, colours), stone = channels(colours.obstacle);
    const image = document.createElement("canvas");
    image.width = floor.width; image.height = floor.height;
    const data = image.getContext("2d").createImageData(floor.width, floor.height);
    floor.cells.forEach((row, y) => {
      for (let x = 0; x < floor.width; x++) {
        const to = 4 * ((floor.height - 1 - y) * floor.width + x), from = 3 * (y * floor.width + x);
        for (let i = 0; i < 3; i++) data.data[to + i] = row[x] === "#" ? stone[i] : pixels[from + i];
        data.data[to + 3] = 255;
      }
    });
    image.getContext("2d").putImageData(data, 0, 0);
    canvas.width = wide; canvas.height = high;
    const scale = Math.min(wide / floor.width, high / floor.height), w = floor.width * scale, h = floor.height * scale;
    canvas.getContext("2d").drawImage(image, (wide - w) / 2, (high - h) / 2, w, h);
  };

  wl.terrain = { marks, goal, thumb, shaded, contours, interval };
})();
