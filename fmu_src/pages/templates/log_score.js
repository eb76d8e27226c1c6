/* Error of a law against measured friction, and drift since the fit. */

const MOVING = 0.02; /* [rad/s, m/s] slower joints rest */
const SURE = 3; /* significance threshold of a change, in standard errors */
const WORSE = 1.5; /* reporting threshold of the error, relative to that of the fit */
const MOST_ROWS = 6000; /* maximum rows of an autocorrelation */

function mean(values) {
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

function extremes(values) {
  return values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
}

function rms(values) {
  return Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
}

function deviation(values) {
  const middle = mean(values);
  return rms(values.map((value) => value - middle));
}

/* Integrated autocorrelation of a residual in rows, at least 1, cut at the first crossing. */
function correlationLength(residual) {
  const every = Math.ceil(residual.length / MOST_ROWS), middle = mean(residual);
  const x = residual.filter((_, k) => k % every === 0).map((value) => value - middle);
  const at = (lag) => {
    let sum = 0;
    for (let k = lag; k < x.length; k++) sum += x[k] * x[k - lag];
    return sum;
  };
  const whole = at(0);
  let length = 1;
  for (let lag = 1; whole > 0 && lag < x.length / 4; lag++) {
    const share = at(lag) / whole;
    if (share <= 0) break;
    length += 2 * share;
  }
  return every * length;
}

/* Error, level and offset of measured friction against a law, by least squares, with standard
 * errors for correlated rows. */
function scoreOf(measured, law, dq) {
  const residual = measured.map((value, k) => value - law[k]);
  const n = law.length, middle = mean(law), centre = mean(measured);
  let spread = 0, common = 0;
  for (let k = 0; k < n; k++) {
    spread += (law[k] - middle) ** 2;
    common += (law[k] - middle) * (measured[k] - centre);
  }
  const rmse = rms(residual);
  const moves = dq.some((v) => Math.abs(v) > MOVING);
  const level = moves && spread > 0 ? common / spread : NaN;
  const left = measured.map((value, k) => value - centre - level * (law[k] - middle));
  const noise = rms(left) * Math.sqrt(n / Math.max(n - 2, 1) * correlationLength(left));
  return {
    residual, rmse, nrmse: rmse / deviation(measured), moves, level,
    levelError: noise / Math.sqrt(spread),
    offset: centre - middle, offsetError: noise / Math.sqrt(n),
  };
}

/* Drift of a joint: [kind, sentence]. */
function driftOf(score, { noise, unit, change, shift }) {
  const { level, levelError, offset, offsetError, rmse } = score;
  if (!score.moves) return ["rests", "The joint rests in this log."];
  if (!Number.isFinite(level)) return ["rests", "The law gives no friction in this log."];
  const sure = (value, error) => Math.abs(value) > SURE * error;
  const percent = shown(100 * Math.abs(level - 1), 2);
  if (Math.abs(level - 1) > change && sure(level - 1, levelError)) {
    return ["drift", `Friction is ${percent} % ${level > 1 ? "higher" : "lower"} than the law.`];
  }
  if (noise && Math.abs(offset) > shift * noise && sure(offset, offsetError)) {
    return ["shift", `The torque is off by ${shown(offset, 2)} ${unit} at the fitted level: ` +
      "payload, gravity error or sensor."];
  }
  if (noise && rmse > WORSE * noise) {
    return ["worse", `The level is as fitted, but the error is ${shown(rmse / noise, 2)} times ` +
      "that of the fit: a different motion or temperature."];
  }
  return ["same", `No: the level is within ${shown(100 * change, 2)} %` +
    (noise ? " and the error is that of the fit." : ".")];
}
