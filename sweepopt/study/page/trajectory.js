// Runs over time, each with the band that holds the solution.

function drawTrajectories() {
  const pictures = Map.groupBy(DATA.trajectories, (run) => `${run.problem}: ${run.component}`);
  if (!pictures.size) return;
  byId("trajectory").hidden = false;
  const hidden = new Set();
  const select = el("select", { id: "picture", onchange: () => draw() }, [...pictures.keys()].map((name) => el("option", {}, name)));
  byId("which").append(el("label", {}, "problem ", select));
  const draw = () => {
    const runs = pictures.get(select.value);
    const toggle = (name) => {
      hidden.has(name) ? hidden.delete(name) : hidden.add(name);
      draw();
    };
    byId("runs").replaceChildren(...runs.map((run) => {
      const widest = run.band && Math.max(...run.band);
      const name = runName(run) + (run.band ? `, ± ${shown(widest)} at most` : ", no band");
      return legendButton(name, { colour: hue(run.scheme), line: lineOf(run, runs) }, !hidden.has(run), () => toggle(run));
    }));
    drawCurves(runs.filter((run) => !hidden.has(run)), (run) => lineOf(run, runs));
  };
  draw();
  onResize(byId("curves"), draw);
}

const runName = (run) => `${run.scheme}, ${whole(run.steps)} steps`;

// runs of one scheme have one colour and different strokes
const lineOf = (run, runs) => `line dash-${runs.filter((other) => other.scheme === run.scheme).indexOf(run) % 4}`;

function drawCurves(runs, line) {
  const place = byId("curves");
  const width = place.clientWidth || 960, height = Math.min(420, Math.max(260, width * 0.5));
  const box = { left: 66, right: width - 12, top: 8, bottom: height - 44 };
  const half = (run, k) => (run.band ? run.band[k] : 0);
  const range = (pick) => {
    let low = Infinity, high = -Infinity;
    for (const run of runs) {
      for (let k = 0; k < run.t.length; k += 1) {
        const [a, b] = pick(run, k);
        low = Math.min(low, a);
        high = Math.max(high, b);
      }
    }
    return low <= high ? [low, high] : [0, 1];
  };
  const across = linearAxis(...range((run, k) => [run.t[k], run.t[k]]), box.left, box.right);
  const up = linearAxis(...range((run, k) => [run.u[k] - half(run, k), run.u[k] + half(run, k)]), box.bottom, box.top);
  const points = (run, sign) => run.t.map((t, k) => `${across.place(t).toFixed(2)} ${up.place(run.u[k] + sign * half(run, k)).toFixed(2)}`);
  const cursor = svg("line", { class: "cursor", y1: box.top, y2: box.bottom, visibility: "hidden" });
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, tabindex: 0, role: "img", "aria-label": "Trajectory over time; arrow keys read values" },
    drawAxes(box, across, up, "time t", runs.length ? runs[0].component : ""),
    runs.filter((run) => run.band).map((run) => svg("polygon", { class: `band ${hue(run.scheme)}`, points: [...points(run, 1), ...points(run, -1).reverse()].join(" ") })),
    runs.map((run) => svg("polyline", { class: `${line(run)} ${hue(run.scheme)}`, points: points(run, 0).join(" ") })),
    cursor);
  read(picture, cursor, runs, across, width);
  place.replaceChildren(picture);
}

// values at the node nearest to the pointer, said below the picture
function read(picture, cursor, runs, across, width) {
  if (!runs.length) return;
  const times = runs[0].t;
  let k = 0;
  const nearest = (values, t) => {
    let low = 0, high = values.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (values[middle] < t) low = middle; else high = middle;
    }
    return t - values[low] < values[high] - t ? low : high;
  };
  const say = () => {
    const x = across.place(times[k]);
    for (const [name, value] of [["x1", x], ["x2", x], ["visibility", "visible"]]) cursor.setAttribute(name, value);
    const parts = runs.map((run) => {
      const i = nearest(run.t, times[k]);
      return `${runName(run)}: ${shown(run.u[i], 4)}${run.band ? ` ± ${shown(run.band[i])}` : ""}`;
    });
    byId("reading").textContent = `t = ${shown(times[k], 3)}   ${parts.join("   ")}`;
  };
  picture.addEventListener("pointermove", (event) => {
    const { left, width: seen } = picture.getBoundingClientRect();
    const x = ((event.clientX - left) / seen) * width;
    const a = across.place(times[0]), b = across.place(times[times.length - 1]);
    k = nearest(times, times[0] + ((x - a) / (b - a)) * (times[times.length - 1] - times[0]));
    say();
  });
  picture.addEventListener("keydown", (event) => {
    const size = event.shiftKey ? 10 : 1;
    const step = { ArrowRight: size, ArrowLeft: -size }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    k = Math.min(times.length - 1, Math.max(0, k + step));
    say();
  });
}
