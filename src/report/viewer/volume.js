// Volumes without a page: decoding, values, planes, projections. Node tests this file.
//
// A volume holds whole numbers q in memory order, the last of its three axes fastest; its values are offset + scale·q.
const strides = (shape) => [shape[1] * shape[2], shape[2], 1];
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** The numbers of base64 text: deflated, each the difference to the one before; of 16 bits, folded, high bytes first. */
async function numbers(base64, bits) {
  const packed = Uint8Array.fromBase64?.(base64) ?? Uint8Array.from(atob(base64), (char) => char.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate-raw'));
  const coded = new Uint8Array(await new Response(stream).arrayBuffer());
  if (bits === 8) {
    for (let i = 1; i < coded.length; i++) coded[i] += coded[i - 1];
    return coded;
  }
  const out = new Uint16Array(coded.length / 2);
  for (let i = 0, last = 0; i < out.length; i++) {
    const folded = (coded[i] << 8) | coded[out.length + i];
    out[i] = last += (folded >> 1) ^ -(folded & 1);
  }
  return out;
}

const decode = async ({ name, bits, offset, scale, data }) => ({ name, offset, scale, q: await numbers(data, bits) });

/** The first layer and the number of layers of a slab about one layer; all of them if its thickness is 0. */
function layers(count, index, { slab, thickness }) {
  if (slab === 'slice') return [index, 1];
  const first = thickness ? clamp(index - ((thickness - 1) >> 1), 0, count - 1) : 0;
  return [first, Math.min(thickness || count, count - first)];
}

/** Values over three nested loops of [count, step in memory, step in the output]; the last loop is the slab's. */
function reduce({ q, offset, scale }, from, loops, size, mode) {
  const depth = loops[2][0];
  loops.sort((a, b) => Math.abs(b[1]) - Math.abs(a[1]));
  const [[n0, in0, out0], [n1, in1, out1], [n2, in2, out2]] = loops;
  const is_mean = mode === 'mean';
  const out = new Float32Array(size).fill(is_mean ? 0 : -Infinity);
  for (let a = 0; a < n0; a++) {
    for (let b = 0; b < n1; b++) {
      let [at, to] = [from + a * in0 + b * in1, a * out0 + b * out1];
      for (let c = 0; c < n2; c++, at += in2, to += out2) {
        if (is_mean) out[to] += q[at];
        else if (q[at] > out[to]) out[to] = q[at];
      }
    }
  }
  return out.map((level) => offset + (scale * level) / (is_mean ? depth : 1));
}

/**
 * The values of a plane as rows from its top left corner. `plane` is { across, axes: [horizontal, vertical], signs }: a
 * sign of 1 says that the index grows to the right or downwards.
 */
function cut(volume, shape, { across, axes, signs }, index, state) {
  const stride = strides(shape);
  const [first, depth] = layers(shape[across], index, state);
  const counts = axes.map((axis) => shape[axis]);
  const steps = axes.map((axis, i) => signs[i] * stride[axis]);
  const corner = steps.reduce((sum, step, i) => sum - Math.min(0, step * (counts[i] - 1)), first * stride[across]);
  const loops = [[counts[0], steps[0], 1], [counts[1], steps[1], counts[0]], [depth, stride[across], 0]];
  return reduce(volume, corner, loops, counts[0] * counts[1], state.slab);
}

/** The value of a voxel, or of the slab through it across an axis. */
function value(volume, shape, voxel, across, state) {
  const stride = strides(shape);
  const [first, depth] = layers(shape[across], voxel[across], state);
  const from = voxel.reduce((sum, index, axis) => sum + (axis === across ? first : index) * stride[axis], 0);
  return reduce(volume, from, [[1, 0, 0], [1, 0, 0], [depth, stride[across], 0]], 1, state.slab)[0];
}

/** The length of a line between two voxels, and the values of each volume in the voxels nearest to it. */
function profile(volumes, shape, from, to, spacing) {
  const way = to.map((x, axis) => x - from[axis]);
  const steps = Math.max(1, ...way.map(Math.abs));
  const stride = strides(shape);
  const nearest = (i) => from.reduce((sum, x, axis) => sum + Math.round(x + (way[axis] * i) / steps) * stride[axis], 0);
  const voxels = Array.from({ length: steps + 1 }, (_, i) => nearest(i));
  const values = volumes.map(({ q, offset, scale }) => voxels.map((voxel) => offset + scale * q[voxel]));
  return { length: Math.hypot(...way.map((x, axis) => x * spacing[axis])), values };
}

/** The position of a voxel in the unit of the scan. */
const position = ({ origin, spacing, directions }, voxel) =>
  origin.map((start, row) => voxel.reduce((sum, i, axis) => sum + directions[axis][row] * spacing[axis] * i, start));
