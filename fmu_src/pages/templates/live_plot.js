/* A plot of curves as SVG in the colours of the page. */

const MARGIN = { left: 58, right: 14, top: 26, bottom: 42 };
const DIGITS = 4; /* significant digits of slider values, which are shown exactly */

function short(value, digits = DIGITS) {
  return Number.isFinite(value) ? String(Number(value.toPrecision(digits))) : "–";
}

function shown(value, digits) {
  return short(value, digits).replaceAll("-", "−");
}

function ticks(low, high, most) {
  const raw = (high - low) / most, base = 10 ** Math.floor(Math.log10(raw));
  const step = base * [1, 2, 5, 10].find((f) => f * base >= raw * (1 - 1e-9));
  const first = Math.ceil(low / step - 1e-9), found = [];
  for (let i = first; i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found.map((value) => ({ value, text: shown(value, 6) }));
}

function range(...columns) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) {
    for (const value of column) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  const some = Math.max(high - low, 1e-12 * Math.max(Math.abs(low), Math.abs(high))) || 1;
  return [low - 0.05 * some, high + 0.05 * some];
}

class Plot {
  /* Named curves, the last one in front. */
  constructor(svg, names) {
    this.svg = svg;
    this.grid = this.add("g");
    this.curves = Object.fromEntries(
      names.map((name) => [name, this.add("path", { class: `plot-${name}` })]),
    );
  }

  add(tag, attributes = {}, text = "", parent = this.svg) {
    const element = document.createElementNS(this.svg.namespaceURI, tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.textContent = text;
    return parent.appendChild(element);
  }

  /* Draw curves { x, y } by name; false if the values exceed every axis. */
  draw(curves, textAcross, textUp) {
    const { width, height } = this.svg.getBoundingClientRect();
    const all = Object.values(curves);
    const [left, right] = range(...all.map((c) => c.x));
    const [bottom, top] = range(...all.map((c) => c.y));
    this.grid.replaceChildren();
    for (const path of Object.values(this.curves)) path.setAttribute("d", "");
    if (!Number.isFinite(right - left) || !Number.isFinite(top - bottom)) return false;
    const across = (width - MARGIN.left - MARGIN.right) / (right - left);
    const up = (height - MARGIN.top - MARGIN.bottom) / (top - bottom);
    const x = (value) => MARGIN.left + (value - left) * across;
    const y = (value) => height - MARGIN.bottom - (value - bottom) * up;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const line = (x1, y1, x2, y2, value) =>
      this.add("line", { x1, y1, x2, y2, ...(value === 0 && { class: "plot-zero" }) }, "", this.grid);
    const label = (at, words) => this.add("text", at, words, this.grid);
    const axis = { class: "plot-axis" };
    for (const { value, text: words } of ticks(left, right, width / 90)) {
      line(x(value), MARGIN.top, x(value), height - MARGIN.bottom, value);
      label({ x: x(value), y: height - MARGIN.bottom + 16, "text-anchor": "middle" }, words);
    }
    for (const { value, text: words } of ticks(bottom, top, height / 55)) {
      line(MARGIN.left, y(value), width - MARGIN.right, y(value), value);
      label({ x: MARGIN.left - 7, y: y(value) + 4, "text-anchor": "end" }, words);
    }
    const middle = MARGIN.left + (width - MARGIN.left - MARGIN.right) / 2;
    label({ x: middle, y: height - 6, "text-anchor": "middle", ...axis }, textAcross);
    label({ x: 8, y: 15, ...axis }, textUp);
    for (const [name, curve] of Object.entries(curves)) {
      this.curves[name].setAttribute("d", this.path(curve, x, y));
    }
    return true;
  }

  /* Omit points that coincide with the previous one. */
  path(curve, x, y) {
    const parts = [];
    let px = NaN, py = NaN;
    for (let k = 0; k < curve.y.length; k++) {
      const ax = x(curve.x[k]), ay = y(curve.y[k]);
      if (Math.abs(ax - px) + Math.abs(ay - py) < 0.3 && k < curve.y.length - 1) continue;
      parts.push(`${ax.toFixed(2)} ${ay.toFixed(2)}`);
      [px, py] = [ax, ay];
    }
    return parts.length ? `M${parts.join("L")}` : "";
  }
}

/* A section of the page with a plot for a choice of joints and views. */
class Panel {
  constructor(element, prefix, curves) {
    this.element = element;
    this.find = (name) => element.querySelector(`.${prefix}-${name}`);
    this.plot = new Plot(element.querySelector(".plot"), curves);
    this.find("save").addEventListener("click", () => this.save());
    new ResizeObserver(() => this.redraw()).observe(this.plot.svg);
    element.querySelector(".views").addEventListener("change", () => this.redraw());
    element.querySelector(".joint")?.addEventListener("change", () => this.show());
  }

  get number() {
    return Number(this.element.querySelector(".joint")?.value ?? 0);
  }

  get view() {
    return this.element.querySelector(".views :checked").value;
  }

  say(name, text) {
    const place = this.find(name);
    if (place.textContent !== text) place.textContent = text;
    place.hidden = !text;
  }
}

function saveTable(columns, name) {
  const all = Object.values(columns);
  const rows = Array.from(all[0], (_, k) => all.map((values) => values[k] ?? "").join(","));
  const text = `${Object.keys(columns).join(",")}\n${rows.join("\n")}\n`;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href));
}
