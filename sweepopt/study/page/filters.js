// Filters over rows: buttons for the values of some columns; where none is pressed all rows pass.

function filters(place, rows, columns, { noun, prefix = "", redraw }) {
  const picked = Object.fromEntries(columns.map(({ name }) => [name, new Set()]));
  const passes = (row, without) => columns.every(({ name }) => name === without || !picked[name].size || picked[name].has(row[name]));

  function chip(name, value) {
    const found = rows.filter((row) => row[name] === value && passes(row, name)).length;
    return el("button", {
      type: "button",
      class: "chip",
      "data-filter": `${name}:${value}`,
      "aria-pressed": String(picked[name].has(value)),
      onclick: () => {
        flip(picked[name], value);
        redraw();
      },
    }, String(value), " ", el("small", {}, String(found)));
  }

  function draw() {
    const focused = document.activeElement?.dataset.filter;
    const groups = columns.map(({ name, title = name, values = distinct(rows.map((row) => row[name])) }) =>
      el("fieldset", {}, el("legend", {}, title), values.map((value) => chip(name, value))));
    const clear = el("button", {
      type: "button",
      id: `${prefix}clear`,
      class: "clear",
      "data-filter": "clear",
      disabled: columns.every(({ name }) => !picked[name].size),
      onclick: () => {
        columns.forEach(({ name }) => picked[name].clear());
        redraw();
      },
    }, "Show all");
    place.replaceChildren(...groups, el("p", { class: "count" },
      el("span", { id: `${prefix}count`, role: "status" }, `${whole(passing().length)} of ${whole(rows.length)} ${noun}`), clear));
    if (focused) place.querySelector(`[data-filter="${CSS.escape(focused)}"]`)?.focus();
  }

  const passing = () => rows.filter((row) => passes(row));
  return { draw, passing };
}

const tile = (value, name, kind = "") => el("div", { class: `tile ${kind}` }, el("strong", {}, whole(value)), el("span", {}, name));

// the counts of all rows, and what is wrong with those that are
function drawTiles(place, counts, good, bad, failed, reason) {
  const reasons = [...Map.groupBy(failed, reason)].map(([words, rows]) => `${words} × ${rows.length}`);
  const [, total] = counts[counts.length - 1];
  place.append(...counts.map(([name, count]) => tile(count, name)),
    tile(total - failed.length, good, "good"),
    tile(failed.length, bad, failed.length ? "bad" : ""),
    failed.length ? el("p", { class: "reasons" }, reasons.join(", ")) : "");
}
