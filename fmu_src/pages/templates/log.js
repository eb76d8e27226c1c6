/* Replays a dropped log through the FMU and compares the torques. */

const QUANTITIES = ["q", "dq", "tau_load", "tau"];

const kindOf = (quantity) => quantity.startsWith("tau") ? "tau" : quantity;

class Log extends Panel {
  constructor(element, joints, own, fmu, body) {
    super(element, "log", ["measured", "law"]);
    Object.assign(this, { joints, own, fmu, body });
    const input = this.find("file");
    input.addEventListener("change", () => input.files.length && this.take(input.files[0]));
    /* Allow a changed file to be chosen again. */
    input.addEventListener("click", () => { input.value = ""; });
    for (const kind of ["dragover", "dragleave", "drop"]) {
      element.addEventListener(kind, (event) => {
        event.preventDefault();
        element.classList.toggle("log-over", kind === "dragover");
        if (kind === "drop" && event.dataTransfer.files.length) {
          this.take(event.dataTransfer.files[0]);
        }
      });
    }
    this.find("columns").addEventListener("change", (event) => {
      this.follow(event.target);
      this.compute();
    });
    this.find("start").hidden = false;
  }

  async take(file) {
    this.find("app").hidden = true;
    this.result = null;
    try {
      if (file.size > LARGEST_FILE) {
        throw new LogError("the file is larger than 256 MB; 'hesr test' reads logs of any size.");
      }
      const bytes = await file.arrayBuffer();
      let text;
      try {
        text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
      } catch {
        throw new LogError("the file is not text; choose a CSV. 'hesr test' reads other formats.");
      }
      this.name = file.name;
      this.table = tableOf(text);
      this.offer(new Guess(
        this.table, this.joints.map((j) => j.name), this.own.words, this.own.units));
    } catch (error) {
      this.refuse(error, file.name);
      return;
    }
    this.compute();
  }

  refuse(error, name = this.name) {
    if (!(error instanceof LogError)) throw error;
    this.say("wrong", `${name}: ${error.message}`);
  }

  selects(quantity) {
    return [...this.element.querySelectorAll(`select[data-column=${quantity}]`)];
  }

  unit(quantity) {
    return this.element.querySelector(`select[data-unit=${quantity}]`);
  }

  /* Fill the fields with guessed columns; open them if a guess is uncertain. */
  offer(guess) {
    this.guess = guess;
    const option = (name, text = name) => new Option(text, name);
    const put = (select, chosen) => {
      select.replaceChildren(option("", "–"), ...this.table.names.map((name) => option(name)));
      select.value = chosen ?? "";
    };
    put(this.selects("t")[0], guess.columns.t);
    if (guess.columns.t) this.unit("t").value = guess.unitOfTime(guess.columns.t);
    for (const quantity of QUANTITIES) {
      const group = guess.columns[quantity];
      this.selects(quantity).forEach((select, k) => put(select, group?.[k]));
      const unit = this.unit(quantity), said = group && guess.said(kindOf(quantity), group[0]);
      unit.selectedIndex = 0;
      if ([...unit.options].some((o) => o.value === said)) unit.value = said;
    }
    this.find("kind").value = guess.friction ? "friction" : "total";
    this.find("cutoff").value = "";
    const { t, q, dq, tau } = guess.columns;
    this.find("columns").open = !(t && (q || dq) && tau);
    this.reasons = "";
    if (t && q) this.guessUnits();
  }

