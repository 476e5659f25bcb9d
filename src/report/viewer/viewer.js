// The viewer: its state, controls and keys. One for each element of class trgs-viewer, which holds its scene as JSON.

// Far below three flashes in a second.
const FLICKER_MS = 600;
const MODES = { one: 'One', side: 'Side by side', all: 'Side by side, difference', difference: 'Difference', wipe: 'Wipe', flicker: 'Flicker' };
const SLABS = { slice: 'Slice', max: 'Maximum', mean: 'Mean' };
const DRAGS = { cross: 'Crosshair', window: 'Window', slice: 'Slices', zoom: 'Zoom', pan: 'Pan', line: 'Line' };
/** Level and width in Hounsfield units. */
const TISSUES = { 'Soft tissue': [40, 400], Lung: [-600, 1500], Bone: [500, 2000], Brain: [40, 80] };
/** The control that a key takes to its next option. */
const CYCLES = { o: 'layout', m: 'slab', p: 'preset', c: 'map', t: 'drag', e: 'model', l: 'axis', n: 'a', b: 'b' };
const KEYS = `Arrows|move the crosshair; with Shift by 10
Page up, Page down, wheel|next and previous slice; with Shift by 10
Home, End|first and last slice
+ − 0, Ctrl + wheel|zoom in, zoom out, whole picture
Ctrl + arrows, middle drag|pan
[ ] { }, right drag|level down, up; window narrower, wider
a p|automatic window; next preset
1 to 6|one volume, side by side, with difference, difference, wipe, flicker
n b space|next first, next second volume; exchange
( )|edge of the wipe
o m c t e|next planes, projection, colours, use of a drag, primitives
< >|fewer, more layers
k l, Shift + drag|line from here to the crosshair; axis of the profile
h r ?|crosshair; reset; this sheet`;

/** An element of a tag and class; of the parts, objects are properties or attributes, and all others children. */
function element(tag, ...parts) {
  const [name, className = ''] = tag.split('.');
  const made = Object.assign(document.createElement(name), { className });
  for (const part of parts) {
    if (part instanceof Node || typeof part === 'string') made.append(part);
    else for (const key in part) key in made ? (made[key] = part[key]) : made.setAttribute(key, part[key]);
  }
  return made;
}

const same = (names) => Object.fromEntries(names.map((name) => [name, name]));
const replaced = (list, at, value) => list.map((old, i) => (i === at ? value : old));

class View {
  constructor(root, scene, volumes, columns) {
    const rows = columns.length && Array.from(columns[0].q, (_, n) => columns.map(({ offset, scale, q }) => offset + scale * q[n]));
    Object.assign(this, { root, scene, volumes, columns, rows, planes: scene.planes, frames: 0, inputs: {} });
    this.state = this.start();
    this.build();
    this.arrange();
    new ResizeObserver(() => this.draw()).observe(root);
    matchMedia('(prefers-color-scheme: dark)').onchange = () => this.draw();
  }

  start() {
    const { root, scene: { shape, window, reach, angles, map }, volumes: [, second, third], planes } = this;
    // The plane that is shown alone: a projection, or the one across the last axis.
    const last = planes[angles ? 0 : planes.length - 1];
    const is_one = angles || planes.length < 3 || root.clientWidth < 540;
    return {
      cross: shape.map((count, axis) => (angles && !axis ? 0 : (count - 1) >> 1)),
      centre: shape.map((count) => (count - 1) / 2),
      zoom: 1, wipe: 0.5, phase: 0, mark: null, drag: 'cross', crosshair: true, map, model: '',
      window, reach,
      mode: third ? 'side' : second ? 'all' : 'one', pair: [0, second ? 1 : 0], slab: 'slice', thickness: 0,
      layout: is_one ? last.across : 'all', active: last.across, axis: last.axes[0],
    };
  }

  /** Changes the state and draws; a change of what is shown arranges the panes anew. */
  set(change) {
    if (change.window && !(change.window[1] > change.window[0])) return;
    Object.assign(this.state, change);
    if (change.mode || 'layout' in change || change.pair) this.arrange();
    this.draw();
  }

