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
    const views = await Bokeh.embed.embed_item(data.item, box.querySelector(".place"));
    opened.set(box, [...views][0].model.document);
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
