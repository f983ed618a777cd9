/* Keyboard shortcuts, and the functions that Dash calls in the browser. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});

  const typing = (target) => target.closest && target.closest("input, textarea, select, [contenteditable], dialog, [role=dialog], .ag-root, .wl-menu");
  const pressable = (target) => target.closest && target.closest("button, a, summary, [role=tab]");

  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.altKey || event.metaKey) return;
    const stage = wl.stage, key = event.key;
    if (key === "Escape") {
      if (wl.closeMenu()) return;
      if (stage && stage.map && stage.map.sendMode) { stage.map.endSend(); return; }
      if (stage && stage.map && !typing(event.target)) stage.select(null);
      return;
    }
    if (typing(event.target)) return;
    if (key === "?") { wl.setProps("help", { opened: true }); event.preventDefault(); return; }
    if (!stage || !stage.map) return;
    if ((key === " " || key === "Enter") && pressable(event.target)) return;
    if (/^Arrow/.test(key) && event.target.closest && event.target.closest("[role=tablist]")) return;
    const act = {
      " ": () => stage.toggle(),
      ArrowLeft: () => (event.ctrlKey ? stage.toEvent(-1) : stage.step(event.shiftKey ? -10 : -1)),
      ArrowRight: () => (event.ctrlKey ? stage.toEvent(1) : stage.step(event.shiftKey ? 10 : 1)),
      Home: () => { stage.playing = false; stage.seek(0, true); },
      End: () => stage.toLive(),
      ArrowUp: () => stage.faster(1),
      ArrowDown: () => stage.faster(-1),
      f: () => stage.toggleFollow(),
      g: () => stage.toggleLayer("grid"),
      i: () => stage.toggleLayer("ids"),
      p: () => stage.toggleLayer("paths"),
      h: () => stage.toggleLayer("heat"),
      r: () => stage.fit(),
      "+": () => stage.zoom(1.25),
      "-": () => stage.zoom(0.8),
      "/": () => stage.findBox.focus(),
    }[key.length === 1 ? key.toLowerCase() : key];
    if (!act || (event.ctrlKey && !/^Arrow(Left|Right)$/.test(key))) return;
    event.preventDefault();
    act();
  });

  const none = () => window.dash_clientside.no_update;

  /** Callbacks that Dash runs here (dash.ClientsideFunction namespace `wattlane`). */
  window.dash_clientside = window.dash_clientside || {};
  Object.assign(window.dash_clientside, {
    wattlane: {
      bind(config) { wl.bind(config); return none(); },
      extra(data) { if (wl.stage) wl.stage.extra(data); },
      acknowledge(number) { if (wl.stage && number) wl.stage.acknowledge(number); },
      tab(value) { if (wl.stage && value) wl.stage.setTab(value); },
      selectRow(cell) {
        if (wl.stage && cell && cell.rowId !== undefined && cell.rowId !== null) wl.stage.select({ kind: "vehicle", id: Number(cell.rowId) }, { from: "table" });
      },
      centreRow(cell) {
        if (wl.stage && cell && cell.rowId !== undefined && cell.rowId !== null) wl.stage.select({ kind: "vehicle", id: Number(cell.rowId) }, { centre: true });
      },
      /** The colour scheme: applied to the page, the tables, the map; kept in the browser. */
      scheme(clicks, stored) {
        const triggered = (window.dash_clientside.callback_context.triggered[0] || {}).prop_id || "";
        let now = stored === "dark" || stored === "light" ? stored : wl.firstScheme;
        if (clicks && triggered.startsWith("theme-switch")) now = now === "dark" ? "light" : "dark";
        document.documentElement.dataset.mantineColorScheme = now;
        document.documentElement.dataset.agThemeMode = now;
        if (wl.stage) requestAnimationFrame(() => { if (wl.stage) { wl.stage.setTheme(); wl.stage.pulseSoon(); } });
        return [now, now];
      },
      help(clicks) { return !!clicks; },
      newOrder(clicks, from, to) {
        if (!clicks) return;
        if (!from || !to) wl.notify("New order", "Choose both stations.", "warning");
        else wl.command({ do: "order", from: Number(from), to: Number(to) });
      },
      rate(clicks, perHour) {
        if (!clicks) return;
        if (perHour === "" || perHour === null || perHour === undefined) wl.notify("Order rate", "Type the orders per hour.", "warning");
        else wl.command({ do: "rate", per_h: Number(perHour) });
      },
      levels(clicks, ...percent) {
        if (!clicks) return;
        const names = ["critical", "good", "sufficient", "full", "reserve"], command = { do: "thresholds" };
        names.forEach((name, i) => { if (percent[i] !== "" && percent[i] !== null && percent[i] !== undefined) command[name] = Number(percent[i]) / 100; });
        wl.command(command);
      },
      /** The moment shown when the button was pressed. */
      forkAt(clicks) { return clicks && wl.stage ? { t: wl.stage.time, clicks } : none(); },
      /** The embedded Rerun viewer is made only when it is asked for, inside the window that opens: it is large. */
      rerun(clicks) {
        if (!clicks || !wl.stage) return none();
        const url = new URL(`/recordings/${encodeURIComponent(wl.stage.config.run)}.rrd`, location.href).href;
        const query = new URLSearchParams({ url, hide_welcome_screen: "true", theme: wl.scheme() });
        wl.found("rerun-host").then((host) => {
          if (host) host.replaceChildren(wl.el("iframe", { title: "Rerun viewer", src: `/rerun/index.html?${query}`, allow: "fullscreen" }));
        });
        return true;
      },
    },
  });
})();
