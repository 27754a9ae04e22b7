// The work-precision diagram: a panel for each problem, a line for each scheme and solver.

const SHAPES = [
  "M-4.5 0A4.5 4.5 0 1 1 4.5 0A4.5 4.5 0 1 1-4.5 0Z",
  "M-4-4H4V4H-4Z",
  "M0-5.2L5 4H-5Z",
  "M0-5.5L5.5 0L0 5.5L-5.5 0Z",
  "M0 5.2L5-4H-5Z",
  "M-1.8-5H1.8V-1.8H5V1.8H1.8V5H-1.8V1.8H-5V-1.8H-1.8Z",
  "M0-6L1.6-1.8L6-1.8L2.4 1L3.8 5.4L0 2.8L-3.8 5.4L-2.4 1L-6-1.8L-1.6-1.8Z",
  "M-2.6-4.6H2.6L5.2 0L2.6 4.6H-2.6L-5.2 0Z",
];
const CROSS = "M-4-4L4 4M-4 4L4-4";
const ROW = 30; // pixels of a row above the axes: its name, then its marks

const seriesOf = (cell) => `${cell.scheme} · ${cell.solver}`;
const positive = (value) => Number.isFinite(number(value)) && number(value) > 0;
const hue = (scheme) => `hue-${schemes.indexOf(scheme) % 8}`;
const shape = (solver) => SHAPES[solvers.indexOf(solver) % SHAPES.length];

function drawDiagram(cells, { x, y, withBounds }) {
  const place = byId("diagram");
  const problems = distinct(cells.map((cell) => cell.problem));
  const total = place.clientWidth || 960;
  const columns = problems.length > 1 ? Math.max(1, Math.min(problems.length, 3, Math.floor(total / 330))) : 1;
  const width = Math.floor((total - 16 * (columns - 1)) / columns);
  place.style.setProperty("--columns", columns);
  tip.hide();
  place.replaceChildren(...problems.map((problem) =>
    drawPanel(problem, cells.filter((cell) => cell.problem === problem), x, y, withBounds, width)));
  if (!problems.length) place.append(el("p", { class: "empty" }, "No cell passes the filters."));
}

function drawPanel(problem, cells, x, y, withBounds, width) {
  const placed = cells.filter((cell) => cell.success && positive(cell[x]) && number(cell[y]) >= 0 && number(cell[y]) < Infinity);
  const rows = Map.groupBy(cells.filter((cell) => !placed.includes(cell)),
    (cell) => (!cell.success ? cell.status : number(cell[y]) < Infinity ? `no ${x.replace("_", " ")}` : `no ${y} known`));
  const bounded = y === "error" && withBounds ? placed.filter((cell) => cell.guaranteed && positive(cell.bound)) : [];
  const top = 8 + ROW * rows.size, height = Math.min(420, Math.max(320, width * 0.7));
  const box = { left: 62, right: width - 12, top, bottom: top + height - 50 };
  const across = logAxis(cells.map((cell) => number(cell[x])).filter(positive), box.left, box.right);
  const heights = [...placed.map((cell) => cell[y]), ...bounded.map((cell) => cell.bound)];
  const up = logAxis(heights.filter(positive), box.bottom, box.top);
  if (!heights.some(positive)) up.ticks = [];
  if (placed.some((cell) => cell[y] === 0)) up.ticks = floor(up);
  const at = (cell) => [across.place(number(cell[x])), cell[y] > 0 ? up.place(cell[y]) : box.bottom];
  const lines = [...Map.groupBy(placed, (cell) => seriesOf(cell) + cell.tol).values()].map((line) => {
    const ordered = [...line].sort((one, other) => one.steps - other.steps);
    const proved = ordered.filter((cell) => bounded.includes(cell));
    return svg("g", { class: hue(line[0].scheme) },
      proved.length ? svg("polyline", { class: "bound", points: proved.map((cell) => [across.place(number(cell[x])), up.place(cell.bound)]).join(" ") }) : null,
      svg("polyline", { class: "line", points: ordered.filter((cell) => cell[y] > 0).map(at).join(" ") }));
  });
  const marks = placed.map((cell) => drawMark(cell, ...at(cell), y));
  const above = [...rows].map(([reason, members], k) => drawAbove(reason, members, box, 4 + ROW * k, across, x));
  marks.push(...above.flatMap((row) => row.marks));
  const picture = svg("svg", { viewBox: `0 0 ${width} ${box.bottom + 44}`, role: "group", "aria-label": `${problem}: ${y} against ${x}` },
    drawAxes(box, across, up, DATA.costs[x], DATA.accuracies[y]),
    above.map((row) => row.label), lines, marks);
  if (!placed.length) picture.append(svg("text", { class: "empty", x: (box.left + box.right) / 2, y: (box.top + box.bottom) / 2, "text-anchor": "middle" }, "no cell has a value"));
  listen(picture, marks);
  return el("figure", { "data-problem": problem }, el("figcaption", {}, problem), picture);
}