  /* Guess unnamed units: the derivative of the position must match the velocity. */
  guessUnits() {
    const { q, dq } = this.guess.columns, said = (name, group) => this.guess.said(name, group[0]);
    const units = this.own.units, slides = !("rad" in units.q);
    let columns;
    try {
      columns = this.read();
    } catch {
      return; /* reported when computed */
    }
    const travel = columns.q.map(extremes).map(([low, high]) => high - low);
    const far = !slides && Math.max(...travel) > 4 * Math.PI && !said("q", q);
    if (!dq) {
      if (far) this.unit("q").value = "deg";
      return;
    }
    const ratios = [];
    for (const [first, last] of columns.parts) {
      if (last - first < 10) continue;
      const cut = (values) => values.subarray(first, last), t = cut(columns.t);
      try {
        const cutoff = cutoffFor(median(differences(t)), this.own.cutoff);
        const all = [...columns.q.map(cut), ...columns.dq.map(cut)], n = this.joints.length;
        const motion = smoothed(t, all, cutoff);
        for (let k = 0; k < n; k++) {
          const [derived, logged] = [deviation(motion[k](1)), deviation(motion[n + k](0))];
          if (derived > 1e-3 && logged > 1e-6) ratios.push(derived / logged);
        }
      } catch (error) {
        if (!(error instanceof LogError)) throw error;
      }
    }
    if (!ratios.length) return;
    const ratio = median(ratios), alike = (found, wanted) => Math.abs(Math.log(found / wanted)) < 0.04;
    if (alike(ratio, 1)) {
      if (far) [this.unit("q").value, this.unit("dq").value] = ["deg", "deg/s"];
      return;
    }
    for (const quantity of far ? ["q", "dq"] : ["dq", "q"]) {
      if (said(quantity, quantity === "q" ? q : dq)) continue;
      const now = units[quantity][this.unit(quantity).value];
      const wanted = quantity === "q" ? 1 / ratio : ratio;
      const unit = Object.keys(units[quantity]).find((u) => alike(units[quantity][u] / now, wanted));
      if (unit) {
        this.unit(quantity).value = unit;
        this.reasons = `${quantity} is in ${unit}; otherwise q would change ` +
          `${shown(ratio, 3)} times as fast as dq.`;
        return;
      }
    }
    this.find("columns").open = true;
    this.reasons = `q changes ${shown(ratio, 3)} times as fast as dq: check the units.`;
  }

  /* The first joint's column selects the others if names differ only in a number. */
  follow(select) {
    const quantity = select.dataset.column, all = quantity ? this.selects(quantity) : [];
    if (all.length < 2 || select !== all[0]) return;
    const group = this.guess.groups.find((names) => names[0] === select.value);
    all.slice(1).forEach((other, k) => {
      other.value = group ? group[k + 1] : select.value ? other.value : "";
    });
  }

  /* Chosen columns in SI, without rows with missing numbers or repeated time stamps. */
  read() {
    const time = this.selects("t")[0].value;
    if (!time) throw new LogError("no time column was recognised; choose it below.");
    const t = timesOf(this.table, time, this.own.units.t[this.unit("t").value]);
    const chosen = Object.fromEntries(QUANTITIES.map((quantity) =>
      [quantity, this.selects(quantity).map((select) => select.value)]));
    for (const [quantity, names] of Object.entries(chosen)) {
      if (names.some(Boolean) && !names.every(Boolean)) {
        const k = names.findIndex((name) => !name);
        throw new LogError(`the column '${quantity}' of ${this.joints[k].name} is missing; ` +
          "choose it below, or none for all joints.");
      }
    }
    const columns = Object.fromEntries(QUANTITIES.map((quantity) => {
      const factor = this.own.units[kindOf(quantity)][this.unit(quantity).value];
      return [quantity, chosen[quantity][0]
        ? chosen[quantity].map((name) => numbersOf(this.table, name).map((x) => x * factor)) : null];
    }));
    if (!columns.q && !columns.dq) {
      throw new LogError("no position or velocity columns were recognised for " +
        `${this.joints.length} joints; choose them below.`);
    }
    const all = [t, ...QUANTITIES.flatMap((quantity) => columns[quantity] ?? [])];
    const whole = [...t.keys()].filter((k) => all.every((values) => Number.isFinite(values[k])));
    const rows = whole.filter((k, i) => !i || t[k] !== t[whole[i - 1]]);
    if (rows.length < 2) {
      throw new LogError(`only ${rows.length} rows have numbers in all chosen columns; ` +
        "at least 2 are needed.");
    }
    const cut = (values) => Float64Array.from(rows, (k) => values[k]);
    const found = { t: cut(t), dropped: t.length - rows.length };
    const back = found.t.findIndex((value, k) => k && value < found.t[k - 1]);
    if (back > 0) {
      throw new LogError(`column '${time}', row ${this.table.rows[rows[back]]}: time must ` +
        `increase, but ${short(found.t[back], 9)} s follows ${short(found.t[back - 1], 9)} s.`);
    }
    for (const quantity of QUANTITIES) found[quantity] = columns[quantity]?.map(cut) ?? null;
    found.carried = Boolean(this.body && found.q && !found.tau_load);
    found.parts = partsOf(found.t);
    if (!found.parts.length) throw new LogError("no part between its gaps lasts 1 s.");
    return found;
  }

