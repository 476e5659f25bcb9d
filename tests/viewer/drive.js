// Drives a page of `trgs view` in Chromium, without packages: node tests/viewer/drive.js PAGE.html [FLAG ..]
//
// The page shows two volumes `a` and `b` of 16³ voxels: (x + 16·y + 256·z)/4096, and the same plus 0.25. Each check prints a
// line; the exit code is 1 if one fails. Instead, of any page, --measure prints times, --shots DIR writes pictures,
// --against DIR compares such pictures with those of a folder, --picture FILE writes one of the first viewer with the last of
// its planes alone, --model checks that the first viewer draws primitives, and --letters that it shows the phantom `letters`.
'use strict';
const assert = require('node:assert/strict');
const { spawn } = require('node:child_process');
const fs = require('node:fs');
const os = require('node:os');
const path = require('node:path');

const [page, ...flags] = process.argv.slice(2);
const profile = fs.mkdtempSync(path.join(os.tmpdir(), 'trgs-viewer-'));
const browser = spawn(process.env.CHROMIUM || 'chromium', [
  '--headless', '--no-sandbox', '--disable-gpu', '--no-first-run', '--hide-scrollbars', '--remote-debugging-pipe',
  '--disable-background-networking', '--disable-extensions', '--disable-component-update', `--user-data-dir=${profile}`, 'about:blank',
], { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
browser.on('error', (error) => fail(`chromium does not start: ${error.message}`));
setTimeout(() => fail('no end after 120 seconds'), 120000).unref();

function fail(words) {
  console.log(`not ok: ${words}`);
  end(1);
}

/** Ends the browser; its processes may write to the profile for a moment more. */
function end(code, tries = 20) {
  browser.kill('SIGKILL');
  try {
    fs.rmSync(profile, { recursive: true, force: true });
    process.exit(code);
  } catch (error) {
    if (!tries) throw error;
    setTimeout(end, 100, code, tries - 1);
  }
}

// The protocol: JSON between zero bytes.
const waiting = new Map();
const problems = [];
let [count, session, received] = [0, undefined, ''];
browser.stdio[4].setEncoding('utf8').on('data', (data) => {
  const messages = (received + data).split('\0');
  received = messages.pop();
  for (const { id, result, error, method, params } of messages.map((text) => JSON.parse(text))) {
    if (id) waiting.get(id)(error ? Promise.reject(new Error(JSON.stringify(error))) : result);
    if (method === 'Runtime.exceptionThrown') problems.push(params.exceptionDetails.exception?.description || params.exceptionDetails.text);
    if (method === 'Runtime.consoleAPICalled') problems.push(`console.${params.type}`);
    if (method === 'Log.entryAdded') problems.push(params.entry.text);
    if (method === 'Network.requestWillBeSent' && params.type !== 'Document') problems.push(`request of ${params.request.url}`);
  }
});
const send = (method, params = {}) => new Promise((resolve) => {
  waiting.set(++count, resolve);
  browser.stdio[3].write(`${JSON.stringify({ id: count, method, params, sessionId: session })}\0`);
});

/** The value of an expression in the page, in which `v` is the first viewer and `s` its state, after the next frame. */
async function ask(expression) {
  const frames = 'await new Promise((done) => requestAnimationFrame(() => setTimeout(done)))';
  const body = `(async () => { const [v] = await trgsViews; const s = v.state; ${frames}; return ${expression}; })()`;
  const { result, exceptionDetails } = await send('Runtime.evaluate', { expression: body, awaitPromise: true, returnByValue: true });
  if (exceptionDetails) throw new Error(`${expression}: ${exceptionDetails.exception?.description}`);
  return result.value;
}

/** A point of the screen in the first pane across an axis, in parts of its sides. */
async function at(across, x, y) {
  const pane = `v.panes.find(({ plane }) => plane.across === ${across}).canvas`;
  const box = await ask(`(${pane}.scrollIntoView({ block: 'center' }), ${pane}.getBoundingClientRect().toJSON())`);
  return { x: box.x + x * box.width, y: box.y + y * box.height };
}

/** The colour at a point of a pane, in parts of its sides. */
const grey = (across, x, y) => ask(`(() => {
  const { canvas } = v.panes.find(({ plane }) => plane.across === ${across});
  const copy = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
  copy.drawImage(canvas, -Math.floor(${x} * canvas.width), -Math.floor(${y} * canvas.height));
  return [...copy.getImageData(0, 0, 1, 1).data.slice(0, 3)];
})()`);

const mouse = (type, place, more = {}) => send('Input.dispatchMouseEvent', { type, ...place, button: 'none', ...more });
async function drag(from, to, button, modifiers = 0) {
  const buttons = { left: 1, right: 2, middle: 4 }[button];
  await mouse('mousePressed', from, { button, buttons, modifiers, clickCount: 1 });
  await mouse('mouseMoved', to, { button, buttons, modifiers });
  await mouse('mouseReleased', to, { button, modifiers, clickCount: 1 });
}
async function key(key, modifiers = 0) {
  const text = key.length === 1 && !modifiers ? key : undefined;
  for (const type of [text ? 'keyDown' : 'rawKeyDown', 'keyUp']) await send('Input.dispatchKeyEvent', { type, key, text, code: key, modifiers, windowsVirtualKeyCode: { Tab: 9, Escape: 27, Enter: 13 }[key] });
}
const CTRL = 2;
const SHIFT = 8;

async function open(width, height, mobile = false) {
  await send('Emulation.setDeviceMetricsOverride', { width, height, deviceScaleFactor: mobile ? 2 : 1, mobile });
  await send('Emulation.setTouchEmulationEnabled', { enabled: mobile });
  await send('Page.navigate', { url: `file://${path.resolve(page)}` });
  for (let tries = 0; tries < 1500; tries++) {
    const { result } = await send('Runtime.evaluate', { expression: "document.readyState === 'complete' && 'trgsViews' in globalThis", returnByValue: true });
    if (result.value) return ask('v.frames');
    await new Promise((done) => setTimeout(done, 20));
  }
  throw new Error('the page has no viewer');
}

/** The lowest contrast of texts of the viewer to what is behind them. */
const contrast = () => ask(`(() => {
  const light = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map((c) => c / 255)
    .map((c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)).reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = (element) => {
    const { backgroundColor } = getComputedStyle(element);
    return /, 0\\)$/.test(backgroundColor) && element.parentElement ? behind(element.parentElement) : backgroundColor;
  };
  const texts = [...v.root.querySelectorAll('*')].filter((element) => element.offsetParent && [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim()));
  return Math.min(...texts.map((element) => {
    const [a, b] = [light(getComputedStyle(element).color), light(behind(element))].sort((x, y) => y - x);
    return (a + 0.05) / (b + 0.05);
  }));
})()`);

const near = (found, expected, within, what) => assert.ok(Math.abs(found - expected) <= within, `${what}: ${found}, expected ${expected}`);

const checks = {
  async 'wheel and keys go through the slices'() {
    await open(1280, 900);
    assert.deepEqual(await ask('s.cross'), [7, 7, 7]);
    const before = await grey(2, 0.25, 0.25);
    const place = await at(2, 0.25, 0.25);
    await mouse('mouseWheel', place, { deltaX: 0, deltaY: 120 });
    assert.deepEqual(await ask('s.cross'), [7, 7, 8]);
    await mouse('mouseWheel', place, { deltaX: 0, deltaY: -120 });
    await mouse('mouseWheel', place, { deltaX: 0, deltaY: -120 });
    assert.deepEqual(await ask('s.cross'), [7, 7, 6]);
    assert.notDeepEqual(await grey(2, 0.25, 0.25), before);
    await ask('v.panes.find(({ plane }) => plane.across === 2).canvas.focus()');
    for (const [name, expected] of [['PageUp', 7], ['End', 15], ['PageUp', 15], ['Home', 0], ['PageDown', 0]]) {
      await key(name);
      assert.equal(await ask('s.cross[2]'), expected, name);
    }
    await key('PageUp', SHIFT);
    assert.deepEqual(await ask('s.cross'), [7, 7, 10]);
    await key('ArrowRight');
    await key('ArrowUp');
    assert.deepEqual(await ask('s.cross'), [8, 8, 10]);
    assert.equal(await ask('v.root.querySelector(".trgs-head:last-child, .trgs-planes > :last-child .trgs-head").textContent'), 'Across z11 / 16');
  },

  async 'the value, voxel and position under the pointer are right'() {
    await open(1280, 900);
    await drag(await at(2, 0.28, 0.28), await at(2, 0.28, 0.28), 'left');
    // Column 4 of 16 from the left, row 4 from the top, where y is largest.
    assert.deepEqual(await ask('s.cross'), [4, 11, 7]);
    await mouse('mouseMoved', await at(2, 0.72, 0.03));
    const words = await ask('[...v.readout.children].map((part) => part.textContent)');
    const value = (11 + 16 * 15 + 256 * 7) / 4096;
    near(Number(words[0].replace('a.npy ', '')), value, 1 / 510 + 1e-4, 'a');
    near(Number(words[1].replace('b.npy ', '')), value + 0.25, 1 / 510 + 1e-4, 'b');
    near(Number(words[2].replace('b.npy − a.npy ', '')), 0.25, 1e-4, 'difference');
    assert.equal(words[3], 'voxel 12, 16, 8');
    assert.equal(words[4], 'position 11, 15, 7 ');
  },

  async 'dragging sets the window, and the picture follows'() {
    await open(1280, 900);
    const [from, to] = await ask('s.window');
    const first = await grey(2, 0.1, 0.9);
    const value = (1 + 16 * 1 + 256 * 7) / 4096;
    near(first[0], (255 * (value - from)) / (to - from), 3, 'grey');
    await drag(await at(2, 0.5, 0.5), await at(2, 0.7, 0.5), 'right');
    const wider = await ask('s.window');
    near(wider[1] - wider[0], (to - from) * Math.exp(0.4), 0.02, 'width');
    assert.notDeepEqual(await grey(2, 0.1, 0.9), first);
    await key('a');
    assert.deepEqual(await ask('s.window'), [from, to]);
    await key(']');
    assert.ok((await ask('s.window[0]')) > from);
    await key('p');
    assert.deepEqual(await ask('[v.inputs.preset.value, s.window.join()]'), ['Automatic', `${from},${to}`]);
    await key('p');
    assert.equal(await ask('v.inputs.preset.value'), 'Full range');
    await ask(`(v.inputs.low.value = 0.5, v.inputs.low.onchange())`);
    assert.deepEqual(await ask('[s.window[0], v.inputs.preset.value]'), [0.5, '']);
  },

  async 'slabs and maxima along an axis'() {
    await open(1280, 900);
    await ask('v.panes.find(({ plane }) => plane.across === 2).canvas.focus()');
    await ask('v.set({ window: [0, 1] })');
    await key('m');
    assert.equal(await ask('s.slab'), 'max');
    near((await grey(2, 0.1, 0.9))[0], (255 * (1 + 16 + 256 * 15)) / 4096, 2, 'maximum of all layers');
    await key('Home');
    for (let layers = 16; layers > 3; layers--) await key('<');
    assert.equal(await ask('s.thickness'), 3);
    near((await grey(2, 0.1, 0.9))[0], (255 * (1 + 16 + 256 * 2)) / 4096, 2, 'maximum of the first three layers');
    await key('m');
    near((await grey(2, 0.1, 0.9))[0], (255 * (1 + 16 + 256)) / 4096, 2, 'mean of the first three layers');
  },

  async 'side by side, difference, wipe and flicker'() {
    await open(1280, 900);
    assert.equal(await ask('v.panes.length'), 9);
    await ask('v.panes[0].canvas.focus()');
    for (const [name, mode, panes] of [['1', 'one', 3], ['2', 'side', 6], ['3', 'all', 9], ['4', 'difference', 3], ['5', 'wipe', 3], ['6', 'flicker', 3]]) {
      await key(name);
      assert.deepEqual(await ask('[s.mode, v.panes.length]'), [mode, panes]);
    }
    await key('4');
    const [red, , blue] = await grey(2, 0.1, 0.9);
    assert.ok(red > blue + 50, 'b is larger than a: red');
    assert.equal(await ask('v.panes[0].caption.textContent'), 'b.npy − a.npy RMS 0.25, blue to red ±0.25');
    await key(' ');
    const [less, , more] = await grey(2, 0.1, 0.9);
    assert.ok(more > less + 50, 'exchanged: blue');
    await key(' ');
    await key('5');
    await ask('v.set({ window: [0, 1] })');
    const row = (1 + 256 * 7 + 16) / 4096;
    near((await grey(2, 0.1, 0.9))[0], 255 * row, 2, 'a on the left');
    near((await grey(2, 0.9, 0.9))[0], 255 * (row + 13 / 4096 + 0.25), 2, 'b on the right');
    await drag(await at(2, 0.5, 0.7), await at(2, 0.05, 0.7), 'left');
    near(await ask('s.wipe'), 0.05, 0.02, 'edge');
    near((await grey(2, 0.1, 0.9))[0], 255 * (row + 0.25), 2, 'b now on the left');
    await key(')');
    near(await ask('s.wipe'), 0.1, 0.02, 'edge by key');
    await key('6');
    for (const phase of [1, 0, 1]) {
      const seen = `await (async () => { for (let i = 0; i < 500 && s.phase !== ${phase}; i++) await new Promise((done) => setTimeout(done, 20)); return s.phase; })()`;
      assert.equal(await ask(seen), phase, 'flicker');
    }
    await key('1');
  },

  async 'zoom, pan, line and planes'() {
    await open(1280, 900);
    await mouse('mouseWheel', await at(2, 0.5, 0.5), { deltaX: 0, deltaY: -120, modifiers: CTRL });
    assert.ok((await ask('s.zoom')) > 1.3);
    await drag(await at(2, 0.5, 0.5), await at(2, 0.7, 0.5), 'middle');
    assert.ok((await ask('s.centre[0]')) < 6);
    await key('0');
    assert.deepEqual(await ask('[s.zoom, s.centre]'), [1, [7.5, 7.5, 7.5]]);
    await drag(await at(2, 0.03, 0.97), await at(2, 0.97, 0.97), 'left', SHIFT);
    assert.deepEqual(await ask('[s.mark, s.cross]'), [[0, 0, 7], [15, 0, 7]]);
    assert.match(await ask('v.line.canvas.getAttribute("aria-label")'), /^Profile of 15 : values from 0\.43\d+ to 0\.69\d+$/);
    await key('k');
    assert.equal(await ask('s.mark'), null);
    await key('o');
    assert.deepEqual(await ask('[v.panes.length, s.layout]'), [3, 0]);
  },

  async 'every control is reached by Tab, and the focus is visible'() {
    await open(1280, 900);
    const controls = await ask('[...v.root.querySelectorAll("select, input, button, canvas[tabindex]")].filter((e) => e.offsetParent).length');
    await send('Runtime.evaluate', { expression: 'document.activeElement.blur()' });
    const seen = new Set();
    for (let i = 0; i < controls; i++) {
      await key('Tab');
      const [number, outline] = await ask('[[...document.querySelectorAll("*")].indexOf(document.activeElement), getComputedStyle(document.activeElement).outline]');
      assert.match(outline, /solid 3px/);
      seen.add(number);
    }
    assert.equal(seen.size, controls);
    assert.equal(await ask('[...v.root.querySelectorAll("select, input, canvas")].filter((e) => !e.labels?.length && !e.getAttribute("aria-label")).length'), 0);
    await ask('v.panes[0].canvas.focus()');
    await key('?');
    assert.equal(await ask('v.sheet.open'), true);
    await key('Escape');
    assert.deepEqual(await ask('[v.sheet.open, document.activeElement === v.panes[0].canvas]'), [false, true]);
  },

  async 'dark and light have contrast'() {
    for (const value of ['light', 'dark']) {
      await send('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value }] });
      await open(1280, 900);
      const found = await contrast();
      assert.ok(found >= 4.5, `${value}: ${found}`);
    }
    await send('Emulation.setEmulatedMedia', { features: [] });
  },

  async 'a phone of 390 pixels'() {
    await open(390, 844, true);
    assert.ok((await ask('document.documentElement.scrollWidth')) <= 390, 'wider than the screen');
    assert.deepEqual(await ask('[s.layout, v.panes.length]'), [2, 3]);
    const place = await at(2, 0.28, 0.28);
    await send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [place] });
    await send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] });
    assert.deepEqual(await ask('s.cross'), [4, 11, 7]);
    const small = await ask('[...v.root.querySelectorAll("select, button, input")].filter((e) => e.offsetParent && e.getBoundingClientRect().height < 24).length');
    assert.equal(small, 0, 'controls below 24 pixels');
  },
};

