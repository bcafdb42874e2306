// What the map is drawn with: the part in view, tiles, the base map with its names, and lines side by side.
const KINDS = { // pixels: width of the line; most: metres a pixel up to which it is drawn
  water: { fill: '#b9d3e6', stripes: '#2a6f97', stroke: '#2a6f97', pixels: 1.5, most: Infinity },
  park: { fill: '#a3bf90', stroke: '#3f7d3a', pixels: 1, most: 3 },
  path: { stroke: '#ffffff99', pixels: 0.6, most: 1.2 }, street: { stroke: '#ffffffa6', pixels: 0.8, most: 4 },
  major: { stroke: '#ffffffb3', pixels: 1.4, most: Infinity }, rail: { stroke: '#4a515899', pixels: 0.8, most: 3 },
};
const inMetres = (pen, toPixel, scale, act) => { // draws with metres as its unit
  const [left, top] = toPixel([0, 0]);
  pen.save();
  pen.transform(1 / scale, 0, 0, -1 / scale, left, top);
  act();
  pen.restore();
};
const ground = (pen, toPixel, scale, wide, high) => inMetres(pen, toPixel, scale, () => {
  pen.fillStyle = '#fbfaf7';
  pen.fillRect(0, 0, wide, high);
});
function baseMap({ shapes, names }) {
  const paths = Object.entries(shapes).filter(([kind]) => kind in KINDS).map(([kind, lines]) => {
    const path = new Path2D();
    for (const line of lines)
      for (let k = 0; k < line.length; k += 2) path[k ? 'lineTo' : 'moveTo'](line[k], line[k + 1]);
    return [KINDS[kind], path];
  });
  const fill = (pen, toPixel, scale) => inMetres(pen, toPixel, scale, () => {
    for (const [{ fill, stripes }, path] of paths) // level stripes are known for water below any colours
      for (const fillStyle of [fill, stripes && striped(pen, stripes, scale)])
        if (fillStyle) Object.assign(pen, { fillStyle }).fill(path, 'evenodd');
  });
  const draw = (pen, toPixel, scale) => inMetres(pen, toPixel, scale, () => { // lines alone, which hide no values
    for (const [{ stroke, pixels, most }, path] of paths) {
      Object.assign(pen, { strokeStyle: stroke, lineWidth: pixels * scale, lineJoin: 'round' });
      if (scale <= most) pen.stroke(path);
    }
  });
  const write = (pen, toPixel, scale, [west, north, east, south], ends, routes, covers) => { // inside these; those in
    const boxes = (places, ...reach) => places.map(toPixel).map(at => [...at, ...reach]); // front come first, none
    const taken = [...boxes(ends, 46, 10), ...boxes(routes, 0, 0), ...covers]; // over another, a route or a control
    const most = taken.length + 60;
    for (const [x, y, text, kind, angle, metres] of names) {
      const [middle, top] = toPixel([x, y]), coarsest = KINDS[kind]?.most ?? Infinity;
      if (taken.length > most) return;
      if (middle < west || top < north || middle > east || top > south || scale > coarsest / 2) continue;
      pen.font = kind === 'place' ? '600 12.5px system-ui' : '11px system-ui';
      const half = pen.measureText(text).width / 2 + 4;
      const reach = [Math.abs(half * Math.cos(angle)) + 8, Math.abs(half * Math.sin(angle)) + 8];
      const left = metres ? middle : clamp(middle, west + half, east - half); // a place's name moves inside
      if (metres && metres / scale < 2 * half || Math.min(left - west, east - left) < reach[0] - 8) continue;
      if (Math.min(top - north, south - top) < reach[1]) continue;
      if (taken.some(([x2, y2, a, b]) => Math.abs(x2 - left) < a + reach[0] && Math.abs(y2 - top) < b + reach[1]))
        continue;
      taken.push([left, top, ...reach]);
      pen.save();
      pen.translate(left, top);
      pen.rotate(-angle);
      Object.assign(pen, { textAlign: 'center', textBaseline: 'middle', lineWidth: 3, lineJoin: 'round' });
      Object.assign(pen, { strokeStyle: '#ffffffc0', fillStyle: '#2b3138' });
      for (const ink of ['strokeText', 'fillText']) pen[ink](text, 0, 0);
      pen.restore();
    }
  };
  return { fill, draw, write };
}
// Outlines of what stands (`jaxurban.viewer.outlines`), by group: pale where the flight is above it, dashed where its
// height is guessed, and filled where it is no building and reaches the flight.
function outlinesOf(values, { step_m: step, group_colours: colours, cols, rows, resolution_m: side }) {
  const [num] = values, [counts, heights, guesses, groups] = [0, 1, 2, 3].map(k => values.subarray(k * num + 1));
  const steps = values.subarray(4 * num + 1), half = steps.length / 2, drawn = { flight: null, paths: [] };
  const inks = colours.map((colour, group) => group ? `color-mix(in srgb, ${colour}, #1f2429 40%)` : '#1f2429');
  const border = [0, 0, cols * side, rows * side], pathsAt = flight => {
    const paths = colours.map(() => [0, 1, 2, 3].map(() => new Path2D()));
    for (let ring = 0, k = 0, x = 0, y = 0; ring < num; ring++) {
      const path = paths[groups[ring]][2 * (heights[ring] >= flight) + guesses[ring]];
      for (let corner = 0; corner < counts[ring]; corner++, k++) {
        x += step * steps[k];
        y += step * steps[half + k];
        path[corner ? 'lineTo' : 'moveTo'](x, y);
      }
    }
    return paths;
  };
  return (pen, toPixel, { scale }, flight, isShown) => {
    if (!Object.is(drawn.flight, flight)) Object.assign(drawn, { flight, paths: pathsAt(flight) });
    const drawPath = (path, kind, group) => {
      const isBelow = kind < 2, isGuessed = kind % 2, alpha = (isBelow ? 40 : 100) * (scale < 4 ? 1 : 0.6);
      pen.setLineDash(isGuessed ? [4 * scale, 3 * scale] : []);
      Object.assign(pen, { strokeStyle: `color-mix(in srgb, ${inks[group]} ${alpha}%, transparent)`,
        fillStyle: `${colours[group]}cc`, lineWidth: (scale < 2 ? 1 : 0.6) * scale });
      if (group && !isBelow) pen.fill(path);
      pen.stroke(path);
    };
    inMetres(pen, toPixel, scale, () => {
      for (const act of ['beginPath', 'rect', 'clip']) pen[act](...act === 'rect' ? border : []);
      drawn.paths.forEach((paths, k) => isShown[k] && paths.forEach((path, kind) => drawPath(path, kind, k)));
    });
  };
}
function keptSheet() { // what is drawn again only where its key has changed
  const sheet = new OffscreenCanvas(1, 1), ink = sheet.getContext('2d');
  let drawn = '';
  return (pen, key, act) => {
    const { canvas: { width, height, clientWidth, clientHeight } } = pen, now = JSON.stringify([width, height, key]);
    if (now !== drawn) {
      drawn = now;
      Object.assign(sheet, { width, height });
      ink.setTransform(pen.getTransform());
      act(ink);
    }
    pen.drawImage(sheet, 0, 0, clientWidth, clientHeight);
  };
}
const colouring = (edges, colours, [blocked, nothing, zero]) => value => {
  if (value === -Infinity) return blocked;
  if (Number.isNaN(value)) return nothing;
  if (value === 0 && zero) return zero;
  let low = 0, top = colours.length - 1; // the last edge that is not above the value
  while (low < top) {
    const middle = (low + top + 1) >> 1;
    if (edges[middle] <= value) low = middle; else top = middle - 1;
  }
  return colours[low];
};
const whereClosed = value => value > 1 ? 0xffffffff : 0; // free is 0, an obstacle 1
const whereNoFix = value => value === Infinity ? 0xffffffff : 0; // of a dilution of precision
function striped(pen, fillStyle, scale, slope = 0) { // lines of a colour: level, rising or falling
  const size = slope ? 7 : 6, tile = new OffscreenCanvas(size, size), ink = tile.getContext('2d');
  ink.fillStyle = fillStyle;
  for (let k = -1; k < size; k++) ink.fillRect(k, slope < 0 ? k : size - 1 - slope * k, slope ? 1.3 : 2, 1);
  const pattern = pen.createPattern(tile, 'repeat');
  pattern.setTransform(new DOMMatrix([scale, 0, 0, scale, 0, 0]));
  return pattern;
}
function viewOf(map, wide, high, side, redraw) { // the part of the map in view: its scale in metres a
  // pixel, and what fitted it, until it is moved
  const view = { x: wide / 2, y: high / 2, scale: 1 };
  view.toPixel = ([x, y]) =>
    [(x - view.x) / view.scale + map.clientWidth / 2, map.clientHeight / 2 - (y - view.y) / view.scale];
  view.toMetres = (left, top) =>
    [view.x + (left - map.clientWidth / 2) * view.scale, view.y - (top - map.clientHeight / 2) * view.scale];
  view.show = (x, y, scale, refit = null) => redraw(Object.assign(view, { x, y, scale, refit }));
  view.fit = () =>
    view.show(wide / 2, high / 2, 1.06 * Math.max(wide / map.clientWidth, high / map.clientHeight), view.fit);
  view.zoom = (factor, left = map.clientWidth / 2, top = map.clientHeight / 2) => {
    const [x, y] = view.toMetres(left, top), scale = clamp(view.scale * factor, side / 40, Math.max(wide, high) / 100);
    view.show(x + (view.x - x) * scale / view.scale, y + (view.y - y) * scale / view.scale, scale);
  };
  view.shift = (left, top) => view.show(view.x - left * view.scale, view.y + top * view.scale, view.scale);
  return view;
}
function tilesOf(ask, { tile, rows, cols, resolution_m: side, strides }, view, guard, redraw) {
  const held = new Map(), sheet = new OffscreenCanvas(1, 1), over = sheet.getContext('2d');
  const tileOf = (shown, stride, row, col, isWanted) => {
    const request = { ...shown.request, stride, row, col }, key = JSON.stringify([request, shown.over]);
    if (isWanted && !held.has(key)) {
      held.set(key, null); // on its way
      guard(async () => {
        const values = await unpack(await ask('tile', request));
        held.set(key, paint(values, Math.min(tile, Math.ceil(cols / stride) - col * tile), shown.colourOf));
        redraw();
      })();
    }
    const picture = held.get(key);
    if (held.delete(key)) held.set(key, picture); // those that were looked at last come last
    return picture;
  };
  return (pen, shown, { alpha = 1, hatch = null }) => { // coarse tiles lie below those still on their way
    const { canvas: { width, height, clientWidth, clientHeight } } = pen, ratio = width / clientWidth;
    const [west, north] = view.toMetres(0, 0), [east, south] = view.toMetres(clientWidth, clientHeight);
    const finest = strides.findLast(stride => stride * side <= view.scale / ratio * 1.01) ?? strides[0];
    Object.assign(sheet, { width, height });
    over.setTransform(ratio, 0, 0, ratio, 0, 0);
    over.imageSmoothingEnabled = false;
    const [left0, top0] = view.toPixel([0, rows * side]), [right0, bottom0] = view.toPixel([cols * side, 0]);
    over.beginPath(); // coarse tiles reach beyond the border
    over.rect(left0, top0, right0 - left0, bottom0 - top0);
    over.clip();
    let num = 0;
    for (const stride of strides.filter(each => each >= finest).reverse()) {
      const reach = stride * side * tile, isWanted = [finest, strides.at(-1)].includes(stride);
      const span = (low, top, end) => [clamp(low / reach, 0, end) | 0, Math.ceil(Math.min(end, top) / reach)];
      for (let [row, end] = span(south, north, rows * side); row < end; row++)
        for (let [col, last] = span(west, east, cols * side); col < last; col++) {
          const picture = tileOf(shown, stride, row, col, isWanted);
          num++;
          if (!picture) continue;
          const [left, bottom] = view.toPixel([col * reach, row * reach]), pixels = stride * side / view.scale;
          const up = picture.height * pixels, place = [left, bottom - up, picture.width * pixels, up];
          over.clearRect(...place); // else a coarser tile shows through
          over.drawImage(picture, ...place);
        }
    }
    for (const key of held.keys()) if (held.size > Math.max(200, 3 * num)) held.delete(key); // never those in view
    if (hatch) {
      const [colour, slope] = hatch, fillStyle = striped(over, colour, 1, slope);
      Object.assign(over, { globalCompositeOperation: 'source-in', fillStyle });
      over.fillRect(0, 0, clientWidth, clientHeight);
    }
    pen.globalAlpha = alpha;
    pen.drawImage(sheet, 0, 0, clientWidth, clientHeight);
    pen.globalAlpha = 1;
  };
}
function paint(values, width, colourOf) {
  const height = values.length / width, image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer), picture = new OffscreenCanvas(width, height);
  for (let row = 0, k = 0; row < height; row++) // rows run to the north, those of a picture down
    for (let to = (height - 1 - row) * width, col = 0; col < width; col++) pixels[to++] = colourOf(values[k++]);
  picture.getContext('2d').putImageData(image, 0, 0);
  return picture;
}
// Where lines share cells, `lanes` to the right at each of their points, as in `side_by_side` of our figures.
function sideBySide(lines, side) {
  const dense = lines.map(places => places.flatMap((place, k) => {
    const from = places[k - 1] ?? place, step = [0, 1].map(axis => place[axis] - from[axis]);
    const num = Math.ceil(2 * Math.hypot(...step) / side) || 1;
    return Array.from({ length: num }, (_, i) => [0, 1].map(axis => from[axis] + step[axis] * (i + 1) / num));
  }));
  const cells = dense.map(places => places.map(place => String(place.map(metres => Math.floor(metres / side)))));
  const others = cells.map(each => new Set(each));
  return dense.map((places, k) => {
    const reach = Math.ceil(places.length / 100), lanes = places.map(() => 0), mean = values => values.map((_, i) =>
      values.slice(Math.max(i - reach, 0), i + reach + 1).reduce((sum, value) => sum + value, 0) / (2 * reach + 1));
    others.forEach((other, j) => j !== k && mean(cells[k].map(cell => +other.has(cell))).forEach((share, i) => {
      if (share > 0.5) lanes[i] += Math.sign(k - j) / 2;
    }));
    return { places, reach, lanes: mean(lanes) };
  });
}
function beside(points, { lanes, reach }, apart) { // the line, in pixels, in its lanes
  return points.map(([x, y], k) => {
    const [[a, b], [c, d]] = [points[Math.max(k - reach, 0)], points[Math.min(k + reach, points.length - 1)]];
    const size = Math.hypot(c - a, d - b) || 1, off = apart * lanes[k];
    return [x - off * (d - b) / size, y + off * (c - a) / size];
  });
}
