/* Cells of the tables that are more than text; dash-ag-grid finds them by name. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const h = (...args) => window.React.createElement(...args);
  const functions = (window.dashAgGridFunctions = window.dashAgGridFunctions || {});
  const components = (window.dashAgGridComponentFunctions = window.dashAgGridComponentFunctions || {});

  functions.wlClock = (seconds) => (seconds === null || seconds === undefined || seconds < 0 ? "" : wl.clock(seconds));
  functions.wlSpan = (seconds) => (seconds === null || seconds === undefined || seconds < 0 ? "" : wl.span(seconds));
  functions.wlEnergy = (joules) => (joules === null || joules === undefined ? ""
    : Math.abs(joules) >= 1e6 ? `${(joules / 1e6).toFixed(2)} MJ` : `${(joules / 1e3).toFixed(1)} kJ`);
  functions.wlMetres = (metres) => (metres === null || metres === undefined ? ""
    : metres >= 10000 ? `${(metres / 1000).toFixed(1)} km` : `${metres.toFixed(0)} m`);
  functions.wlNone = (value) => (value === null || value === undefined || value === -1 ? "–" : String(value));

  /** A bar with its number, and the charging levels as ticks. `levels` comes with the column. */
  components.SocBar = (props) => {
    const soc = props.value;
    if (soc === null || soc === undefined) return h("span", {}, "–");
    const levels = props.levels || {};
    const kind = levels.critical !== undefined && soc < levels.critical ? " critical" : levels.good !== undefined && soc < levels.good ? " low" : "";
    const ticks = ["critical", "good", "sufficient"].filter((name) => levels[name] !== undefined)
      .map((name) => h("span", { key: name, className: "wl-soc-tick", title: `${name} ${Math.round(100 * levels[name])} %`, style: { left: `${100 * levels[name]}%` } }));
    return h("div", { className: "wl-soc" },
      h("span", { className: "wl-soc-number" }, `${Math.round(100 * soc)} %`),
      h("span", { className: "wl-soc-bar" }, h("span", { className: `wl-soc-fill${kind}`, style: { width: `${100 * Math.min(1, Math.max(0, soc))}%` } }), ...ticks));
  };

  components.StateCell = (props) => h("span", {},
    h("span", { className: "wl-dot", style: { background: `var(--wl-state-${String(props.value).replace(/[ _]/g, "-")})` }, "aria-hidden": true }), props.value);

  /** A button that gives the row's command; the row brings `command` and `commandText`, or none. */
  components.CommandCell = (props) => {
    const { command, command_text: text } = props.data;
    if (!command) return null;
    const danger = ["withdraw", "charger out"].includes(command.do);
    return h("button", { type: "button", className: `wl-link${danger ? " danger" : ""}`, onClick: () => wl.command(command) }, text);
  };

  /** Goes to the time and place of an event's row: on a double click, or on Enter. */
  functions.wlGoToEvent = ({ data: row, event }) => {
    if (!wl.stage || !row || (event instanceof KeyboardEvent && event.key !== "Enter")) return;
    const select = Number.isInteger(row.vehicle) ? { kind: "vehicle", id: row.vehicle } : Number.isInteger(row.place) ? { kind: "place", id: row.place, place: row.place } : null;
    wl.stage.act({ action: "goto", t: row.time_s, select });
  };

  components.VehicleCell = (props) => (props.value === null || props.value === undefined || props.value < 0 ? h("span", {}, "–")
    : h("button", { type: "button", className: "wl-link", onClick: () => wl.stage && wl.stage.select({ kind: "vehicle", id: props.value }, { centre: true }) }, String(props.value)));
})();