  compute() {
    this.find("wrong").hidden = true;
    this.find("app").hidden = true;
    this.find("mapping").hidden = false;
    this.result = null;
    try {
      this.result = this.replayed(this.read());
    } catch (error) {
      this.find("columns").open = true;
      this.refuse(error);
      return;
    }
    this.find("app").hidden = false;
    this.tell();
    this.redraw();
  }

  /* As HESR replays logs, the law restarts after each gap. */
  replayed(log) {
    const kept = log.parts.map(([first, last]) => (values) => values.subarray(first, last));
    const wanted = this.find("cutoff").valueAsNumber || this.own.cutoff;
    if (!(wanted > 0)) throw new LogError("the cut-off of the low-pass filter must be positive [Hz].");
    const joined = (columns) =>
      columns[0].map((_, k) => Float64Array.from(columns.flatMap((part) => [...part[k]])));
    const each = kept.map((cut) => {
      const t = cut(log.t), period = median(differences(t));
      const cutoff = this.find("cutoff").value ? wanted : cutoffFor(period, wanted);
      const speed = smoothed(t, (log.dq ?? log.q).map(cut), cutoff), first = log.dq ? 0 : 1;
      const dq = speed.map((derivative) => derivative(first));
      const nothing = () => this.joints.map(() => new Float64Array(t.length));
      const q = log.q?.map(cut) ?? nothing();
      let load = log.tau_load?.map(cut) ?? nothing();
      if (log.carried) {
        const place = log.dq ? smoothed(t, q, cutoff) : speed;
        load = this.through(this.body, this.own.body.joints, t, {
          q: place.map((derivative) => derivative(0)), dq,
          ddq: speed.map((derivative) => derivative(first + 1)),
        });
      }
      const law = this.through(this.fmu, this.joints, t, { dq, q, tau_load: load });
      return { t: [t], dq, q, load, law, cutoff };
    });
    const of = (name) => joined(each.map((part) => part[name]));
    const found = { t: of("t")[0], dq: of("dq"), q: of("q"), load: of("load"), law: of("law") };
    found.cutoff = Math.min(...each.map((part) => part.cutoff));
    found.dropped = log.dropped;
    found.ends = each.map((part) => part.t[0].length);
    const total = this.find("kind").value === "total";
    if (log.tau && (log.tau_load || log.carried || !total)) {
      const tau = joined(kept.map((cut) => log.tau.map(cut)));
      found.tau = total ? tau.map((v, k) => v.map((x, i) => x - found.load[k][i])) : tau;
      found.scores = found.tau.map((v, k) => scoreOf(v, found.law[k], found.dq[k]));
    }
    return Object.assign(found, { log, total });
  }

  through(fmu, joints, t, inputs) {
    const { found, refused } = fmu.replay(joints, t, inputs);
    if (refused) throw new LogError(`the FMU refuses it. ${refused}`);
    return found;
  }

