// State, filters and what follows from them.

const DATA = JSON.parse(byId("data").textContent);
DATA.cells.forEach((cell, k) => {
  cell.key = k;
  cell.outcome = cell.success ? "succeeded" : "failed";
});
const schemes = distinct([...DATA.cells, ...DATA.trajectories].map((item) => item.scheme));
const solvers = distinct(DATA.cells.map((cell) => cell.solver));
const FILTERS = ["problem", "scheme", "solver", "outcome"];
const state = {
  picked: Object.fromEntries(FILTERS.map((name) => [name, new Set()])), // none picked: all shown
  hidden: new Set(),
  sort: { column: "", down: false },
  x: "wall",
  y: "error",
  withBounds: true,
};

const passes = (cell, names = FILTERS) => names.every((name) => !state.picked[name].size || state.picked[name].has(cell[name]));
const flip = (set, value) => (set.has(value) ? set.delete(value) : set.add(value));

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
  const failed = DATA.cells.filter((cell) => !cell.success);
  const tile = (value, name, kind) => el("div", { class: `tile ${kind}` }, el("strong", {}, whole(value)), el("span", {}, name));
  const reasons = [...Map.groupBy(failed, (cell) => cell.status)].map(([status, cells]) => `${status} × ${cells.length}`);
  byId("summary").append(
    tile(distinct(DATA.cells.map((cell) => cell.problem)).length, "problems", ""),
    tile(DATA.cells.length, "cells", ""),
    tile(DATA.cells.length - failed.length, "succeeded", "good"),
    tile(failed.length, "failed", failed.length ? "bad" : ""),
    ...(failed.length ? [el("p", { class: "reasons" }, reasons.join(", "))] : []));
}

function drawFilters() {
  const focused = document.activeElement?.dataset.filter;
  const groups = FILTERS.map((name) => {
    const others = FILTERS.filter((other) => other !== name);
    const values = name === "outcome" ? ["succeeded", "failed"] : distinct(DATA.cells.map((cell) => cell[name]));
    return el("fieldset", {}, el("legend", {}, name === "outcome" ? "status" : name), values.map((value) => {
      const found = DATA.cells.filter((cell) => cell[name] === value && passes(cell, others)).length;
      return el("button", {
        type: "button",
        class: "chip",
        "data-filter": `${name}:${value}`,
        "aria-pressed": String(state.picked[name].has(value)),
        onclick: () => {
          flip(state.picked[name], value);
          draw();
        },
      }, value, " ", el("small", {}, String(found)));
    }));
  });
  const found = DATA.cells.filter((cell) => passes(cell)).length;
  const clear = el("button", {
    type: "button",
    id: "clear",
    "data-filter": "clear",
    disabled: FILTERS.every((name) => !state.picked[name].size),
    onclick: () => {
      FILTERS.forEach((name) => state.picked[name].clear());
      draw();
    },
  }, "Show all");
  byId("filters").replaceChildren(...groups, el("p", { class: "count" },
    el("span", { id: "count", role: "status" }, `${whole(found)} of ${whole(DATA.cells.length)} cells`), clear));
  if (focused) byId("filters").querySelector(`[data-filter="${CSS.escape(focused)}"]`)?.focus();
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

function sortBy(column) {
  state.sort = { column, down: state.sort.column === column && !state.sort.down };
  draw();
  byId("table").querySelector(`[data-sort="${column}"]`).focus();
}

function draw() {
  const cells = DATA.cells.filter((cell) => passes(cell));
  drawFilters();
  drawLegend(cells);
  drawDiagram(cells.filter((cell) => !state.hidden.has(seriesOf(cell))), state);
  drawTable(cells, state.sort, sortBy);
}

drawHeader();
drawSummary();
drawControls();
draw();
drawTrajectories();
onResize(byId("diagram"), draw);
