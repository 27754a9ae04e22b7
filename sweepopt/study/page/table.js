// Tables that sort, and the rows of a study: every cell is one, and says why if it failed.

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

function sorted(rows, columns, { column, down }) {
  if (!column) return rows;
  const numeric = columns.find(({ name }) => name === column).show;
  const key = (row) => (numeric ? number(row[column]) : row[column]);
  const unknown = (value) => Number.isNaN(value);
  return [...rows].sort((one, other) => {
    const a = key(one), b = key(other);
    if (unknown(a) || unknown(b)) return unknown(a) - unknown(b); // what is unknown comes last
    return (a < b ? -1 : a > b ? 1 : 0) * (down ? -1 : 1);
  });
}

function drawTable(place, columns, rows, sort, redraw, drawRow) {
  const sortBy = (column) => {
    Object.assign(sort, { down: sort.column === column && !sort.down, column });
    redraw();
    place.querySelector(`[data-sort="${column}"]`).focus();
  };
  const head = columns.map(({ name, title, show }) => el("th", {
    scope: "col",
    class: show ? "number" : undefined,
    "aria-sort": sort.column === name ? (sort.down ? "descending" : "ascending") : undefined,
  }, el("button", { type: "button", "data-sort": name, onclick: () => sortBy(name) }, title)));
  const table = el("table", {},
    el("thead", {}, el("tr", {}, head)),
    el("tbody", {}, sorted(rows, columns, sort).map(drawRow)));
  place.replaceChildren(rows.length ? table : el("p", { class: "empty" }, "Nothing passes the filters."));
}

function drawRow(cell) {
  const row = COLUMNS.map(({ name, title, show }) => el("td", { class: show ? "number" : name, "data-column": name, "data-title": title },
    name === "status" ? drawBadge(cell.success, cell.status, cell.message === DATA.usual ? "" : cell.message) : show ? show(cell[name]) : cell[name], el("small", {}, remark(cell, name))));
  return el("tr", { class: cell.success ? undefined : "failed", "data-cell": cell.key, tabindex: -1 }, row);
}

function drawBadge(good, words, message) {
  const badge = el("span", { class: "badge" }, (good ? "✓ " : "✗ ") + words);
  return message ? [badge, el("span", { class: "message" }, message)] : [badge];
}

// how an error or a bound is known
function remark(cell, name) {
  if (!Number.isFinite(number(cell[name]))) return "";
  if (name === "error") return cell.error_is;
  return name === "bound" ? (cell.guaranteed ? "guaranteed" : "estimated") : "";
}
