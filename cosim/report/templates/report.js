"use strict";
(() => {
  const said = document.querySelector(".said");
  let silence = 0;

  function say(text) {
    said.textContent = text;
    clearTimeout(silence);
    silence = setTimeout(() => { said.textContent = ""; }, 4000);
  }

  // Tables as CSV: numbers with all their digits.
  function csv(table) {
    const text = (cell) => cell.dataset.value ?? cell.textContent.trim().replace(/\s+/g, " ");
    const quoted = (value) => (/[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
    return [...table.rows]
      .map((row) => [...row.cells].map((cell) => quoted(text(cell))).join(","))
      .join("\n") + "\n";
  }

  for (const button of document.querySelectorAll("button.copy")) {
    button.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(csv(button.closest(".table").querySelector("table")));
        say("Copied as CSV.");
      } catch {
        say("This browser does not let the page copy.");
      }
    });
  }

  // What scrolls must be reachable by keyboard.
  function reachable() {
    for (const box of document.querySelectorAll(".wide")) {
      if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
      else box.removeAttribute("tabindex");
    }
  }

  // Mark the current section in the contents.
  const links = [...document.querySelectorAll("nav a")];
  const sections = links.map((link) => document.querySelector(link.hash));
  function mark() {
    const atEnd = innerHeight + scrollY >= document.documentElement.scrollHeight - 2 && scrollY > 0;
    const passed = sections.filter((section) => section.getBoundingClientRect().top < 0.3 * innerHeight);
    const current = atEnd ? sections.length - 1 : Math.max(passed.length - 1, 0);
    links.forEach((link, k) => { link.ariaCurrent = k === current ? "true" : null; });
  }

  // A link into a folded section unfolds it.
  function reveal() {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (const folded of document.querySelectorAll("details")) {
      if (folded.contains(target) || folded.parentElement === target) folded.open = true;
    }
    target.scrollIntoView();
  }

  addEventListener("scroll", mark, { passive: true });
  addEventListener("hashchange", reveal);
  addEventListener("resize", () => { reachable(); mark(); });
  document.addEventListener("toggle", () => dispatchEvent(new Event("resize")), true);
  reachable();
  mark();
  reveal();

  // Views that zoom: library and data are packed in this page and unpacked when first asked for.
  async function unpacked(id) {
    const packed = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).text();
  }

  let library = null;
  const loaded = () => library ??= unpacked("zoom-library").then((code) => {
    const script = document.createElement("script");
    script.textContent = code;
    document.head.append(script);
    Bokeh.logger.set_level("error");
  });

  const palette = JSON.parse(document.getElementById("palette").textContent);

  async function show(key, box) {
    await loaded();
    const style = getComputedStyle(document.documentElement);
    let text = await unpacked(`zoom-${key}`);
    for (const [colour, variable] of Object.entries(palette)) {
      text = text.replaceAll(colour, style.getPropertyValue(variable).trim());
    }
    const data = JSON.parse(text);
    hide(box);
    box.querySelector(".names").replaceChildren(...legend(data.names, box));
    const item = models(data, (name) => style.getPropertyValue(name).trim());
    const views = await Bokeh.embed.embed_item(item, box.querySelector(".place"));
    opened.set(box, [...views][0].model.document);
  }

  // Bokeh's models of a chart; absent attributes have Bokeh's defaults.
  function models(data, colour) {
    const ink = colour("--ink"), soft = colour("--soft"), line = colour("--line");
    let last = 0;
    const model = (name, attributes = {}) => ({ type: "object", name, id: `p${++last}`, attributes });
    const reference = ({ id }) => ({ id });
    const written = new Set();
    const once = (one) => written.has(one) ? reference(one) : (written.add(one), one);
    const numbers = (values) => values.map((value) => value ?? NaN);
    const range = model("DataRange1d");
    const source = (x) => model("ColumnDataSource", { data: { type: "map", entries: [["x", numbers(x)]] } });
    const sources = data.times.map(source);
    const drag = (tools) => ({ tools, active_drag: reference(tools[0]), active_scroll: null });
    const kinds = { BoxZoomTool: {}, PanTool: {}, WheelZoomTool: { dimensions: "width" }, ResetTool: {} };
    const shared = Object.keys(kinds).map(() => []);
    const axis = (label) => model("LinearAxis", {
      axis_label: label, axis_label_text_color: ink, axis_label_text_font_size: "12px",
      axis_label_text_font_style: "normal", major_label_text_color: soft,
      axis_line_color: line, major_tick_line_color: line, minor_tick_line_color: line,
    });
    const glyph = ({ name, time, y, colour, width, dash }) => {
      const { entries } = sources[time].attributes.data;
      const field = `y${entries.length}`;
      entries.push([field, numbers(y)]);
      const style = { line_color: colour, line_width: width, line_dash: dash };
      const fields = { x: { type: "field", field: "x" }, y: { type: "field", field } };
      const shape = model("Line", { ...fields, ...style });
      return model("GlyphRenderer", { name, data_source: once(sources[time]), glyph: shape });
    };
    const plot = ({ title, y, lines, marks }, label) => {
      const below = axis(label), left = axis(y);
      const grid = (one, dimension) => model("Grid", { axis: reference(one), dimension, grid_line_color: line });
      const mark = (location) => model("Span", { location, dimension: "height", line_color: ink, line_dash: [6] });
      const tools = Object.entries(kinds).map(([name, options]) => model(name, options));
      tools.forEach((tool, k) => shared[k].push(reference(tool)));
      return model("Figure", {
        height: data.height, sizing_mode: "stretch_width", x_range: once(range),
        title: model("Title", { text: title, text_color: ink, text_font_size: "13px" }),
        renderers: lines.map(glyph), toolbar: model("Toolbar", drag(tools)), toolbar_location: null,
        left: [left], below: [below], center: [grid(below, 0), grid(left, 1), ...marks.map(mark)],
        outline_line_color: null, background_fill_alpha: 0, border_fill_alpha: 0, min_border_left: 52,
      });
    };
    const children = data.rows.flatMap((row, k) => row.map(
      (panel, j) => [plot(panel, k === data.rows.length - 1 ? data.x : null), k, j],
    ));
    const proxies = shared.map((tools) => model("ToolProxy", { tools }));
    const bar = model("Toolbar", { ...drag([...proxies, model("SaveTool")]), logo: null });
    const grid = model("GridPlot", { children, toolbar: bar, sizing_mode: "stretch_width" });
    return { target_id: null, root_id: grid.id, doc: { version: Bokeh.version, title: "", roots: [grid] } };
  }

  const opened = new Map();

  function hide(box) {
    opened.get(box)?.clear();
    opened.delete(box);
    box.querySelector(".place").replaceChildren();
  }

  function legend(names, box) {
    return Object.entries(names).map(([name, { colour, dash }]) => {
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.innerHTML = '<svg viewBox="0 0 32 8" aria-hidden="true"><path d="M0 4H32"/></svg>';
      const dashes = dash.map((length) => 1.6 * length).join(" ");
      button.querySelector("path").style = `stroke: ${colour}; stroke-width: 2.5; stroke-dasharray: ${dashes}`;
      button.append(name);
      button.addEventListener("click", () => {
        const shown = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(shown));
        for (const model of opened.get(box).all_models) if (model.name === name) model.visible = shown;
      });
      return button;
    });
  }

  for (const button of document.querySelectorAll("button.to-zoom")) {
    const box = button.closest("figure").querySelector(".zoom");
    const drawing = button.closest("figure").querySelector(".drawing");
    let work = Promise.resolve();

    function want(open) {
      button.textContent = open ? "Back to the picture" : "Zoom in";
      button.setAttribute("aria-expanded", String(open));
    }

    async function turn(open) {
      box.hidden = !open;
      try {
        await (open ? show(button.dataset.zoom, box) : hide(box));
        drawing.hidden = open;
      } catch (error) {
        say(`This browser cannot zoom: ${error.message}`);
        want(false);
        turn(false);
      }
    }

    // A click while a view is still being unpacked counts once it is there.
    button.addEventListener("click", () => {
      const open = button.getAttribute("aria-expanded") !== "true";
      want(open);
      work = work.then(() => turn(open));
    });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const button of document.querySelectorAll('button.to-zoom[aria-expanded="true"]')) {
      show(button.dataset.zoom, button.closest("figure").querySelector(".zoom"));
    }
  });

  const choice = document.getElementById("live-law");
  choice?.addEventListener("change", () => {
    for (const law of document.querySelectorAll(".live-law")) {
      law.hidden = law.dataset.law !== choice.value;
    }
    dispatchEvent(new Event("resize"));
  });
})();
