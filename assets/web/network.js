/* A path network on the live map: lanes as lines beside each other, nodes as squares; drawn under the fleet. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const LANE_SHARE = 0.1;        // width of a lane, of the mean arc
  const NODE_SHARE = 0.34;       // side of a node
  const ARROWS_FROM_PX = 26;     // a shorter arc has no arrowheads

  const lineOf = (map, lane) => {
    // the lane's own place lies beside the arc's middle: that gives the side on which it is drawn
    const { places } = map.floor;
    const [ax, ay] = places[lane.from], [bx, by] = places[lane.to], [mx, my] = places[lane.place];
    const dx = mx - (ax + bx) / 2, dy = my - (ay + by) / 2;
    return [...map.toScreen(ax + dx, ay + dy), ...map.toScreen(bx + dx, by + dy)];
  };

  const stroke = (map, ctx, lanes, width, colour) => {
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.beginPath();
    for (const lane of lanes) {
      const [ax, ay, bx, by] = lineOf(map, lane);
      ctx.moveTo(ax, ay);
      ctx.lineTo(bx, by);
    }
    ctx.stroke();
  };

  /** Lanes, coloured by heat where there is any, kerbs dashed; nodes and stations. */
  const draw = (map, ctx, cell) => {
    const { floor, palette, heat, layers } = map, width = Math.max(1, cell * LANE_SHARE);
    ctx.lineCap = "butt";
    stroke(map, ctx, floor.lanes, width + 1.5, palette.aisle);
    stroke(map, ctx, floor.lanes.filter((lane) => !lane.kerb), width, palette.arrow);
    ctx.setLineDash([Math.max(2, cell * 0.08), Math.max(2, cell * 0.06)]);
    stroke(map, ctx, floor.lanes.filter((lane) => lane.kerb), width, palette.parking);
    ctx.setLineDash([]);
    if (layers.heat && heat) {
      const most = map.heatTop();
      const scale = layers.log ? (v) => Math.log1p(Math.min(1, v / most) * 999) / Math.log(1000) : (v) => Math.min(1, v / most);
      for (const lane of floor.lanes) {
        if (!(heat[lane.place] > 0)) continue;
        const [r, g, b] = wl.marks.viridis(scale(heat[lane.place]));
        stroke(map, ctx, [lane], width * 1.5, `rgb(${r},${g},${b})`);
      }
    }
    if (cell >= ARROWS_FROM_PX) drawArrows(map, ctx, cell);
    drawNodes(map, ctx, cell);
  };

  const drawArrows = (map, ctx, cell) => {
    const s = cell * 0.07;
    ctx.strokeStyle = map.palette.label;
    ctx.lineWidth = Math.max(1, cell * 0.025);
    ctx.lineCap = ctx.lineJoin = "round";
    ctx.beginPath();
    for (const lane of map.floor.lanes) {
      const [ax, ay, bx, by] = lineOf(map, lane), length = Math.hypot(bx - ax, by - ay) || 1;
      const dx = (bx - ax) / length, dy = (by - ay) / length;
      const tx = (ax + bx) / 2 + dx * s, ty = (ay + by) / 2 + dy * s;
      ctx.moveTo(tx - (dx + dy) * s, ty - (dy - dx) * s);
      ctx.lineTo(tx, ty);
      ctx.lineTo(tx - (dx - dy) * s, ty - (dy + dx) * s);
    }
    ctx.stroke();
  };

  const drawNodes = (map, ctx, cell) => {
    const { floor, palette } = map, side = Math.max(2, cell * NODE_SHARE);
    const fill = { entrance: palette.inbound, inbound: palette.inbound, outbound: palette.outbound, rack: palette.rack };
    for (const node of floor.nodes) {
      const [x, y] = map.toScreen(...floor.places[node.place]);
      ctx.fillStyle = fill[node.kind] || palette.shelf;
      wl.marks.roundRect(ctx, x - side / 2, y - side / 2, side, side, side * 0.2);
      ctx.fill();
    }
  };

  /** The node or lane nearest to a point in metres, within reach; undefined when there is none. */
  const pick = (map, x, y) => {
    let best, least = (0.3 * map.floor.cell_m) ** 2;
    map.floor.places.forEach(([px, py], place) => {
      const d = (px - x) ** 2 + (py - y) ** 2;
      if (d < least) { least = d; best = place; }
    });
    return best;
  };

  wl.network = { draw, pick };
})();
