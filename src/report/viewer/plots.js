// The histogram with the window in it, and the profile along a line.

const DASHES = [[], [6, 3], [2, 3], [9, 3, 2, 3]];
// Heights of the bar of colours, and of the numbers below a plot.
const [BAR, FOOT] = [8, 16];

class Plot {
  constructor(view) {
    this.view = view;
    this.canvas = element('canvas.trgs-plot', { role: 'img' });
  }

  /** Clears the plot, and returns its width and the height above the numbers. */
  begin() {
    this.context = cleared(this.canvas);
    this.context.scale(ratio(), ratio());
    this.context.font = '12px system-ui, sans-serif';
    const style = getComputedStyle(this.canvas);
    this.colour = (name) => style.getPropertyValue(name);
    return [this.canvas.clientWidth, this.canvas.clientHeight - FOOT];
  }

  /** A line for each volume. */
  lines(all, width, y) {
    const { context } = this;
    all.forEach((line, number) => {
      Object.assign(context, { strokeStyle: this.colour(`--c${number}`), lineWidth: 1.5 });
      context.setLineDash(DASHES[number]);
      context.beginPath();
      line.forEach((value, i) => context.lineTo((i / Math.max(1, line.length - 1)) * width, y(value)));
      context.stroke();
    });
  }

  bar(x, top, width, height, colour) {
    this.context.fillStyle = colour;
    this.context.fillRect(x, top, width, height);
  }

  label(words, x, y, textAlign) {
    Object.assign(this.context, { fillStyle: this.colour('--quiet'), textAlign });
    this.context.fillText(words, x, y);
  }

  histogram() {
    const { state, scene: { range: [low, high], histograms } } = this.view;
    const [width, foot] = this.begin();
    const bottom = foot - BAR;
    const [from, to] = state.window.map((end) => ((end - low) / (high - low)) * width);
    const [left, right] = [from, to].map((x) => clamp(x, 0, width));
    this.bar(left, 0, right - left, bottom, this.colour('--card'));
    // The height is logarithmic: air would hide all else.
    this.lines(histograms, width, (part) => bottom - Math.max(0, 1 + Math.log10(part) / 6) * (bottom - 4));
    // The colours of the values: those of the window, and its ends on both sides.
    const strip = element('canvas', { width: 256, height: 1 });
    strip.getContext('2d').putImageData(new ImageData(new Uint8ClampedArray(tables[state.map].buffer), 256, 1), 0, 0);
    for (const [at, count, x, size] of [[0, 256, from, to - from], [0, 1, 0, left], [255, 1, right, width - right]]) {
      this.context.drawImage(strip, at, 0, count, 1, x, bottom, size, BAR);
    }
    for (const end of [left, right]) this.bar(clamp(end - 1, 0, width - 2), 0, 2, foot, this.colour('--ink'));
    this.label(text(low), 0, foot + 14, 'left');
    this.label(text(high), width, foot + 14, 'right');
    const ends = state.window.map(text).join(' to ');
    this.canvas.setAttribute('aria-label', `Histogram from ${text(low)} to ${text(high)}, window from ${ends}`);
  }

  /** The line from the mark to the crosshair, or the axis through the crosshair. */
  profile() {
    const { state, scene, volumes } = this.view;
    const [width, bottom] = this.begin();
    const count = scene.shape[state.axis];
    const ends = [0, count - 1].map((end) => state.cross.map((x, axis) => (axis === state.axis ? end : x)));
    const [from, to] = state.mark ? [state.mark, state.cross] : ends;
    const { length, values } = profile(volumes, scene.shape, from, to, scene.spacing);
    const [low, high] = [Math.min(...values.flat()), Math.max(...values.flat())];
    if (!state.mark) this.bar((state.cross[state.axis] / Math.max(1, count - 1)) * width, 14, 1, bottom - 14, this.colour('--quiet'));
    this.lines(values, width, (value) => bottom - 18 - ((value - low) / (high - low || 1)) * (bottom - 34));
    const has_length = !scene.angles || from[0] === to[0];
    const far = has_length ? `${text(length)} ${scene.unit || ''}` : `${values[0].length} views`;
    this.label(text(high), 0, 11, 'left');
    this.label(text(low), 0, bottom - 4, 'left');
    this.label(far, width, bottom + 14, 'right');
    this.canvas.setAttribute('aria-label', `Profile of ${far}: values from ${text(low)} to ${text(high)}`);
  }
}
