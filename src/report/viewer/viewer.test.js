// Run with `node --test src/report/viewer/`.
'use strict';
const assert = require('node:assert/strict');
const fs = require('node:fs');
const path = require('node:path');
const test = require('node:test');
const vm = require('node:vm');
const zlib = require('node:zlib');

// The files of the page, in its order, in one scope.
const files = ['model.js', 'volume.js', 'colour.js', 'pane.js', 'plots.js', 'viewer.js'];
const names = ['decode', 'layers', 'cut', 'value', 'profile', 'position', 'section', 'paint', 'tables', 'text', 'View', 'KEYS', 'MODES', 'CYCLES'];
const source = files.map((file) => fs.readFileSync(path.join(__dirname, file), 'utf8')).join('\n');
const viewer = vm.runInThisContext(`(() => { 'use strict'; ${source}\nreturn { ${names} }; })()`);

const shape = [2, 3, 4];
/** Voxel (x, y, z) holds 100·x + 10·y + z; its value is half of that, plus 1. */
const volume = {
  name: 'digits', offset: 1, scale: 0.5,
  q: Uint16Array.from({ length: 24 }, (_, i) => 100 * Math.floor(i / 12) + 10 * (Math.floor(i / 4) % 3) + (i % 4)),
};
const digits = (values) => [...values].map((value) => (value - 1) / 0.5);
const slice = { slab: 'slice', thickness: 0 };
const plain = (across, h, v, signs = [1, -1]) => ({ across, axes: [h, v], signs });

test('8 and 16 bits decode to the numbers that were coded', async () => {
  for (const bits of [8, 16]) {
    const top = 2 ** bits;
    const q = Array.from({ length: 1000 }, (_, i) => (i * i * 7919 + (i % 3) * (top - 1)) % top);
    const steps = q.map((x, i) => x - (i ? q[i - 1] : 0));
    const folded = steps.map((d) => ((d << 16) >> 16) * 2).map((d) => (d < 0 ? -d - 1 : d));
    const coded = bits === 8 ? steps.map((d) => d & 255) : [...folded.map((d) => d >> 8), ...folded.map((d) => d & 255)];
    const data = zlib.deflateRawSync(Uint8Array.from(coded)).toString('base64');
    const found = await viewer.decode({ name: 'a', bits, offset: -1, scale: 0.25, data });
    assert.deepEqual([...found.q], q);
    assert.deepEqual([found.name, found.offset, found.scale], ['a', -1, 0.25]);
  }
});

test('a plane begins at its top left corner, and its signs turn it', () => {
  // As on the page of geometry: to the right y and z up, x and z, x and y.
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(0, 1, 2), 1, slice)), [103, 113, 123, 102, 112, 122, 101, 111, 121, 100, 110, 120]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(1, 0, 2), 1, slice)), [13, 113, 12, 112, 11, 111, 10, 110]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(2, 0, 1), 1, slice)), [21, 121, 11, 111, 1, 101]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(2, 1, 0, [-1, 1]), 0, slice)), [20, 10, 0, 120, 110, 100]);
});

test('a slab is the maximum or the mean of its layers along any axis', () => {
  const max = { slab: 'max', thickness: 0 };
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(0, 1, 2), 0, max)), [103, 113, 123, 102, 112, 122, 101, 111, 121, 100, 110, 120]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(1, 0, 2), 0, max)), [23, 123, 22, 122, 21, 121, 20, 120]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(2, 0, 1), 0, max)), [23, 123, 13, 113, 3, 103]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(2, 0, 1), 2, { slab: 'max', thickness: 2 })), [23, 123, 13, 113, 3, 103]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(2, 0, 1), 0, { slab: 'max', thickness: 2 })), [21, 121, 11, 111, 1, 101]);
  assert.deepEqual(digits(viewer.cut(volume, shape, plain(1, 0, 2), 0, { slab: 'mean', thickness: 0 })), [13, 113, 12, 112, 11, 111, 10, 110]);
});

test('a slab ends at the border of the volume', () => {
  assert.deepEqual(viewer.layers(10, 9, { slab: 'max', thickness: 4 }), [8, 2]);
  assert.deepEqual(viewer.layers(10, 0, { slab: 'max', thickness: 4 }), [0, 4]);
  assert.deepEqual(viewer.layers(10, 3, { slab: 'max', thickness: 0 }), [0, 10]);
  assert.deepEqual(viewer.layers(10, 3, { slab: 'slice', thickness: 4 }), [3, 1]);
});

test('the value at a voxel is that of the picture', () => {
  for (const state of [slice, { slab: 'max', thickness: 2 }, { slab: 'mean', thickness: 0 }]) {
    const picture = viewer.cut(volume, shape, plain(2, 0, 1), 1, state);
    // Row 0 of the picture is y = 2.
    assert.equal(viewer.value(volume, shape, [1, 2, 1], 2, state), picture[1]);
    assert.equal(viewer.value(volume, shape, [0, 0, 1], 2, state), picture[4]);
  }
});

