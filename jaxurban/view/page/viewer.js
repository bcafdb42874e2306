// The page of the viewer. It asks one function, `ask(name, parameters)`, which each door brings along: a server over
// HTTP, a notebook's kernel, or the answers that lie in the file itself. Places are metres from the maps' southwest
// corner, x to the east of the grid and y to its north; values travel as `jaxurban.view.tiles` packs them.

const fromBase64 = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const number = value => value === null ? '–' : Math.abs(value) >= 1000
  ? Math.round(value).toLocaleString('en') : String(Number(value.toPrecision(3)));

async function unpack(packed) { // bytes by significance, deflated -> Float32Array
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  const parts = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = parts.length / 4, bytes = new Uint8Array(parts.length);
  for (let k = 0; k < 4; k++) for (let i = 0; i < size; i++) bytes[4 * i + k] = parts[k * size + i];
  return new Float32Array(bytes.buffer);
}

async function overHttp(name, parameters) {
  const headers = { 'Content-Type': 'application/json' };
  const reply = await fetch(`ask/${name}`, { method: 'POST', headers, body: JSON.stringify(parameters) });
  if (!reply.ok) throw new Error(await reply.text());
  const isJson = reply.headers.get('Content-Type') === 'application/json';
  return isJson ? reply.json() : new Uint8Array(await reply.arrayBuffer());
}

function overWidget(model) {
  const waiting = new Map();
  let last = 0;
  model.on('msg:custom', ({ id, error, json }, buffers) => {
    const { resolve, reject } = waiting.get(id) ?? {};
    if (!waiting.delete(id)) return;
    if (error) reject(new Error(error));
    else resolve(json ?? new Uint8Array(buffers[0].buffer, buffers[0].byteOffset, buffers[0].byteLength));
  });
  return (name, parameters) => new Promise((resolve, reject) => {
    waiting.set(++last, { resolve, reject });
    model.send({ id: last, name, parameters });
  });
}

function inFile(answers) { // the values under the pointer come from the tiles
  const ask = async (name, parameters) => {
    if (name === 'values') return valuesAt(parameters);
    const found = answers[name + JSON.stringify(parameters)];
    if (found === undefined) throw new Error('This file does not hold that: open the maps with jaxurban view.');
    return typeof found === 'string' ? fromBase64(found) : found;
  };
  const valuesAt = async ({ at, row, col }) => {
    const { layers, tile, cols, strides: [stride] } = answers['scene{}'];
    const [y, x] = [row, col].map(cell => Math.floor(cell / stride)), [r, c] = [y, x].map(k => Math.floor(k / tile));
    const wide = Math.min(tile, Math.ceil(cols / stride) - c * tile);
    return Promise.all(layers.map(async layer => {
      const told = { layer: layer.name, at: ofLayer(layer, at), minus: null, stride, row: r, col: c };
      const value = (await unpack(await ask('tile', told)))[(y - r * tile) * wide + x - c * tile];
      return { ...layer, value: Number.isFinite(value) ? value : null };
    }));
  };
  return ask;
}

const ofLayer = (layer, at) => ['altitude', 'time', 'time_of_day'].map((dim, k) => layer.dims.includes(dim) ? at[k] : 0);

