// The table: every cell is a row, one that failed says why.

const COLUMNS = [
  { name: "problem", title: "problem" },
  { name: "scheme", title: "scheme" },
  { name: "solver", title: "solver" },
  { name: "steps", title: "steps", show: whole },
  { name: "status", title: "status" },
  { name: "error", title: "error", show: shown },
  { name: "bound", title: "bound", show: shown },
  { name: "wall", title: "wall (s)", show: shown },
  { name: "cpu", title: "cpu (s)", show: shown },
  { name: "solver_calls", title: "solver calls", show: whole },
  { name: "certificate", title: "certificate", show: shown },
  { name: "tol", title: "tolerance", show: (value) => shown(value, 1) },
  { name: "steps_done", title: "steps done", show: whole },
  { name: "unknowns", title: "unknowns", show: whole },
  { name: "path", title: "path" },
];

function sorted(cells, { column, down }) {
  if (!column) return cells;
  const numeric = COLUMNS.find(({ name }) => name === column).show;
  const key = (cell) => (numeric ? number(cell[column]) : cell[column]);
  const unknown = (value) => Number.isNaN(value);
  return [...cells].sort((one, other) => {
    const a = key(one), b = key(other);
    if (unknown(a) || unknown(b)) return unknown(a) - unknown(b); // what is unknown comes last
    return (a < b ? -1 : a > b ? 1 : 0) * (down ? -1 : 1);
  });
}

function drawTable(cells, sort, sortBy) {
  const head = COLUMNS.map(({ name, title, show }) => el("th", {
    scope: "col",
    class: show ? "number" : undefined,
    "aria-sort": sort.column === name ? (sort.down ? "descending" : "ascending") : undefined,
  }, el("button", { type: "button", "data-sort": name, onclick: () => sortBy(name) }, title)));
  const table = el("table", {},
    el("thead", {}, el("tr", {}, head)),
    el("tbody", {}, sorted(cells, sort).map(drawRow)));
  byId("table").replaceChildren(cells.length ? table : el("p", { class: "empty" }, "No cell passes the filters."));
}

function drawRow(cell) {
  const row = COLUMNS.map(({ name, title, show }) => el("td", { class: show ? "number" : name, "data-column": name, "data-title": title },
    name === "status" ? drawStatus(cell) : show ? show(cell[name]) : cell[name], el("small", {}, remark(cell, name))));
  return el("tr", { class: cell.success ? undefined : "failed", "data-cell": cell.key, tabindex: -1 }, row);
}

function drawStatus(cell) {
  const name = el("span", { class: "badge" }, (cell.success ? "✓ " : "✗ ") + cell.status);
  return cell.message === DATA.usual ? [name] : [name, el("span", { class: "message" }, cell.message)];
}

// how an error or a bound is known
function remark(cell, name) {
  if (!Number.isFinite(number(cell[name]))) return "";
  if (name === "error") return cell.error_is;
  return name === "bound" ? (cell.guaranteed ? "guaranteed" : "estimated") : "";
}
