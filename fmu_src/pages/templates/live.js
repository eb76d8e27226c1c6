/* Runs the FMU of each section of class "live" through a motion and draws the result. */

const AXES = {
  velocity: { column: "dq", text: "velocity q̇" },
  position: { column: "q", text: "position q" },
  time: { column: "t", text: "time" },
};
const STEPS = 200; /* steps of a slider */

class Fmu {
  static async from(text) {
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const { instance } = await WebAssembly.instantiate(await new Response(stream).arrayBuffer());
    return new Fmu(instance.exports);
  }

  constructor(functions) {
    this.fmu = functions;
  }

  heard() {
    const bytes = new Uint8Array(this.fmu.memory.buffer, this.fmu.live_heard());
    return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
  }

  /* Torque of a joint up to a refusal of the FMU, with its message. As in a replayed log: set row k of
   * the inputs, step to it, read it. */
  run({ references, coefficients }, values, motion) {
    const { fmu } = this, { t } = motion, torque = [];
    const inputs = ["dq", "q", "tau_load"].map((name) => [references[name], motion[name]]);
    const put = (k) => inputs.some(([reference, column]) => fmu.live_set(reference, column[k]));
    let failed = fmu.live_reset() ||
      coefficients.some((c) => fmu.live_set(c.reference, values[keyOf(c)])) ||
      put(0) || fmu.live_initialise();
    for (let k = 0; !failed && k < t.length; k++) {
      failed = k > 0 && (put(k) || fmu.live_step(t[k - 1] - t[0], t[k] - t[k - 1]));
      if (!failed) torque.push(fmu.live_get(references.tau));
    }
    return { torque, refused: failed ? this.heard() || "It gives no reason." : "" };
  }
}

function motionOf({ amplitude, frequency, cycles, centre = 0, load = 0 }, step) {
  const cycle = Math.max(2, Math.round(1 / (frequency * step)));
  const rate = 2 * Math.PI * frequency;
  const t = Array.from({ length: cycles * cycle + 1 }, (_, k) => k * step);
  return {
    step, cycle, t,
    dq: t.map((s) => amplitude * Math.sin(rate * s)),
    q: t.map((s) => centre - (amplitude / rate) * Math.cos(rate * s)),
    tau_load: t.map(() => load),
  };
}

/* Largest torque and dissipated work (trapezoidal rule) of the last cycle; NaN if the run ended
 * before. */
function figures(motion, torque) {
  const last = torque.length - 1;
  if (last < motion.t.length - 1) return [NaN, NaN];
  let largest = 0, work = 0;
  for (let k = last - motion.cycle; k <= last; k++) {
    largest = Math.max(largest, Math.abs(torque[k]));
    if (k < last) {
      work += 0.5 * motion.step * (torque[k] * motion.dq[k] + torque[k + 1] * motion.dq[k + 1]);
    }
  }
  return [largest, work];
}

/* Key of a knob's value; coefficients may have any name. */
const keyOf = (knob) => knob.reference ?? knob.name;

/* Position of a value on its slider, 0 to 1, and the inverse. */
function positionOf(knob, value) {
  const share = knob.scale === "log"
    ? Math.log(value / knob.low) / Math.log(knob.high / knob.low)
    : (value - knob.low) / (knob.high - knob.low);
  return Math.min(1, Math.max(0, Number.isNaN(share) ? 0 : share));
}

function valueAt(knob, share) {
  const { low, high, scale } = knob;
  const value = scale === "log" ? low * (high / low) ** share : low + (high - low) * share;
  return scale === "whole" ? Math.round(value) : Number(value.toPrecision(DIGITS));
}

function allowed({ least, most, scale, unit }) {
  const from = least !== null && (most === null ? `of at least ${short(least)}` : `from ${short(least)}`);
  const words = [scale === "whole" ? "a whole number" : "a number", from, most !== null && `to ${short(most)}`];
  if (least !== null || most !== null) words.push(unit);
  return words.filter(Boolean).join(" ");
}

class Section extends Panel {
  constructor(element, data, fmu) {
    super(element, "live", ["fitted", "early", "now"]);
    Object.assign(this, { data, fmu });
    this.values = data.joints.map((joint) => this.fitted(joint));
    this.find("app").hidden = false;
    this.find("reset").addEventListener("click", () => this.reset());
    this.show();
  }

  fitted({ motion, coefficients }) {
    return Object.fromEntries([...motion, ...coefficients].map((knob) => [keyOf(knob), knob.value]));
  }

  show() {
    this.joint = this.data.joints[this.number];
    this.rows = new Map();
    for (const group of ["motion", "coefficients"]) {
      const rows = this.joint[group].map((knob) => this.row(knob));
      this.find(group).replaceChildren(this.find(group).firstElementChild, ...rows);
      this.find(group).hidden = !rows.length;
    }
    this.object("");
  }

