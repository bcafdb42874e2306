// A mission that is opened: judged by `Viewer.check` under the limits of the page, and its findings to walk through.
const base64Of = file => new Promise((resolve, reject) => {
  const reader = new FileReader();
  reader.onerror = () => reject(reader.error);
  reader.onload = () => resolve(reader.result.split(',')[1] ?? '');
  reader.readAsDataURL(file);
});
function missionsOf({ root, is, field, scene, ask, latest, tell, draw, view, rules, reveal, showLevel, fitTo }) {
  const [flown, wrong] = scene.mission_colours, texts = ['state', 'findings', 'not-judged', 'figures'];
  let file = null, asked = [], check = null, chosen = -1;
  const put = answer => {
    if (chosen >= 0) tell(''); // of a finding that is gone
    [check, chosen] = [answer, -1];
    is('state').className = '';
    for (const name of texts) is(name).innerHTML = check?.[name] ?? '';
    if (check) showLevel(check.cruise_m);
    if (check?.lines.length) fitTo(() => check?.lines.flat() ?? []);
    draw();
  };
  const judge = latest(async () => { // again only where the file or a limit is another one
    const { at, clearance_m, vertical_clearance_m, zones } = rules();
    const [heights, autopilot] = ['heights', 'autopilot'].map(name => field(name).value || null);
    const limits = { at: [0, ...at.slice(1)], clearance_m, vertical_clearance_m, zones, heights, autopilot };
    const now = [file, JSON.stringify(limits)];
    if (now.every((each, k) => each === asked[k])) return;
    asked = now;
    put(null);
    is('mission').textContent = file?.name ?? '';
    is('close').hidden = !file;
    if (!file) return;
    is('state').innerHTML = '<label>Judging the mission …<progress></progress></label>';
    try {
      if (file.size > scene.most_bytes) throw new Error(`${file.name} has more than ${scene.most_bytes >> 20} MiB.`);
      put(await ask('check', { ...limits, file: file.name, data: await base64Of(file) }));
    } catch (error) {
      Object.assign(is('state'), { className: 'jv-limit', textContent: error.message });
      if (error.isOld) throw error;
    } finally {
      reveal(is('mission'));
    }
  });
  const choose = (k, isOnMap = false) => {
    const buttons = [...is('findings').children], button = buttons[chosen = clamp(k, 0, buttons.length - 1)];
    if (!button) return;
    for (const each of buttons) each.ariaPressed = each === button;
    tell(isOnMap ? button.textContent : ''); // where the button takes the focus, that says it
    if (!isOnMap) button.focus();
    showLevel(check.heights[chosen]);
    view.show(...check.places[chosen], Math.min(view.scale, 1));
  };
  const chooseAt = ([x, y]) => {
    const near = check?.places.findIndex(place => Math.hypot(place[0] - x, place[1] - y) < 12 * view.scale) ?? -1;
    if (near >= 0) choose(near);
  };
  const open = given => {
    file = given;
    root.querySelector('[data-tab="check"]').click();
    judge();
  };
  const paint = (line, spot, label) => {
    if (!check) return;
    for (const [ink, width] of [['#fff', 5], [flown, 2.4]]) for (const part of check.lines) line(part, ink, width);
    for (const [place, ...inks] of [[check.lines[0]?.[0], '#fff', flown], [check.lines.at(-1)?.[1], flown, '#fff']])
      if (place) spot(place, 4, ...inks);
    const named = []; // no number is written over another
    check.places.forEach((place, k) => {
      spot(place, k === chosen ? 8 : 5, wrong, '#fff');
      const isClear = named.every(([x, y]) => Math.hypot(x - place[0], y - place[1]) > 14 * view.scale);
      if (isClear || k === chosen) named.push(place) && label(k + 1, place, wrong);
    });
  };
  is('findings').onclick = ({ target }) => choose([...is('findings').children].indexOf(target.closest('button')));
  is('findings').onkeydown = event => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) { event.preventDefault(); choose(chosen + step); }
  };
  is('file').onchange = ({ target }) => { if (target.files.length) open(target.files[0]); target.value = ''; };
  if (scene.can_plan) root.ondragover = event => {
    if (event.dataTransfer.types.includes('Files')) event.preventDefault();
  };
  root.ondrop = event => {
    event.preventDefault();
    if (event.dataTransfer.files.length) open(event.dataTransfer.files[0]);
  };
  const walk = step => () => choose(chosen + step, true);
  return { judge, paint, chooseAt, pick: () => is('file').click(), isOpen: () => Boolean(check),
    close: () => { file = null; judge(); },
    keys: { o: () => is('file').click(), n: walk(1), p: walk(-1) } };
}
