// Elements, numbers and axes. Text enters the page through text nodes only.

const SVG = "http://www.w3.org/2000/svg";

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== undefined && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return node;
}

const el = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);
const svg = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);
const byId = (id) => document.getElementById(id);
const distinct = (values) => [...new Set(values)];
const flip = (set, value) => (set.has(value) ? set.delete(value) : set.add(value));

// null is unknown, the word "inf" is infinity: JSON has neither
function number(value) {
  if (value === null) return NaN;
  return typeof value === "string" ? Number(value.replace("inf", "Infinity")) : value;
}

function shown(value, digits = 2) {
  const x = number(value);
  if (Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return x > 0 ? "∞" : "−∞";
  if (x === 0) return "0";
  if (Math.abs(x) < 1e-2 || Math.abs(x) >= 1e5) return x.toExponential(digits - 1);
  return String(Number(x.toPrecision(digits + 1)));
}

const whole = (value) => (value === null ? "–" : number(value).toLocaleString("en"));

function raised(power) {
  const digits = [...String(power)].map((c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)]));
  return "10" + digits.join("");
}

// an axis: where a value is in pixels, and its ticks
function logAxis(values, from, to) {
  const low = values.length ? Math.min(...values) : 0.1;
  const high = values.length ? Math.max(...values) : 1;
  const room = Math.max(0.05 * Math.log10(high / low), 0.08);
  const a = Math.log10(low) - room, b = Math.log10(high) + room;
  const place = (value) => from + ((Math.log10(value) - a) / (b - a)) * (to - from);
  const between = Math.abs(to - from) > 130 * (b - a) ? [1, 2, 5] : [1];
  const stride = Math.max(1, Math.ceil((b - a) / Math.max(2, Math.abs(to - from) / 30)));
  const ticks = [];
  for (let power = Math.floor(a); power <= Math.ceil(b); power += 1) {
    if (power % stride) continue;
    for (const times of between) {
      const at = power + Math.log10(times);
      if (at < a || at > b) continue;
      const value = times * 10 ** power;
      ticks.push({ value, text: power >= -3 && power <= 3 ? String(Number(value.toPrecision(1))) : times === 1 ? raised(power) : `${times}·${raised(power)}` });
    }
  }
  return { place, ticks, start: from };
}

function linearAxis(low, high, from, to) {
  const span = high - low || Math.abs(high) || 1;
  const a = low - 0.04 * span, b = high + 0.04 * span;
  const place = (value) => from + ((value - a) / (b - a)) * (to - from);
  const rough = (b - a) / Math.max(2, Math.abs(to - from) / 70);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((size) => size >= rough);
  const ticks = [];
  for (let k = Math.ceil(a / step); k * step <= b; k += 1) {
    ticks.push({ value: k * step, text: String(Number((k * step).toPrecision(6))) });
  }
  return { place, ticks };
}

// frame, grid, tick labels and names of both axes
function drawAxes(box, across, up, nameAcross, nameUp) {
  const { left, right, top, bottom } = box;
  return svg("g", { class: "axes" },
    across.ticks.map(({ value, text }) => {
      const x = across.place(value);
      return svg("g", {}, svg("line", { class: "grid", x1: x, x2: x, y1: top, y2: bottom }),
        svg("text", { x, y: bottom + 16, "text-anchor": "middle" }, text));
    }),
    up.ticks.map(({ value, at, text }) => {
      const y = at ?? up.place(value);
      return svg("g", {}, svg("line", { class: "grid", x1: left, x2: right, y1: y, y2: y }),
        svg("text", { x: left - 6, y: y + 4, "text-anchor": "end" }, text));
    }),
    svg("rect", { class: "frame", x: left, y: top, width: right - left, height: bottom - top }),
    svg("text", { class: "name", x: (left + right) / 2, y: bottom + 36, "text-anchor": "middle" }, nameAcross),
    svg("text", { class: "name", "text-anchor": "middle", transform: `translate(14 ${(top + bottom) / 2}) rotate(-90)` }, nameUp));
}

// a box of values beside a place of the page
const tip = {
  show(x, y, heading, pairs, note) {
    const box = byId("tip");
    box.replaceChildren(el("strong", {}, heading), note ? el("p", {}, note) : "",
      el("dl", {}, pairs.map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])));
    box.hidden = false;
    const width = document.documentElement.clientWidth;
    const left = x + 14 + box.offsetWidth < width ? x + 14 : Math.max(4, x - 14 - box.offsetWidth);
    const top = Math.min(Math.max(4, y - box.offsetHeight / 2), window.innerHeight - box.offsetHeight - 4);
    box.style.left = `${left}px`;
    box.style.top = `${top}px`;
  },
  hide() {
    byId("tip").hidden = true;
  },
};
