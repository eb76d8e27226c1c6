/* How well a law explains measured friction, and whether friction has drifted since it was fitted. */

const MOVING = 0.02; /* [rad/s, m/s] slower joints rest */
const SURE = 3; /* standard errors from which on a change is none of chance */
const WORSE = 1.5; /* error over that of the fit, from which on it is told */
const MOST_ROWS = 6000; /* of an autocorrelation */

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

/* Integrated autocorrelation of a residual in rows, at least 1; cut at the first crossing. */
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

/* Of measured friction over a law's: error, level and offset by least squares, with standard
 * errors that count neighbouring rows as alike. */
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

/* What a joint's score says of drift: [kind, sentence]. */
function driftOf(score, { noise, unit, change, shift }) {
  const { level, levelError, offset, offsetError, rmse } = score;
  if (!score.moves) return ["rests", "It rests in this log, so nothing is said of it."];
  if (!Number.isFinite(level)) return ["rests", "The law gives no friction here to compare with."];
  const sure = (value, error) => Math.abs(value) > SURE * error;
  const percent = shown(100 * Math.abs(level - 1), 2);
  if (Math.abs(level - 1) > change && sure(level - 1, levelError)) {
    return ["drift", `Friction is ${percent} % ${level > 1 ? "higher" : "lower"} than the law says.`];
  }
  if (noise && Math.abs(offset) > shift * noise && sure(offset, offsetError)) {
    return ["shift", `The torque is off by ${shown(offset, 2)} ${unit} at a level as fitted: a ` +
      "payload, an error of gravity or a sensor."];
  }
  if (noise && rmse > WORSE * noise) {
    return ["worse", `Its level is as fitted, but the error is ${shown(rmse / noise, 2)} times ` +
      "that of the fit: another motion or temperature than it was fitted to."];
  }
  return ["same", `No: its level is within ${shown(100 * change, 2)} %` +
    (noise ? " and its error is that of the fit." : ".")];
}