  row(knob) {
    const row = this.element.querySelector("template").content.cloneNode(true).firstElementChild;
    const [slider, field] = row.querySelectorAll("input");
    const back = row.querySelector("button"), what = `${knob.name}, ${knob.text}`;
    const label = row.querySelector("label");
    slider.id = `${this.element.id}-${keyOf(knob)}`;
    label.htmlFor = slider.id;
    label.title = knob.name;
    slider.step = knob.scale === "whole" ? 1 / (knob.high - knob.low) : 1 / STEPS;
    row.querySelector(".live-symbol").innerHTML = knob.symbol; /* MathML made by the page */
    row.querySelector(".live-text").textContent = knob.text;
    row.querySelector(".live-unit").textContent = knob.unit && `[${knob.unit}]`;
    slider.setAttribute("aria-label", what);
    field.setAttribute("aria-label", `${what}: number in ${knob.unit || "its unit"}`);
    Object.assign(field, { min: knob.least ?? "", max: knob.most ?? "" });
    if (knob.scale === "whole") field.step = 1;
    back.setAttribute("aria-label", `${knob.name} back to ${short(knob.value, 6)}`);
    back.title = "back";
    slider.addEventListener("input", () => this.set(knob, valueAt(knob, Number(slider.value))));
    field.addEventListener("input", () => {
      const wrong = field.value === "" || !field.validity.valid;
      field.setAttribute("aria-invalid", wrong);
      if (!wrong) this.set(knob, field.valueAsNumber, field);
      /* An empty field is valid while a number is being typed. */
      else this.object(field.value && `${knob.name} must be ${allowed(knob)}.`);
    });
    field.addEventListener("change", () => {
      /* Selecting another joint ends an edit and removes this field. */
      if (!this.rows.has(knob)) return;
      if (field.getAttribute("aria-invalid") === "true") {
        this.object(`${knob.name} is unchanged: it must be ${allowed(knob)}.`);
      }
      this.write(knob);
    });
    back.addEventListener("click", () => {
      this.set(knob, knob.value);
      slider.focus();
    });
    this.rows.set(knob, { row, slider, field, back });
    this.write(knob);
    return row;
  }

  /* Report an invalid number, or "" for none, until another one is set. */
  object(text) {
    this.objection = text;
    this.redraw();
  }

  set(knob, value, typing) {
    this.values[this.number][keyOf(knob)] = knob.scale === "whole" ? Math.round(value) : value;
    this.write(knob, typing);
    this.object("");
  }

  /* Show a knob's value, except in the field being edited. */
  write(knob, typing) {
    const { row, slider, field, back } = this.rows.get(knob);
    const value = this.values[this.number][keyOf(knob)];
    slider.value = positionOf(knob, value);
    slider.setAttribute("aria-valuetext", `${short(value, 6)} ${knob.unit}`.trim());
    if (field !== typing) {
      field.value = value === knob.value ? short(value, 6) : value;
      field.removeAttribute("aria-invalid");
    }
    back.hidden = value === knob.value;
    row.classList.toggle("live-moved", !back.hidden);
  }

  reset() {
    this.values[this.number] = this.fitted(this.joint);
    for (const knob of this.rows.keys()) this.write(knob);
    this.object("");
  }

  /* Once per frame. */
  redraw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.draw();
    });
  }

  draw() {
    const { joint } = this, values = this.values[this.number];
    const motion = motionOf(values, this.data.step);
    const now = this.fmu.run(joint, values, motion);
    const fitted = this.fmu.run(joint, this.fitted(joint), motion);
    this.result = { motion, now: now.torque, fitted: fitted.torque };
    const { view } = this, x = motion[AXES[view].column];
    const early = motion.t.length - 1 - motion.cycle;
    const from = view === "time" ? 0 : early;
    const part = (torque, a, b) => ({ x: x.slice(a, b), y: torque.slice(a, b) });
    const curves = { fitted: part(fitted.torque, from), now: part(now.torque, early) };
    if (early > 0) curves.early = part(now.torque, 0, early + 1);
    const { units } = joint;
    const whole = this.plot.draw(
      curves, `${AXES[view].text} [${units[view]}]`, `friction torque τ [${units.torque}]`);
    const refused = now.refused && `The FMU refuses these values. ${now.refused}`;
    this.tell(motion, view, refused || (whole ? "" : "The torque is too large to draw."));
  }

  tell(motion, view, trouble) {
    const { now, fitted } = this.result;
    const columns = [figures(motion, fitted), figures(motion, now)];
    this.find("figures").querySelectorAll("td").forEach((cell, i) => {
      cell.textContent = shown(columns[i % 2][i >> 1]);
    });
    const { speeds } = this.joint, { amplitude } = this.values[this.number];
    const inside = !speeds || (-amplitude >= speeds[0] && amplitude <= speeds[1]);
    this.say("beyond", inside ? "" : "Faster than the training data: extrapolated.");
    this.say("refused", this.objection || trouble);
    const unit = this.joint.units.torque;
    this.say("torque-unit", unit);
    const value = (knob) => this.values[this.number][keyOf(knob)];
    const changes = this.joint.coefficients.filter((c) => value(c) !== c.value).map((c) =>
      `${c.name} ${shown(value(c), 6)} instead of ${shown(c.value, 6)} ${c.unit}`.trim());
    this.say("changed", changes.length ? `Changed: ${changes.join("; ")}.` : "All as fitted.");
    this.plot.svg.firstElementChild.textContent =
      `Friction torque over ${view} of ${this.joint.name}, maximum ${shown(columns[1][0])} ${unit}; ` +
      `as fitted ${shown(columns[0][0])} ${unit}.`;
  }

  /* Full precision; rows refused by the FMU are empty. */
  save() {
    const { motion: { t, dq, q, tau_load }, now, fitted } = this.result;
    const columns = { t, dq, q, tau_load, tau: now, tau_fitted: fitted };
    saveTable(columns, `friction_${this.joint.name.replace(/\W+/g, "_")}.csv`);
  }
}

for (const element of document.querySelectorAll(".live")) {
  const data = JSON.parse(element.querySelector("script").textContent);
  Fmu.from(data.module).then((fmu) => new Section(element, data, fmu)).catch((error) => {
    const dead = element.querySelector(".live-dead");
    dead.textContent = "This browser cannot run the FMU's code as WebAssembly " +
      `(${error.message}).`;
    dead.hidden = false;
  });
}
