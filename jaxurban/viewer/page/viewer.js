// The page of the viewer. It asks one function, `ask(name, parameters)`, which each door brings along: a server over
// HTTP, a notebook's kernel, or the answers that lie in the file itself. Places are metres from the maps' southwest
// corner, x to the east of the grid and y to its north; values travel as `jaxurban.viewer.tiles` packs them.
const fromBase64 = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const number = value => value === null ? '–'
  : Math.abs(value) >= 1000 ? Math.round(value).toLocaleString('en') : String(+value.toPrecision(3));
async function unpack(packed) { // bytes by significance, deflated -> Float32Array
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  const parts = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = parts.length / 4, bytes = new Uint8Array(parts.length);
  for (let k = 0; k < 4; k++) for (let i = 0; i < size; i++) bytes[4 * i + k] = parts[k * size + i];
  return new Float32Array(bytes.buffer);
}
function overHttp() {
  let key = ''; // of the maps that the scene is of: the server refuses those that were made since
  return async (name, parameters) => {
    const kind = 'application/json', body = JSON.stringify(parameters);
    const reply = await fetch(`ask/${name}?${key}`, { method: 'POST', headers: { 'Content-Type': kind }, body });
    if (!reply.ok) throw Object.assign(new Error(await reply.text()), { isOld: reply.status === 409 });
    const isJson = reply.headers.get('Content-Type') === kind;
    const answer = isJson ? await reply.json() : new Uint8Array(await reply.arrayBuffer());
    key ||= answer.key ?? '';
    return answer;
  };
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
    return typeof found === 'string' ? fromBase64(found) : found;
  };
  const valuesAt = async ({ at, row, col }) => {
    const { layers, tile, cols, strides: [stride] } = answers['scene{}'];
    const [y, x] = [row, col].map(cell => Math.floor(cell / stride)), [r, c] = [y, x].map(k => Math.floor(k / tile));
    const wide = Math.min(tile, Math.ceil(cols / stride) - c * tile);
    return Promise.all(layers.filter(layer => layer.told).map(async layer => {
      const request = { layer: layer.name, at: ofLayer(layer, at), stride, row: r, col: c };
      const value = (await unpack(await ask('tile', request)))[(y - r * tile) * wide + x - c * tile];
      return { ...layer, value: Number.isFinite(value) ? value : null };
    }));
  };
  return ask;
}
const DIMS = ['altitude', 'time', 'time_of_day'];
const ofLayer = (layer, at) => DIMS.map((dim, k) => layer.dims.includes(dim) ? at[k] : 0);
async function start(root, ask) {
  const is = name => root.querySelector(`[data-is="${name}"]`);
  const field = name => root.querySelector(`[name="${name}"]`), all = what => root.querySelectorAll(what);
  const scene = await ask('scene', {}), side = scene.resolution_m, wide = scene.cols * side, high = scene.rows * side;
  const layers = Object.fromEntries(scene.layers.map(layer => [layer.name, layer]));
  const map = is('map'), pen = map.getContext('2d'), tiles = new Map();
  const state = { tab: 'look', ends: {}, marks: {}, zones: [], routes: [], plans: 0, weights: { ...scene.weights } };
  const view = { x: wide / 2, y: high / 2, scale: 1 }, [west0, south0] = scene.corner_m; // scale: metres a pixel
  const tell = (text, isOld = false) => { // that the maps are old stays
    if (!root.querySelector('.jv-reload').hidden) return;
    is('tell').textContent = text;
    is('tell').classList.toggle('jv-limit', isOld);
    root.querySelector('.jv-reload').hidden = !isOld;
  };
  const guard = action => async (...given) => {
    try { return await action(...given); } catch (e) { tell(e.message, e.isOld); }
  };
  const latest = action => { // one call at a time; of those that come meanwhile the last one waits
    let isBusy = false, next = null;
    return async (...given) => {
      next = given;
      if (isBusy) return;
      for (isBusy = true; next;) { const now = next; next = null; await guard(action)(...now); }
      isBusy = false;
    };
  };
  const toPixel = ([x, y]) =>
    [(x - view.x) / view.scale + map.clientWidth / 2, map.clientHeight / 2 - (y - view.y) / view.scale];
  const toMetres = (left, top) =>
    [view.x + (left - map.clientWidth / 2) * view.scale, view.y - (top - map.clientHeight / 2) * view.scale];
  const isInside = ([x, y]) => x >= 0 && y >= 0 && x < wide && y < high;
  const toLonLat = ([x, y]) => {
    const u = 2 * x / wide - 1, v = 2 * y / high - 1, { powers, lon, lat } = scene.lonlat;
    return [lon, lat].map(terms => +powers.reduce((sum, [i, j], k) => sum + terms[k] * u ** i * v ** j, 0).toFixed(7));
  };
  const whole = () => 1.06 * Math.max(wide / map.clientWidth, high / map.clientHeight);
  const fit = () => Object.assign(view, { x: wide / 2, y: high / 2, scale: whole() });
  const zoom = (factor, left = map.clientWidth / 2, top = map.clientHeight / 2) => {
    const [x, y] = toMetres(left, top), scale = clamp(view.scale * factor, side / 40, Math.max(wide, high) / 100);
    Object.assign(view, { x: x + (view.x - x) * scale / view.scale, y: y + (view.y - y) * scale / view.scale, scale });
  };
  const places = () => DIMS.map(name => +field(name).value);
  const show = guard(async () => {
    const layer = layers[field('layer').value], request = { layer: layer.name, at: ofLayer(layer, places()) };
    state.asked = JSON.stringify(request);
    const legend = await ask('legend', request), rgb = fromBase64(legend.colours);
    if (state.asked !== JSON.stringify(request)) return; // another one was asked for meanwhile
    const colour = (red, green, blue) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
    const ofHex = hex => hex && colour(...[1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16)));
    const colours = Array.from({ length: rgb.length / 3 }, (_, k) => colour(...rgb.subarray(3 * k, 3 * k + 3)));
    state.shown = { request, edges: legend.edges, colours, flat: legend.flat.map(ofHex) };
    is('legend').innerHTML = legend.html;
    if (state.pointer) point(state.pointer);
    draw();
  });
  const tileOf = (shown, stride, row, col, isWanted) => {
    const request = { ...shown.request, stride, row, col }, key = JSON.stringify(request);
    if (isWanted && !tiles.has(key)) {
      tiles.set(key, null); // on its way
      guard(async () => {
        const values = await unpack(await ask('tile', request));
        tiles.set(key, paint(values, Math.min(scene.tile, Math.ceil(scene.cols / stride) - col * scene.tile), shown));
        if (tiles.size > 200) tiles.delete(tiles.keys().next().value);
        draw();
      })();
    }
    return tiles.get(key);
  };
  const paint = (values, width, { edges, colours, flat: [blocked, nothing, zero] }) => {
    const height = values.length / width, image = new ImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer), picture = new OffscreenCanvas(width, height);
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
    picture.getContext('2d').putImageData(image, 0, 0);
    return picture;
  };
  // --- the map
  const draw = () => { state.frame ??= requestAnimationFrame(drawMap); };
  const drawMap = () => {
    state.frame = null;
    const { clientWidth: width, clientHeight: height } = map, ratio = window.devicePixelRatio || 1;
    Object.assign(map, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.imageSmoothingEnabled = false;
    const [west, north] = toMetres(0, 0), [east, south] = toMetres(width, height);
    if (state.shown) drawTiles(west, south, east, north, view.scale / ratio);
    for (const zone of state.zones) line(zone, '#a01830', 1.5, { fill: '#a0183033' });
    if (state.drawing) line(state.drawing, '#a01830', 1.5);
    const routes = state.routes.map((route, k) => ({ ...route, width: 2.6 + 3 * k })).reverse(); // wide ones below
    for (const { xy_m, width } of routes) line(xy_m, '#fff', width + 2.4);
    for (const { xy_m, width, planner } of routes) line(xy_m, scene.planner_colours[planner], width);
    if (state.report) { // what a .plan holds
      line(state.report.mission, '#1f2429', 1.4, { dash: [5, 4] });
      let last = [-99, -99]; // else they would hide the route from afar
      for (const place of state.report.mission) {
        const at = toPixel(place);
        if (Math.hypot(at[0] - last[0], at[1] - last[1]) < 14) continue;
        spot(place, 2.5, '#fff', '#1f2429');
        last = at;
      }
    }
    for (const [name, place] of Object.entries(state.ends)) {
      line([place, markOf(name)], '#1f2429', 1);
      spot(place, 1, '#1f2429', '#1f2429');
      mark(name, markOf(name));
    }
    if (state.linked) spot(state.linked, 5, '#1f2429', '#fff');
    if (map.matches(':focus-visible')) spot([view.x, view.y], 3, '#fff', '#1f2429');
    const most = 130 * view.scale, power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map(factor => factor * power).find(each => each <= most);
    is('scale').style.width = `${length / view.scale}px`;
    is('scale-text').textContent = length < 1000 ? `${length} m` : `${length / 1000} km`;
  };
  const drawTiles = (west, south, east, north, scale) => {
    const finest = scene.strides.findLast(stride => stride * side <= scale * 1.01) ?? scene.strides[0];
    for (const stride of scene.strides.filter(each => each >= finest).reverse()) {
      const reach = stride * side * scene.tile, isWanted = [finest, scene.strides.at(-1)].includes(stride);
      const span = (low, top, end) => [clamp(low / reach, 0, end) | 0, Math.ceil(Math.min(end, top) / reach)];
      for (let [row, end] = span(south, north, high); row < end; row++)
        for (let [col, last] = span(west, east, wide); col < last; col++) {
          const picture = tileOf(state.shown, stride, row, col, isWanted);
          if (!picture) continue;
          const [left, bottom] = toPixel([col * reach, row * reach]), pixels = stride * side / view.scale;
          const up = picture.height * pixels;
          pen.drawImage(picture, left, bottom - up, picture.width * pixels, up);
        }
    }
  };
  const line = (places, strokeStyle, lineWidth, { fill, dash } = {}) => {
    pen.beginPath();
    for (const place of places) pen.lineTo(...toPixel(place));
    Object.assign(pen, { strokeStyle, lineWidth, lineJoin: 'round', lineCap: 'round', fillStyle: fill });
    if (fill) { pen.closePath(); pen.fill(); }
    pen.setLineDash(dash || []);
    pen.stroke();
  };
  const spot = (place, radius, fillStyle, strokeStyle) => {
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(...toPixel(place), radius, 0, 7);
    Object.assign(pen, { fillStyle, strokeStyle, lineWidth: 2 });
    pen.fill();
    pen.stroke();
  };
  const markOf = name => state.marks[name] ?? state.ends[name]; // where the route itself begins or ends
  const mark = (name, place) => {
    const [left, top] = toPixel(place), ink = '#1f2429';
    spot(place, 7, ...(name === 'start' ? ['#fff', ink] : [ink, '#fff']));
    Object.assign(pen, { font: '600 12px system-ui', strokeStyle: '#fff', fillStyle: ink, lineWidth: 3 });
    for (const write of ['strokeText', 'fillText']) pen[write](name, left + 11, top + 4);
  };
  // --- the pointer
  const look = latest(async ([x, y]) => {
    const cell = [y, x].map(metres => Math.floor(metres / side));
    const values = await ask('values', { at: places(), row: cell[0], col: cell[1] });
    const table = is('values');
    table.replaceChildren();
    for (const { name, told, value, unit } of values) {
      const row = table.insertRow(), text = name === 'obstacle' ? ['no', 'yes'][value] : `${number(value)} ${unit}`;
      Object.assign(row.dataset, { layer: name, value });
      row.className = name === field('layer').value ? 'jv-chosen' : '';
      for (const each of [told, text]) row.insertCell().textContent = each;
    }
    table.dataset.cell = cell.join(' ');
  });
  const point = place => {
    const said = toLonLat(place).map((degree, k) => `${Math.abs(degree).toFixed(6)}° ${'ENWS'[k + 2 * (degree < 0)]}`);
    state.pointer = isInside(place) ? place : null;
    is('at').textContent = state.pointer ? said.join('  ') : '';
    if (state.pointer && state.tab === 'look') look(place);
    const offs = state.report?.xy.map(([x, y]) => Math.hypot(x - place[0], y - place[1])) ?? [];
    const least = offs.reduce((best, off, k) => off < offs[best] ? k : best, 0);
    if (offs.length) link(offs[least] < 25 * view.scale ? least : -1);
  };
  const setEnd = (name, place) => {
    state.ends[name] = place;
    delete state.marks[name];
  };
  const endAt = (...at) => state.tab === 'plan' && !state.drawing && Object.keys(state.ends).find(name =>
    Math.hypot(...toPixel(markOf(name)).map((pixel, k) => pixel - at[k])) < 12);
  map.onpointerdown = ({ pointerId, button, offsetX: left, offsetY: top }) => {
    if (button === 0) map.setPointerCapture(pointerId); else return;
    state.drag = { end: endAt(left, top), left, top, isMoved: false };
  };
  map.onpointermove = ({ offsetX: left, offsetY: top }) => {
    const drag = state.drag, place = toMetres(left, top);
    if (drag) {
      drag.isMoved ||= Math.hypot(left - drag.left, top - drag.top) > 3;
      if (drag.end && drag.isMoved && isInside(place)) setEnd(drag.end, place);
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
  map.onwheel = event => {
    event.preventDefault();
    zoom(1.0015 ** event.deltaY, event.offsetX, event.offsetY);
    draw();
  };
  map.onkeydown = event => {
    const move = (x, y) => () => Object.assign(view, { x: view.x + x * view.scale, y: view.y + y * view.scale });
    const acts = { '+': () => zoom(0.7), '-': () => zoom(1 / 0.7), 0: fit, Enter: () => click([view.x, view.y]),
      Escape: () => { state.drawing = null; hint(); }, ArrowLeft: move(-60, 0), ArrowRight: move(60, 0),
      ArrowUp: move(0, 60), ArrowDown: move(0, -60) };
    if (!acts[event.key] || event.ctrlKey || event.metaKey) return; // the browser's own zoom
    event.preventDefault();
    acts[event.key]();
    point([view.x, view.y]);
    draw();
  };
  // --- routes
  const zones = () => !state.zones.length ? '' : JSON.stringify({ type: 'FeatureCollection', features: state.zones.map(
    (zone, k) => ({ type: 'Feature', properties: { name: `zone ${k + 1}` },
      geometry: { type: 'Polygon', coordinates: [[...zone, zone[0]].map(toLonLat)] } })) });
  const query = planner => ({ start: toLonLat(state.ends.start), goal: toLonLat(state.ends.goal ?? state.ends.start),
    cost_model: field('cost_model').value, obstacles: field('obstacles').value, zones: zones(), planner,
    at: places(), weights: state.weights, clearance_m: +field('clearance_m').value, snap: field('snap').checked });
  const isReady = () => state.ends.start && state.ends.goal;
  const placed = route => ({ ...route, xy_m: route.xy_m.map(([x, y]) => [x - west0, y - south0]) });
  const chosen = () => [...is('planners').querySelectorAll(':checked')].map(box => box.value);
  const planAll = latest(async () => {
    const asked = state.plans, found = [], refused = [];
    tell('Planning …');
    for (const request of chosen().map(query)) {
      try { found.push({ ...placed(await ask('plan', request)), request }); } catch (e) { refused.push(e); }
      if (asked !== state.plans) return;
    }
    tell(refused[0]?.message ?? found.find(route => !route.has_path)?.message ?? '', refused[0]?.isOld);
    showRoutes(found);
  });
  const plan = () => { state.plans++; hint(); if (isReady()) planAll(); };
  const showRoutes = (routes, route = routes.find(each => each.has_path) ?? routes[0]) => {
    const marks = route?.has_path ? { start: route.xy_m[0], goal: route.xy_m.at(-1) } : {};
    Object.assign(state, { routes, route, marks, report: null, linked: null, at: -1 });
    is('routes').innerHTML = routes.map(each => each.button).join('');
    [...is('routes').children].forEach((button, k) =>
      Object.assign(button, { onclick: () => showRoutes(routes, routes[k]), ariaPressed: routes[k] === route }));
    is('costs').innerHTML = route?.html ?? '';
    is('command').textContent = route?.command ?? '';
    is('command').hidden = is('copy').hidden = !route?.command;
    if (route?.has_path) report(route); else is('report').hidden = true;
    draw();
  };
  const report = latest(async route => {
    const follows = 'Cautions and profile follow …';
    if (!is('tell').textContent) tell(follows);
    is('report').ariaBusy = true;
    const found = await ask('report', route.request);
    if (is('tell').textContent === follows) tell('');
    if (state.route !== route) return;
    is('report').ariaBusy = false;
    state.report = found;
    draw();
    for (const name of ['cautions', 'totals', 'profile', 'saved', 'report-text']) is(name).innerHTML = found[name];
    if (!is('report').hidden) return;
    is('report').hidden = false; // which takes of the map's height
    const pixels = route.xy_m.map(toPixel);
    if (pixels.some(([x, y]) => x < 0 || y < 0 || x > map.clientWidth || y > map.clientHeight)) {
      const [x, y] = [0, 1].map(k => route.xy_m.map(place => place[k]));
      const [[left, right], [low, top]] = [x, y].map(each => [Math.min(...each), Math.max(...each)]);
      const scale = 1.3 * Math.max((right - left) / map.clientWidth, (top - low) / map.clientHeight);
      Object.assign(view, { x: (left + right) / 2, y: (low + top) / 2, scale: Math.max(scale, view.scale) });
      draw();
    }
  });
  const link = k => { // the same place on the map and on the profile
    if (k === state.at) return;
    const { xy, to_share: ends } = state.report, here = is('profile').querySelector('.jv-here');
    Object.assign(state, { at: k, linked: xy[k] });
    here.setAttribute('transform', `translate(${xy[k] ? 500 * ((ends[k - 1] ?? 0) + ends[k]) : -9})`);
    draw();
  };
  is('profile').onpointermove = ({ clientX }) => { // the old profile stays until a new route's own comes
    const { left, width } = is('profile').querySelector('svg').getBoundingClientRect();
    const share = (clientX - left) / width, ends = state.report?.to_share;
    if (ends) link(clamp(ends.findIndex(end => end >= share), 0, ends.length - 1));
  };
  const click = place => {
    if (!isInside(place) || state.tab !== 'plan') return;
    if (state.drawing) state.drawing.push(place);
    else { setEnd(state.ends.start ? 'goal' : 'start', place); plan(); }
    draw();
  };
  const closeZone = () => {
    const corners = state.drawing?.filter((place, k, { [k - 1]: before }) => String(place) !== String(before)) ?? [];
    state.drawing = null;
    if (corners.length > 2) { state.zones.push(corners); plan(); }
    hint();
    draw();
  };
  Object.assign(map, { ondblclick: closeZone, onfocus: draw, onblur: draw });
  const hint = () => {
    const { drawing, ends, zones: { length } } = state, button = root.querySelector('[data-do="zone"]');
    button.ariaPressed = Boolean(drawing);
    button.textContent = drawing ? 'Close the zone' : 'Draw a no-fly zone';
    root.querySelector('[data-do="save-zones"]').hidden = !length;
    is('hint').textContent = drawing ? 'Click the corners of the zone; a double click closes it, Escape gives up.'
      : isReady() ? 'Drag start or goal, or move a weight.' : `Click the map for the ${ends.start ? 'goal' : 'start'}.`;
  };
  const download = (bytes, name) => {
    const href = URL.createObjectURL(new Blob([bytes]));
    Object.assign(document.createElement('a'), { href, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(href), 9000);
  };
  const actions = {
    zone: () => { if (state.drawing) closeZone(); else state.drawing = []; hint(); draw(); },
    'save-zones': () => download(zones(), 'zones.geojson'),
    clear: () => { Object.assign(state, { ends: {}, zones: [], drawing: null }); tell(''); showRoutes([]); plan(); },
    reload: () => window.location.reload(),
    copy: () => navigator.clipboard.writeText(is('command').textContent),
  };
  for (const format of ['geojson', 'kml', 'plan']) actions[format] = async () =>
    download(await ask('save', { ...state.route.request, format }), `route.${format}`);
  for (const button of all('[data-do]')) button.onclick = guard(actions[button.dataset.do]);
  const setWeight = (name, value) => { // at its left end a slider weighs nothing
    const slider = field(`weight-${name}`);
    slider.max = Math.max(slider.max, Math.ceil(Math.log10(value || 1)));
    slider.value = value > 0 ? Math.log10(value) : slider.min;
    state.weights = { ...state.weights, [name]: value };
    slider.previousElementSibling.textContent = number(value);
  };
  const setFields = values => Object.entries(values).forEach(([name, value]) =>
    Object.assign(field(name), { [name === 'snap' ? 'checked' : 'value']: value }));
  for (const [name, html] of Object.entries(scene.html)) (is(name) ?? field(name)).innerHTML = html;
  setFields(scene.fields);
  for (const [name, value] of Object.entries(scene.weights)) {
    const slider = field(`weight-${name}`), read = () => setWeight(name,
      slider.value === slider.min ? 0 : Number((10 ** slider.value).toPrecision(3)));
    slider.oninput = read;
    slider.onchange = plan;
    setWeight(name, value);
  }
  for (const each of all('select, input:not([type="range"])')) each.onchange = () => { show(); plan(); };
  root.querySelector('nav').hidden = !scene.can_plan;
  for (const button of all('[data-tab]')) button.onclick = () => {
    state.tab = button.dataset.tab;
    for (const each of all('[data-tab]')) each.ariaSelected = each === button;
    for (const page of all('[data-page]')) page.hidden = page.dataset.page !== state.tab;
  };
  hint();
  fit();
  new ResizeObserver(draw).observe(map);
  await show();
  root.dataset.ready = 'yes';
}
const held = document.getElementById('jv-data')?.textContent;
if (held !== undefined) start(document.querySelector('.jv'), held ? inFile(JSON.parse(held)) : overHttp());
export default { render({ model, el }) {
  el.innerHTML = `<div class="jv jv-inset">${model.get('markup')}</div>`;
  start(el.firstElementChild, overWidget(model));
} };
