'use strict';
// Samples: how they come out of the page, and which of them a plot of so many pixels needs.

/** Return the bytes of a blob of the page. */
async function inflated(name) {
  const text = document.querySelector(`[data-name="${name}"]`).textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Undo packed() of packing.py; returns an array of Kind, Float32Array or Uint32Array. */
async function unpacked(name, Kind) {
  const bytes = await inflated(name);
  const count = bytes.length / 4;
  const bits = new Uint32Array(count);
  let sum = 0;
  for (let i = 0; i < count; i++) {
    sum = (sum + (bytes[i] | bytes[count + i] << 8 | bytes[2 * count + i] << 16
                  | bytes[3 * count + i] << 24)) >>> 0;
    bits[i] = sum;
  }
  return new Kind(bits.buffer);
}

/** Return the index of the first of the rising times that is not below the given one. */
function firstAt(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1; else high = middle;
  }
  return low;
}

/**
 * Return {x, y, all, count}: the count samples from one time to another, and one beyond each end.
 *
 * More than two a bin are thinned to the least and the largest value of each bin, in their order:
 * a line through them covers the same pixels, and no peak is lost. all tells whether they are all.
 */
function thinned(times, values, from, to, bins) {
  const first = Math.max(firstAt(times, from) - 1, 0);
  const last = Math.min(firstAt(times, to) + 1, times.length);
  if (last - first <= 2 * bins) {
    return {x: Array.from(times.subarray(first, last)),
            y: Array.from(values.subarray(first, last)), all: true, count: last - first};
  }
  const x = [];
  const y = [];
  let i = first;
  for (let bin = 1; bin <= bins + 1 && i < last; bin++) {
    const border = from + (to - from) * bin / bins;
    const end = bin > bins ? last : Math.min(last, firstAt(times, border));
    if (i >= end) continue;
    let least = i;
    let largest = i;
    for (; i < end; i++) {
      if (values[i] < values[least]) least = i;
      if (values[i] > values[largest]) largest = i;
    }
    for (const at of new Set([Math.min(least, largest), Math.max(least, largest)])) {
      x.push(times[at]);
      y.push(values[at]);
    }
  }
  return {x, y, all: false, count: last - first};
}

/**
 * Return functions of sample numbers on the plane of xs and ys, seen through a box.
 *
 * The box is {x: [low, high], y: [low, high], width, height}, the latter in pixels. cell(i)
 * numbers the pixel of a sample, those far outside together; touches(i, j) is false where no part
 * of the line between the two can be seen; isNew(i, j) is true once for all lines between two
 * pixels.
 */
function plane(xs, ys, box) {
  const columns = 9 * box.width + 1;
  const rows = 9 * box.height + 1;
  const place = (value, [low, high], pixels) => Math.floor(
    Math.min(Math.max((value - low) / (high - low) + 4, 0), 9) * pixels);
  const apart = (a, b, [low, high]) => Math.max(a, b) < low || Math.min(a, b) > high;
  const cell = (i) => place(xs[i], box.x, box.width) * rows + place(ys[i], box.y, box.height);
  const touches = (i, j) => !apart(xs[i], xs[j], box.x) && !apart(ys[i], ys[j], box.y);
  const seen = new Set();
  const isNew = (i, j) => seen.size < seen.add(cell(i) * columns * rows + cell(j)).size;
  return {cell, touches, isNew};
}

/** Return {x, y} of the line through all samples as the box shows it; null lifts the pen. */
function path(xs, ys, box) {
  const {cell, touches, isNew} = plane(xs, ys, box);
  const x = [];
  const y = [];
  let down = false;
  for (let i = 1; i < xs.length; i++) {
    if (cell(i) === cell(i - 1)) continue;
    if (!touches(i - 1, i) || !isNew(i - 1, i)) {
      down = false;
      continue;
    }
    if (!down) {
      x.push(null, xs[i - 1]);
      y.push(null, ys[i - 1]);
    }
    x.push(xs[i]);
    y.push(ys[i]);
    down = true;
  }
  return {x, y};
}

/** Return {x, y} of the lines from each of some samples to the next one. */
function jumps(xs, ys, samples, box) {
  const {touches, isNew} = plane(xs, ys, box);
  const x = [];
  const y = [];
  for (const i of samples) {
    const j = Math.min(i + 1, xs.length - 1);
    if (!touches(i, j) || !isNew(i, j)) continue;
    x.push(xs[i], xs[j], null);
    y.push(ys[i], ys[j], null);
  }
  return {x, y};
}
