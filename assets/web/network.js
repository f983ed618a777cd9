/* A path network on the live map: lanes as lines beside each other, nodes as squares; drawn under the fleet. */
(() => {
  "use strict";
  const wl = (window.wattlane = window.wattlane || {});
  const LANE_SHARE = 0.1;        // width of a lane, of the mean arc
  const NODE_SHARE = 0.34;       // side of a node
  const ARROWS_FROM_PX = 26;     // a shorter arc has no arrowheads
  const HEAT_WIDER = 1.8;

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
      for (const lane of floor.lanes) if (heat[lane.place] > 0) stroke(map, ctx, [lane], width * HEAT_WIDER, map.heatColour(lane.place));
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

  const colourOf = (palette, kind) =>
    ({ entrance: palette.inbound, inbound: palette.inbound, outbound: palette.outbound, rack: palette.rack })[kind] || palette.shelf;

  const drawNodes = (map, ctx, cell) => {
    const { floor, palette, heat, layers } = map, side = Math.max(2, cell * NODE_SHARE);
    for (const node of floor.nodes) {
      const [x, y] = map.toScreen(...floor.places[node.place]);
      ctx.fillStyle = colourOf(palette, node.kind);
      wl.marks.roundRect(ctx, x - side / 2, y - side / 2, side, side, side * 0.2);
      ctx.fill();
      if (!layers.heat || !heat || !(heat[node.place] > 0)) continue;
      ctx.fillStyle = map.heatColour(node.place);
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

  /** What a person calls a place: a lane by its ends, `E1→N17`, a node by its station. */
  const name = (map, place) => {
    const lane = map.laneAt.get(place);
    if (lane) return `${name(map, lane.from)}→${name(map, lane.to)}`;
    const station = map.stationAt.get(place);
    return station ? station.name : map.floor.nodes[place].name;
  };

  const PERIODS = { 600: "in the last 10 min", 3600: "in the last hour", 28800: "in the last 8 h", 0: "so far" };

  /** What is known of an arc, `arcs` as the server tells them: expected time, passages and share of the time occupied. */
  const facts = (arcs, place, window) => [`expected ${wl.heatText("expected", arcs.expected_s[place])}`,
    `${wl.number(arcs.passages[place])} passage${arcs.passages[place] === 1 ? "" : "s"} ${PERIODS[window] || `in the last ${wl.span(window)}`}`,
    `occupied ${(100 * arcs.occupancy[place]).toFixed(1)} % of the time`];

  /** The marks of a network in the legend: [draw on a small canvas, word]. */
  const marks = (palette) => {
    const line = (colour, dash) => (ctx, x, y) => {
      ctx.strokeStyle = colour;
      ctx.lineWidth = 4;
      ctx.setLineDash(dash);
      ctx.beginPath(); ctx.moveTo(x - 10, y); ctx.lineTo(x + 10, y); ctx.stroke();
    };
    const node = (colour) => (ctx, x, y) => { ctx.fillStyle = colour; wl.marks.roundRect(ctx, x - 7, y - 7, 14, 14, 3); ctx.fill(); };
    return [[line(palette.arrow, []), "lane"], [line(palette.parking, [4, 3]), "kerb: a lane to rest on"],
      [node(palette.inbound), "entrance"], [node(palette.rack), "node"]];
  };

  wl.network = { draw, pick, name, facts, marks, colourOf };
})();
