// Primitives cut by a plane. Pages without a model do not carry this file.

/**
 * Where a plane cuts an ellipsoid: centre, half axes and angle of the ellipse, in voxels; null beside it. A row has the
 * centre (3) and the rows of the factor F of the ellipsoid's matrix F·Fᵀ (9).
 */
function section(row, { across, axes: [h, v] }, index) {
  const product = (a, b) => [3, 4, 5].reduce((sum, c) => sum + row[c + 3 * a] * row[c + 3 * b], 0);
  const [depth, away] = [product(across, across), index - row[across]];
  const rest = 1 - (away * away) / depth;
  if (rest < 0) return null;
  const part = (a, b) => rest * (product(a, b) - (product(a, across) * product(b, across)) / depth);
  const centre = (a) => row[a] + (product(a, across) * away) / depth;
  const [p, q, r] = [part(h, h), part(h, v), part(v, v)];
  const root = Math.hypot((p - r) / 2, q);
  const half = (sign) => Math.sqrt(Math.max(0, (p + r) / 2 + sign * root));
  return [centre(h), centre(v), half(1), half(-1), Math.atan2(2 * q, p - r) / 2];
}

/** The ellipses in which the plane cuts primitives, coloured by a column of the model. */
function ellipses({ plane, view: { columns, rows, state: { model, cross } } }, context, h, v) {
  const { offset, scale } = columns[model];
  const colours = new Uint8Array(tables.Viridis.buffer);
  context.lineWidth = ratio();
  for (const row of rows) {
    const found = section(row, plane, cross[plane.across]);
    if (!found) continue;
    const [x, y, a, b, angle] = found;
    const first = 4 * Math.round((row[model] - offset) / scale / 257);
    context.strokeStyle = `rgb(${colours.slice(first, first + 3)})`;
    context.setTransform(h.scale * plane.signs[0], 0, 0, v.scale * plane.signs[1], h.pixel(x), v.pixel(y));
    context.beginPath();
    context.ellipse(0, 0, a, b, angle, 0, 7);
    // Lines are as wide as elsewhere.
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.stroke();
  }
}
