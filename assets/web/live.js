/* The live link: binary frames over a WebSocket, latest wins; polling the same bytes when there is no socket. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const HEADER = 32;
  const PER_VEHICLE = 8;

  /** One frame from its bytes; x and y in metres, heading in radians counter-clockwise from east. Throws when it is none. */
  wl.decodeFrame = (buffer, widthM, heightM) => {
    const view = new DataView(buffer);
    if (buffer.byteLength < HEADER || view.getUint8(0) !== 0x57 || view.getUint8(1) !== 0x4c) throw new Error("not a frame");
    if (view.getUint8(2) !== 1) throw new Error(`frame version ${view.getUint8(2)} is not known`);
    const n = view.getUint16(24, true);
    if (buffer.byteLength < HEADER + n * PER_VEHICLE) throw new Error("a frame is cut short");
    const bits = view.getUint8(3);
    const frame = {
      paused: !!(bits & 1), done: !!(bits & 2), replay: !!(bits & 4),
      sequence: view.getUint32(4, true), time: view.getFloat64(8, true),
      reached: view.getFloat32(16, true), asked: view.getFloat32(20, true),
      n, tick: view.getUint32(28, true),
      x: new Float32Array(n), y: new Float32Array(n), heading: new Float32Array(n),
      soc: new Uint8Array(n), state: new Uint8Array(n), flags: new Uint8Array(n),
    };
    const bytes = new Uint8Array(buffer, HEADER);
    const toX = widthM / 65535, toY = heightM / 65535, toAngle = (2 * Math.PI) / 256;
    for (let i = 0, at = 0; i < n; i++, at += PER_VEHICLE) {
      frame.x[i] = (bytes[at] | (bytes[at + 1] << 8)) * toX;
      frame.y[i] = (bytes[at + 2] | (bytes[at + 3] << 8)) * toY;
      frame.heading[i] = bytes[at + 4] * toAngle;
      frame.soc[i] = bytes[at + 5];
      frame.state[i] = bytes[at + 6];
      frame.flags[i] = bytes[at + 7];
    }
    return frame;
  };

  const FIRST_RETRY_MS = 250, LAST_RETRY_MS = 5000, POLL_MS = 200, STALE_MS = 4000, ASK_TIMEOUT_MS = 1500;

  /** handlers: frame(frame, bytes), status(object), state("open" | "polling" | "down", age in ms). */
  wl.Link = class {
    constructor(run, size, handlers) {
      this.run = run;
      this.size = size;
      this.handlers = handlers;
      this.retry = FIRST_RETRY_MS;
      this.heard = performance.now();
      this.closed = false;
      this.pending = null;   // the replay time that is being answered
      this.wanted = null;    // the newest time asked for meanwhile
      this.socketOpen = false;
      this.failures = 0;
      this.live = true;
    }

    start() {
      this._connect();
      this.watch = setInterval(() => this._check(), 500);
    }

    stop() {
      this.closed = true;
      clearInterval(this.watch);
      clearTimeout(this.timer);
      clearTimeout(this.poller);
      if (this.socket) this.socket.close();
    }

    /** Asks for the fleet at a time of the past, in seconds. Only the newest question is kept. */
    ask(time) {
      if (this.pending !== null && performance.now() - this.askedAt < ASK_TIMEOUT_MS) { this.wanted = time; return; }
      this.pending = time;
      this.wanted = null;
      this.askedAt = performance.now();
      if (this.socketOpen) this.socket.send(JSON.stringify({ t: time }));
      else this._fetch(time);
    }

    /** Whether frames of the present are wanted; the past alone costs less. */
    watchLive(on) {
      if (this.live === on) return;
      this.live = on;
      if (this.socketOpen) this.socket.send(JSON.stringify({ follow: on }));
    }

    _answered() {
      this.pending = null;
      if (this.wanted !== null) { const time = this.wanted; this.wanted = null; this.ask(time); }
    }

    _connect() {
      if (this.closed) return;
      const scheme = location.protocol === "https:" ? "wss" : "ws";
      const socket = new WebSocket(`${scheme}://${location.host}/live/${encodeURIComponent(this.run)}`);
      socket.binaryType = "arraybuffer";
      this.socket = socket;
      socket.onopen = () => {
        if (socket !== this.socket) return;
        this.socketOpen = true;
        this.failures = 0;
        this.retry = FIRST_RETRY_MS;
        this._heard();
        if (this.live === false) socket.send(JSON.stringify({ follow: false }));
        if (this.pending !== null) { const time = this.wanted ?? this.pending; this.pending = null; this.ask(time); }
      };
      socket.onmessage = (event) => {
        if (this.closed) return;
        this._heard();
        if (typeof event.data === "string") this._text(event.data);
        else this._bytes(event.data);
      };
      socket.onclose = () => {
        this.socketOpen = false;
        if (this.closed) return;
        this.failures += 1;
        this.timer = setTimeout(() => this._connect(), this.retry * (0.75 + Math.random() / 2));
        this.retry = Math.min(LAST_RETRY_MS, this.retry * 2);
        if (this.failures === 2) this._poll();
      };
    }

    _text(text) {
      try { this.handlers.status(JSON.parse(text)); } catch { /* a message we don't know is no reason to stop */ }
    }

    _bytes(buffer) {
      let frame;
      try {
        frame = wl.decodeFrame(buffer, this.size.width, this.size.height);
      } catch (problem) {
        this.handlers.status({ error: problem.message });
        return;
      }
      this.handlers.frame(frame, buffer.byteLength);
      if (frame.replay) this._answered();
    }

    async _fetch(time) {
      const query = time === null ? "" : `?t=${time}`;
      try {
        const answer = await fetch(wl.runPath(this.run, `/frame${query}`), { credentials: "same-origin" });
        if (!answer.ok) throw new Error(String(answer.status));
        const buffer = await answer.arrayBuffer();
        if (this.closed) return;
        this._heard();
        this._bytes(buffer);
      } catch { /* the watch says how old the data is */ }
      if (time !== null && this.pending === time) this._answered();
    }

    async _poll() {
      if (this.closed || this.socketOpen) return;
      if (this.pending === null && this.live) await this._fetch(null);
      const pause = performance.now() - this.heard > STALE_MS ? 2000 : POLL_MS;
      this.poller = setTimeout(() => this._poll(), pause);
    }

    _heard() { this.heard = performance.now(); }

    _check() {
      const age = performance.now() - this.heard;
      if (this.socketOpen) this.handlers.state("open", age);
      else this.handlers.state(age < STALE_MS ? "polling" : "down", age);
    }
  };
})();