/** CPU seconds of the browser with all its processes, where there is /proc. */
function cpu() {
  const stats = fs.readdirSync('/proc').filter((name) => /^\d+$/.test(name)).map((pid) => {
    try {
      const fields = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').replace(/^.*\) /, '').split(' ');
      return { pid: Number(pid), parent: Number(fields[1]), ticks: Number(fields[11]) + Number(fields[12]) };
    } catch {
      return { ticks: 0 };
    }
  });
  const family = new Set([browser.pid]);
  for (let size = 0; size < family.size;) {
    size = family.size;
    for (const { pid, parent } of stats) if (family.has(parent)) family.add(pid);
  }
  return stats.reduce((sum, { pid, ticks }) => sum + (family.has(pid) ? ticks : 0), 0) / 100;
}

async function measure() {
  await open(1280, 900);
  const paint = await ask("performance.getEntriesByName('first-contentful-paint')[0]?.startTime");
  const ready = await ask('performance.now()');
  const [steps, before, begin] = [120, cpu(), Date.now()];
  await ask(`await (async () => {
    for (let i = 0; i < ${steps}; i++) {
      v.step(v.planes[v.planes.length - 1].across, i % 80 < 40 ? 1 : -1);
      await new Promise((done) => requestAnimationFrame(done));
    }
  })()`);
  const found = { bytes: fs.statSync(page).size, shape: await ask('v.scene.shape'), panes: await ask('v.panes.length'), first_paint_ms: paint, ready_ms: ready };
  console.log(JSON.stringify({ ...found, frames_per_second: (1000 * steps) / (Date.now() - begin), cpu_ms_of_a_frame: (1000 * (cpu() - before)) / steps }));
}

