/* The time ruler: the run from its start to now, event ticks, and the moment shown; drag it to scrub. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400, 172800, 604800];
  const HIGH = 34;

  wl.Ruler = class {
    /** hooks: seek(seconds). */
    constructor(host, hooks) {
      this.host = host;
      this.canvas = wl.el("canvas", { class: "wl-ruler-canvas", tabindex: 0, role: "slider", "aria-label": "Time of the run",
        "aria-valuemin": 0, "aria-valuemax": 0, "aria-valuenow": 0 });
      host.append(this.canvas);
      this.stale = true;
      this.end = 0;
      new ResizeObserver(() => { this.stale = true; }).observe(host);
      const seek = (event) => {
        const box = this.canvas.getBoundingClientRect();
        hooks.seek(Math.max(0, Math.min(1, (event.clientX - box.left) / box.width)) * this.end);
      };
      this.canvas.addEventListener("pointerdown", (event) => { this.canvas.setPointerCapture(event.pointerId); this.dragging = true; seek(event); });
      this.canvas.addEventListener("pointermove", (event) => { if (this.dragging) seek(event); });
      for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, () => { this.dragging = false; });
    }

    draw(stage) {
      const wide = this.host.clientWidth;
      if (!wide) return;
      if (!this.stale && this.time === stage.time && this.end === stage.end && this.marks === stage.marks && this.follow === stage.follow) return;
      this.stale = false;
      this.time = stage.time;
      this.end = stage.end;
      this.marks = stage.marks;
      this.follow = stage.follow;
      const dpr = Math.min(3, window.devicePixelRatio || 1), canvas = this.canvas;
      if (canvas.width !== Math.round(wide * dpr)) { canvas.width = Math.round(wide * dpr); canvas.height = Math.round(HIGH * dpr); }
      const style = getComputedStyle(this.host), colour = (name) => style.getPropertyValue(name).trim();
      const ctx = canvas.getContext("2d");
      ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
      ctx.clearRect(0, 0, wide, HIGH);
      const span = Math.max(this.end, 1e-9), x = (t) => (t / span) * (wide - 2) + 1;
      ctx.fillStyle = colour("--wl-line");
      ctx.fillRect(1, 19, wide - 2, 4);
      ctx.fillStyle = colour(stage.follow ? "--wl-live" : "--wl-mine");
      ctx.fillRect(1, 19, x(this.time) - 1, 4);
      const step = STEPS.find((s) => (s / span) * wide >= 74) || STEPS[STEPS.length - 1];
      ctx.font = "11px system-ui, sans-serif";
      ctx.textBaseline = "top";
      ctx.fillStyle = colour("--wl-muted");
      for (let t = 0; t <= span; t += step) {
        ctx.fillRect(Math.round(x(t)), 15, 1, 4);
        ctx.textAlign = t === 0 ? "left" : x(t) > wide - 30 ? "right" : "center";
        ctx.fillText(wl.clock(t).replace(/^00:/, ""), x(t), 2);
      }
      const hues = [colour("--wl-muted"), colour("--wl-map-low"), colour("--wl-map-blocked")];
      // a mark with a name is drawn as a flag, its name beside it where there is room
      const pin = ({ t, label }) => {
        const at = x(t), right = at + ctx.measureText(label).width + 14 < wide;
        ctx.fillStyle = colour("--wl-map-select");
        ctx.fillRect(at - 1, 17, 2, HIGH - 17);
        ctx.beginPath();
        ctx.moveTo(at, 24); ctx.lineTo(at + (right ? 8 : -8), 28); ctx.lineTo(at, 32); ctx.closePath();
        ctx.fill();
        ctx.textAlign = right ? "left" : "right";
        ctx.fillText(label, at + (right ? 11 : -11), 24);
      };
      for (const mark of this.marks || []) {
        if (mark.label) { pin(mark); continue; }
        ctx.fillStyle = hues[Math.min(2, Math.max(0, mark.level || 0))];
        ctx.fillRect(Math.round(x(mark.t)), 25, 2, mark.level ? 8 : 5);
      }
      ctx.fillStyle = colour("--wl-text");
      const at = x(this.time);
      ctx.beginPath();
      ctx.moveTo(at - 5, 12); ctx.lineTo(at + 5, 12); ctx.lineTo(at, 19); ctx.closePath();
      ctx.fill();
      ctx.fillRect(at - 0.75, 12, 1.5, HIGH - 12);
      canvas.setAttribute("aria-valuemax", String(Math.round(this.end)));
      canvas.setAttribute("aria-valuenow", String(Math.round(this.time)));
      canvas.setAttribute("aria-valuetext", wl.clock(this.time));
    }
  };
})();
