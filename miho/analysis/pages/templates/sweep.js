"use strict";
// Functions that Vega-Lite lacks: the selection of curves, and the values under the crosshair.
(() => {
  const GAP_FLOOR = 1e-4;
  const byId = (id) => document.getElementById(id);
  const read = (id) => JSON.parse(byId(id).textContent);
  const about = read("about");
  const plot = byId("plot"), legend = byId("legend"), readout = byId("readout");
  const shown = new Set(about.shown);
  const entries = new Map([...legend.children].map((item) => [item.firstChild.dataset.method, item]));
  const state = { problem: 0, at: null };
  for (const button of document.querySelectorAll("button[data-set][aria-pressed=true]")) {
    state[button.dataset.set] = button.dataset.to;
  }
  const problems = new Map();
  let view = null, drawn = 0;

  // A curve is a text with a number per grid position, empty if it is unchanged.
  const dense = (text) => {
    let last = NaN;
    return text.split(",").map((word) => (word === "" ? last : (last = Number(word))));
  };
  const current = () => {
    if (!problems.has(state.problem)) {
      const problem = read(`curves-${state.problem}`);
      for (const curve of Object.values(problem.axes).flatMap((axis) => axis.curves)) {
        for (const key of ["median", "low", "high"]) if (curve[key]) curve[key] = dense(curve[key]);
        curve.seeds = curve.seeds.map(dense);
      }
      problems.set(state.problem, problem);
    }
    const problem = problems.get(state.problem);
    const gap = state.quantity === "gap" && problem.best !== null;
    const value = gap ? (v) => Math.max(v / problem.best - 1, GAP_FLOOR) : (v) => v;
    return { problem, gap, value, ...problem.axes[state.axis] };
  };

  // The rows of a step function: its changes and its end.
  const steps = (grid, rows, more) => {
    const points = [];
    grid.forEach((x, i) => {
      const values = rows.map((row) => row[i]);
      const last = points[points.length - 1];
      if (values.some(Number.isNaN)) return;
      if (i === grid.length - 1 || !last || values.some((v, k) => v !== last.values[k])) {
        points.push({ x, values });
      }
    });
    return points.map(({ x, values: [y, low, high] }) => ({ x, y, low, high, ...more }));
  };
  const rowsOf = ({ grid, curves, value }) => {
    const data = { bands: [], curves: [], ends: [] };
    for (const curve of [...curves].reverse()) {
      if (!shown.has(curve.method)) continue;
      const { color, dash, width } = about.methods[curve.method];
      const look = { method: curve.method, color, dash, width, opacity: 1, seed: 0 };
      const of = (...rows) => rows.map((row) => row.map(value));
      if (state.mode === "seeds") {
        curve.seeds.forEach((row, seed) => {
          data.curves.push(...steps(grid, of(row), { ...look, seed, width: 1.1, opacity: 0.65 }));
        });
        continue;
      }
      if (state.mode === "band" && curve.low) {
        data.bands.push(...steps(grid, of(curve.median, curve.low, curve.high), look));
      }
      data.curves.push(...steps(grid, of(curve.median), look));
      const y = value(curve.median[index(grid, curve.end)]);
      if (!Number.isNaN(y)) data.ends.push({ x: Math.max(curve.end, grid[0]), y, color });
    }
    return data;
  };
  // The range of the visible errors; a linear scale cuts off large first values.
  const rangeOf = (data, grid) => {
    const rows = [...data.bands, ...data.curves];
    const values = rows.flatMap((row) => [row.y, row.low, row.high]);
    const seen = values.filter((v) => v > 0 || (v === 0 && state.y === "linear"));
    const last = grid[grid.length - 1];
    const ends = rows.filter((row) => row.x === last).flatMap((row) => [row.y, row.high ?? 0]);
    const high = seen.reduce((a, b) => Math.max(a, b), 0);
    if (!(high > 0)) return state.y === "log" ? [0.1, 1] : [0, 1];
    if (state.y === "linear") return [0, Math.min(high, 2 * Math.max(...ends)) || high];
    const low = seen.reduce((a, b) => Math.min(a, b), high);
    return low === high ? [low / 2, high * 2] : [low * (low / high) ** 0.03, high * (high / low) ** 0.03];
  };

  // Ticks of a logarithmic axis: powers of ten, and 2 and 5 times them if there are few.
  const ticksOf = (kind, [low, high], tickCount) => {
    if (kind === "linear") return { tickCount };
    const [first, last] = [Math.floor(Math.log10(low)), Math.floor(Math.log10(high))];
    const factors = last - first < 3 ? [1, 2, 5] : [1];
    const powers = Array.from({ length: last - first + 1 }, (_, k) => 10 ** (first + k));
    const values = powers.flatMap((p) => factors.map((f) => f * p)).filter((v) => v >= low && v <= high);
    return values.length > 1 ? { values } : { tickCount };
  };

  const draw = async () => {
    const turn = (drawn += 1);
    plot.setAttribute("aria-busy", "true");
    const now = current();
    const { problem, gap, grid } = now;
    const data = rowsOf(now);
    const [low, high] = rangeOf(data, grid);
    const last = grid[grid.length - 1];
    if (state.y === "log") {
      for (const row of Object.values(data).flat()) {
        for (const key of ["y", "low", "high"]) if (row[key] < low) row[key] = low;
      }
    }
    const width = Math.max(plot.clientWidth, 280);
    const spec = structuredClone(about.chart);
    const axes = {
      x: {
        title: state.axis === "seconds" ? `${about.time} [s]` : "evaluations of the loss [-]",
        domain: [state.x === "log" ? grid[0] : 0, grid.length > 1 ? last : 2 * last],
        tickCount: width < 500 ? 4 : 7,
      },
      y: {
        title: gap ? `gap to the best ${problem.recorded ? "known error" : "of these runs"} [-]`
          : `error [${problem.unit}]`,
        domain: [low, high],
        tickCount: 6,
      },
    };
    for (const [name, { title, domain, tickCount }] of Object.entries(axes)) {
      Object.assign(spec.encoding[name], { title, axis: ticksOf(state[name], domain, tickCount),
        scale: { type: state[name], domain, nice: false } });
    }
    Object.assign(spec, { width, height: Math.round(Math.min(480, Math.max(300, 0.62 * width))),
      datasets: { ...data, cross: [], values: [] },
      description: `${axes.y.title} over ${axes.x.title}, ${about.problems[state.problem]}` });
    // ast: expressions are interpreted, because the page forbids eval; the page has the styles.
    const options = { ast: true, renderer: "svg", actions: false, tooltip: false, defaultStyle: false };
    const place = document.createElement("div");
    const made = await vegaEmbed(place, spec, options);
    if (turn !== drawn) return made.finalize();
    if (view) view.finalize();
    view = made.view;
    plot.replaceChildren(place);
    plot.setAttribute("aria-valuemax", grid.length - 1);
    point();
    return plot.setAttribute("aria-busy", "false");
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
  const number = (v, digits) => {
    const power = v === 0 ? 0 : Math.floor(Math.log10(Math.abs(v)));
    const notation = power >= 6 || power < -3 ? "scientific" : "standard";
    return v.toLocaleString("en-US", { notation, maximumSignificantDigits: digits });
  };
  const point = () => {
    const { problem, gap, value, grid, curves } = current();
    const at = state.at === null ? grid.length - 1 : state.at;
    const x = grid[at];
    const unit = state.axis === "seconds" ? about.time : "evaluations";
    const words = state.at === null ? "at the end" : `after ${number(x, 4)} ${unit}`;
    readout.textContent = `${gap ? "Gap" : `Median error [${problem.unit}]`} ${words}`;
    plot.setAttribute("aria-valuenow", at);
    plot.setAttribute("aria-valuetext", words);
    const values = [];
    for (const curve of curves) {
      const raw = curve.median[at], y = value(raw);
      entries.get(curve.method).querySelector(".value").textContent = Number.isNaN(raw) ? "–"
        : gap && raw / problem.best - 1 < GAP_FLOOR ? "<10⁻⁴" : number(gap ? y : raw, gap ? 3 : 5);
      if (state.at !== null && shown.has(curve.method) && !Number.isNaN(raw)) {
        values.push({ x, y, color: about.methods[curve.method].color });
      }
    }
    if (!view) return;
    view.data("cross", state.at === null ? [] : [{ x, color: "#555" }]).data("values", values).run();
  };

  // Controls
  const show = () => {
    const { problem, curves } = current();
    const gap = document.querySelector("button[data-to=gap]");
    gap.disabled = problem.best === null;
    gap.title = gap.disabled ? "no error above zero" : "";
    legend.replaceChildren(...curves.map((curve) => {
      const item = entries.get(curve.method);
      item.firstChild.title =
        `${about.methods[curve.method].name}: ${curve.runs} ${curve.runs === 1 ? "run" : "runs"}`;
      return item;
    }));
    point();
    return draw();
  };
  const press = () => {
    for (const [method, item] of entries) {
      item.firstChild.setAttribute("aria-pressed", shown.has(method));
    }
    return draw();
  };
  legend.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    const { method } = button.dataset;
    if (!shown.delete(method)) shown.add(method);
    press();
  });
  byId("all").addEventListener("click", () => {
    entries.forEach((_, method) => shown.add(method));
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
    state[set] = to;
    for (const other of controls.querySelectorAll(`button[data-set="${set}"]`)) {
      other.setAttribute("aria-pressed", other.dataset.to === to);
    }
    if (set === "axis") state.at = null;
    show();
  });
  byId("problem").addEventListener("change", (event) => {
    state.problem = Number(event.target.value);
    state.at = null;
    show();
  });

  // The crosshair
  const moveTo = (at) => {
    state.at = at;
    point();
  };
  const follow = (event) => {
    if (!view) return;
    const { grid } = current();
    const place = event.clientX - plot.getBoundingClientRect().left - view.origin()[0];
    moveTo(index(grid, view.scale("x").invert(Math.min(Math.max(place, 0), view.signal("width")))));
  };
  plot.addEventListener("pointermove", follow);
  plot.addEventListener("pointerdown", follow);
  plot.addEventListener("pointerleave", () => moveTo(null));
  plot.addEventListener("keydown", (event) => {
    const last = current().grid.length - 1;
    const from = state.at === null ? last : state.at;
    const size = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: from - size, ArrowRight: from + size, Home: 0, End: last, Escape: null };
    if (!(event.key in moves)) return;
    event.preventDefault();
    const to = moves[event.key];
    moveTo(to === null ? null : Math.min(Math.max(to, 0), last));
  });
  let width = plot.clientWidth;
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