/** Primitives are drawn in colours; all else is grey without the crosshair. */
async function model() {
  await open(1280, 900);
  await ask('v.panes[0].canvas.focus()');
  await key('h');
  const coloured = () => ask(`v.panes.filter(({ sources }) => sources[0] === 1).map(({ canvas }) => {
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return Array.from({ length: data.length / 4 }, (_, i) => Math.max(...data.slice(4 * i, 4 * i + 3)) - Math.min(...data.slice(4 * i, 4 * i + 3))).filter((spread) => spread > 20).length;
  })`);
  const seen = {};
  for (const quantity of ['ν', 'confidence', 'density', 'hidden']) {
    await key('e');
    const name = await ask('v.inputs.model.selectedOptions[0].textContent');
    assert.ok(name.startsWith(quantity), `${name}, expected ${quantity}`);
    seen[quantity] = await coloured();
    assert.ok(seen[quantity].every((count) => (quantity === 'hidden' ? count === 0 : count > 100)), `${quantity}: ${seen[quantity]}`);
  }
  assert.notDeepEqual(seen['ν'], seen.density);
  console.log('ok: primitives are drawn');
}

/** The letters on the sides of the phantom `letters`, 50³ voxels of a patient, as the planes of the viewer show them. */
async function letters() {
  await open(1280, 900);
  const expected = [
    ['Sagittal', -0.65, true, '####. #...# #...# ####. #.#.. #..#. #...#'],
    ['Coronal', -0.65, false, '.###. #...# #...# ##### #...# #...# #...#'],
    ['Axial', 0.65, true, '.#### #.... #.... .###. ....# ....# ####.'],
  ];
  for (const [title, depth, is_mirrored, rows] of expected) {
    const found = await ask(`(() => {
      const plane = v.planes.find((plane) => plane.title === '${title}');
      const { origin, spacing, directions, shape } = v.scene;
      // The patient's axis across the plane, and the slice there.
      const side = { Sagittal: 0, Coronal: 1, Axial: 2 }['${title}'];
      const along = directions[plane.across][side] * spacing[plane.across];
      const index = Math.round((${depth} - origin[side]) / along);
      v.set({ cross: v.state.cross.map((old, axis) => (axis === plane.across ? index : old)) });
      const values = v.cut(plane, 0);
      const width = shape[plane.axes[0]];
      const at = (row, column) => values[Math.round(24.5 + 3 * (row - 3)) * width + Math.round(24.5 + 3 * (column - 2))];
      return [0, 1, 2, 3, 4, 5, 6].map((row) => [0, 1, 2, 3, 4].map((column) => (at(row, column) > 0.5 ? '#' : '.')).join(''));
    })()`);
    // A side that is seen from within the patient shows its letter mirrored.
    const read = found.map((row) => (is_mirrored ? [...row].reverse().join('') : row)).join(' ');
    assert.equal(read, rows, title);
  }
  console.log('ok: the letters are on their sides');
}