  draw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.panes.forEach((pane) => pane.draw());
      this.counts.histogram();
      this.line.profile();
      this.show();
      this.frames++;
    });
  }

  /** The values of a plane as it is shown. */
  cut(plane, source) {
    const { scene, state, volumes } = this;
    const of = (number) => cut(volumes[number], scene.shape, plane, state.cross[plane.across], state);
    if (source !== 'difference') return of(source);
    const [a, b] = state.pair.map(of);
    return b.map((value, i) => value - a[i]);
  }

  step(across, steps) {
    const { scene, state } = this;
    const to = clamp(state.cross[across] + steps, 0, scene.shape[across] - 1);
    if (steps) this.set({ cross: replaced(state.cross, across, to) });
  }

  /** Zooms; the crosshair keeps its place. */
  zoom(factor) {
    const { zoom: old, centre, cross } = this.state;
    const zoom = clamp(old * factor, 0.5, 40);
    this.set({ zoom, centre: centre.map((x, axis) => cross[axis] + ((x - cross[axis]) * old) / zoom) });
  }

  /** A drag to the right widens the window, one downwards raises its level: the picture darkens. */
  drag(dx, dy, source) {
    const { reach, window: [low, high] } = this.state;
    const growth = Math.exp(2 * dx);
    if (source === 'difference') return this.set({ reach: reach * growth });
    const [middle, half] = [(low + high) / 2 + dy * (high - low), ((high - low) / 2) * growth];
    this.set({ window: [middle - half, middle + half] });
  }

  hover(voxel, across) {
    this.under = voxel && { voxel, across };
    this.read();
  }

  /** On a page with other content, the wheel scrolls the page until the viewer is used. */
  takesWheel() {
    return this.root.dataset.wheel === 'page' || this.root.contains(document.activeElement);
  }

  presets() {
    const { is_hounsfield, water, window, range } = this.scene;
    const found = { Automatic: window, 'Full range': range };
    const of = (hu) => (is_hounsfield ? hu : water * (1 + hu / 1000));
    if (is_hounsfield || water) for (const name in TISSUES) found[name] = [-0.5, 0.5].map((half) => of(TISSUES[name][0] + half * TISSUES[name][1]));
    return found;
  }

  name(source) {
    const { pair, phase } = this.state;
    const of = (number) => this.volumes[number].name;
    return source === 'difference' ? `${of(pair[1])} − ${of(pair[0])}` : of(source === 'flicker' ? pair[phase] : source);
  }

  /** Name, label, options or null for a number, value in the state, change of the state, and whether it is of use. */
  controls() {
    const { volumes, columns, planes, scene, state } = this;
    const { mode, pair: [a, b], slab, thickness, window: [low, high] } = state;
    const names = volumes.map(({ name }) => name);
    const presets = this.presets();
    const preset = Object.keys(presets).find((name) => presets[name].join() === state.window.join());
    const titles = Object.fromEntries(planes.map(({ across, title }) => [across, title]));
    // Those before place the primitives.
    const quantities = columns.slice(12).map(({ name, offset, scale }, i) => [i + 12, `${name}, ${text(offset)} to ${text(offset + 65535 * scale)}`]);
    const is_pair = mode !== 'side' && names.length > 2;
    const short = (value) => Number(value.toPrecision(4));
    return [
      ['mode', 'Show', MODES, mode, (mode) => ({ mode }), b || a],
      ['a', 'first', { ...names }, a, (first) => ({ pair: [Number(first), b] }), is_pair || (names.length > 1 && mode === 'one')],
      ['b', 'second', { ...names }, b, (second) => ({ pair: [a, Number(second)] }), is_pair && mode !== 'one'],
      ['layout', 'Planes', { ...titles, all: 'All' }, state.layout, (to) => ({ layout: to === 'all' ? to : Number(to) }), planes.length > 1],
      ['slab', 'Projection', SLABS, slab, (slab) => ({ slab }), true],
      ['layers', 'of layers (0: all)', null, thickness, (n) => ({ thickness: Math.max(0, Math.round(n)) }), slab !== 'slice'],
      ['preset', 'Window', { ...same(Object.keys(presets)), '': 'Own' }, preset || '', (name) => ({ window: presets[name] || state.window }), true],
      ['low', 'from', null, short(low), (low) => ({ window: [low, high] }), true],
      ['high', 'to', null, short(high), (high) => ({ window: [low, high] }), true],
      ['map', 'Colours', same(Object.keys(tables).slice(0, -1)), state.map, (map) => ({ map }), true],
      ['drag', 'Drag', DRAGS, state.drag, (drag) => ({ drag }), true],
      ['model', 'Primitives', { '': 'hidden', ...Object.fromEntries(quantities) }, state.model, (model) => ({ model }), columns.length],
      ['axis', 'Profile along', { ...scene.axes, mark: 'a line' }, state.mark ? 'mark' : state.axis,
        (to) => (to === 'mark' ? { mark: [0, 0, 0] } : { axis: Number(to), mark: null }), true],
    ];
  }

  build() {
    const { root, scene, inputs } = this;
    this.counts = new Plot(this);
    this.line = new Plot(this);
    const labels = this.controls().map(([name, words, options], number) => {
      const choices = Object.entries(options || {}).map(([value, label]) => element('option', { value }, label));
      const input = options ? element('select', { name }, ...choices) : element('input', { type: 'number', name, step: 'any' });
      input.onchange = () => {
        const value = options ? input.value : input.valueAsNumber;
        if (!Number.isNaN(value)) this.set(this.controls()[number][4](value));
      };
      inputs[name] = input;
      return element('label', `${words} `, input);
    });
    const axis = labels.pop();
    const button = (words, onclick) => element('button', { type: 'button', onclick }, words);
    const buttons = [button('Reset', () => this.set(this.start())), button('Keys ?', () => this.sheet.showModal())];
    const plot = (title, { canvas }) => element('div', element('p', title), canvas);
    const row = (line) => element('tr', ...line.split('|').map((cell, i) => element(i ? 'td' : 'th', cell)));
    const close = element('form', { method: 'dialog' }, element('button', 'Close'));
    const table = element('table', ...KEYS.split('\n').map(row));
    this.sheet = element('dialog.trgs-sheet', { 'aria-label': 'Keys' }, close, table);
    this.field = element('div.trgs-planes');
    this.readout = element('div.trgs-readout', { role: 'status' });
    const plots = element('div.trgs-plots', plot('Histogram, window', this.counts), plot(axis, this.line));
    const bar = element('div.trgs-bar', ...labels, ...buttons);
    root.replaceChildren(bar, this.readout, this.field, plots, element('p.note', scene.note || ''), this.sheet);
    root.setAttribute('role', 'group');
    root.setAttribute('aria-label', scene.title);
    root.onkeydown = (event) => this.key(event);
  }

  /** The panes of what is shown. */
  arrange() {
    const { state, volumes, field, scene } = this;
    const each = volumes.map((_, i) => [i]);
    const sources = { one: [[state.pair[0]]], side: each, all: [...each, ['difference']], wipe: [state.pair] }[state.mode] || [[state.mode]];
    const is_focused = field.contains(document.activeElement);
    this.panes = [];
    this.shown = this.planes.filter(({ across }) => ['all', across].includes(state.layout));
    const columns = this.shown.map((plane) => {
      const { across, title } = plane;
      const slider = element('input', { type: 'range', min: 1, max: scene.shape[across], 'aria-label': `${title}, slice` });
      slider.oninput = () => this.step(across, slider.valueAsNumber - 1 - state.cross[across]);
      Object.assign(plane, { slider, count: element('span') });
      const panes = sources.map((of) => {
        const pane = new Pane(this, plane, of);
        this.panes.push(pane);
        pane.caption = element('p');
        return element('div', pane.caption, pane.canvas);
      });
      const head = element('div.trgs-head', element('b', title), slider, plane.count);
      return element('div', head, element('div.trgs-stack', ...panes));
    });
    field.replaceChildren(...columns);
    field.style.setProperty('--planes', columns.length);
    field.style.setProperty('--sources', columns.length === 1 ? sources.length : 1);
    if (is_focused) (this.panes.find(({ plane }) => plane.across === state.active) || this.panes[0]).canvas.focus();
    clearInterval(this.timer);
    const moves = state.mode === 'flicker' && !matchMedia('(prefers-reduced-motion: reduce)').matches;
    if (moves) this.timer = setInterval(() => this.set({ phase: 1 - state.phase }), FLICKER_MS);
  }

  /** Brings controls and text up to date with the state. */
  show() {
    const { state, scene } = this;
    const slice = (across) => `${state.cross[across] + 1} / ${scene.shape[across]}`;
    for (const { across, slider, count } of this.shown) {
      slider.value = state.cross[across] + 1;
      count.textContent = slice(across);
    }
    for (const { sources, caption, canvas, plane: { across, title }, rms } of this.panes) {
      const names = sources.map((source) => this.name(source)).join(' | ');
      const note = sources[0] === 'difference' ? ` RMS ${text(rms)}, blue to red ±${text(state.reach)}` : '';
      caption.replaceChildren(names, element('span.note', note));
      canvas.style.touchAction = state.drag === 'cross' ? 'pan-y' : 'none';
      canvas.setAttribute('aria-label', `${names}, ${title}, ${slice(across)}; arrows move the crosshair, ? lists the keys`);
    }
    for (const [name, , , value, , is_used] of this.controls()) {
      const input = this.inputs[name];
      if (input !== document.activeElement || input.type !== 'number') input.value = value;
      input.parentElement.hidden = !is_used;
    }
    this.read();
  }

  /** Writes what lies under the pointer, or else under the crosshair. */
  read() {
    const { state, scene: { shape, water, is_hounsfield, quantity = '', unit = '', angles, has_sides }, volumes } = this;
    const { voxel, across } = this.under || { voxel: state.cross, across: state.active };
    const values = volumes.map((volume) => value(volume, shape, voxel, across, state));
    const plain = (x) => (is_hounsfield ? '' : `${text(x)} ${quantity}`);
    const hounsfield = (x) => (is_hounsfield || water ? ` ${text(Math.round(water ? 1000 * (x / water - 1) : x))} HU` : '');
    const found = volumes.map(({ name }, i) => `${name} ${plain(values[i])}${hounsfield(values[i])}`);
    if (values.length > 1) found.push(`${this.name('difference')} ${text(values[state.pair[1]] - values[state.pair[0]])}`);
    const place = position(this.scene, voxel).map(text);
    const [one, two, three] = voxel.map((index) => index + 1);
    if (angles) found.push(`view ${one}${angles.length ? `, ${text(angles[voxel[0]])}°` : ''}`, `row ${two}, column ${three}`, `u ${place[2]}, v ${place[1]} ${unit}`);
    else found.push(`voxel ${one}, ${two}, ${three}`, `${has_sides ? 'position L P S' : 'position'} ${place.join(', ')} ${unit}`);
    this.readout.replaceChildren(...found.map((words, i) => element(volumes[i] ? `span.c${i}` : 'span', words)));
  }

  key(event) {
    const { target, key, shiftKey, altKey, metaKey } = event;
    if (altKey || metaKey || this.sheet.open || target.matches('select, [type=number]')) return;
    if (target.matches('[type=range]') && /^(Arrow|Page|Home|End)/.test(key)) return;
    const act = target.matches('button') && key === ' ' ? null : this.action(event, shiftKey ? 10 : 1);
    if (!act) return;
    event.preventDefault();
    if (act instanceof Function) act();
    else this.set(act);
  }

  /** Takes a control to its next option. */
  cycle(input) {
    if (input.parentElement.hidden) return;
    input.selectedIndex = (input.selectedIndex + 1) % input.options.length;
    input.onchange();
  }

  /** What a key does: a change of the state, or a function. */
  action({ key, ctrlKey }, size) {
    const { state, scene: { shape }, planes, volumes } = this;
    const plane = planes.find(({ across }) => across === state.active) || planes[0];
    const arrow = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, -1], ArrowDown: [1, 1] }[key];
    if (arrow) {
      const [axis, steps] = [plane.axes[arrow[0]], arrow[1] * plane.signs[arrow[0]] * size];
      if (!ctrlKey) return () => this.step(axis, steps);
      return { centre: replaced(state.centre, axis, state.centre[axis] + (steps * shape[axis]) / (20 * state.zoom)) };
    }
    if (ctrlKey) return null;
    if (CYCLES[key]) return () => this.cycle(this.inputs[CYCLES[key]]);
    if (key >= '1' && key <= '6') return volumes.length > 1 && { mode: Object.keys(MODES)[key - 1] };
    const [count, first] = [shape[plane.across], this.start()];
    const thicker = (by) => ({ thickness: clamp((state.thickness || count) + by, 1, count) });
    const wipe = (by) => ({ wipe: clamp(state.wipe + by, 0.02, 0.98) });
    const step = (steps) => () => this.step(plane.across, steps);
    const zoom = (factor) => () => this.zoom(factor);
    const drag = (dx, dy) => () => this.drag(dx, dy, state.mode);
    return {
      PageUp: step(size), PageDown: step(-size), Home: step(-count), End: step(count),
      '+': zoom(1.25), '=': zoom(1.25), '-': zoom(0.8), 0: { zoom: 1, centre: first.centre },
      '[': drag(0, -0.05), ']': drag(0, 0.05), '{': drag(-0.05, 0), '}': drag(0.05, 0), a: { window: this.scene.window },
      '<': thicker(-1), '>': thicker(1), '(': wipe(-0.05), ')': wipe(0.05), ' ': { pair: [...state.pair].reverse() }, k: { mark: state.mark ? null : state.cross },
      h: { crosshair: !state.crosshair }, r: first, '?': () => this.sheet.showModal(),
    }[key];
  }
}

async function start(root) {
  const scene = JSON.parse(root.querySelector('script').textContent);
  if (!globalThis.DecompressionStream) root.textContent = 'The viewer needs a browser of 2023 or newer.';
  else return new View(root, scene, ...(await Promise.all([scene.volumes, scene.model].map((all) => Promise.all(all.map(decode))))));
}

if (globalThis.document) globalThis.trgsViews = Promise.all([...document.querySelectorAll('.trgs-viewer')].map(start));