test('a profile passes the voxels between its ends, and has a length in the unit of the scan', () => {
  const along = viewer.profile([volume], shape, [1, 0, 0], [1, 2, 0], [5, 2, 7]);
  assert.deepEqual([digits(along.values[0]), along.length], [[100, 110, 120], 4]);
  const slanted = viewer.profile([volume, volume], shape, [0, 0, 0], [1, 2, 3], [1, 1, 1]);
  assert.deepEqual([slanted.values.length, digits(slanted.values[1])], [2, [0, 11, 112, 123]]);
  assert.deepEqual(viewer.profile([volume], shape, [0, 1, 1], [0, 1, 1], [1, 1, 1]).length, 0);
});

test('a position follows origin, spacing and directions', () => {
  const scene = { origin: [10, 20, 30], spacing: [1, 2, 3], directions: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] };
  assert.deepEqual(viewer.position(scene, [1, 1, 1]), [8, 21, 33]);
});

test('a plane cuts an ellipsoid in the ellipse of its points', () => {
  const centre = [4, 5, 6];
  const factor = [[2, 0.5, -0.3], [0.2, 1.5, 0.4], [-0.6, 0.1, 3]];
  const plane = plain(2, 0, 1);
  const [x, y, a, b, angle] = viewer.section([...centre, ...factor.flat()], plane, 7);
  assert.ok(a > b && b > 0);
  // The inverse of the factor takes points of the surface to the unit sphere.
  const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
  const columns = [0, 1, 2].map((j) => factor.map((row) => row[j]));
  const rows = [cross(columns[1], columns[2]), cross(columns[2], columns[0]), cross(columns[0], columns[1])];
  const determinant = dot(columns[0], rows[0]);
  for (const turn of [0, 1, 2, 3, 4, 5]) {
    const [p, q] = [a * Math.cos(turn), b * Math.sin(turn)];
    const point = [x + p * Math.cos(angle) - q * Math.sin(angle), y + p * Math.sin(angle) + q * Math.cos(angle), 7].map((at, axis) => at - centre[axis]);
    const unit = rows.map((row) => dot(row, point) / determinant);
    assert.ok(Math.abs(dot(unit, unit) - 1) < 1e-12);
  }
  assert.equal(viewer.section([...centre, 1, 0, 0, 0, 1, 0, 0, 0, 1], plane, 7.01), null);
});

test('a window maps its ends to the ends of the colours', () => {
  const pixels = new Uint32Array(5);
  viewer.paint([-1, 0, 1, 2, 3], [0, 2], viewer.tables.Grey, pixels);
  assert.deepEqual([...pixels].map((pixel) => pixel & 255), [0, 0, 128, 255, 255]);
  assert.equal(pixels[2], 0xff808080);
});

test('differences are white at 0, red above and blue below, and lightness tells values of all other maps apart', () => {
  const channels = (pixel) => [pixel & 255, (pixel >> 8) & 255, (pixel >> 16) & 255];
  const difference = viewer.tables.Difference;
  assert.ok(Math.min(...channels(difference[127]), ...channels(difference[128])) > 230);
  const [[r, , b], [r2, , b2]] = [channels(difference[215]), channels(difference[40])];
  assert.ok(r > b + 50 && b2 > r2 + 50);
  const light = (pixel) => channels(pixel).reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  for (const [name, table] of Object.entries(viewer.tables)) {
    const steps = Array.from(table.slice(1), (pixel, i) => Math.sign(light(pixel) - light(table[i])));
    if (name !== 'Difference') assert.ok(steps.every((step) => step === 0 || step === steps[0]), name);
  }
});

test('numbers have four digits and a typographic minus', () => {
  assert.deepEqual([0, 1, -0.12345, 1234.56, 2e-7, 3e9].map(viewer.text), ['0', '1', '−0.1235', '1235', '2e−7', '3e+9']);
});

test('the sheet of keys lists every key that acts', () => {
  const listed = new Set(viewer.KEYS.split('\n').flatMap((row) => row.split('|')[0].split(/[\s,]+/)));
  const state = { active: 0, cross: [0, 0, 0], centre: [0, 0, 0], pair: [0, 1], wipe: 0.5, zoom: 1, thickness: 0, crosshair: true, model: '' };
  const scene = { shape, planes: [plain(0, 1, 2)], window: [0, 1] };
  const view = Object.assign(Object.create(viewer.View.prototype), { state, scene, planes: scene.planes, volumes: [volume, volume], root: {} });
  for (const key of '+-0[]{}()<>akhr?123456'.split('').concat(Object.keys(viewer.CYCLES))) {
    assert.ok(view.action({ key }, 1), `${key} does nothing`);
    assert.ok(listed.has(key === '-' ? '−' : key) || (key > '1' && key < '6'), `${key} is not listed`);
  }
  assert.deepEqual(view.action({ key: '4' }, 1), { mode: 'difference' });
  assert.ok(!view.action({ key: 'q' }, 1) && !view.action({ key: 'a', ctrlKey: true }, 1));
});
