// A picture of one plane: placement, drawing, and what a pointer does on it.

const [HALO, LINE] = ['rgba(0, 0, 0, 0.6)', '#ffc24a'];
const ratio = () => window.devicePixelRatio || 1;

/** Gives a canvas the resolution of the screen, and returns its cleared context. */
function cleared(canvas) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio())));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext('2d');
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

/** Shows `sources`, one over the other: numbers of volumes, 'difference' or 'flicker'. */
class Pane {
  constructor(view, plane, sources) {
    Object.assign(this, { view, plane, sources, keys: [], turned: 0 });
    this.canvas = element('canvas.trgs-pane', { tabIndex: 0, role: 'img' });
    this.pictures = sources.map(() => document.createElement('canvas'));
    const end = () => (this.task = null);
    const handlers = {
      wheel: this.wheel, pointerdown: this.down, pointermove: this.move, pointerup: end, pointercancel: end,
      pointerleave: () => view.hover(null), contextmenu: (event) => event.preventDefault(),
      focus: () => (view.state.active = plane.across),
    };
    for (const name in handlers) this.canvas.addEventListener(name, handlers[name].bind(this), { passive: false });
  }

  /** Of both directions: voxels, pixels of the screen per voxel, start of the picture, and places of indices. */
  place() {
    const { canvas, view: { scene, state }, plane: { axes, signs } } = this;
    const sides = [canvas.width, canvas.height];
    const fit = state.zoom * Math.min(...axes.map((axis, i) => sides[i] / (scene.shape[axis] * scene.sides[axis])));
    return axes.map((axis, i) => {
      const [count, scale] = [scene.shape[axis], scene.sides[axis] * fit];
      // Its own inverse.
      const turned = (index) => (signs[i] > 0 ? index : count - 1 - index);
      const pixel = (index) => sides[i] / 2 + (turned(index) - turned(state.centre[axis])) * scale;
      const index = (at) => clamp(turned((at - sides[i] / 2) / scale + turned(state.centre[axis])), 0, count - 1);
      return { count, scale, start: pixel(turned(0)) - scale / 2, index, pixel };
    });
  }

  /** The voxel under a pointer. */
  voxel({ clientX, clientY }) {
    const box = this.canvas.getBoundingClientRect();
    const at = [clientX - box.left, clientY - box.top];
    const found = [...this.view.state.cross];
    this.place().forEach(({ index }, i) => (found[this.plane.axes[i]] = Math.round(index(at[i] * ratio()))));
    return found;
  }

  draw() {
    const { canvas, sources, plane, view: { state } } = this;
    const context = cleared(canvas);
    const [h, v] = this.place();
    const { width, height } = canvas;
    const edge = sources.length > 1 && state.wipe * width;
    sources.forEach((source, layer) => {
      this.refresh(source, layer, h.count, v.count);
      context.save();
      context.beginPath();
      context.rect(layer && edge, 0, layer || !edge ? width : edge, height);
      context.clip();
      context.imageSmoothingEnabled = h.scale < 1;
      context.drawImage(this.pictures[layer], h.start, v.start, h.count * h.scale, v.count * v.scale);
      context.restore();
    });
    if (state.model) ellipses(this, context, h, v);
    const at = (voxel) => [h.pixel(voxel[plane.axes[0]]), v.pixel(voxel[plane.axes[1]])];
    const [[x, y], gap] = [at(state.cross).map((place) => Math.floor(place) + 0.5), 8 * ratio()];
    const lines = [[0, y, x - gap, y], [x + gap, y, width, y], [x, 0, x, y - gap], [x, y + gap, x, height]];
    if (state.crosshair) this.stroke(context, lines, 1);
    if (edge) this.stroke(context, [[edge, 0, edge, height]], 2);
    if (state.mark) this.stroke(context, [[...at(state.mark), x, y]], 2);
    this.letters(context, width, height);
  }