async function start(root, ask) {
  const is = name => root.querySelector(`[data-is="${name}"]`);
  const field = name => root.querySelector(`[name="${name}"]`), all = what => root.querySelectorAll(what);
  const scene = await ask('scene', {}), side = scene.resolution_m, wide = scene.cols * side, high = scene.rows * side;
  const layers = Object.fromEntries(scene.layers.map(layer => [layer.name, layer]));
  const map = is('map'), pen = map.getContext('2d'), tiles = new Map(), outlines = new Map(), waiting = new Set();
  const state = { tab: 'look', ends: {}, zones: [], routes: [], chosen: 0, plans: 0 };
  const view = { x: wide / 2, y: high / 2, scale: 1 }; // scale: metres a pixel
  const tell = text => { is('tell').textContent = text; };
  const guard = action => async (...given) => { try { return await action(...given); } catch (e) { tell(e.message); } };
  const latest = action => { // one call at a time; of those that come meanwhile the last one waits
    let isBusy = false, next = null;
    return async (...given) => {
      next = given;
      if (isBusy) return;
      for (isBusy = true; next;) { const now = next; next = null; await guard(action)(...now); }
      isBusy = false;
    };
  };

  // --- where things are
  const toPixel = ([x, y]) =>
    [(x - view.x) / view.scale + map.clientWidth / 2, map.clientHeight / 2 - (y - view.y) / view.scale];
  const toMetres = (left, top) =>
    [view.x + (left - map.clientWidth / 2) * view.scale, view.y - (top - map.clientHeight / 2) * view.scale];
  const isInside = ([x, y]) => x >= 0 && y >= 0 && x < wide && y < high;
  const toLonLat = ([x, y]) => {
    const u = 2 * x / wide - 1, v = 2 * y / high - 1, { powers, lon, lat } = scene.lonlat;
    return [lon, lat].map(terms => +powers.reduce((sum, [i, j], k) => sum + terms[k] * u ** i * v ** j, 0).toFixed(7));
  };
  const fit = () => {
    const scale = 1.06 * Math.max(wide / map.clientWidth, high / map.clientHeight);
    Object.assign(view, { x: wide / 2, y: high / 2, scale });
  };
  const zoom = (factor, left = map.clientWidth / 2, top = map.clientHeight / 2) => {
    const [x, y] = toMetres(left, top), scale = clamp(view.scale * factor, side / 40, Math.max(wide, high) / 100);
    Object.assign(view, { x: x + (view.x - x) * scale / view.scale, y: y + (view.y - y) * scale / view.scale, scale });
  };

  // --- layers
  const places = (which = '') => ['altitude', 'time', 'day'].map(name => +field(which + name).value);
  const show = guard(async () => {
    const layer = layers[field('layer').value], less = layers[field('minus-layer').value];
    const minus = is('minus').open
      ? { layer: less.name, at: ofLayer(less, places('minus-')), run: +field('minus-run').value } : null;
    const request = { layer: layer.name, at: ofLayer(layer, places()), minus };
    state.asked = JSON.stringify(request);
    const legend = await ask('legend', request), rgb = fromBase64(legend.colours);
    if (state.asked !== JSON.stringify(request)) return; // another one was asked for meanwhile
    const colour = (red, green, blue) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
    const ofHex = hex => hex && colour(...[1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16)));
    const colours = Array.from({ length: rgb.length / 3 }, (_, k) => colour(...rgb.subarray(3 * k, 3 * k + 3)));
    state.shown = { request, edges: legend.edges, colours, flat: legend.flat.map(ofHex) };
    is('legend').innerHTML = legend.html;
    draw();
  });
  const tileOf = (shown, stride, row, col, isWanted) => {
    const request = { ...shown.request, stride, row, col }, key = JSON.stringify(request);
    if (isWanted && !tiles.has(key) && !waiting.has(key)) {
      waiting.add(key);
      guard(async () => {
        const values = await unpack(await ask('tile', request));
        tiles.set(key, paint(values, Math.min(scene.tile, Math.ceil(scene.cols / stride) - col * scene.tile), shown));
        if (tiles.size > 200) tiles.delete(tiles.keys().next().value);
        draw();
      })().finally(() => waiting.delete(key));
    }
    return tiles.get(key);
  };
  const paint = (values, width, { edges, colours, flat: [blocked, nothing, zero] }) => {
    const height = values.length / width, image = new ImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer), picture = document.createElement('canvas');
    const colourOf = value => {
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
    for (let row = 0, k = 0; row < height; row++) // rows run to the north, those of a picture down
      for (let to = (height - 1 - row) * width, col = 0; col < width; col++) pixels[to++] = colourOf(values[k++]);
    Object.assign(picture, { width, height }).getContext('2d').putImageData(image, 0, 0);
    return picture;
  };

  // --- the map
  let isQueued = false;
  const draw = () => {
    if (!isQueued) requestAnimationFrame(drawMap);
    isQueued = true;
  };
  const drawMap = () => {
    isQueued = false;
    const { clientWidth: width, clientHeight: height } = map, ratio = window.devicePixelRatio || 1;
    Object.assign(map, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.imageSmoothingEnabled = false;
    const [west, north] = toMetres(0, 0), [east, south] = toMetres(width, height);
    if (state.shown) drawTiles(west, south, east, north, view.scale / ratio);
    if (scene.has_outlines && view.scale < 1.5) drawOutlines(west, south, east, north);
    for (const zone of state.zones) line(zone, '#a01830', 1.5, { fill: '#a0183033' });
    if (state.drawing) line(state.drawing, '#a01830', 1.5);
    [...state.routes].reverse().forEach((route, k, { length }) => { // those below are wider, so that all are seen
      line(route.xy_m, '#fff', 5 + 2 * (length - 1 - k));
      line(route.xy_m, scene.planner_colours[route.planner], 2.6 + 2 * (length - 1 - k), { dash: route.cell_m && [6, 6] });
    });
    for (const [name, place] of Object.entries(state.ends)) mark(name, place);
    if (state.linked) spot(state.linked, 5, '#1f2429', '#fff');
    if (map.matches(':focus-visible')) spot([view.x, view.y], 3, '#fff', '#1f2429');
    const most = 130 * view.scale, power = 10 ** Math.floor(Math.log10(most)), length = power * (most < 2 * power ? 1 : most < 5 * power ? 2 : 5);
    is('scale').style.width = `${length / view.scale}px`;
    is('scale-text').textContent = length < 1000 ? `${length} m` : `${length / 1000} km`;
  };
  const drawTiles = (west, south, east, north, scale) => {
    const finest = scene.strides.findLast(stride => stride * side <= scale * 1.01) ?? scene.strides[0];
    for (const stride of scene.strides.filter(each => each >= finest).reverse()) {
      const cell = stride * side, reach = cell * scene.tile, isWanted = [finest, scene.strides.at(-1)].includes(stride);
      const span = (low, top, end) => [clamp(low / reach, 0, end) | 0, Math.min(Math.ceil(end / reach), Math.ceil(top / reach))];
      for (let [row, end] = span(south, north, high); row < end; row++)
        for (let [col, last] = span(west, east, wide); col < last; col++) {
          const picture = tileOf(state.shown, stride, row, col, isWanted), [left, bottom] = toPixel([col * reach, row * reach]);
          if (!picture) continue;
          const [across, up] = [picture.width, picture.height].map(cells => cells * cell / view.scale);
          pen.drawImage(picture, left, bottom - up, across, up);
        }
    }
  };
  const drawOutlines = (west, south, east, north, step = 400) => {
    for (let x = Math.floor(west / step); x <= east / step; x++)
      for (let y = Math.floor(south / step); y <= north / step; y++) {
        const key = `${x} ${y}`, box = { west: x * step, south: y * step, east: (x + 1) * step, north: (y + 1) * step };
        if (!outlines.has(key)) {
          outlines.set(key, []);
          guard(async () => {
            const found = await ask('outlines', box);
            if (found.state === 'reading') setTimeout(() => { outlines.delete(key); draw(); }, 700);
            outlines.set(key, found.rings);
            draw();
          })();
        }
        for (const ring of outlines.get(key)) line(ring, '#1f2429aa', 0.8);
      }
  };
  const line = (places, strokeStyle, lineWidth, { fill, dash } = {}) => {
    pen.beginPath();
    for (const place of places) pen.lineTo(...toPixel(place));
    Object.assign(pen, { strokeStyle, lineWidth, lineJoin: 'round', lineCap: 'round', fillStyle: fill });
    if (fill) { pen.closePath(); pen.fill(); }
    pen.setLineDash(dash || []);
    pen.stroke();
    pen.setLineDash([]);
  };
  const spot = (place, radius, fillStyle, strokeStyle) => {
    pen.beginPath();
    pen.arc(...toPixel(place), radius, 0, 7);
    Object.assign(pen, { fillStyle, strokeStyle, lineWidth: 2 });
    pen.fill();
    pen.stroke();
  };
  const mark = (name, place) => {
    const [left, top] = toPixel(place), colours = ['#fff', '#1f2429'];
    spot(place, 7, ...(name === 'start' ? colours : colours.reverse()));
    Object.assign(pen, { font: '600 12px system-ui, sans-serif', strokeStyle: '#fff', fillStyle: '#1f2429', lineWidth: 3 });
    pen.strokeText(name, left + 11, top + 4);
    pen.fillText(name, left + 11, top + 4);
  };

  // --- the pointer
  const look = latest(async ([x, y]) => {
    const cell = [y, x].map(metres => Math.floor(metres / side));
    const values = await ask('values', { at: places(), row: cell[0], col: cell[1] });
    const table = is('values').tBodies[0], parts = [];
    const add = (className, facts, ...texts) => {
      const row = Object.assign(document.createElement('tr'), { className });
      for (const text of texts) row.insertCell().textContent = text;
      Object.assign(row.dataset, facts);
      parts.push(row);
    };
    values.forEach(({ name, heading, group, value, unit }, k) => {
      if (group !== values[k - 1]?.group) add('jv-part', {}, group);
      const text = name === 'obstacle' ? (value ? 'yes' : 'no') : `${number(value)} ${unit}`;
      add(name === field('layer').value ? 'jv-chosen' : '', { layer: name, value }, heading, text);
    });
    table.replaceChildren(...parts);
    is('values').dataset.cell = cell.join(' ');
  });
  const point = place => {
    is('at').textContent = !isInside(place) ? '' : toLonLat(place).map((degrees, k) =>
      `${Math.abs(degrees).toFixed(6)}° ${'ENWS'[k + 2 * (degrees < 0)]}`).join('  ');
    if (isInside(place) && state.tab === 'look') look(place);
    if (state.report) {
      const offs = state.report.xy.map(([x, y]) => Math.hypot(x - place[0], y - place[1])), least = Math.min(...offs);
      link(least < 25 * view.scale ? offs.indexOf(least) : -1);
    }
  };
  const endAt = (left, top) => state.tab === 'plan' && !state.drawing && ['goal', 'start'].find(name =>
    state.ends[name] && Math.hypot(toPixel(state.ends[name])[0] - left, toPixel(state.ends[name])[1] - top) < 12);
  map.onpointerdown = ({ pointerId, offsetX: left, offsetY: top }) => {
    map.setPointerCapture(pointerId);
    state.drag = { end: endAt(left, top), left, top, isMoved: false };
  };
  map.onpointermove = ({ offsetX: left, offsetY: top }) => {
    const drag = state.drag, place = toMetres(left, top);
    if (drag) {
      drag.isMoved ||= Math.hypot(left - drag.left, top - drag.top) > 3;
      if (drag.end && drag.isMoved && isInside(place)) { state.ends[drag.end] = place; preview(); }
      if (!drag.end && drag.isMoved) {
        view.x -= (left - drag.left) * view.scale;
        view.y += (top - drag.top) * view.scale;
        Object.assign(drag, { left, top });
      }
      draw();
    }
    point(place);
  };
  map.onpointerup = ({ offsetX, offsetY }) => {
    const { end, isMoved } = state.drag ?? { isMoved: true };
    state.drag = null;
    if (end) plan(); else if (!isMoved) click(toMetres(offsetX, offsetY));
  };
  map.ondblclick = () => closeZone();
  map.onwheel = event => {
    event.preventDefault();
    zoom(1.0015 ** event.deltaY, event.offsetX, event.offsetY);
    draw();
  };
  map.onkeydown = event => {
    const steps = { ArrowLeft: [-60, 0], ArrowRight: [60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key] ?? [0, 0];
    const acts = { '+': () => zoom(0.7), '-': () => zoom(1 / 0.7), 0: fit, Enter: () => click([view.x, view.y]),
      Escape: () => { state.drawing = null; hint(); } };
    if (!steps.some(Boolean) && !acts[event.key]) return;
    event.preventDefault();
    acts[event.key]?.();
    Object.assign(view, { x: view.x + steps[0] * view.scale, y: view.y + steps[1] * view.scale });
    point([view.x, view.y]);
    draw();
  };
  map.onfocus = map.onblur = draw;

  // --- routes
  const weights = () => Object.fromEntries(Object.keys(scene.weights).map(name => [name, +field(`weight-${name}`).dataset.value]));
  const zones = () => !state.zones.length ? '' : JSON.stringify({ type: 'FeatureCollection', features: state.zones.map(
    (zone, k) => ({ type: 'Feature', properties: { name: `zone ${k + 1}` },
      geometry: { type: 'Polygon', coordinates: [[...zone, zone[0]].map(toLonLat)] } })) });
  const query = planner => ({ start: toLonLat(state.ends.start), goal: toLonLat(state.ends.goal), at: places(),
    weights: weights(), planner, cost_model: field('cost_model').value, obstacles: field('obstacles').value,
    clearance_m: +field('clearance_m').value, snap: field('snap').checked, zones: zones() });
  const isReady = () => state.ends.start && state.ends.goal;
  const placed = route => ({ ...route, xy_m: route.xy_m.map(([x, y]) => [x - scene.corner_m[0], y - scene.corner_m[1]]) });
  const chosen = () => [...all('[data-is="planners"] input:checked')].map(box => box.value);
  const coarse = latest(async () => {
    const asked = state.plans, found = await ask('coarse', query(chosen()[0] ?? 'astar-plus'));
    if (asked !== state.plans || !found.has_path) return; // the route itself was asked for meanwhile
    state.routes = [placed(found)];
    tell(`Preview on cells of ${found.cell_m} m: let go for the route itself.`);
    draw();
  });
  const preview = () => isReady() && coarse();
  const planAll = latest(async () => {
    const asked = state.plans, found = [];
    tell('Planning …');
    for (const request of chosen().map(query)) {
      found.push({ ...placed(await ask('plan', request)), request });
      if (asked !== state.plans) return;
    }
    tell(found.find(route => !route.has_path)?.message ?? '');
    showRoutes(found);
  });
  const plan = () => { state.plans++; hint(); if (isReady()) planAll(); };
  const showRoutes = (routes, number = state.chosen) => {
    Object.assign(state, { routes, chosen: clamp(number, 0, Math.max(routes.length - 1, 0)), report: null });
    const route = routes[state.chosen], list = is('routes');
    list.innerHTML = routes.map(() => '<button class="jv-route"><i class="jv-dot"></i><span></span><b></b></button>').join('');
    routes.forEach(({ planner, text }, k) => {
      const [spotted, name, told] = list.children[k].children;
      spotted.style.background = scene.planner_colours[planner];
      Object.assign(list.children[k], { onclick: () => showRoutes(routes, k), ariaPressed: k === state.chosen });
      Object.assign(name, { textContent: planner });
      Object.assign(told, { textContent: text });
    });
    is('costs').innerHTML = route?.html ?? '';
    is('command').textContent = route?.command ?? '';
    is('command').hidden = is('copy').hidden = !route?.command;
    is('report').hidden = true;
    if (route?.has_path) report(route);
    draw();
  };
  const report = latest(async route => {
    const found = await ask('report', route.request);
    if (state.routes[state.chosen] !== route) return;
    state.report = found;
    is('totals').innerHTML = found.totals;
    is('profile').innerHTML = found.svg;
    is('report-text').textContent = found.text;
    is('report').hidden = false;
  });
  const link = k => { // the same place on the map and on the profile
    if (k === state.at) return;
    const { xy, to_share: ends } = state.report, here = is('profile').querySelector('.jv-here');
    Object.assign(state, { at: k, linked: xy[k] });
    here.style.display = xy[k] ? 'block' : 'none';
    here.setAttribute('transform', `translate(${36 + 864 * (xy[k] ? ((ends[k - 1] ?? 0) + ends[k]) / 2 : 0)})`);
    draw();
  };
  is('profile').onpointermove = event => {
    const box = is('profile').firstElementChild.getBoundingClientRect();
    const share = ((event.clientX - box.left) / box.width * 900 - 36) / 864;
    link(clamp(state.report.to_share.findIndex(end => end >= share), 0, state.report.xy.length - 1));
  };
  const click = place => {
    if (!isInside(place) || state.tab !== 'plan') return;
    if (state.drawing) state.drawing.push(place);
    else { state.ends[state.ends.start ? 'goal' : 'start'] = place; plan(); }
    draw();
  };
  const closeZone = () => {
    const corners = state.drawing?.filter((place, k, { [k - 1]: before }) => String(place) !== String(before)) ?? [];
    state.drawing = null;
    if (corners.length > 2) { state.zones.push(corners); plan(); }
    hint();
    draw();
  };
  const hint = () => {
    const { drawing, ends, zones: { length } } = state, button = root.querySelector('[data-do="zone"]');
    Object.assign(button, { ariaPressed: Boolean(drawing), textContent: drawing ? 'Close the zone' : 'Draw a no-fly zone' });
    root.querySelector('[data-do="save-zones"]').hidden = !length;
    is('hint').textContent = drawing ? 'Click the corners of the zone; a double click closes it, Escape gives up.'
      : isReady() ? 'Drag start or goal, or move a weight.' : `Click the map for the ${ends.start ? 'goal' : 'start'}.`;
  };
  const download = (bytes, name) => {
    const href = URL.createObjectURL(new Blob([bytes]));
    Object.assign(document.createElement('a'), { href, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(href), 1000);
  };
  const actions = {
    zone: () => { if (state.drawing) closeZone(); else state.drawing = []; hint(); draw(); },
    'save-zones': () => download(zones(), 'zones.geojson'),
    clear: () => { Object.assign(state, { ends: {}, zones: [], drawing: null, linked: null }); tell(''); showRoutes([]); plan(); },
    copy: () => navigator.clipboard.writeText(is('command').textContent),
  };
  for (const button of all('[data-do]')) button.onclick = guard(actions[button.dataset.do]);
  for (const button of all('[data-save]')) button.onclick = guard(async () => {
    const format = button.dataset.save;
    download(await ask('save', { ...state.routes[state.chosen].request, format }), `route.${format}`);
  });
  const setWeight = (name, value) => { // at its left end a slider weighs nothing
    const slider = field(`weight-${name}`);
    slider.max = Math.max(slider.max, Math.ceil(Math.log10(value || 1)));
    slider.value = value > 0 ? Math.log10(value) : slider.min;
    slider.dataset.value = value;
    slider.previousElementSibling.textContent = number(value);
  };

  // --- the triangle of weights
  const showStudy = guard(async () => {
    if (state.study) return;
    const { cells, svg, hint: told, at, query: asked } = state.study = await ask('study', {});
    is('weigh-hint').textContent = told;
    is('triangle').innerHTML = svg;
    Object.entries({ altitude: at[0], time: at[1], day: at[2] }).forEach(([name, k]) => { field(name).value = k; });
    const { start: from, goal, ...rules } = asked;
    setFields(rules);
    show();
    const choose = latest(async k => {
      const { weights: its, html } = cells[k];
      [...all('polygon')].forEach((cell, each) => cell.classList.toggle('jv-chosen', each === k));
      for (const name of Object.keys(its)) setWeight(name, its[name]);
      state.ends = { start: [0, 0], goal: [0, 0] };
      const request = { ...query('astar-plus'), start: from, goal, weights: its }, route = placed(await ask('plan', request));
      state.ends = { start: route.xy_m[0], goal: route.xy_m.at(-1) };
      is('weigh-table').innerHTML = html;
      showRoutes([{ ...route, request }], 0);
    });
    [...all('polygon')].forEach((cell, k) => { cell.onpointerenter = cell.onfocus = () => choose(k); });
  });
  const setFields = values => {
    for (const [name, value] of Object.entries(values)) field(name)[name === 'snap' ? 'checked' : 'value'] = value;
  };

  // --- the beginning
  for (const [name, html] of Object.entries(scene.html)) (is(name) ?? field(name)).innerHTML = html;
  for (const name of ['time', 'day', 'run']) for (const which of ['', 'minus-']) {
    const list = field(which + name);
    if (list) list.parentElement.hidden = list.length < (name === 'run' ? 2 : 1);
  }
  field('minus-run').selectedIndex = field('minus-run').length - 1;
  field('minus-altitude').selectedIndex = field('minus-run').length > 1 ? 0 : field('minus-altitude').length - 1;
  is('north').style.transform = `rotate(${scene.north_deg}deg)`;
  setFields(scene.fields);
  for (const [name, value] of Object.entries(scene.weights)) {
    const slider = field(`weight-${name}`), read = () => setWeight(name,
      slider.value === slider.min ? 0 : Number((10 ** slider.value).toPrecision(3)));
    slider.oninput = () => { read(); preview(); };
    slider.onchange = plan;
    setWeight(name, value);
  }
  for (const each of all('[data-page="plan"] details :is(select, input)')) each.onchange = plan;
  for (const each of all('[data-page="look"] select')) each.onchange = show;
  for (const name of ['altitude', 'day', 'time']) field(name).onchange = () => { show(); plan(); };
  is('minus').ontoggle = show;
  root.querySelector('nav').hidden = is('minus').hidden = !scene.can_plan;
  root.querySelector('[data-tab="weigh"]').hidden = !scene.has_study;
  for (const button of all('[data-tab]')) button.onclick = () => {
    state.tab = button.dataset.tab;
    for (const each of all('[data-tab]')) each.ariaSelected = each === button;
    for (const page of all('[data-page]')) page.hidden = page.dataset.page !== state.tab;
    if (state.tab === 'weigh') showStudy();
  };
  hint();
  fit();
  new ResizeObserver(draw).observe(map);
  await show();
  root.dataset.ready = 'yes';
}

const held = document.getElementById('jv-data');
if (held) start(document.querySelector('.jv'), held.textContent ? inFile(JSON.parse(held.textContent)) : overHttp);

export default {
  render({ model, el }) {
    el.innerHTML = `<div class="jv jv-inset">${model.get('markup')}</div>`;
    start(el.firstElementChild, overWidget(model));
  },
};
