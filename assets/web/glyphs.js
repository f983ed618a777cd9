/* The marks of the map: vehicle sprites, bolts, arrows, colours. The legend is drawn with the same functions. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});

  const STATES = ["idle", "moving", "waiting", "loading", "to-charger", "charging", "fault", "paused"];
  const WORDS = ["idle", "moving", "waiting", "loading", "to charger", "charging", "fault", "paused"];
  const TASKS = ["none", "to pick up", "to deliver", "to rest", "to charge", "sent"];
  const LOADED = 1, LOW = 2, TASK_SHIFT = 2, UNKNOWN_SOC = 255, FULL_SOC = 250;
  const WAITING = 2, LOADING = 3, TO_CHARGER = 4, CHARGING = 5, FAULT = 6, PAUSED = 7;
  const TO_PICK = 1, TO_DROP = 2;
  const TINY_PX = 11;
  const VIRIDIS = ["#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"];

  const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  const luminance = (hex) => {
    const [r, g, b] = channels(hex).map((c) => { const v = c / 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const inkOn = new Map();
  const ink = (hex) => {
    if (!inkOn.has(hex)) inkOn.set(hex, luminance(hex) > 0.19 ? "#0d141c" : "#ffffff");
    return inkOn.get(hex);
  };

  /** Viridis-like colour of a share 0…1, as [r, g, b]. */
  const viridis = (share) => {
    const at = Math.min(0.9999, Math.max(0, share)) * (VIRIDIS.length - 1);
    const low = channels(VIRIDIS[Math.floor(at)]), high = channels(VIRIDIS[Math.floor(at) + 1]);
    const part = at - Math.floor(at);
    return low.map((c, i) => Math.round(c + (high[i] - c) * part));
  };
  const hexOf = ([r, g, b]) => `#${[r, g, b].map((c) => c.toString(16).padStart(2, "0")).join("")}`;
  const SOC_RAMP = Array.from({ length: 21 }, (_, i) => {
    const share = i / 20, red = [211, 47, 47], yellow = [240, 180, 30], green = [46, 158, 79];
    const [a, b, part] = share < 0.5 ? [red, yellow, share * 2] : [yellow, green, share * 2 - 1];
    return hexOf(a.map((c, k) => Math.round(c + (b[k] - c) * part)));
  });
  const POWER_RAMP = Array.from({ length: 21 }, (_, i) => hexOf(viridis(i / 20)));
  const ID_RAMP = ["#4e79a7", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#76b7b2", "#edc948", "#9c755f",
    "#ff9da7", "#86bcb6", "#8cd17d", "#d37295"];

  /** Colours from the style sheet, so that light, dark and the legend agree. */
  const readPalette = (host) => {
    const style = getComputedStyle(host);
    const colour = (name) => style.getPropertyValue(`--wl-${name}`).trim() || "#888888";
    const palette = { state: STATES.map((name) => colour(`state-${name}`)) };
    for (const name of ["floor", "aisle", "wall", "rack", "rack-edge", "inbound", "outbound", "shelf", "charger", "parking", "grid-line",
      "label", "arrow", "bolt", "blocked", "low", "select", "outline", "box", "route", "text", "surface"]) {
      palette[name.replace(/-(.)/, (_, c) => c.toUpperCase())] = colour(`map-${name}`);
    }
    palette.task = TASKS.map((name) => colour(`task-${name.replace(/ /g, "-")}`));
    palette.thesis = { empty: colour("thesis-empty"), loaded: colour("thesis-loaded"), low: colour("thesis-low"), charged: colour("thesis-charged") };
    return palette;
  };

  /** Body colour of a vehicle under a colouring (`state`, `id`, `soc`, `task`, `power`, `thesis`). power: in parts of
   *  the scale's top, negative while it charges, null when unknown. */
  const bodyColour = (palette, colouring, { id, state, soc, flags, power }) => {
    if (colouring === "soc") return soc === UNKNOWN_SOC ? "#888888" : SOC_RAMP[Math.round((soc / FULL_SOC) * 20)];
    if (colouring === "task") return palette.task[flags >> TASK_SHIFT] || palette.task[0];
    if (colouring === "power") {
      if (power === null || power === undefined) return "#888888";
      return power < 0 ? palette.state[CHARGING] : POWER_RAMP[Math.round(Math.min(1, power) * 20)];
    }
    if (colouring === "id") return ID_RAMP[id % ID_RAMP.length];
    if (colouring === "thesis") {
      if (state === CHARGING && soc !== UNKNOWN_SOC && soc >= FULL_SOC / 2) return palette.thesis.charged;
      if (flags & LOW) return palette.thesis.low;
      return flags & LOADED ? palette.thesis.loaded : palette.thesis.empty;
    }
    return palette.state[state] || palette.state[0];
  };

  const roundRect = (ctx, x, y, w, h, r) => {
    ctx.beginPath();
    if (ctx.roundRect) ctx.roundRect(x, y, w, h, r);
    else ctx.rect(x, y, w, h);
  };

  /** A bolt centred at (x, y), as high as `size`. */
  const bolt = (ctx, x, y, size, fill, stroke) => {
    const s = size / 10;
    ctx.beginPath();
    [[1.2, -5], [-3, 0.8], [-0.4, 0.8], [-1.2, 5], [3, -0.9], [0.5, -0.9]].forEach(([px, py], i) =>
      i ? ctx.lineTo(x + px * s, y + py * s) : ctx.moveTo(x + px * s, y + py * s));
    ctx.closePath();
    if (stroke) { ctx.lineWidth = Math.max(1, s * 1.2); ctx.lineJoin = "round"; ctx.strokeStyle = stroke; ctx.stroke(); }
    if (fill) { ctx.fillStyle = fill; ctx.fill(); }
  };

  const cross = (ctx, x, y, size, colour, width) => {
    ctx.lineWidth = width;
    ctx.lineCap = "round";
    ctx.strokeStyle = colour;
    ctx.beginPath();
    ctx.moveTo(x - size, y - size); ctx.lineTo(x + size, y + size);
    ctx.moveTo(x + size, y - size); ctx.lineTo(x - size, y + size);
    ctx.stroke();
  };

  /** The sign that says the state without colour; at the corner of a vehicle `size` wide, upright. */
  const sign = (ctx, cx, cy, size, state, palette) => {
    const x = cx + size * 0.36, y = cy - size * 0.36, r = size * 0.27;
    if (state === 0 || state === 1) return;
    ctx.beginPath();
    ctx.arc(x, y, r, 0, 2 * Math.PI);
    ctx.fillStyle = palette.surface;
    ctx.fill();
    ctx.lineWidth = Math.max(1, size * 0.05);
    ctx.strokeStyle = palette.outline;
    ctx.stroke();
    ctx.fillStyle = ctx.strokeStyle = palette.text;
    ctx.lineCap = "round";
    const bar = Math.max(1, r * 0.32);
    if (state === 2) {          // waiting: an hourglass
      ctx.beginPath();
      ctx.moveTo(x - r * 0.5, y - r * 0.6); ctx.lineTo(x + r * 0.5, y - r * 0.6); ctx.lineTo(x - r * 0.5, y + r * 0.6);
      ctx.lineTo(x + r * 0.5, y + r * 0.6); ctx.closePath(); ctx.fill();
    } else if (state === 3) {   // loading: up and down
      ctx.lineWidth = bar * 0.8;
      ctx.beginPath();
      for (const [dx, way] of [[-0.32, -1], [0.32, 1]]) {
        ctx.moveTo(x + dx * r, y - 0.55 * r * way); ctx.lineTo(x + dx * r, y + 0.55 * r * way);
        ctx.moveTo(x + (dx - 0.25) * r, y + 0.28 * r * way); ctx.lineTo(x + dx * r, y + 0.58 * r * way);
        ctx.lineTo(x + (dx + 0.25) * r, y + 0.28 * r * way);
      }
      ctx.stroke();
    } else if (state === 4) bolt(ctx, x, y, r * 1.5, null, palette.text);
    else if (state === 5) bolt(ctx, x, y, r * 1.7, palette.text, null);
    else if (state === 6) cross(ctx, x, y, r * 0.45, palette.state[6], bar);
    else if (state === 7) {
      ctx.fillRect(x - r * 0.5, y - r * 0.5, bar, r);
      ctx.fillRect(x + r * 0.5 - bar, y - r * 0.5, bar, r);
    }
  };

  /** A vehicle: rounded square, heading tick, box when loaded, orange ring when low, cross when broken, sign. Angles ccw from east. */
  const vehicle = (ctx, cx, cy, size, { state, heading, flags, colour, palette }) => {
    const half = size / 2;
    const tiny = size < TINY_PX;   // then an outline would drown the colour
    if (flags & LOW) {
      ctx.beginPath();
      ctx.arc(cx, cy, size * 0.74, 0, 2 * Math.PI);
      ctx.lineWidth = Math.max(1.5, size * 0.12);
      ctx.strokeStyle = palette.low;
      ctx.stroke();
    }
    ctx.save();
    ctx.translate(cx, cy);
    ctx.rotate(-heading);
    roundRect(ctx, -half, -half, size, size, size * 0.24);
    ctx.fillStyle = colour;
    ctx.fill();
    if (!tiny) {
      ctx.lineWidth = Math.max(1, size * 0.05);
      ctx.strokeStyle = palette.outline;
      ctx.stroke();
    }
    ctx.beginPath();
    ctx.moveTo(half * 1.02, 0); ctx.lineTo(half * 0.5, -half * 0.42); ctx.lineTo(half * 0.5, half * 0.42);
    ctx.closePath();
    ctx.fillStyle = ink(colour);
    ctx.fill();
    ctx.restore();
    if (flags & LOADED) {
      const b = size * (tiny ? 0.22 : 0.3);
      ctx.fillStyle = palette.box;
      ctx.fillRect(cx - b, cy - b, 2 * b, 2 * b);
      if (!tiny) {
        ctx.lineWidth = Math.max(1, size * 0.045);
        ctx.strokeStyle = "#3b2a12";
        ctx.strokeRect(cx - b, cy - b, 2 * b, 2 * b);
      }
    }
    if (state === 6) cross(ctx, cx, cy, half * 0.95, palette.state[6] === colour ? "#ffffff" : palette.state[6], Math.max(1.5, size * 0.13));
    if (size >= 13) sign(ctx, cx, cy, size, state, palette);
  };

  /** Equal slots on one canvas; a drawing is made once per key. */
  class Atlas {
    constructor(slot) {
      this.slot = slot;
      this.columns = Math.max(1, Math.floor(2048 / slot));
      this.rows = Math.max(1, Math.floor(2048 / slot));
      this.canvas = document.createElement("canvas");
      this.canvas.width = this.columns * slot;
      this.canvas.height = slot;
      this.ctx = this.canvas.getContext("2d");
      this.index = new Map();
    }

    /** Slot number of a key; `draw(ctx, centreX, centreY)` is called the first time. */
    at(key, draw) {
      const known = this.index.get(key);
      if (known !== undefined) return known;
      let next = this.index.size;
      if (next >= this.columns * this.rows) {
        this.index.clear();
        this.ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
        next = 0;
      }
      const row = Math.floor(next / this.columns), column = next % this.columns;
      const needed = (row + 1) * this.slot;
      if (needed > this.canvas.height) {
        const old = document.createElement("canvas");
        old.width = this.canvas.width; old.height = this.canvas.height;
        old.getContext("2d").drawImage(this.canvas, 0, 0);
        this.canvas.height = Math.min(this.rows * this.slot, needed * 2);
        this.ctx.drawImage(old, 0, 0);
      }
      this.ctx.save();
      draw(this.ctx, (column + 0.5) * this.slot, (row + 0.5) * this.slot);
      this.ctx.restore();
      this.index.set(key, next);
      return next;
    }

    draw(ctx, number, x, y) {
      const s = this.slot;
      ctx.drawImage(this.canvas, (number % this.columns) * s, Math.floor(number / this.columns) * s, s, s, x - s / 2, y - s / 2, s, s);
    }
  }

  wl.marks = { STATES, WORDS, TASKS, LOADED, LOW, TASK_SHIFT, UNKNOWN_SOC, FULL_SOC, WAITING, LOADING, TO_CHARGER, CHARGING,
    FAULT, PAUSED, TO_PICK, TO_DROP, viridis, ink, readPalette, bodyColour, roundRect, bolt, cross, sign, vehicle, Atlas };
})();
