// Hard cases: every path and solver beside the true answer.

const HARD_COLUMNS = [
  { name: "family", title: "case" },
  { name: "seed", title: "seed", show: whole },
  { name: "path", title: "path" },
  { name: "solver", title: "solver" },
  { name: "answer", title: "true answer" },
  { name: "error", title: "true error", show: shown },
  { name: "certificate", title: "certificate", show: shown },
  { name: "rung", title: "found by" },
  { name: "attempts", title: "attempts", show: whole },
  { name: "milliseconds", title: "time (ms)", show: shown },
  { name: "verdict", title: "verdict" },
];

function hardPage({ target, about, rows }) {
  rows.forEach((row) => {
    row.outcome = row.good ? "right" : "wrong";
  });
  const sort = { column: "", down: false };
  const chosen = filters(byId("hard-filters"), rows, [
    { name: "path" }, { name: "solver" }, { name: "rung", title: "found by" }, { name: "seed" },
    { name: "outcome", title: "verdict", values: ["right", "wrong"] }, { name: "family", title: "case" },
  ], { noun: "runs", prefix: "hard-", redraw: draw });

  function drawRow(row) {
    const text = { family: [row.family, el("small", { class: "message" }, row.drawn || about[row.family])], verdict: drawBadge(row.good, row.verdict) };
    return el("tr", { class: row.good ? undefined : "failed" }, HARD_COLUMNS.map(({ name, title, show }) =>
      el("td", { class: show ? "number" : name, "data-column": name, "data-title": title }, show ? show(row[name]) : text[name] ?? row[name])));
  }

  function draw() {
    chosen.draw();
    drawTable(byId("hard-table"), HARD_COLUMNS, chosen.passing(), sort, draw, drawRow);
  }

  const wrong = rows.filter((row) => !row.good);
  const families = distinct(rows.map((row) => row.family)).length;
  drawTiles(byId("hard-summary"), [["cases", families], ["runs", rows.length]], "right", "wrong", wrong, (row) => row.verdict);
  byId("hard-target").textContent = target.toExponential(0);
  return draw;
}
