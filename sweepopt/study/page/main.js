// The pages, the state of the first one and what follows from it.

const DATA = JSON.parse(byId("data").textContent);
DATA.cells.forEach((cell, k) => {
  cell.key = k;
  cell.outcome = cell.success ? "succeeded" : "failed";
});
const schemes = distinct([...DATA.cells, ...DATA.trajectories].map((item) => item.scheme));
const solvers = distinct(DATA.cells.map((cell) => cell.solver));
const state = { hidden: new Set(), sort: { column: "", down: false }, x: "wall", y: "error", withBounds: true };
const chosen = filters(byId("filters"), DATA.cells, [
  { name: "problem" }, { name: "scheme" }, { name: "solver" }, { name: "outcome", title: "status", values: ["succeeded", "failed"] },
], { noun: "cells", redraw: draw });

function onResize(place, draw) {
  let width = place.clientWidth;
  new ResizeObserver(() => {
    if (place.clientWidth === width) return;
    width = place.clientWidth;
    draw();
  }).observe(place);
}

function drawHeader() {
  byId("title").textContent = DATA.title;
  byId("when").textContent = `${DATA.date} · ${DATA.machines.filter(Boolean).join(" / ")}`;
  for (const [name, found] of Object.entries(DATA.versions)) {
    if (found.some(Boolean)) byId("versions").append(el("div", {}, el("dt", {}, name), el("dd", {}, found.filter(Boolean).join(" / "))));
  }
}

function drawSummary() {
  const counts = [["problems", distinct(DATA.cells.map((cell) => cell.problem)).length], ["cells", DATA.cells.length]];
  drawTiles(byId("summary"), counts, "succeeded", "failed", DATA.cells.filter((cell) => !cell.success), (cell) => cell.status);
}

function drawControls() {
  const select = (name, label, words) => el("label", {}, `${label} `, el("select", {
    id: name,
    onchange: (event) => {
      state[name] = event.target.value;
      draw();
    },
  }, Object.entries(words).map(([value, text]) => el("option", { value }, text))));
  byId("axes").append(select("y", "vertical", DATA.accuracies), select("x", "horizontal", DATA.costs));
}

function legendButton(name, { colour, line = "line", path = "" }, pressed, press) {
  const swatch = svg("svg", { class: `swatch ${colour}`, viewBox: "-16 -8 32 16", "aria-hidden": "true" },
    svg("line", { class: line, x1: -15, x2: 15, y1: 0, y2: 0 }),
    svg("path", { d: path }));
  return el("button", { type: "button", "data-series": name, "aria-pressed": String(pressed), onclick: press }, swatch, name);
}

function drawLegend(cells) {
  const focused = document.activeElement?.dataset.series;
  const buttons = [...Map.groupBy(cells, seriesOf)].map(([series, [{ scheme, solver }]]) =>
    legendButton(series, { colour: hue(scheme), path: shape(solver) }, !state.hidden.has(series), () => {
      flip(state.hidden, series);
      draw();
    }));
  if (state.y === "error" && cells.some((cell) => cell.guaranteed)) {
    buttons.push(legendButton("guaranteed bound", { colour: "hue-ink", line: "bound" }, state.withBounds, () => {
      state.withBounds = !state.withBounds;
      draw();
    }));
  }
  byId("legend").replaceChildren(...buttons);
  if (focused) byId("legend").querySelector(`[data-series="${CSS.escape(focused)}"]`)?.focus();
}

function draw() {
  const cells = chosen.passing();
  chosen.draw();
  drawLegend(cells);
  drawDiagram(cells.filter((cell) => !state.hidden.has(seriesOf(cell))), state);
  drawTable(byId("table"), COLUMNS, cells, state.sort, draw, drawRow);
}

function drawStudy() {
  drawSummary();
  drawControls();
  draw();
  drawTrajectories();
  onResize(byId("diagram"), draw);
}

// a page is drawn when it is first seen: pictures need its width
function openPages(pages) {
  const open = (chosen) => {
    for (const page of pages) {
      byId(page.id).hidden = page !== chosen;
      page.button.setAttribute("aria-pressed", String(page === chosen));
    }
    chosen.draw?.();
    chosen.draw = null;
  };
  for (const page of pages) {
    page.button = el("button", { type: "button", class: "chip", "data-page": page.id, onclick: () => open(page) }, page.title);
  }
  if (pages.length > 1) byId("pages").append(...pages.map((page) => page.button));
  open(pages[0]);
}

drawHeader();
openPages([
  ...(DATA.cells.length ? [{ id: "study", title: "What accuracy costs", draw: drawStudy }] : []),
  ...(DATA.hard ? [{ id: "hard", title: "Hard cases", draw: hardPage(DATA.hard) }] : []),
]);
