/* Smoothing of a log's motion, equal to hesr_model/logs/signals.py and robot_log.py. */

const LONGEST_GAP = 10; /* in usual steps */
const USUAL = 0.95; /* fraction of the shortest steps that define the usual step */
const SHORTEST_PART = 1; /* [s] */
const PADDING_PERIODS = 3;
const HIGHEST_SHARE = 0.8; /* fraction of the Nyquist frequency */

const differences = (t) => t.slice(1).map((value, k) => value - t[k]);

/* First and last row, exclusive, of the parts between gaps. */
function partsOf(t) {
  const steps = differences(t), sorted = Float64Array.from(steps).sort();
  const kept = sorted.filter((step) => step <= sorted[Math.floor(USUAL * (sorted.length - 1))]);
  const usual = kept.reduce((sum, step) => sum + step, 0) / kept.length;
  const longest = LONGEST_GAP * Math.max(median(steps), usual);
  const ends = [0];
  steps.forEach((step, k) => step > longest && ends.push(k + 1));
  ends.push(t.length);
  const parts = ends.slice(1).map((end, k) => [ends[k], end]);
  if (parts.length === 1) return parts;
  return parts.filter(([first, last]) => t[last - 1] - t[first] >= SHORTEST_PART);
}

function basis(knots, k, span, x, out) {
  out[0] = 1;
  for (let d = 1; d <= k; d++) {
    let saved = 0;
    for (let r = 0; r < d; r++) {
      const right = knots[span + r + 1], left = knots[span + 1 - d + r];
      const part = out[r] / (right - left);
      out[r] = saved + (right - x) * part;
      saved = (x - left) * part;
    }
    out[d] = saved;
  }
}

/* Call `use` with the first coefficient and the weights of each point, which rise. */
function eachRow(knots, k, points, use) {
  const last = knots.length - k - 2, row = new Float64Array(k + 1);
  let span = k;
  points.forEach((x, i) => {
    while (span < last && x >= knots[span + 1]) span++;
    basis(knots, k, span, x, row);
    use(i, span - k, row);
  });
}

/* Splines of odd degree through values at x, without a knot next to the ends (de Boor). The matrix
 * is totally positive: no pivoting. */
class Spline {
  constructor(x, k) {
    const n = x.length, half = (k + 1) / 2, ends = (value) => new Array(k + 1).fill(value);
    this.k = k;
    this.knots = Float64Array.from(
      [...ends(x[0]), ...x.subarray(half, n - half), ...ends(x[n - 1])]);
    const width = 2 * k + 1, band = new Float64Array(n * width); /* row i, columns i - k to i + k */
    eachRow(this.knots, k, x, (i, first, row) => band.set(row, i * width + first - i + k));
    for (let i = 0; i < n; i++) {
      for (let j = i + 1; j <= Math.min(i + k, n - 1); j++) {
        const at = j * width + i - j + k, factor = band[at] / band[i * width + k];
        band[at] = factor;
        if (factor) for (let c = 1; c <= k; c++) band[at + c] -= factor * band[i * width + k + c];
      }
    }
    this.band = band;
  }

  coefficients(values) {
    const { k, band } = this, width = 2 * k + 1, c = Float64Array.from(values), n = c.length;
    for (let i = 0; i < n; i++) {
      for (let j = Math.max(0, i - k); j < i; j++) c[i] -= band[i * width + j - i + k] * c[j];
    }
    for (let i = n - 1; i >= 0; i--) {
      for (let j = i + 1; j <= Math.min(i + k, n - 1); j++) c[i] -= band[i * width + j - i + k] * c[j];
      c[i] /= band[i * width + k];
    }
    return c;
  }
}

/* Values of a derivative of a spline, one of lower degree on the inner knots. */
function derived({ knots, k }, c, order, points) {
  for (; order; order--, k--) {
    c = c.slice(1).map((value, i) => k * (value - c[i]) / (knots[i + k + 1] - knots[i + 1]));
    knots = knots.subarray(1, knots.length - 1);
  }
  const found = new Float64Array(points.length);
  eachRow(knots, k, points, (i, first, row) => {
    for (let r = 0; r <= k; r++) found[i] += row[r] * c[first + r];
  });
  return found;
}

/* Second-order Butterworth low-pass filter, forwards and backwards, with mirrored ends. */
function lowPassed(values, cutoff, rate, padding) {
  const w = Math.tan(Math.PI * cutoff / rate), a0 = 1 + Math.SQRT2 * w + w * w;
  const b = w * w / a0, a1 = 2 * (w * w - 1) / a0, a2 = (1 - Math.SQRT2 * w + w * w) / a0;
  const n = values.length, x = new Float64Array(n + 2 * padding);
  x.set(values, padding);
  const near = Math.round(2 * padding / PADDING_PERIODS) + 1;
  /* First and last value of parabolas through the nearest rows. */
  let first = 0, last = 0;
  for (let k = 0; k < near; k++) {
    const weight = (3 * (3 * near * near - 3 * near + 2) - 18 * (2 * near - 1) * k + 30 * k * k) /
      (near * (near + 1) * (near + 2));
    first += weight * values[k];
    last += weight * values[n - 1 - k];
  }
  for (let k = 1; k <= padding; k++) {
    x[padding - k] = 2 * first - values[k];
    x[padding + n - 1 + k] = 2 * last - values[n - 1 - k];
  }
  const once = () => {
    let z0 = (1 - b) * x[0], z1 = (b - a2) * x[0];
    for (let k = 0; k < x.length; k++) {
      const y = b * x[k] + z0;
      z0 = 2 * b * x[k] - a1 * y + z1;
      z1 = b * x[k] - a2 * y;
      x[k] = y;
    }
    x.reverse();
  };
  once();
  once();
  return x.slice(padding, padding + n);
}

/* Cut-off [Hz]: as requested, or lower for a slow log. */
function cutoffFor(period, wanted) {
  const rate = 1 / period;
  return wanted <= 0.4 * rate || rate < 1 ? wanted : Number((0.3 * rate).toPrecision(2));
}

/* Smoothed columns as functions of the derivative order. */
function smoothed(t, columns, cutoff) {
  const period = median(differences(t)), span = t[t.length - 1] - t[0];
  if (cutoff > HIGHEST_SHARE * 0.5 / period) {
    throw new LogError(`its rows are ${short(period, 3)} s apart, too slow for a cut-off of ` +
      `${short(cutoff)} Hz; the maximum is ${short(HIGHEST_SHARE * 0.5 / period, 3)} Hz.`);
  }
  const steps = Math.max(Math.ceil(span / period), 1);
  const padding = Math.ceil(PADDING_PERIODS / (cutoff * period));
  if (steps <= padding || t.length < 6) {
    throw new LogError(`a cut-off of ${short(cutoff)} Hz needs more than ${padding + 1} rows ` +
      `without a gap; there are ${t.length}.`);
  }
  const step = span / steps;
  const grid = Float64Array.from({ length: steps + 1 }, (_, k) => k * step + t[0]);
  grid[steps] = t[t.length - 1];
  const into = new Spline(t, 3), outOf = new Spline(grid, 5), rate = steps / (grid[steps] - grid[0]);
  return columns.map((column) => {
    const even = derived(into, into.coefficients(column), 0, grid);
    const c = outOf.coefficients(lowPassed(even, cutoff, rate, padding));
    return (order) => derived(outOf, c, order, t);
  });
}