/** Means of the differences of 16 × 16 pixels between two PNG files, levels of 255. */
const differences = (a, b) => ask(`await (async () => {
  const pixels = async (data) => {
    const image = Object.assign(new Image(), { src: 'data:image/png;base64,' + data });
    await image.decode();
    const [width, height] = [image.width, image.height].map((side) => Math.ceil(side / 16));
    const context = new OffscreenCanvas(width, height).getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(image, 0, 0, width, height);
    return context.getImageData(0, 0, width, height).data;
  };
  const [a, b] = [await pixels('${a}'), await pixels('${b}')];
  return a.length === b.length ? Array.from(a, (level, i) => Math.abs(level - b[i])).filter((_, i) => i % 4 < 3) : [255];
})()`);
const part = (all, above) => all.filter((level) => level > above).length / all.length;

/** Compares pictures with those of a folder; another font moves letters, which a tolerance of blocks allows. */
async function against(folder) {
  const known = Object.fromEntries(fs.readdirSync(folder).map((file) => [file.replace('.png', ''), fs.readFileSync(path.join(folder, file)).toString('base64')]));
  // The lines of a narrow page break elsewhere with another font.
  for (const [name, data] of await pictures(Object.keys(known).filter((name) => name !== 'phone'))) {
    const found = await differences(data, known[name]);
    assert.ok(part(found, 12) <= 0.04, `${name}: ${part(found, 12)} of all blocks differ from ${folder}`);
    console.log(`ok: ${name} is as before`);
  }
  const other = await differences(known.wide, known.wipe);
  assert.ok(part(other, 12) > 0.04, 'two pictures are told apart');
}

