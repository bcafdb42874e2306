// How the page asks: one function, `ask(name, parameters)`, which each door brings along: a server over HTTP, a
// notebook's kernel, or the answers that lie in the file itself. Values travel as `jaxurban.viewer.tiles` packs them.
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
