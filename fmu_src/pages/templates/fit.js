/* Compress too wide tables, then show them row by row with column names in each cell; shrink
 * equations. */
function fitTables() {
  const equations = [...document.querySelectorAll(".equation")].filter((e) => e.clientWidth);
  for (const equation of equations) equation.style.fontSize = "";
  const shares = equations.map((e) => 0.96 * e.clientWidth / e.scrollWidth);
  equations.forEach((e, k) => {
    if (shares[k] < 0.96) e.style.fontSize = `${shares[k] * parseFloat(getComputedStyle(e).fontSize)}px`;
  });
  const places = [...document.querySelectorAll(".wide")].filter((place) => place.clientWidth);
  const wider = (all) => all.filter((place) => place.scrollWidth > place.clientWidth);
  for (const place of places) place.classList.remove("tight", "cards");
  const tight = wider(places);
  for (const place of tight) place.classList.add("tight");
  for (const place of wider(tight)) {
    place.classList.add("cards");
    const heads = [...place.querySelectorAll("thead tr:last-child > *")];
    for (const row of place.querySelectorAll("tbody tr")) {
      [...row.cells].forEach((cell, k) => {
        const name = k && row.cells.length === heads.length ? heads[k].textContent.trim() : "";
        if (name) cell.dataset.label = `${name}: `;
        if (cell.matches(".beside")) cell.previousElementSibling.dataset.beside = cell.textContent;
      });
    }
  }
}
{
  let width, frame;
  /* React to widths only; fitting itself changes heights. */
  new ResizeObserver(() => {
    if (width !== document.body.clientWidth) fitTables();
    width = document.body.clientWidth;
  }).observe(document.body);
  /* Once per frame, when many sections unfold. */
  document.addEventListener("toggle", () => {
    frame ??= requestAnimationFrame(() => { frame = undefined; fitTables(); });
  }, true);
}