async function shots(folder, ...names) {
  for (const [name, data] of await pictures(names.length ? names : undefined)) fs.writeFileSync(path.join(folder, `${name}.png`), Buffer.from(data, 'base64'));
}

/** Pictures of half the size, all or those of some names. */
async function pictures(names) {
  const found = [];
  for (const [name, width, height, mobile, keys, scheme] of [
    ['wide', 1280, 1000, false, '', 'light'], ['dark', 1280, 1000, false, '', 'dark'], ['wipe', 1280, 1000, false, '5', 'light'], ['sheet', 1280, 1000, false, '?', 'light'],
    ['maximum', 1280, 1000, false, '1m', 'dark'], ['large', 1280, 1000, false, 'oo', 'light'], ['phone', 390, 844, true, '', 'light'],
  ].filter(([name]) => names?.includes(name) ?? true)) {
    await send('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value: scheme }] });
    await open(width, height, mobile);
    if (keys) await ask('v.panes[0].canvas.focus()');
    for (const name of keys) await key(name);
    await ask('1');
    const clip = { x: 0, y: 0, width, height, scale: 0.5 };
    const { data } = await send('Page.captureScreenshot', { captureBeyondViewport: !keys.includes('?'), clip });
    found.push([name, data]);
  }
  return found;
}

async function picture(file) {
  await open(1280, 900);
  await ask('v.set({ layout: v.planes.at(-1).across })');
  const [x, y, width, height] = await ask(`(() => {
    const [first, last] = [v.readout, v.field].map((part) => part.getBoundingClientRect());
    return [first.x, first.y + scrollY, first.width, last.bottom - first.y];
  })()`);
  const { data } = await send('Page.captureScreenshot', { captureBeyondViewport: true, clip: { x, y, width, height, scale: 1 } });
  fs.writeFileSync(file, Buffer.from(data, 'base64'));
}

(async () => {
  const { targetId } = await send('Target.createTarget', { url: 'about:blank' });
  ({ sessionId: session } = await send('Target.attachToTarget', { targetId, flatten: true }));
  for (const domain of ['Page', 'Runtime', 'Network', 'Log']) await send(`${domain}.enable`);
  if (flags[0] === '--measure') await measure();
  else if (flags[0] === '--shots') await shots(...flags.slice(1));
  else if (flags[0] === '--against') await against(flags[1]);
  else if (flags[0] === '--model') await model();
  else if (flags[0] === '--letters') await letters();
  else if (flags[0] === '--picture') await picture(flags[1]);
  else {
    for (const [name, check] of Object.entries(checks)) {
      await check();
      assert.deepEqual(problems, [], `${name}: errors or requests`);
      console.log(`ok: ${name}`);
    }
  }
  end(0);
})().catch((error) => fail(error.stack));
