// The page: maps to look at, and routes to plan on them. Places are metres from the maps' southwest corner, x to the
// east of the grid and y to its north.
const DIMS = ['altitude', 'time', 'time_of_day'];
const ofLayer = (layer, at) => DIMS.map((dim, k) => layer.dims.includes(dim) ? at[k] : 0);
async function start(root, ask, keepsPlan = true) { // in the address, unless it is a notebook's
  const is = name => root.querySelector(`[data-is="${name}"]`);
  const field = name => root.querySelector(`[name="${name}"]`), all = what => root.querySelectorAll(what);
  const scene = await ask('scene', {}), side = scene.resolution_m, wide = scene.cols * side, high = scene.rows * side;
  const layers = Object.fromEntries(scene.layers.map(layer => [layer.name, layer]));
  const map = is('map'), pen = map.getContext('2d');
  const state = { tab: 'look', ends: {}, marks: {}, zones: [], routes: [], lines: [], plans: 0,
    weights: { ...scene.weights } };
  const draw = () => { state.frame ??= requestAnimationFrame(drawMap); };
  const view = viewOf(map, wide, high, side, draw), { toPixel, toMetres } = view, [west0, south0] = scene.corner_m;
  const base = scene.has_base ? baseMap(await ask('base', {})) : null;
  const tell = (text, isOld = false) => { // that the maps are old stays
    if (!root.querySelector('.jv-reload').hidden) return;
    Object.assign(is('tell'), { textContent: text }).classList.toggle('jv-limit', isOld);
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
  const isInside = ([x, y]) => x >= 0 && y >= 0 && x < wide && y < high;
  const toLonLat = ([x, y]) => {
    const u = 2 * x / wide - 1, v = 2 * y / high - 1, { powers, lon, lat } = scene.lonlat;
    return [lon, lat].map(terms => +powers.reduce((sum, [i, j], k) => sum + terms[k] * u ** i * v ** j, 0).toFixed(7));
  };
  const places = () => DIMS.map(name => +field(name).value);
  const flight = () => parseFloat(field('flight_m').value || field('altitude').selectedOptions[0]?.text); // metres
  const isOfHome = () => field('layer').value === 'return_altitude';
  const show = guard(async () => {
    const layer = layers[field('layer').value];
    const request = { layer: layer.name, at: ofLayer(layer, places()) };
    if (isOfHome() && state.home) request.home = toLonLat(state.home);
    if (layer.name === 'closed') Object.assign(request, ruled());
    state.asked = JSON.stringify(request);
    const legend = await ask('legend', request).catch(error => {
      state.fault = error.message;
      throw error;
    });
    if (is('tell').textContent === state.fault) tell('');
    if (state.asked !== JSON.stringify(request)) return; // another one was asked for meanwhile
    const colours = new Uint32Array(fromBase64(legend.colours).buffer);
    state.shown = { request, colourOf: colouring(legend.edges, colours, legend.flat) };
    const noFix = scene.no_fix && { layer: scene.no_fix, at: ofLayer(layers[scene.no_fix], places()) };
    state.noFix = noFix && { request: noFix, colourOf: whereNoFix, over: 'hatch' };
    is('legend').innerHTML = legend.html;
    if (state.pointer) point(state.pointer);
    draw();
  });
  // --- the map
  const drawTiles = tilesOf(ask, scene, view, guard, draw), drawLines = keptSheet();
  const drawMap = () => {
    state.frame = null;
    const { clientWidth: width, clientHeight: height } = map, ratio = window.devicePixelRatio || 1;
    Object.assign(map, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const alpha = field('opacity').value / 100;
    ground(pen, toPixel, view.scale, wide, high);
    if (alpha < 1) base?.fill(pen, toPixel, view.scale);
    is('legend').style.setProperty('--opacity', alpha);
    if (state.shown) drawTiles(pen, state.shown, { alpha });
    if (state.shown && state.shown.request.layer !== 'closed' && field('closed').checked) {
      const request = { layer: 'closed', at: ofLayer(layers.closed, places()), ...ruled() };
      drawTiles(pen, { request, colourOf: whereClosed, over: 'closed' }, { hatch: scene.hatches.closed });
    }
    if (state.noFix && field('hatch').checked) drawTiles(pen, state.noFix, { hatch: scene.hatches['no-fix'] });
    const { x, y, scale } = view;
    const isShown = scene.group_colours.map((_, k) => field(`group-${k}`)?.checked ?? true);
    drawLines(pen, [x, y, scale, flight(), Boolean(state.outlines), isShown], ink => {
      base?.draw(ink, toPixel, scale);
      state.outlines?.(ink, toPixel, view, flight(), isShown);
    });
    const [west, north] = toPixel([0, high]), [east, south] = toPixel([wide, 0]);
    const area = [Math.max(west, 0), Math.max(north, 0), Math.min(east, width), Math.min(south, height)];
    const routes = state.lines.flatMap(({ places }) => places.filter((_, k) => k % 4 === 0));
    const at = map.getBoundingClientRect();
    const covers = [...root.querySelectorAll('.jv-map > div > *')].map(each => each.getBoundingClientRect()).map(
      ({ left, top, width: across, height: down }) =>
        [left - at.left + across / 2, top - at.top + down / 2, across / 2, down / 2]);
    base?.write(pen, toPixel, view.scale, area, Object.keys(state.ends).map(markOf), routes, covers);
    for (const zone of state.zones) line(zone, '#a01830', 1.5, { fill: '#a0183033' });
    if (state.drawing) line(state.drawing, '#a01830', 1.5);
    pen.globalAlpha = state.tab === 'check' && missions.isOpen() ? 0.4 : 1; // each tab's own line stands out
    const [alone, oneOfSeveral, edge] = scene.line_px, pixels = state.lines.length > 1 ? oneOfSeveral : alone;
    for (const lane of state.lines) line(lane.places, '#fff', pixels + 2 * edge + 1, { lane });
    state.lines.forEach((lane, k) =>
      line(lane.places, scene.planner_colours[state.routes[k].planner], pixels, { lane }));
    if (state.report && view.scale < side / 2.5) { // what files of waypoints hold: from afar it would hide the route
      line(state.report.mission, '#1f2429', 1.4, { dash: [5, 4] });
      for (const place of state.report.mission) spot(place, 1.5, '#fff', '#fff');
    }
    pen.globalAlpha = 1;
    for (const [name, place] of Object.entries(state.ends)) {
      line([place, markOf(name)], '#1f2429', 1);
      spot(place, 1, '#1f2429', '#1f2429');
      mark(name, markOf(name));
    }
    pen.globalAlpha = state.tab === 'plan' && state.lines.length ? 0.4 : 1;
    missions.paint(line, spot, label);
    pen.globalAlpha = 1;
    const looked = state.tab === 'look' && (isOfHome() ? state.home : state.sky);
    for (const each of [looked, state.linked]) if (each) spot(each, 5, '#1f2429', '#fff');
    if (map.matches(':focus-visible')) spot([view.x, view.y], 3, '#fff', '#1f2429');
    const most = 130 * view.scale, power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map(factor => factor * power).find(each => each <= most);
    is('scale').style.width = `${length / view.scale}px`;
    is('scale-text').textContent = length < 1000 ? `${length} m` : `${length / 1000} km`;
  };
  const line = (places, strokeStyle, lineWidth, { fill, dash, lane } = {}) => {
    const points = places.map(toPixel);
    pen.beginPath();
    for (const at of lane ? beside(points, lane, scene.line_px[1] + scene.line_px[2]) : points) pen.lineTo(...at);
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
    for (const act of ['fill', 'stroke']) pen[act]();
  };
  const markOf = name => state.marks[name] ?? state.ends[name]; // where the route itself begins or ends
  const mark = (name, place) => {
    const ink = '#1f2429';
    spot(place, 7, ...(name === 'start' ? ['#fff', ink] : [ink, '#fff']));
    label(name, place, ink);
  };
  const label = (text, place, fillStyle) => {
    const [left, top] = toPixel(place), { clientWidth, clientHeight } = map;
    if (Math.min(left, top, clientWidth - left, clientHeight - top) < 0) return;
    Object.assign(pen, { font: '600 12px system-ui', strokeStyle: '#fff', fillStyle, lineWidth: 3 });
    const across = pen.measureText(text).width, isCut = left + 14 + across > clientWidth; // then it stands left
    const at = [isCut ? left - 11 - across : left + 11, clamp(top + 4, 14, clientHeight - 5)];
    for (const write of ['strokeText', 'fillText']) pen[write](text, ...at);
  };
  // --- the sheet of controls; where the page is wider they stand beside the map, and it has nothing to open
  const sheet = root.querySelector('[data-do="sheet"]'), aside = root.querySelector('aside');
  const bar = aside.firstElementChild;
  const open = isOpen => { sheet.ariaExpanded = isOpen; };
  const reveal = part => { // below the bar, unless another tab is chosen meanwhile
    open(true);
    if (!part.offsetParent) return;
    for (const box of [aside, part.closest('.jv-side, .jv-place')]) // one of which scrolls
      box.scrollTop += part.getBoundingClientRect().top - bar.getBoundingClientRect().bottom;
  };
  bar.onpointerdown = ({ clientY }) => { state.grip = clientY; };
  bar.onpointerup = ({ clientY }) => { if (Math.abs(clientY - state.grip) > 20) open(clientY < state.grip); };
  // --- the pointer
  const look = latest(async ([x, y]) => {
    const cell = [y, x].map(metres => Math.floor(metres / side)), table = is('values');
    const { home } = state.shown?.request ?? {};
    const values = await ask('values', { at: places(), row: cell[0], col: cell[1], ...home && { home } });
    table.replaceChildren();
    let above = '';
    for (const { name, told, value, classes, unit, group } of values) {
      const heading = Object.assign(document.createElement('th'), { textContent: group, colSpan: 2 });
      if (group !== above) table.insertRow().append(heading);
      above = group;
      const row = table.insertRow(), text = classes[value] ?? `${number(value)} ${unit}`;
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
  const showWhy = latest(async () => {
    const place = state.sky && toLonLat(state.sky);
    is('why').textContent = place ? await ask('why', { start: place, goal: place, weights: {}, ...rules() }) : '';
    is('stands').innerHTML = place ? await ask('stands', { at: places(), place }) : ''; // reads the city first
  });
  const showSky = latest(async () => { // over the place that was clicked; the first one waits for the city
    const follows = 'Looking at the sky …';
    showWhy();
    is('sky-box').classList.toggle('jv-empty', !state.sky);
    if (state.sky) tell(follows);
    const sky = state.sky && ask('sky', { at: places(), place: toLonLat(state.sky) });
    is('sky').innerHTML = await Promise.resolve(sky).catch(error => {
      is('sky').textContent = error.message; // in place of what it holds, which is of another place
      if (error.isOld) throw error;
      return is('sky').innerHTML;
    }) ?? '';
    if (is('tell').textContent === follows) tell('');
  });
  const setEnd = (name, place) => {
    state.ends[name] = place;
    delete state.marks[name];
  };
  const fingers = new Map(); // on the map, or the mouse's button: where they are
  const grip = () => { // their middle, and how far they are from it
    const points = [...fingers.values()];
    const [x, y] = [0, 1].map(k => points.reduce((sum, at) => sum + at[k], 0) / points.length);
    return [x, y, Math.hypot(points[0][0] - x, points[0][1] - y)];
  };
  const endAt = (at, reach) => state.tab === 'plan' && !state.drawing && Object.keys(state.ends).find(name =>
    Math.hypot(...toPixel(markOf(name)).map((pixel, k) => pixel - at[k])) < reach);
  const showValues = place => { // of the cell below a finger that rests
    Object.assign(state.drag, { isMoved: true, end: null });
    choose('look');
    point(place);
    reveal(is('under'));
  };
  map.onpointerdown = ({ pointerId, button, pointerType, offsetX, offsetY }) => {
    if (button !== 0) return;
    const at = [offsetX, offsetY], slack = pointerType === 'touch' ? 12 : 3;
    map.setPointerCapture(pointerId);
    fingers.set(pointerId, at);
    clearTimeout(state.drag?.rest);
    state.drag = { at, slack, isMoved: fingers.size > 1, end: fingers.size < 2 && endAt(at, slack + 9) };
    if (slack > 3 && fingers.size < 2) state.drag.rest = setTimeout(showValues, 500, toMetres(...at));
  };
  map.onpointermove = ({ pointerId, offsetX, offsetY }) => {
    const { drag } = state, at = [offsetX, offsetY], place = toMetres(...at);
    if (!fingers.has(pointerId)) return point(place);
    drag.isMoved ||= Math.hypot(at[0] - drag.at[0], at[1] - drag.at[1]) > drag.slack;
    if (!drag.isMoved) return;
    clearTimeout(drag.rest);
    const [x, y, reach] = grip();
    fingers.set(pointerId, at);
    const [x2, y2, reach2] = grip();
    if (!drag.end) view.shift(x2 - x, y2 - y);
    else if (isInside(place)) setEnd(drag.end, place);
    if (reach && reach2) view.zoom(reach / reach2, x2, y2);
    point(place);
    draw();
  };
  map.onpointerup = ({ pointerId, type, offsetX, offsetY }) => {
    if (!fingers.delete(pointerId) || fingers.size) return;
    const { end, isMoved, rest } = state.drag, place = toMetres(offsetX, offsetY);
    clearTimeout(rest);
    if (end) return plan();
    if (isMoved || type !== 'pointerup') return;
    point(place);
    click(place);
  };
  map.onpointercancel = map.onpointerup;
  map.oncontextmenu = () => !fingers.size; // else a resting finger opens the browser's menu
  map.onwheel = event => {
    event.preventDefault();
    view.zoom(1.001 ** clamp(event.deltaY, -300, 300), event.offsetX, event.offsetY);
  };
  map.onkeydown = event => {
    const move = (left, top) => () => view.shift(left, top);
    const put = end => () => click([view.x, view.y], end), isPlan = state.tab === 'plan';
    const acts = { '+': actions.closer, '-': actions.farther, 0: actions.fit, Enter: put(),
      ...scene.can_plan && missions.keys, ...isPlan && { s: put('start'), g: put('goal'), z: actions.zone },
      Escape: () => { state.drawing = state.sky = null; showSky(); hint(); draw(); }, ArrowLeft: move(60, 0),
      ArrowRight: move(-60, 0), ArrowUp: move(0, 60), ArrowDown: move(0, -60) };
    const act = acts[event.key] ?? acts[event.key.toLowerCase()];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return; // the browser's own
    event.preventDefault();
    act();
    point([view.x, view.y]);
  };
  // --- routes
  const zones = () => !state.zones.length ? '' : JSON.stringify({ type: 'FeatureCollection', features: state.zones.map(
    (zone, k) => ({ type: 'Feature', properties: { name: `zone ${k + 1}` },
      geometry: { type: 'Polygon', coordinates: [[...zone, zone[0]].map(toLonLat)] } })) });
  const given = names => Object.fromEntries(names.map(name => [name, field(name).value ? +field(name).value : null]));
  const rules = () => ({ at: places(), unknown_heights: field('unknown_heights').value,
    clearance_m: field('clearance_m').valueAsNumber, zones: zones(), ...given(['vertical_clearance_m', 'flight_m']) });
  const ruled = () => scene.can_plan && { plan: { start: [0, 0], goal: [0, 0], weights: {}, ...rules() } };
  const query = planner => ({ start: toLonLat(state.ends.start), goal: toLonLat(state.ends.goal ?? state.ends.start),
    planner, weights: state.weights, snap: field('snap').checked, on_ground: field('on_ground').checked, ...rules(),
    ...given(['speed_m_s', 'power_w']) });
  const placed = route => ({ ...route, xy_m: route.xy_m.map(([x, y]) => [x - west0, y - south0]) });
  const isReady = () => state.ends.start && state.ends.goal;
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
  const plan = () => { state.plans++; hint(); keep(); missions.judge(); if (isReady()) planAll(); };
  const showRoutes = (routes, route = routes.find(each => each.has_path) ?? routes[0]) => {
    const marks = route?.has_path ? { start: route.xy_m[0], goal: route.xy_m.at(-1) } : {};
    const lines = sideBySide(routes.map(each => each.xy_m), side);
    Object.assign(state, { routes, route, marks, lines, report: null, linked: null, at: -1 });
    is('routes').innerHTML = routes.map(each => each.button).join('');
    [...is('routes').children].forEach((button, k) =>
      Object.assign(button, { onclick: () => showRoutes(routes, routes[k]), ariaPressed: routes[k] === route }));
    is('costs').innerHTML = route?.html ?? '';
    is('command').textContent = route?.command ?? '';
    is('command').hidden = is('copy').hidden = !route?.command;
    if (route?.has_path) report(route); else is('report').classList.add('jv-empty');
    if (route?.has_path === false) frame();
    draw();
  };
  const report = latest(async route => {
    const follows = 'Cautions and profile follow …';
    if (!is('tell').textContent) tell(follows);
    is('report').ariaBusy = true;
    const found = await ask('report', route.request).catch(error => {
      is('report').classList.add('jv-empty'); // what it holds is of another route
      throw error;
    }).finally(() => { is('report').ariaBusy = false; });
    if (is('tell').textContent === follows) tell('');
    if (state.route !== route) return;
    draw(state.report = found);
    for (const name of ['cautions', 'totals', 'profile', 'saved', 'report-text']) is(name).innerHTML = found[name];
    is('report').classList.remove('jv-empty');
    frame();
  });
  const frame = () => { // the view fits the routes, once for each pair of ends
    const ends = JSON.stringify(state.ends);
    if (state.framed === ends) return;
    state.framed = ends;
    reveal(is('routes'));
    fitTo(() => [...Object.values(state.ends), ...state.routes.flatMap(each => each.has_path ? each.xy_m : [])]);
  };
  const fitTo = cornersOf => { // now, and where the page changes its size
    const { offsetWidth: across, parentElement: { offsetHeight: below } } = is('legend');
    const [left0, bottom0] = map.clientWidth > 3 * across ? [across, 0] : [0, below]; // beside the legend, or above it
    const free = [left0 + 24, is('at').parentElement.offsetHeight + 24,
      map.clientWidth - 114, map.clientHeight - bottom0 - 24]; // right of an end stands its label
    const corners = cornersOf();
    if (!corners.length) return draw();
    const [[left, right], [low, top]] = [0, 1].map(k => corners.map(place => place[k])).map(each =>
      [Math.min(...each), Math.max(...each)]);
    const scale = 1.1 * Math.max((right - left) / (free[2] - free[0]), (top - low) / (free[3] - free[1]), side / 40);
    const middle = map.clientWidth / 2, half = (right - left) / scale / 2;
    view.show((left + right) / 2 - (clamp(middle, free[0] + half, free[2] - half) - middle) * scale,
      (low + top + (free[1] + free[3] - map.clientHeight) * scale) / 2, scale, () => fitTo(cornersOf));
  };
  const link = k => { // the same place on the map and on the profile
    if (k === state.at) return;
    const { xy, to_share: ends } = state.report, here = is('profile').querySelector('.jv-here');
    Object.assign(state, { at: k, linked: xy[k] });
    here.hidden = !xy[k];
    here.style.left = `${50 * ((ends[k - 1] ?? 0) + ends[k])}%`;
    draw();
  };
  is('profile').onpointermove = ({ clientX }) => { // the old profile stays until a new route's own comes
    const { left, width } = is('profile').querySelector('.jv-along').getBoundingClientRect();
    const share = (clientX - left) / width, ends = state.report?.to_share;
    if (ends) link(clamp(ends.findIndex(end => end >= share), 0, ends.length - 1));
  };
  const click = (place, end = state.ends.start ? 'goal' : 'start') => {
    if (!isInside(place) || !scene.can_plan) return;
    if (state.tab === 'look' && isOfHome()) { state.home = place; show(); }
    else if (state.tab === 'check') missions.chooseAt(place);
    else if (state.tab === 'look') showSky(state.sky = place).then(() => reveal(is('sky-box')));
    else if (state.drawing) state.drawing.push(place);
    else { setEnd(end, place); plan(); }
    draw();
  };
  const closeZone = () => {
    const corners = state.drawing?.filter((place, k, { [k - 1]: before }) => String(place) !== String(before)) ?? [];
    state.drawing = null;
    if (corners.length > 2) { state.zones.push(corners); plan(); }
    for (const settle of [hint, show, draw]) settle();
  };
  Object.assign(map, { ondblclick: closeZone, onfocus: draw, onblur: draw });
  const hint = () => {
    const { drawing, ends, zones: { length } } = state, button = root.querySelector('[data-do="zone"]');
    button.ariaPressed = Boolean(drawing);
    button.textContent = drawing ? 'Close the zone' : 'Draw a no-fly zone';
    root.querySelector('[data-do="save-zones"]').hidden = !length;
    is('hint').textContent = drawing
      ? 'Click the corners of the zone; a double click, Z or this button closes it, Escape gives up.'
      : isReady() ? 'Drag start or goal, or move a weight.' : `Click the map for the ${ends.start ? 'goal' : 'start'}.`;
  };
  const download = (bytes, name) => {
    const href = URL.createObjectURL(new Blob([bytes]));
    Object.assign(document.createElement('a'), { href, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(href), 9000);
  };
  const showLevel = height => { // on the map, unless a route is planned, whose altitude it is
    const levels = scene.altitudes_m;
    if (isReady() || height === null) return;
    field('flight_m').value = +clamp(height, levels[0], levels.at(-1)).toFixed(1);
    for (const settle of [between, show, keep]) settle();
  };
  const missions = missionsOf({ root, is, field, scene, ask, latest, tell, draw, view, rules, reveal, showLevel,
    fitTo });
  const actions = {
    mission: missions.pick,
    close: missions.close,
    map: () => map.focus(),
    zone: () => {
      if (state.drawing) return closeZone();
      state.drawing = [];
      map.focus({ preventScroll: true });
      hint();
    },
    sheet: () => open(sheet.ariaExpanded === 'false'),
    reload: () => window.location.reload(),
    'save-zones': () => download(zones(), 'zones.geojson'),
    clear: () => {
      Object.assign(state, { ends: {}, zones: [], drawing: null });
      tell('');
      showRoutes([]);
      show();
      plan();
    },
    leave: () => { state.sky = null; showSky(); draw(); },
    closer: () => view.zoom(0.7),
    farther: () => view.zoom(1 / 0.7),
    fit: () => view.fit(),
    reset: () => {
      state.sky = null;
      restore(first);
      for (const settle of [between, show, showSky, actions.clear, actions.fit, missions.close]) settle();
    },
    copy: () => navigator.clipboard.writeText(is('command').textContent),
  };
  for (const [name, html] of Object.entries(scene.html)) (is(name) ?? field(name)).innerHTML = html;
  const save = async (format, { request } = state.route) =>
    download(await ask('save', { ...request, format }), [scene.file_name, `${request.flight_m ?? flight()}m`,
      ...['time_of_day', 'time'].map(name => field(name).selectedOptions[0]?.text.replace(/ (..):(..) UTC/, 'T$1$2Z')),
      request.planner].filter(Boolean).join('_') + format);
  for (const button of all('[data-format]')) button.onclick = guard(() => save(button.dataset.format));
  for (const button of all('[data-do]')) button.onclick = guard(actions[button.dataset.do]);
  const setWeight = (name, value) => { // at its left end a slider weighs nothing
    const slider = field(`weight-${name}`);
    slider.max = Math.max(slider.max, Math.ceil(Math.log10(value || 1)));
    slider.value = value > 0 ? Math.log10(value) : slider.min;
    state.weights = { ...state.weights, [name]: value };
    slider.previousElementSibling.textContent = number(value);
  };
  const setField = (each, value) => {
    each[each.type === 'checkbox' ? 'checked' : 'value'] = value;
    if (each.type !== 'checkbox' && each.value !== String(value)) throw new Error(`${each.name} cannot be ${value}`);
  };
  for (const [name, value] of Object.entries(scene.fields)) setField(field(name), value);
  for (const [name, value] of Object.entries(scene.weights)) {
    const slider = field(`weight-${name}`), read = () => setWeight(name,
      slider.value === slider.min ? 0 : Number((10 ** slider.value).toPrecision(3)));
    slider.oninput = read;
    slider.onchange = plan;
    setWeight(name, value);
  }
  // --- what the address keeps, so that a reload or a link shows the same
  const ofMaps = String([scene.corner_m, wide, high]), named = [...all('[name]:not([name^="weight-"])')];
  const kept = () => ({ ofMaps, tab: state.tab, weights: state.weights, planners: chosen(), zones: state.zones,
    ends: state.ends, fields: named.map(each => each.type === 'checkbox' ? each.checked : each.value) });
  const keep = () => keepsPlan && history.replaceState(null, '', `#${encodeURIComponent(JSON.stringify(kept()))}`);
  const restore = plan => {
    const { zones, ends, fields } = plan, { start, goal, ...others } = ends, isPlan = plan.ofMaps === ofMaps &&
      fields.length === named.length && !Object.keys(others).length && zones.every(({ length }) => length > 2);
    if (!isPlan || ![...Object.values(ends), ...zones.flat()].every(isInside)) throw new Error('it is of other maps');
    fields.forEach((value, k) => setField(named[k], value));
    for (const [name, value] of Object.entries(plan.weights)) setWeight(name, value);
    for (const box of is('planners').querySelectorAll('input')) box.checked = plan.planners.includes(box.value);
    Object.assign(state, { zones, ends });
    choose(plan.tab);
  };
  const between = () => { // of the levels that the maps hold, that below the flight's is drawn
    const flight = +field('flight_m').value, index = scene.altitudes_m.findLastIndex(level => level <= flight);
    if (index >= 0) field('altitude').value = index;
    const level = scene.altitudes_m[index] ?? flight, isBetween = level < flight && flight < scene.altitudes_m.at(-1);
    is('drawn').textContent = index < 0 ? '' : `The map shows the level of ${level} m.`;
    is('between').textContent = !isBetween ? '' : `Between two levels: the map shows that of ${level} m.`;
  };
  for (const each of all('select, input:not([type="range"], [type="file"])')) each.onchange = () => {
    if (each.name === 'altitude') field('flight_m').value = scene.altitudes_m[each.value];
    if (each.name === 'altitude' || each.name === 'flight_m') between();
    for (const settle of [show, showSky, plan]) settle();
  };
  for (const each of all('[name="opacity"], [name="hatch"], [name="closed"], [name^="group-"]'))
    Object.assign(each, { oninput: draw, onchange: keep });
  root.querySelector('nav').hidden = is('click-hint').hidden = !scene.can_plan;
  const choose = tab => {
    state.tab = tab;
    for (const each of all('[data-tab]')) each.ariaSelected = each.dataset.tab === tab;
    for (const page of all('[data-page]')) page.hidden = !page.dataset.page.split(' ').includes(tab);
  };
  for (const button of all('[data-tab]')) button.onclick = () => {
    choose(button.dataset.tab);
    for (const box of [aside, root.querySelector('.jv-side')]) box.scrollTop = 0; // its first line stands on top
    open(true);
    keep();
    draw();
  };
  root.querySelector('.jv-key').open = map.clientWidth > 500; // on a phone it would cover the map
  const first = kept(), held = keepsPlan && window.location.hash.slice(1);
  try { if (held) restore(JSON.parse(decodeURIComponent(held))); } catch {
    restore(first);
    tell('The address holds no plan of these maps, so the page begins afresh.');
  }
  for (const settle of [between, hint, view.fit]) settle();
  new ResizeObserver(() => (view.refit ?? draw)()).observe(map);
  await show();
  guard(async () => { // after the picture, as it may take seconds
    state.outlines = outlinesOf(await unpack(await ask('outlines', {})), scene);
    draw();
  })();
  if (scene.can_plan) plan();
  if (keepsPlan) window.onhashchange = () => window.location.reload();
  root.dataset.ready = 'yes';
}
const held = document.getElementById('jv-data')?.textContent;
if (held !== undefined) start(document.querySelector('.jv'), held ? inFile(JSON.parse(held)) : overHttp());
export default { render({ model, el }) {
  el.innerHTML = `<div class="jv jv-inset">${model.get('markup')}</div>`;
  el.onkeydown = event => { if (!event.ctrlKey && !event.metaKey) event.stopPropagation(); }; // not the notebook's keys
  start(el.firstElementChild, overWidget(model), false);
} };
