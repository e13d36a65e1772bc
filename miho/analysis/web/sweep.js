"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const GAP_FLOOR = 1e-4;
  const byId = (id) => document.getElementById(id);
  const read = (id) => JSON.parse(byId(id).textContent);
  const about = read("about");
  const plot = byId("plot"), legend = byId("legend"), readout = byId("readout");
  const shown = new Set(about.shown);
  const state = { problem: 0, at: null };
  for (const button of document.querySelectorAll("button[data-set][aria-pressed=true]")) {
    state[button.dataset.set] = button.dataset.to;
  }
  const problems = new Map();
  let scales = null, cross = null;

  // A curve is a text with a number per grid position, empty where it is as before.
  const dense = (text) => {
    let last = NaN;
    return Float64Array.from(text.split(","), (told) => (told === "" ? last : (last = Number(told))));
  };

  const choose = (name, value) => {
    state[name] = value;
    for (const button of document.querySelectorAll(`button[data-set="${name}"]`)) {
      button.setAttribute("aria-pressed", button.dataset.to === value);
    }
  };
  const current = () => {
    if (!problems.has(state.problem)) problems.set(state.problem, read(`curves-${state.problem}`));
    const problem = problems.get(state.problem);
    const axis = problem.axes[state.axis];
    if (!axis.ready) {
      for (const curve of axis.curves) {
        for (const key of ["median", "low", "high"]) {
          if (curve[key]) curve[key] = dense(curve[key]);
        }
        curve.seeds = curve.seeds.map(dense);
      }
      axis.ready = true;
    }
    return { problem, axis };
  };

  const isGap = (problem) => state.quantity === "gap" && problem.best !== null;
  const quantity = (problem) =>
    isGap(problem) ? (v) => Math.max(v / problem.best - 1, GAP_FLOOR) : (v) => v;

  // Numbers
  const superscript = (n) => String(n).replace(/[-\d]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const number = (v, digits) => {
    if (v === 0) return "0";
    const power = Math.floor(Math.log10(Math.abs(v)));
    if (power >= 6 || power < -3) {
      const mantissa = Number((v / 10 ** power).toPrecision(digits));
      return (mantissa === 1 ? "" : `${mantissa}×`) + `10${superscript(power)}`;
    }
    return Number(v.toPrecision(Math.max(digits, Math.min(power + 1, 6))))
      .toLocaleString("en-US", { maximumFractionDigits: 8 });
  };

  const linearTicks = (low, high, count) => {
    const raw = (high - low) / count;
    const power = 10 ** Math.floor(Math.log10(raw));
    const size = power * [1, 2, 5, 10].find((m) => m * power >= raw);
    const ticks = [];
    for (let k = Math.ceil(low / size); k * size <= high * (1 + 1e-12); k += 1) ticks.push(k * size);
    return ticks;
  };
  const logTicks = (low, high, count) => {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const decades = Math.log10(high / low);
    const within = (ticks) => ticks.filter((t) => t >= low * 0.9999 && t <= high * 1.0001);
    if (decades < 0.7) return linearTicks(low, high, count);
    const every = Math.max(1, Math.ceil(decades / (count + 1)));
    const factors = decades < 2.5 ? [1, 2, 5] : [1];
    const ticks = [];
    for (let k = first; k <= last; k += 1) {
      if (((k % every) + every) % every === 0) ticks.push(...factors.map((m) => m * 10 ** k));
    }
    return within(ticks);
  };
  const scale = (low, high, from, to, kind) => {
    const f = kind === "log" ? Math.log10 : (v) => v;
    const inverse = kind === "log" ? (v) => 10 ** v : (v) => v;
    const [a, b] = [f(low), f(high)];
    const place = (v) => from + ((f(v) - a) / (b - a || 1)) * (to - from);
    place.invert = (p) => inverse(a + ((p - from) / (to - from)) * (b - a));
    place.ticks = (count) => (kind === "log" ? logTicks : linearTicks)(low, high, count);
    return place;
  };

  // Drawing
  const element = (name, attributes, parent) => {
    const made = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  };
  const text = (parent, words, attributes) => {
    element("text", attributes, parent).textContent = words;
  };
  const range = (axis, problem) => {
    const value = quantity(problem);
    let [low, high, top] = [Infinity, 0, 0];
    for (const curve of axis.curves) {
      if (!shown.has(curve.method)) continue;
      const rows = state.mode === "seeds" ? curve.seeds
        : state.mode === "band" && curve.low ? [curve.low, curve.high] : [curve.median];
      for (const row of rows) {
        for (const raw of row) {
          const v = value(raw);
          if (!(v > 0 || state.y === "linear") || Number.isNaN(v)) continue;
          low = Math.min(low, v);
          high = Math.max(high, v);
        }
        const last = value(row[row.length - 1]);
        if (!Number.isNaN(last)) top = Math.max(top, last);
      }
    }
    if (!(high > 0)) return [state.y === "log" ? 0.1 : 0, 1];
    if (state.y === "linear") return [0, Math.min(high, 2 * top) || high];
    return low === high ? [low / 2, high * 2] : [low * (low / high) ** 0.03, high * (high / low) ** 0.03];
  };
  const corners = (row, grid, value) => {
    const points = [];
    let last = NaN;
    for (let i = 0; i < grid.length; i += 1) {
      const v = value(row[i]);
      if (!Number.isNaN(v) && v !== last) points.push([i, v]);
      if (!Number.isNaN(v)) last = v;
    }
    return points;
  };
  const round = (v) => v.toFixed(1);
  const line = (row, grid, value, x, y) => {
    const points = corners(row, grid, value);
    if (!points.length) return "";
    const parts = points.map(([i, v], k) =>
      k ? `H${round(x(grid[i]))}V${round(y(v))}` : `M${round(x(grid[i]))} ${round(y(v))}`);
    return parts.join("") + `H${round(x(grid[grid.length - 1]))}`;
  };
  const band = (curve, grid, value, x, y) => {
    const upper = [], lower = [];
    for (let i = 0; i < grid.length; i += 1) {
      if (Number.isNaN(curve.high[i])) continue;
      const [left, right] = [grid[i], grid[Math.min(i + 1, grid.length - 1)]].map((g) => round(x(g)));
      const [top, bottom] = [curve.high[i], curve.low[i]].map((v) => round(y(value(v))));
      upper.push(`${left} ${top}L${right} ${top}`);
      lower.push(`${right} ${bottom}L${left} ${bottom}`);
    }
    return upper.length ? `M${upper.join("L")}L${lower.reverse().join("L")}Z` : "";
  };
  const axisLabels = (problem) => [
    state.axis === "seconds" ? `${about.time} [s]` : "evaluations of the loss [-]",
    !isGap(problem) ? `error [${problem.unit}]`
      : `gap to the best ${problem.recorded ? "known error" : "of these runs"} [-]`,
  ];

  const draw = () => {
    const { problem, axis } = current();
    const width = Math.max(plot.clientWidth, 280);
    const narrow = width < 500;
    const height = Math.round(Math.min(480, Math.max(300, 0.62 * width)));
    const frame = { right: width - 16, top: 12, bottom: height - 48 };
    const grid = axis.grid;
    const [low, high] = range(axis, problem);
    const y = scale(low, high, frame.bottom, frame.top, state.y);
    const marks = y.ticks(6).map((tick) => [y(tick), number(tick, 3)]);
    frame.left = 34 + 7.5 * Math.max(...marks.map(([, words]) => words.length), 3);
    const x = scale(state.x === "log" ? grid[0] : 0, grid[grid.length - 1] * (grid.length > 1 ? 1 : 2),
      frame.left, frame.right, state.x);
    const value = state.y === "log"
      ? (v) => { const q = quantity(problem)(v); return q > 0 ? q : q === 0 ? low : NaN; }
      : quantity(problem);
    const [xLabel, yLabel] = axisLabels(problem);
    const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
      "aria-label": `${yLabel} over ${xLabel}, ${about.problems[state.problem]}` });
    const clip = element("clipPath", { id: "inside" }, element("defs", {}, svg));
    element("rect", { x: frame.left, y: frame.top - 4, width: frame.right - frame.left + 4,
      height: frame.bottom - frame.top + 4 }, clip);
    for (const tick of x.ticks(narrow ? 4 : 7)) {
      element("line", { class: "grid", x1: x(tick), x2: x(tick), y1: frame.top, y2: frame.bottom }, svg);
      text(svg, number(tick, 3), { x: x(tick), y: frame.bottom + 18, "text-anchor": "middle" });
    }
    for (const [place, words] of marks) {
      element("line", { class: "grid", x1: frame.left, x2: frame.right, y1: place, y2: place }, svg);
      text(svg, words, { x: frame.left - 8, y: place + 4, "text-anchor": "end" });
    }
    element("path", { class: "axis", fill: "none",
      d: `M${frame.left} ${frame.top}V${frame.bottom}H${frame.right}` }, svg);
    text(svg, xLabel, { x: (frame.left + frame.right) / 2, y: height - 8, "text-anchor": "middle" });
    text(svg, yLabel, { transform: `translate(14 ${(frame.top + frame.bottom) / 2}) rotate(-90)`,
      "text-anchor": "middle" });
    const inside = element("g", { "clip-path": "url(#inside)", fill: "none" }, svg);
    for (const curve of [...axis.curves].reverse()) {
      if (!shown.has(curve.method)) continue;
      const look = about.methods[curve.method];
      const stroke = { stroke: look.color, "stroke-dasharray": look.dash, "stroke-linejoin": "round" };
      if (state.mode === "seeds") {
        for (const seed of curve.seeds) {
          element("path", { ...stroke, d: line(seed, grid, value, x, y), "stroke-width": 1.1,
            "stroke-opacity": 0.65 }, inside);
        }
        continue;
      }
      if (state.mode === "band" && curve.low) {
        element("path", { d: band(curve, grid, value, x, y), fill: look.color, "fill-opacity": 0.13 }, inside);
      }
      element("path", { ...stroke, d: line(curve.median, grid, value, x, y),
        "stroke-width": look.width, "data-method": curve.method }, inside);
      const end = value(curve.median[index(grid, curve.end)]);
      if (!Number.isNaN(end)) {
        element("circle", { cx: x(Math.max(curve.end, grid[0])), cy: y(end), r: 3.2, fill: look.color }, inside);
      }
    }
    cross = element("g", {}, svg);
    scales = { x, y, value, frame, width };
    plot.replaceChildren(svg);
    plot.setAttribute("aria-valuemax", grid.length - 1);
    point();
  };

  // Values under the crosshair
  const index = (grid, position) => {
    let [low, high] = [0, grid.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (grid[middle] <= position) low = middle;
      else high = middle - 1;
    }
    return low;
  };
  const point = () => {
    const { problem, axis } = current();
    const last = axis.grid.length - 1;
    const at = state.at === null ? last : Math.min(Math.max(state.at, 0), last);
    const position = axis.grid[at];
    const unit = state.axis === "seconds" ? about.time : "evaluations";
    const place = state.at === null ? "at the end" : `after ${number(position, 4)} ${unit}`;
    readout.textContent = `${isGap(problem) ? "Gap" : `Median error [${problem.unit}]`} ${place}`;
    plot.setAttribute("aria-valuenow", at);
    plot.setAttribute("aria-valuetext", place);
    cross.replaceChildren();
    const { x, y, value, frame } = scales;
    if (state.at !== null) {
      element("line", { class: "cross", x1: x(position), x2: x(position), y1: frame.top, y2: frame.bottom }, cross);
    }
    axis.curves.forEach((curve, k) => {
      const raw = curve.median[at];
      const told = isGap(problem) ? raw / problem.best - 1 : raw;
      legend.children[k].querySelector(".value").textContent =
        Number.isNaN(raw) ? "–" : isGap(problem) ? (told < GAP_FLOOR ? "<10⁻⁴" : number(told, 3)) : number(raw, 5);
      const v = value(raw);
      if (state.at === null || !shown.has(curve.method) || Number.isNaN(v) || y(v) < frame.top) return;
      element("circle", { cx: x(position), cy: y(v), r: 4, fill: about.methods[curve.method].color,
        stroke: "#fff", "stroke-width": 1.5 }, cross);
    });
  };

  const list = () => {
    const { axis } = current();
    legend.replaceChildren(...axis.curves.map((curve) => {
      const look = about.methods[curve.method];
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.method = curve.method;
      button.setAttribute("aria-pressed", shown.has(curve.method));
      const svg = element("svg", { width: 36, height: 10, "aria-hidden": true }, button);
      element("line", { x1: 1, x2: 35, y1: 5, y2: 5, stroke: look.color, "stroke-width": look.width,
        "stroke-dasharray": look.dash }, svg);
      for (const [kind, words] of [["name", look.name], ["value", ""]]) {
        const span = document.createElement("span");
        span.className = kind;
        span.textContent = words;
        button.append(span);
      }
      button.title = `${look.name}: ${curve.runs} ${curve.runs === 1 ? "run" : "runs"}`;
      const item = document.createElement("li");
      item.append(button);
      return item;
    }));
  };
  const show = () => {
    const { problem } = current();
    for (const [to, there, why] of [
      ["gap", problem.best !== null, "no error above zero"],
    ]) {
      const button = document.querySelector(`button[data-to="${to}"]`);
      button.disabled = !there;
      button.title = there ? "" : why;
    }
    list();
    draw();
  };
  const press = () => {
    for (const button of legend.querySelectorAll("button")) {
      button.setAttribute("aria-pressed", shown.has(button.dataset.method));
    }
    draw();
  };

  legend.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    const method = button.dataset.method;
    if (!shown.delete(method)) shown.add(method);
    press();
  });
  byId("all").addEventListener("click", () => {
    Object.keys(about.methods).forEach((method) => shown.add(method));
    press();
  });
  byId("none").addEventListener("click", () => {
    shown.clear();
    press();
  });
  const controls = document.querySelector(".controls");
  controls.addEventListener("submit", (event) => event.preventDefault());
  controls.addEventListener("click", (event) => {
    const button = event.target.closest("button[data-set]");
    if (!button) return;
    const { set, to } = button.dataset;
    choose(set, to);
    if (set === "axis") state.at = null;
    show();
  });
  byId("problem").addEventListener("change", (event) => {
    state.problem = Number(event.target.value);
    state.at = null;
    show();
  });
  const follow = (event) => {
    const box = plot.getBoundingClientRect();
    const place = ((event.clientX - box.left) / box.width) * scales.width;
    const { left, right } = scales.frame;
    state.at = index(current().axis.grid, scales.x.invert(Math.min(Math.max(place, left), right)));
    point();
  };
  plot.addEventListener("pointermove", follow);
  plot.addEventListener("pointerdown", follow);
  plot.addEventListener("pointerleave", () => {
    state.at = null;
    point();
  });
  plot.addEventListener("keydown", (event) => {
    const last = current().axis.grid.length - 1;
    const from = state.at === null ? last : state.at;
    const size = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: from - size, ArrowRight: from + size, Home: 0, End: last, Escape: null };
    if (!(event.key in moves)) return;
    event.preventDefault();
    const to = moves[event.key];
    state.at = to === null ? null : Math.min(Math.max(to, 0), last);
    point();
  });
  let width = 0;
  new ResizeObserver(() => {
    if (plot.clientWidth === width) return;
    width = plot.clientWidth;
    draw();
  }).observe(plot);
  window.addEventListener("pageshow", () => {
    byId("problem").value = String(state.problem);
  });
  show();
})();