// what is exactly 0 lies on the floor, which then has a tick of its own
function floor({ place, ticks, start }) {
  return [{ at: start, text: "0" }, ...ticks.filter(({ value }) => place(value) < start - 14)];
}

// cells without a place on the axes: marks beside each other, at their cost if it is known
function drawAbove(reason, cells, box, top, across, x) {
  const wanted = cells.map((cell) => ({ cell, at: positive(cell[x]) ? across.place(number(cell[x])) : box.right }));
  wanted.sort((one, other) => one.at - other.at);
  const gap = Math.min(11, (box.right - box.left) / wanted.length);
  for (let k = 1; k < wanted.length; k += 1) wanted[k].at = Math.max(wanted[k].at, wanted[k - 1].at + gap);
  let limit = box.right - 4;
  for (let k = wanted.length - 1; k >= 0; k -= 1) limit = (wanted[k].at = Math.min(wanted[k].at, limit)) - gap;
  const failed = cells.filter((cell) => !cell.success).length;
  const text = `${reason}: ${cells.length} ${cells.length === 1 ? "cell" : "cells"}`;
  return {
    label: svg("text", { class: failed ? "reason failed" : "reason", x: box.left, y: top + 8 }, text),
    marks: wanted.map(({ cell, at }) => drawMark(cell, at, top + 18, "")),
  };
}

function drawMark(cell, x, y, accuracy) {
  const open = accuracy === "" || (accuracy === "bound" && !cell.guaranteed);
  const kind = cell.success ? (open ? "mark open" : "mark") : "mark cross";
  return svg("g", {
    class: `${kind} ${hue(cell.scheme)}`,
    transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`,
    "data-cell": cell.key,
    tabindex: -1,
    role: "img",
    "aria-label": [seriesOf(cell), ...describe(cell).map((pair) => pair.join(" ")), cell.success ? "" : cell.message].join(", "),
  }, svg("path", { d: cell.success ? shape(cell.solver) : CROSS }));
}

function describe(cell) {
  return [
    ["status", cell.status],
    ["steps", whole(cell.steps)],
    ["tolerance", shown(cell.tol, 1)],
    ["error", `${shown(cell.error)} ${remark(cell, "error")}`],
    ["bound", `${shown(cell.bound)} ${remark(cell, "bound")}`],
    ["wall", `${shown(cell.wall)} s`],
    ["cpu", `${shown(cell.cpu)} s`],
    ["solver calls", whole(cell.solver_calls)],
  ];
}

// the mark nearest to the pointer, or the one that the arrow keys reach, shows its values
function listen(picture, marks) {
  const middle = (mark) => {
    const { left, right, top, bottom } = mark.getBoundingClientRect();
    return [(left + right) / 2, (top + bottom) / 2];
  };
  const choose = (mark) => {
    picture.querySelector(".chosen")?.classList.remove("chosen");
    if (!mark) return tip.hide();
    mark.classList.add("chosen");
    const cell = DATA.cells[Number(mark.dataset.cell)];
    return tip.show(...middle(mark), seriesOf(cell), describe(cell), cell.success ? "" : cell.message);
  };
  const nearest = (event) => {
    const far = marks.map((mark) => {
      const [x, y] = middle(mark);
      return Math.hypot(x - event.clientX, y - event.clientY);
    });
    const k = far.indexOf(Math.min(...far));
    return far[k] < 28 ? marks[k] : null;
  };
  for (const kind of ["pointermove", "pointerdown"]) picture.addEventListener(kind, (event) => choose(nearest(event)));
  picture.addEventListener("pointerleave", () => choose(null));
  picture.addEventListener("click", (event) => event.pointerType === "mouse" && goTo(nearest(event)));
  picture.addEventListener("focusin", (event) => choose(event.target.closest(".mark")));
  picture.addEventListener("focusout", () => choose(null));
  picture.addEventListener("keydown", (event) => {
    const k = marks.indexOf(document.activeElement);
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (event.key === "Enter" && k >= 0) goTo(marks[k]);
    if (step === undefined || k < 0) return;
    event.preventDefault();
    const next = marks[(k + step + marks.length) % marks.length];
    marks[k].setAttribute("tabindex", -1);
    next.setAttribute("tabindex", 0);
    next.focus();
  });
  marks[0]?.setAttribute("tabindex", 0);
}

function goTo(mark) {
  if (!mark) return;
  const row = byId("table").querySelector(`tr[data-cell="${mark.dataset.cell}"]`);
  row.scrollIntoView({ block: "center" });
  row.focus({ preventScroll: true });
}
