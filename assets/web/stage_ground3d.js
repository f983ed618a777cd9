/* The ground in 3-D: the map's button opens a window that fetches one moment. Nothing is fetched before that. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const TURN = Math.PI / 24, NEARER = 1.15, LEAST = 0.3, MOST = 5;
  const BLIND = "This browser can't draw in three dimensions: WebGL is missing or turned off. "
    + "The map shows the same ground from above.";
  const NOTHING = { data: [], layout: { xaxis: { visible: false }, yaxis: { visible: false },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)" } };
  let asked = 0;

  /** Whether this browser can draw in three dimensions. */
  const drawsSpace = () => {
    const canvas = document.createElement("canvas");
    try {
      const gl = canvas.getContext("webgl") || canvas.getContext("experimental-webgl");
      if (gl && gl.getExtension("WEBGL_lose_context")) gl.getExtension("WEBGL_lose_context").loseContext();
      return !!gl;
    } catch { return false; }
  };

  const drawn = () => document.querySelector("#ground3d-host .js-plotly-plot");
  const eyeOf = (plot) => (plot && plot._fullLayout && plot._fullLayout.scene ? plot._fullLayout.scene.camera.eye : null);

  /** Asks for the moment that the stage shows; the picture stays turned as it is. */
  const ask = () => {
    const stage = wl.stage, eye = eyeOf(drawn());
    if (!stage) return;
    if (!drawsSpace()) { wl.setProps("ground3d-note", { children: BLIND }); return; }
    if (!eye) wl.setProps("ground3d-note", { children: "Reading the ground…" });
    wl.setProps("ground3d-asked", { data: { n: ++asked, run: stage.config.run, t: stage.follow ? null : stage.time,
      heights: window.dash_component_api.getLayout("ground3d-heights").props.value, scheme: wl.scheme(),
      narrow: innerWidth < innerHeight, eye: eye && [eye.x, eye.y, eye.z] } });
  };

  wl.ground3d = {
    open() {
      wl.setProps("ground3d", { opened: true });
      ask();
    },
    /** The map's button, of a run on terrain. */
    button() {
      return wl.el("button", { type: "button", class: "wl-tool", "aria-label": "The ground in 3-D", "aria-haspopup": "dialog",
        title: "The ground in 3-D", onclick: () => wl.ground3d.open() }, "3-D");
    },
  };

  /** Turns the view by keys: the camera goes round the upright axis, higher or lower, nearer or farther. */
  document.addEventListener("keydown", (event) => {
    const plot = event.target.id === "ground3d-host" && drawn(), eye = plot && eyeOf(plot);
    if (!eye || event.ctrlKey || event.altKey || event.metaKey) return;
    const turn = { ArrowLeft: [-TURN, 0, 1], ArrowRight: [TURN, 0, 1], ArrowUp: [0, TURN, 1], ArrowDown: [0, -TURN, 1],
      "+": [0, 0, 1 / NEARER], "-": [0, 0, NEARER] }[event.key];
    if (!turn) return;
    event.preventDefault();
    const flat = Math.hypot(eye.x, eye.y);
    const far = Math.min(MOST, Math.max(LEAST, Math.hypot(flat, eye.z) * turn[2]));
    const round = Math.atan2(eye.y, eye.x) + turn[0], up = Math.min(1.5, Math.max(0.05, Math.atan2(eye.z, flat) + turn[1]));
    window.Plotly.relayout(plot, { "scene.camera.eye": { x: far * Math.cos(up) * Math.cos(round),
      y: far * Math.cos(up) * Math.sin(round), z: far * Math.sin(up) } });
  });

  window.dash_clientside = window.dash_clientside || {};
  window.dash_clientside.wattlane = Object.assign(window.dash_clientside.wattlane || {}, {
    ground3dAgain(clicks) { if (clicks) ask(); },
    ground3dHeights() { if (eyeOf(drawn())) ask(); },
    /** A closed window keeps no picture: browsers allow few at once. */
    ground3dOpened(opened) { if (!opened) wl.setProps("ground3d-graph", { figure: NOTHING }); },
  });
})();
