// Colours: tables of 256 colours, each readable with any colour vision, and numbers as text.
const anchors = {
  Grey: '000000 ffffff',
  'Grey, inverted': 'ffffff 000000',
  Viridis: '440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725',
  Cividis: '00224e 123570 3b496c 575d6d 707173 8a8678 a59c74 c3b369 e1cc55 fee838',
  // Blue below, white at the middle, red above.
  Difference: '053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f',
};

/** 256 pixels as ImageData holds them, between equally spaced anchors. */
function table(name) {
  const colours = anchors[name].split(' ').map((hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  return Uint32Array.from({ length: 256 }, (_, level) => {
    const place = (level / 255) * (colours.length - 1);
    const low = Math.min(Math.floor(place), colours.length - 2);
    const [r, g, b] = colours[low].map((c, i) => Math.round(c + (colours[low + 1][i] - c) * (place - low)));
    return (255 << 24) | (b << 16) | (g << 8) | r;
  });
}

const tables = Object.fromEntries(Object.keys(anchors).map((name) => [name, table(name)]));

/** Colours of values: the first of the table up to `low`, its last from `high` on. */
function paint(values, [low, high], colours, pixels) {
  const factor = 255 / (high - low);
  for (let i = 0; i < values.length; i++) {
    const place = (values[i] - low) * factor + 0.5;
    pixels[i] = colours[place > 255 ? 255 : place > 0 ? place | 0 : 0];
  }
}

/** A number with four significant digits and a typographic minus. */
function text(value) {
  const rounded = Number(value.toPrecision(4));
  const size = Math.abs(rounded);
  return (size && (size < 1e-4 || size >= 1e6) ? rounded.toExponential() : String(rounded)).replaceAll('-', '−');
}
