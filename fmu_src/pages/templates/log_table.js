/* Reads a CSV as HESR does and guesses its columns. */

const DELIMITERS = [",", ";", "\t", " "];
const SEARCHED = 500; /* maximum lines before the first row of data */
const DATUM = /^([-+]?(\d+[.,]?\d*|[.,]\d+)(e[-+]?\d+)?|\d{4}-\d\d-\d\d[T ][\d:.]+Z?)$/i;
const COMMA = /^[-+]?\d*,\d+(e[-+]?\d+)?$/i;
const UNIT_CELL = /^([([].*[)\]]|rad|deg|°|s|ms|us|ns|A|mA|N\.?m|rad\/s|deg\/s|-|)$/;
const MISSING = /^([-+]?nan|null|#?n\/?a|)$/i;
const SINCE_1970 = 1e8; /* [s] */
const LARGEST_FILE = 2 ** 28; /* bytes, read into one string */

class LogError extends Error {}

function cellsOf(line, delimiter) {
  if (!line.includes('"')) return line.split(delimiter).map((cell) => cell.trim());
  /* Zero bytes, which no text has, stand for delimiters in quotes. */
  const bare = line.replace(/"[^"]*"/g, (quoted) => quoted.replaceAll(delimiter, "\0"));
  return bare.split(delimiter).map((cell) => cell.replaceAll("\0", delimiter)
    .replace(/^\s*"(.*)"\s*$/, "$1").replaceAll('""', '"').trim());
}

function isData(line, delimiter) {
  if (isComment(line) || !line.includes(delimiter)) return false;
  const cells = cellsOf(line, delimiter), numbers = cells.filter((c) => DATUM.test(c)).length;
  return numbers > 0 && 2 * numbers >= cells.length;
}

const isComment = (line) => line[0] === "#" || line[0] === "%";

/* Header, first row of data and delimiter: data start at the first line of numbers below a line of
 * as many names. */
function tableIn(lines) {
  const named = lines.map(({ number, text }) => ({ number, text: text.replace(/^[#% ]+/, "") }));
  for (let at = 1; at < Math.min(lines.length, SEARCHED); at++) {
    const { text } = lines[at], often = (d) => text.split(d).length;
    for (const delimiter of [...DELIMITERS].sort((a, b) => often(b) - often(a))) {
      if (!isData(text, delimiter)) continue;
      const count = cellsOf(text, delimiter).length;
      const above = named.slice(0, at).reverse().filter((line) =>
        cellsOf(line.text, delimiter).length === count && !isData(line.text, delimiter));
      const units = above.length > 1 &&
        above[0].text.split(delimiter).every((cell) => UNIT_CELL.test(cell.trim()));
      const header = above[units ? 1 : 0];
      if (header) return { delimiter, at, names: cellsOf(header.text, delimiter) };
    }
  }
  throw new LogError("it has no table; a line of names above lines of numbers is needed.");
}

/* Names and columns of numbers, NaN for empty cells; `wrong` collects invalid cells. */
function tableOf(text) {
  if (text.includes("\0")) throw new LogError("the file is not text; choose a CSV.");
  const lines = [];
  text.replace(/^\uFEFF/, "").split(/\r\n|\n|\r/).forEach((line, k) => {
    if (line.trim()) lines.push({ number: k + 1, text: line.trim() });
  });
  if (!lines.length) throw new LogError("it is empty; a log needs a header and rows of data.");
  const { delimiter, at, names } = tableIn(lines);
  const twice = names.find((name, k) => names.indexOf(name) < k);
  if (twice !== undefined) {
    throw new LogError(`column '${twice}' appears twice; names must differ.`);
  }
  const rows = lines.slice(at).filter((line) => !isComment(line.text));
  const comma = delimiter !== "," && rows.some((line) => line.text.includes(",") &&
    cellsOf(line.text, delimiter).some((cell) => COMMA.test(cell)));
  const columns = new Map(names.map((name) =>
    [name, { name, values: new Float64Array(rows.length), wrong: null, whole: null }]));
  const all = [...columns.values()];
  rows.forEach((line, k) => {
    const cells = cellsOf(line.text, delimiter);
    if (cells.length !== all.length) {
      throw new LogError(`row ${line.number} has ${cells.length} cells; the header has ` +
        `${all.length} columns.`);
    }
    cells.forEach((cell, i) => {
      const column = all[i];
      const value = Number(comma ? cell.replace(",", ".") : cell);
      column.values[k] = cell === "" ? NaN : value;
      if (Number.isNaN(value) && !MISSING.test(cell)) column.wrong ??= { row: line.number, cell };
      /* Nanoseconds since 1970 exceed double precision. */
      if (value > 2 ** 53 && /^\d+$/.test(cell)) {
        column.whole ??= BigInt(cell);
        column.values[k] = Number(BigInt(cell) - column.whole);
      }
    });
  });
  return { names, columns, rows: rows.map((line) => line.number) };
}

function numbersOf(table, name) {
  const { values, wrong } = table.columns.get(name);
  if (wrong) {
    throw new LogError(`column '${name}', row ${wrong.row}: '${wrong.cell}' where a number is ` +
      "needed.");
  }
  return values;
}

/* Time stamps [s]; those since 1970 are relative to the first. */
function timesOf(table, name, unit) {
  const values = numbersOf(table, name), first = values.find(Number.isFinite) ?? 0;
  const since = Math.abs(first) * unit > SINCE_1970 ? first : 0;
  return values.map((value) => (value - since) * unit);
}

function median(values) {
  const sorted = Float64Array.from(values).sort(), half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : 0.5 * (sorted[half - 1] + sorted[half]);
}

/* Guesses with HESR's own word lists. */
class Guess {
  constructor(table, joints, words, units) {
    Object.assign(this, { table, joints, words, units });
    this.groups = [...this.grouped()];
    this.columns = { t: this.time() };
    for (const quantity of ["q", "dq", "tau_load", "tau"]) {
      this.columns[quantity] = this.best(quantity);
    }
    const friction = this.best("friction");
    this.friction = Boolean(friction);
    if (friction) this.columns.tau = friction;
  }

  tokens(name) {
    const one = name.replace(/(?<![A-Za-z])[iI]_([dq])(?![A-Za-z])/, "i$1");
    return (one.match(/[A-Z]?[a-z]+|[A-Z]+(?![a-z])|°/g) ?? []).map((s) => s.toLowerCase());
  }

  /* Columns that differ only in a number or joint name, by joint. */
  *grouped() {
    const numbered = new Map(), named = new Map();
    const keep = (groups, key, place, name) => {
      if (!groups.has(key)) groups.set(key, new Map());
      groups.get(key).set(place, name);
    };
    for (const name of this.table.names) {
      for (const found of name.matchAll(/(?<!\d)\d{1,9}(?!\d)/g)) {
        const key = `${name.slice(0, found.index)}{}${name.slice(found.index + found[0].length)}`;
        keep(numbered, key, Number(found[0]), name);
      }
      this.joints.forEach((joint, k) => {
        if (name.includes(joint)) keep(named, name.replace(joint, "{name}"), k, name);
      });
    }
    for (const found of [...named.values(), ...numbered.values()]) {
      if (found.size < this.joints.length) continue;
      const places = [...found.keys()].sort((a, b) => a - b);
      yield places.map((k) => found.get(k)).slice(0, this.joints.length);
    }
  }

  quantity(name) {
    const { words } = this, has = (list) => this.tokens(name).some((t) => list.includes(t));
    if (has(words.others)) return "";
    if (has(words.load)) return "tau_load";
    if (has(words.friction)) return "friction";
    const found = Object.keys(words.quantities).find((key) => has(words.quantities[key]));
    return found ?? (has(words.places) ? "q" : "");
  }

  best(quantity) {
    const measured = (name) => this.tokens(name).some((t) => this.words.measured.includes(t));
    const fitting = this.groups.filter((group) => this.quantity(group[0]) === quantity);
    const order = ([a], [b]) => measured(b) - measured(a) || a.length - b.length;
    return fitting.sort(order)[0] ?? null;
  }

  time() {
    const rises = (name) => {
      const known = this.table.columns.get(name).values.filter(Number.isFinite);
      let up = 0;
      for (let k = 1; k < known.length; k++) up += known[k] > known[k - 1];
      return known.length > 2 && up > 0.9 * (known.length - 1);
    };
    const { names } = this.table, { time } = this.words;
    const named = names.filter((name) => this.tokens(name).some((t) => time.includes(t)));
    return named.filter(rises).sort((a, b) => a.length - b.length)[0] ?? null;
  }

  /* Unit of time: by name, else the one with a rate closest to 200 Hz. */
  unitOfTime(name) {
    const values = this.table.columns.get(name).values.filter(Number.isFinite);
    const step = median(values.slice(1).map((value, k) => value - values[k]));
    const { t: units } = this.units;
    const [low, high] = this.words.rates;
    const possible = Object.keys(units).filter((unit) =>
      step * units[unit] * high >= 1 && step * units[unit] * low <= 1);
    const said = this.said("t", name);
    if (possible.includes(said) || !possible.length) return said || "s";
    const far = (unit) => Math.abs(Math.log(step * units[unit] * 200));
    return possible.sort((a, b) => far(a) - far(b))[0];
  }

  said(quantity, name) {
    const known = this.words.units[quantity] ?? {};
    const words = [...name.toLowerCase().split(/[^a-z°]+/), ...this.tokens(name)];
    return known[words.find((word) => Object.hasOwn(known, word))] ?? "";
  }
}