  /** Paints a source anew if it has changed. */
  refresh(shown, layer, width, height) {
    const { view, plane, view: { state, scene } } = this;
    const source = shown === 'flicker' ? state.pair[state.phase] : shown;
    const [ends, map] = shown === 'difference' ? [[-state.reach, state.reach], 'Difference'] : [state.window, state.map];
    const slab = layers(scene.shape[plane.across], state.cross[plane.across], state);
    const key = [source, state.pair, slab, state.slab, ends, map].join();
    if (this.keys[layer] === key) return;
    this.keys[layer] = key;
    const values = view.cut(plane, source);
    this.rms = Math.sqrt(values.reduce((sum, d) => sum + d * d, 0) / values.length);
    Object.assign(this.pictures[layer], { width, height });
    const context = this.pictures[layer].getContext('2d');
    const image = context.createImageData(width, height);
    paint(values, ends, tables[map], new Uint32Array(image.data.buffer));
    context.putImageData(image, 0, 0);
  }

  stroke(context, lines, width) {
    for (const [strokeStyle, extra] of [[HALO, 2], [LINE, 0]]) {
      Object.assign(context, { strokeStyle, lineWidth: width * ratio() + extra });
      context.beginPath();
      for (const [x0, y0, x1, y1] of lines) {
        context.moveTo(x0, y0);
        context.lineTo(x1, y1);
      }
      context.stroke();
    }
  }

  letters(context, width, height) {
    const [[left, right], [top, bottom]] = this.plane.ends;
    const inset = 12 * ratio();
    const style = { font: `600 ${14 * ratio()}px system-ui, sans-serif`, textBaseline: 'middle', strokeStyle: HALO, fillStyle: '#fff' };
    Object.assign(context, style, { lineWidth: 3 * ratio() });
    const places = [[left, 'left', inset, height / 2], [right, 'right', width - inset, height / 2],
      [top, 'center', width / 2, inset], [bottom, 'center', width / 2, height - inset]];
    for (const [letter, textAlign, x, y] of places) {
      Object.assign(context, { textAlign });
      context.strokeText(letter, x, y);
      context.fillText(letter, x, y);
    }
  }

  /** Steps through the slices; fractions of a step add up. */
  turn(steps) {
    const whole = Math.trunc(this.turned + steps);
    this.turned += steps - whole;
    this.view.step(this.plane.across, whole);
  }

  wheel(event) {
    const { view } = this;
    const { deltaY, deltaMode, ctrlKey } = event;
    if (!view.takesWheel()) return;
    event.preventDefault();
    // A notch of a wheel is one slice; a touchpad sends many small steps.
    if (ctrlKey) view.zoom(Math.exp(-deltaY / 300));
    else this.turn(deltaMode || Math.abs(deltaY) >= 50 ? Math.sign(deltaY) : deltaY / 40);
  }

  down(event) {
    const { canvas, view, view: { state }, sources } = this;
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    const is_at_edge = sources.length > 1 && Math.abs(event.offsetX - state.wipe * canvas.clientWidth) < 10;
    this.task = is_at_edge ? 'wipe' : event.shiftKey ? 'line' : [state.drag, 'pan', 'window'][event.button];
    this.last = event;
    if (event.button) event.preventDefault();
    if (this.task === 'line') view.set({ mark: this.voxel(event) });
    this.move(event);
  }

  move(event) {
    const { view, canvas, last, sources } = this;
    if (!this.task) return view.hover(this.voxel(event), this.plane.across);
    const [dx, dy] = [event.clientX - last.clientX, event.clientY - last.clientY];
    const cross = () => view.set({ cross: this.voxel(event) });
    const tasks = {
      line: cross, cross,
      window: () => view.drag(dx / canvas.clientWidth, dy / canvas.clientHeight, sources[0]),
      zoom: () => view.zoom(Math.exp(-dy / 150)),
      pan: () => this.pan(dx, dy),
      wipe: () => view.set({ wipe: clamp(event.offsetX / canvas.clientWidth, 0.02, 0.98) }),
      slice: () => this.turn(dx / 6),
    };
    tasks[this.task]();
    this.last = event;
  }

  pan(dx, dy) {
    const { view, plane: { axes, signs } } = this;
    const centre = [...view.state.centre];
    this.place().forEach(({ scale }, i) => (centre[axes[i]] -= (signs[i] * [dx, dy][i] * ratio()) / scale));
    view.set({ centre });
  }
}
