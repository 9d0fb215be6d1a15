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
      if (values[i] < values[least] || Number.isNaN(values[least])) least = i;
      if (values[i] > values[largest] || Number.isNaN(values[largest])) largest = i;
    }
    for (const at of new Set([Math.min(least, largest), Math.max(least, largest)])) {
      x.push(times[at]);
      y.push(values[at]);
    }
  }
  return {x, y, all: false, count: last - first};
}

/**
 * The pixels of a box on the plane of xs and ys, and which of them are covered by lines.
 *
 * The box is {x: [low, high], y: [low, high], width, height}, the latter in pixels.
 */
class Canvas {
  constructor(xs, ys, box) {
    this.width = Math.ceil(box.width);
    this.height = Math.ceil(box.height);
    this.right = (i) => (xs[i] - box.x[0]) / (box.x[1] - box.x[0]) * this.width;
    this.up = (i) => (ys[i] - box.y[0]) / (box.y[1] - box.y[0]) * this.height;
    this.covered = new Uint8Array(this.width * this.height);
  }

  /** Return the number of the pixel of a sample, or -1 outside. */
  pixel(i) {
    const [column, row] = [Math.floor(this.right(i)), Math.floor(this.up(i))];
    const inside = column >= 0 && column < this.width && row >= 0 && row < this.height;
    return inside ? row * this.width + column : -1;
  }

  /** Tell whether two samples are in one pixel. */
  isSame(i, j) {
    return Math.floor(this.right(i)) === Math.floor(this.right(j))
      && Math.floor(this.up(i)) === Math.floor(this.up(j));
  }

  /** Cover the line from sample i to j; returns whether that can be seen. */
  cover(i, j) {
    const [x, y] = [this.right(i), this.up(i)];
    const [dx, dy] = [this.right(j) - x, this.up(j) - y];
    const [left, right] = within(x, dx, this.width);
    const [below, above] = within(y, dy, this.height);
    const start = Math.max(left, below, 0);
    const end = Math.min(right, above, 1);
    if (!(start <= end)) return false;
    const steps = Math.ceil(Math.max(Math.abs(dx), Math.abs(dy)) * (end - start)) || 1;
    let isSeen = false;
    for (let k = 0; k <= steps; k++) {
      const share = start + (end - start) * k / steps;
      const column = Math.min(Math.max(Math.floor(x + share * dx), 0), this.width - 1);
      const row = Math.min(Math.max(Math.floor(y + share * dy), 0), this.height - 1);
      const at = row * this.width + column;
      isSeen = isSeen || !this.covered[at];
      this.covered[at] = 1;
    }
    return isSeen;
  }
}

/** Return the shares of a way from a place at which it enters and leaves the pixels of a size. */
function within(place, way, size) {
  if (way === 0) return place >= 0 && place <= size ? [0, 1] : [1, 0];
  const ends = [-place / way, (size - place) / way];
  return [Math.min(...ends), Math.max(...ends)];
}

/**
 * Return {x, y} of the line through all samples as the box shows it; null lifts the pen.
 *
 * What lies outside, or on what is drawn already, is left out.
 */
function path(xs, ys, box) {
  const canvas = new Canvas(xs, ys, box);
  const x = [];
  const y = [];
  let down = false;
  for (let i = 1; i < xs.length; i++) {
    if (canvas.isSame(i - 1, i)) continue;
    if (!canvas.cover(i - 1, i)) {
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

/**
 * Return {x, y} of the lines from each of some samples to the next one, each with a null after it.
 *
 * One is left out where neither the line nor the pixel that it starts from adds anything.
 */
function jumps(xs, ys, samples, box) {
  const canvas = new Canvas(xs, ys, box);
  const starts = new Set([-1]);
  const x = [];
  const y = [];
  for (const i of samples) {
    const j = Math.min(i + 1, xs.length - 1);
    const pixel = canvas.pixel(i);
    if (!canvas.cover(i, j) && starts.has(pixel)) continue;
    starts.add(pixel);
    x.push(xs[i], xs[j], null);
    y.push(ys[i], ys[j], null);
  }
  return {x, y};
}
