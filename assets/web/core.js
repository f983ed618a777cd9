/* Small helpers every other file uses: elements, times, requests, confirmation, notifications. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const FOUND_MS = 60000;   // a slow machine may take long to draw a page

  /** An element with attributes, listeners (`onclick`), data (`dataset`) and children. */
  wl.el = (tag, attributes = {}, ...children) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (value === null || value === undefined || value === false) continue;
      if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
      else if (name === "dataset") Object.assign(element.dataset, value);
      else element.setAttribute(name, value === true ? "" : value);
    }
    element.append(...children.filter((child) => child !== null && child !== undefined));
    return element;
  };

  /** The same for what is drawn as SVG. */
  wl.svg = (tag, attributes = {}, ...children) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) if (value !== null && value !== undefined) node.setAttribute(name, value);
    node.append(...children);
    return node;
  };

  /** The element with this id, once it is there; null when it does not come. */
  wl.found = (id) => new Promise((resolve) => {
    const begin = performance.now();
    const look = () => {
      const node = document.getElementById(id);
      if (node) resolve(node);
      else if (performance.now() - begin > FOUND_MS) resolve(null);
      else requestAnimationFrame(look);
    };
    look();
  });

  const two = (number) => String(number).padStart(2, "0");

  /** Seconds as HH:MM:SS; hours may exceed 24. */
  wl.clock = (seconds) => {
    const whole = Math.max(0, Math.floor(seconds + 1e-6));
    return `${two(Math.floor(whole / 3600))}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
  };

  /** Seconds as a short span: `4 s`, `3 min`, `2.5 h`. */
  wl.span = (seconds) => {
    if (seconds < 90) return `${Math.round(seconds)} s`;
    if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
    return `${(seconds / 3600).toFixed(1)} h`;
  };

  /** `00:12:30` and `12:30` are clock times, `90s` seconds, a bare number a tick. Null when it is none of these. */
  wl.parseTime = (text, tickS) => {
    const trimmed = text.trim();
    let match = /^(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:\.\d+)?)$/.exec(trimmed);
    if (match) return Number(match[1] || 0) * 3600 + Number(match[2]) * 60 + Number(match[3]);
    match = /^(\d+(?:\.\d+)?)\s*s$/.exec(trimmed);
    if (match) return Number(match[1]);
    return /^\d+$/.test(trimmed) ? Number(trimmed) * tickS : null;
  };

  /** Whether the present page has a Dash component with this id. Dash is asked, since a Store has no element; for an id
   *  that its page does not have, it throws. */
  const onPage = (id) => {
    try { return window.dash_component_api.getLayout(id) !== undefined; } catch { return false; }
  };

  /** Sets properties of a Dash component; when the present page does not have it, nothing. */
  wl.setProps = (id, props) => { if (onPage(id)) window.dash_clientside.set_props(id, props); };

  let notices = 0;
  wl.notify = (title, message, level = "ok") => {
    const color = { ok: "teal", info: "blue", warning: "orange", error: "red" }[level] || "blue";
    wl.setProps("notify", {
      sendNotifications: [{ action: "show", id: `n${Date.now()}-${++notices}`, title, message, color,
        autoClose: level === "error" ? 12000 : 5000 }],
    });
  };

  /** JSON from our own server. Throws an Error whose message is the server's reason. */
  wl.fetchJson = async (path, options = {}) => {
    const headers = options.body ? { "Content-Type": "application/json" } : {};
    let answer;
    try {
      answer = await fetch(path, { credentials: "same-origin", headers, ...options });
    } catch {
      throw new Error("the server does not answer");
    }
    const text = await answer.text();
    let body = null;
    try { body = text ? JSON.parse(text) : {}; } catch { /* not JSON: the status says enough */ }
    if (!answer.ok) {
      const detail = body && (body.reason || body.error || body.detail);
      throw new Error(typeof detail === "string" ? detail : `the server answered ${answer.status}`);
    }
    return body;
  };

  wl.runPath = (run, rest = "") => `/api/runs/${encodeURIComponent(run)}${rest}`;

  /** Asks before something that can't be undone. Resolves to true when the person agrees. */
  wl.confirm = (title, consequence, action = "Go ahead") => new Promise((resolve) => {
    const close = (agreed) => { dialog.close(); dialog.remove(); resolve(agreed); };
    const dialog = wl.el("dialog", { class: "wl-dialog", "aria-labelledby": "wl-dialog-title" },
      wl.el("h2", { id: "wl-dialog-title" }, title),
      wl.el("p", {}, consequence),
      wl.el("div", { class: "wl-dialog-buttons" },
        wl.el("button", { type: "button", class: "wl-button", onclick: () => close(false) }, "Cancel"),
        wl.el("button", { type: "button", class: "wl-button danger", autofocus: true, onclick: () => close(true) }, action)));
    dialog.addEventListener("cancel", (event) => { event.preventDefault(); close(false); });
    document.body.append(dialog);
    dialog.showModal();
  });

  const CONSEQUENCE = {
    withdraw: (c) => [`Withdraw order ${c.order}?`,
      "It will not be carried out; a vehicle on its way to it becomes free. This can't be undone.", "Withdraw"],
    fail: (c) => [`Let vehicle ${c.vehicle} break down?`,
      "It stops at its next place and blocks it until it is repaired; others must go round it.", "Break it down"],
    block: (c) => [`Block ${c.label || `place ${c.place}`}?`,
      "No vehicle may enter it until it is unblocked; those routed over it must be replanned.", "Block"],
    "charger out": (c) => [`Take charger ${c.label || c.charger} out of order?`,
      "A vehicle that charges there stops charging; bookings move to other chargers.", "Take out"],
  };
  const ON_GROUND = {   // one robot, nobody to hinder, and what is dropped can be removed
    fail: () => ["Let the robot break down?", "It stops when its present motion has ended, until it is repaired.", "Break it down"],
  };
  const DID = { order: "New order", withdraw: "Withdraw", charge: "Charge now", send: "Send", pause: "Pause vehicle",
    continue: "Continue vehicle", fail: "Break down", repair: "Repair", block: "Block", unblock: "Unblock",
    "charger out": "Charger out", "charger back": "Charger back", rate: "Order rate", thresholds: "Charging levels" };

  /** Gives one operator command to the live run, asks first where it hurts, and says how it was answered. */
  wl.command = async (command) => {
    const stage = wl.stage;
    if (!stage || !stage.config.live) {
      wl.notify("Not a live run", "Commands go to live runs. Fork from here to start one from this moment.", "warning");
      return;
    }
    const ask = (stage.map && stage.map.ground ? ON_GROUND : CONSEQUENCE)[command.do];
    if (ask && !(await wl.confirm(...ask(command)))) return;
    const { label: _, ...plain } = command;
    try {
      const answer = await wl.fetchJson(wl.runPath(stage.config.run, "/command"),
        { method: "POST", body: JSON.stringify(plain) });
      const name = DID[command.do] || command.do;
      if (answer.accepted) wl.notify(`${name}: accepted`, answer.reason || `Takes effect at tick ${answer.tick}.`, "ok");
      else wl.notify(`${name}: rejected`, answer.reason || "No reason was given.", "error");
    } catch (problem) {
      wl.notify("The command was not delivered", problem.message, "error");
    }
    stage.pulseSoon();
  };

  /** Controls the pace or the life of a live run: pause, play, step, speed, stop, resume. */
  wl.control = async (run, op, more = {}) => {
    try {
      const answer = await wl.fetchJson(wl.runPath(run, "/control"),
        { method: "POST", body: JSON.stringify({ op, ...more }) });
      if (answer && answer.accepted === false) { wl.notify(`${op}: rejected`, answer.reason || "", "error"); return null; }
      return answer || {};
    } catch (problem) {
      wl.notify(`${op}: not done`, problem.message, "error");
      return null;
    }
  };

  wl.go = (href) => wl.setProps("url", { href: new URL(href, location.href).href });

  /** What the buttons of the catalogue and the run list do. */
  const ACTIONS = {
    async delete({ run, label }) {
      if (!(await wl.confirm(`Delete ${label || run}?`, "Its recording, its charts and its downloads are gone for good.", "Delete"))) return;
      try {
        await wl.fetchJson(wl.runPath(run), { method: "DELETE" });
        wl.notify("Deleted", label || run, "ok");
      } catch (problem) { wl.notify("Not deleted", problem.message, "error"); }
      wl.setProps("runs-changed", { data: Date.now() });
      if (wl.stage && wl.stage.config.run === run) wl.go("/runs");
    },
    async rename({ run, label }) {
      const name = await wl.prompt("Rename the run", "Name", label || "");
      if (name === null) return;
      try {
        await wl.fetchJson(wl.runPath(run), { method: "PATCH", body: JSON.stringify({ name }) });
        wl.notify("Renamed", name, "ok");
      } catch (problem) { wl.notify("Not renamed", problem.message, "error"); }
      wl.setProps("runs-changed", { data: Date.now() });
    },
    async resume({ run }) {
      if (await wl.control(run, "resume")) {
        wl.notify("Resumed", "The run continues from its last checkpoint.", "ok");
        if (location.pathname === "/operate" && wl.stage && wl.stage.config.run === run) wl.setProps("rebind", { data: Date.now() });
        else wl.go(`/operate?run=${encodeURIComponent(run)}`);
      }
      wl.setProps("runs-changed", { data: Date.now() });
    },
    async stop({ run, label }) {
      if (!(await wl.confirm(`Stop ${label || run}?`, "The run ends here for everyone and is kept as a recording to replay.", "Stop the run"))) return;
      if (await wl.control(run, "stop")) wl.notify("Stopping", "The recording is being closed.", "ok");
      wl.setProps("runs-changed", { data: Date.now() });
    },
  };

  /** Asks for one line of text; null when cancelled. */
  wl.prompt = (title, label, value) => new Promise((resolve) => {
    const close = (answer) => { dialog.close(); dialog.remove(); resolve(answer); };
    const input = wl.el("input", { type: "text", maxlength: 80, value, id: "wl-prompt", autofocus: true });
    const dialog = wl.el("dialog", { class: "wl-dialog", "aria-labelledby": "wl-dialog-title" },
      wl.el("form", { method: "dialog", onsubmit: (event) => { event.preventDefault(); close(input.value.trim()); } },
        wl.el("h2", { id: "wl-dialog-title" }, title),
        wl.el("label", { for: "wl-prompt" }, label), input,
        wl.el("div", { class: "wl-dialog-buttons" },
          wl.el("button", { type: "button", class: "wl-button", onclick: () => close(null) }, "Cancel"),
          wl.el("button", { type: "submit", class: "wl-button primary" }, "Save"))));
    dialog.addEventListener("cancel", (event) => { event.preventDefault(); close(null); });
    document.body.append(dialog);
    dialog.showModal();
    input.select();
  });

  document.addEventListener("click", (event) => {
    const target = event.target.closest && event.target.closest("[data-command],[data-action],[data-select]");
    if (!target || target.disabled) return;
    if (target.dataset.command) wl.command(JSON.parse(target.dataset.command));
    else if (target.dataset.action) {
      const data = JSON.parse(target.dataset.action);
      if (ACTIONS[data.action]) ACTIONS[data.action](data);
      else if (wl.stage) wl.stage.act(data);
    } else if (wl.stage) wl.stage.select(JSON.parse(target.dataset.select), { centre: true });
  });

  // The colour scheme is set before anything is painted, so that a dark page does not flash white.
  let scheme = null;
  try { scheme = JSON.parse(localStorage.getItem("theme")); } catch { /* storage may be closed */ }
  if (scheme !== "light" && scheme !== "dark") {
    scheme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  }
  document.documentElement.dataset.mantineColorScheme = scheme;
  document.documentElement.dataset.agThemeMode = scheme;
  wl.firstScheme = scheme;
  wl.scheme = () => document.documentElement.dataset.mantineColorScheme || "light";
})();