  tell() {
    const { log, scores, total, cutoff, dropped, ends } = this.result;
    const notes = [`${this.name}: ${this.result.t.length} rows, ` +
      `${shown(this.result.t.length * median(differences(this.result.t)), 3)} s.`];
    notes.push(`Velocity ${log.dq ? "as logged" : "from the position"}, low-pass filter ` +
      `${shown(cutoff, 3)} Hz without lag, as in the fit.`);
    if (dropped) notes.push(`${dropped} rows with missing numbers or repeated time stamps were left out.`);
    if (ends.length > 1) notes.push(`${ends.length} parts between gaps; the law restarts in each.`);
    const uses = (name) => this.own.joints.some((joint) => joint.uses.includes(name));
    if (!log.q && uses("q")) notes.push("The law uses the position; 0 is assumed.");
    if (log.carried) notes.push("Rigid-body torque of the body identified with this law.");
    if (!log.tau_load && !log.carried && uses("tau_load")) {
      notes.push("The law uses the load torque; 0 is assumed.");
    }
    this.own.joints.forEach(({ speeds }, k) => {
      const [low, high] = extremes(this.result.dq[k]);
      if (speeds && (high > speeds[1] * 1.02 + MOVING || low < speeds[0] * 1.02 - MOVING)) {
        notes.push(`${this.joints[k].name} is faster than the training data.`);
      }
    });
    if (this.reasons) notes.push(this.reasons);
    this.say("notes", notes.join(" "));
    const { change, shift } = this.own, unit = (k) => this.joints[k].units.torque;
    const drifts = (scores ?? []).map((score, k) =>
      driftOf(score, { noise: this.own.joints[k].noise, unit: unit(k), change, shift }));
    const named = (kind) => this.joints.filter((_, k) => drifts[k]?.[0] === kind)
      .map((joint) => joint.name).join(", ");
    const judged = drifts.some(([kind]) => kind !== "rests");
    const missing = !log.tau
      ? "Unknown: no measured torque is chosen."
      : "Unknown: a total torque requires " +
        (this.body ? "positions or " : "") + "a column with the rigid-body torque " +
        "(tau_load); or choose friction only.";
    const answers = [named("drift") ? `Yes, on ${named("drift")}.` : "No."];
    if (named("shift")) answers.push(`The torque is shifted on ${named("shift")}.`);
    if (named("worse")) answers.push(`The error has grown on ${named("worse")}.`);
    this.say("answer", !scores ? missing
      : judged ? answers.join(" ") : "Unknown: no joint moves.");
    this.find("kinds").hidden = !log.tau;
    this.find("table").hidden = !scores;
    this.find("rows").replaceChildren(...(scores ?? []).map((score, k) => {
      const { noise } = this.own.joints[k], row = document.createElement("tr");
      const level = Number.isFinite(score.level)
        ? `${shown(score.level, 3)} ± ${shown(1.96 * score.levelError, 2)}` : "–";
      const cells = [this.joints[k].name, `${shown(score.rmse, 3)} ${unit(k)}`,
        Number.isFinite(score.nrmse) ? `${shown(100 * score.nrmse, 3)} %` : "–",
        noise ? shown(score.rmse / noise, 3) : "–", level, drifts[k][1]];
      cells.forEach((text, i) => {
        const cell = document.createElement(i ? "td" : "th");
        if (!i) cell.scope = "row";
        cell.textContent = text;
        if (i && i < 5) cell.className = "number";
        if (i === 1) cell.dataset.value = score.rmse;
        row.append(cell);
      });
      return row;
    }));
    fitTables();
    const residual = this.element.querySelector(".views [value=residual]");
    residual.disabled = !scores;
    if (!scores && residual.checked) this.element.querySelector(".views input").checked = true;
  }

  show() {
    this.redraw();
  }

  redraw() {
    const { result, number: k, view } = this, joint = this.joints[k];
    if (!result) return;
    const residual = view === "residual", over = residual ? "time" : view;
    const { column, text } = AXES[over], { units } = joint;
    const x = column === "t" ? result.t : result[column][k];
    const curves = {
      ...(!residual && result.tau && { measured: { x, y: result.tau[k] } }),
      law: { x, y: residual ? result.scores[k].residual : result.law[k] },
    };
    const torque = residual ? "measured minus law" : "friction torque τ";
    this.plot.draw(curves, `${text} [${units[over]}]`, `${torque} [${units.torque}]`);
    this.plot.svg.firstElementChild.textContent =
      `${residual ? "Residual" : "Friction torque"} over ${over} of ${joint.name}: ` +
      `${Object.keys(curves).join(" and ")}.`;
    this.element.querySelector(".live-key.plot-measured").hidden = !curves.measured;
    this.element.querySelector(".live-key.plot-law").textContent =
      residual ? "measured minus law" : "this law";
  }

  save() {
    const { t, q, dq, load, tau, law } = this.result, columns = { t };
    const named = { q, dq, tau_load: load, tau_friction: tau, tau_law: law };
    for (const [name, values] of Object.entries(named)) {
      values?.forEach((column, k) => { columns[`${name}${k + 1}`] = column; });
    }
    saveTable(columns, `${this.name.replace(/\.[^.]*$/, "")}_against_law.csv`);
  }
}

for (const element of document.querySelectorAll(".log")) {
  const own = JSON.parse(element.querySelector("script").textContent);
  const live = document.getElementById(element.dataset.live).querySelector("script");
  const { module, joints } = JSON.parse(live.textContent);
  /* The section above reports failures. */
  Promise.all([Fmu.from(module), own.body && Fmu.from(own.body.module)])
    .then(([fmu, body]) => new Log(element, joints, own, fmu, body)).catch(() => {});
}
