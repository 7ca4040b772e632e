// Line and bar charts over the steps (or over seconds), with a cursor at the step shown.

function niceTicks(low, high, count) {
  const span = high - low || 1, raw = span / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
  const unit = [1, 2, 2.5, 5, 10].map((x) => x * power).find((x) => x >= raw);
  const out = [];
  for (let x = Math.ceil(low / unit) * unit; x <= high + 1e-9 * span; x += unit) out.push(Math.abs(x) < 1e-12 * span ? 0 : x);
  return out;
}
// A number of an axis; `unit` is the distance to the next one, which it must be told from.
function short(x, unit = 0) {
  const a = Math.abs(x);
  if (unit && unit < 1e-5 * a) return x.toFixed(Math.min(12, Math.max(0, -Math.floor(Math.log10(unit)))));
  if (a >= 1e6) return +(x / 1e6).toFixed(1) + "M";
  if (a >= 1e4) return +(x / 1e3).toFixed(1) + "k";
  return String(+x.toPrecision(6));
}

// `describe()` returns {x: [low, high], y: [low, high], lines, bars, levels, xlabel, cursor}.
function chart(id, describe, onStep) {
  const canvas = byId(id), base = document.createElement("canvas");
  let box = null, told = null;

  function drawBase() {
    told = describe();
    const width = canvas.clientWidth, height = canvas.clientHeight, c = fit(base, width, height);
    c.font = FONT;
    const ticks = niceTicks(told.y[0], told.y[1], height < 200 ? 4 : 5);
    const between = ticks.length > 1 ? ticks[1] - ticks[0] : 0, tick = (y) => short(y, between);
    const left = Math.max(...ticks.map((y) => c.measureText(tick(y)).width)) + 12;
    box = { x: left, y: 10, w: width - left - 8, h: height - 10 - 34, W: width, H: height };
    const px = (x) => box.x + (x - told.x[0]) / (told.x[1] - told.x[0] || 1) * box.w;
    const py = (y) => box.y + box.h - (y - told.y[0]) / (told.y[1] - told.y[0] || 1) * box.h;
    Object.assign(box, { px, py });
    c.textBaseline = "middle"; c.textAlign = "right"; c.lineWidth = 1;
    for (const y of ticks) {
      c.strokeStyle = y === 0 ? theme.css.muted : theme.css.line;
      c.beginPath(); c.moveTo(box.x, py(y)); c.lineTo(box.x + box.w, py(y)); c.stroke();
      c.fillStyle = theme.css.muted; c.fillText(tick(y), box.x - 8, py(y));
    }
    c.textBaseline = "top"; c.textAlign = "center";
    for (const x of niceTicks(told.x[0], told.x[1], Math.max(5, Math.min(8, width / 90)))) {
      if (told.steps && x !== Math.round(x)) continue;
      c.fillText(short(x), Math.min(Math.max(px(x), box.x + 6), box.x + box.w - 6), box.y + box.h + 6);
    }
    c.textAlign = "right"; c.fillText(told.xlabel, box.x + box.w, box.y + box.h + 20);
    for (const bar of told.bars || []) {
      c.fillStyle = bar.colour;
      const w = Math.max(box.w / bar.values.length * 0.82, 0.8);
      for (let k = 0; k < bar.values.length; k++) {
        const top = py(Math.max(bar.values[k], 0)), low = py(Math.min(bar.values[k], 0));
        c.fillRect(px(k + 1) - w / 2, top, w, Math.max(low - top, 0));
      }
    }
    for (const line of told.lines || []) {
      c.strokeStyle = line.colour; c.lineWidth = line.width; c.lineJoin = "round"; c.globalAlpha = line.alpha || 1;
      c.setLineDash(line.dash || []);
      c.beginPath();
      for (let k = 0; k < line.x.length; k++) {
        if (k && line.stairs) c.lineTo(px(line.x[k]), py(line.y[k - 1]));
        c[k ? "lineTo" : "moveTo"](px(line.x[k]), py(line.y[k]));
      }
      c.stroke(); c.setLineDash([]); c.globalAlpha = 1;
    }
    for (const level of told.levels || []) {
      c.strokeStyle = level.colour; c.fillStyle = level.colour; c.lineWidth = 1.6; c.setLineDash([6, 4]);
      c.beginPath(); c.moveTo(box.x, py(level.y)); c.lineTo(box.x + box.w, py(level.y)); c.stroke(); c.setLineDash([]);
      c.textAlign = "left"; c.textBaseline = "top"; c.fillText(level.text, box.x + 6, py(level.y) + 6);
    }
  }

  function drawStep() {
    if (!box) return;
    const c = fit(canvas, box.W, box.H);
    c.drawImage(base, 0, 0, box.W, box.H);
    if (!told.steps) return;
    const x = box.px(state.step + 1);
    c.strokeStyle = theme.css.text; c.globalAlpha = 0.55; c.lineWidth = 1.2;
    c.beginPath(); c.moveTo(x, box.y); c.lineTo(x, box.y + box.h); c.stroke(); c.globalAlpha = 1;
    for (const line of told.lines || []) {
      if (!line.dot) continue;
      c.fillStyle = line.colour; c.strokeStyle = theme.css.card; c.lineWidth = 2;
      c.beginPath(); c.arc(x, box.py(line.y[state.step]), 4.5, 0, 7); c.fill(); c.stroke();
    }
  }

  if (onStep) {
    const stepAt = (x) => Math.min(D.T - 1, Math.max(0, Math.round(told.x[0] + (x - box.x) / box.w * (told.x[1] - told.x[0])) - 1));
    canvas.style.cursor = "pointer";
    canvas.addEventListener("click", (event) => onStep(stepAt(event.offsetX)));
    hover(canvas, (x) => told.tell && told.tell(stepAt(x)));
  }
  panels.push({ base: drawBase, step: drawStep });
}

const stepNumbers = Array.from({ length: D.T }, (_, k) => k + 1);
const stepRange = [D.T > 1 ? 1 : 0.5, D.T > 1 ? D.T : 1.5];

function cumulativeChart() {
  const lines = R.map((r) => {
    const chosen = r.index === state.result;
    return { name: r.name, x: stepNumbers, y: r.cumulative, colour: colourOf(r.index), width: chosen ? 2.8 : 1.4, alpha: chosen ? 1 : 0.75, dot: chosen, chosen };
  }).sort((a, b) => a.chosen - b.chosen);
  const top = Math.max(D.bound || 0, ...R.map((r) => Math.max(...r.cumulative)), 1e-9);
  const low = Math.min(0, ...R.map((r) => Math.min(...r.cumulative)));
  legend("cumulativelegend", R.length > 1 ? R.map((r) => ["", colourOf(r.index), r.name]) : [["", colourOf(0), R[0].name]]);
  const beyond = result().beyond, told = Math.abs(beyond) > 1e-4 * Math.max(1, Math.abs(top))
    ? ` What limits cost and teams earn, ${small(beyond)} in all, is counted at the end.` : "";
  byId("cumulativehint").textContent = `The sum over the steps, handovers paid${D.bound === null ? "" : `; no plan ends above ${number(D.bound)}`}.${told}`;
  return {
    steps: true, x: stepRange, y: [low, top * 1.03], lines, xlabel: "step",
    levels: D.bound === null ? [] : [{ y: D.bound, text: "proven bound " + number(D.bound), colour: theme.css.warm }],
    tell: (k) => [`up to ${stepName(k)}`, ...R.map((r) => `${r.name}: ${number(r.cumulative[k])}`)].join("\n"),
  };
}

function stepsChart() {
  const r = result(), net = r.benefit.map((b, k) => b + r.handover[k]);
  const values = [...r.benefit, ...r.handover, ...net];
  legend("stepslegend", [["", theme.css.accent, "benefit"], ["", theme.css.warm, "handovers"], ["dash", theme.css.text, "both together"]]);
  return {
    steps: true, x: [D.T > 1 ? 0.5 : 0, D.T + (D.T > 1 ? 0.5 : 1)], xlabel: "step",
    y: [Math.min(0, ...values) * 1.06, Math.max(0, ...values) * 1.06 || 1],
    bars: [{ values: r.benefit, colour: theme.css.accent }, { values: r.handover, colour: theme.css.warm }],
    lines: [{ x: stepNumbers, y: net, colour: theme.css.text, width: 1.5, dash: [4, 3], dot: true }],
    tell: (k) => `${stepName(k)}\nbenefit ${small(r.benefit[k])}\nhandovers ${small(r.handover[k])} (${r.movesAt[k]})`,
  };
}

// Whether plan or bound changed while the planner ran, by more than rounding.
function hasGap(r) {
  const all = r.trace.flatMap((p) => [p[1], p[2]]);
  return r.trace.length > 1 && Math.max(...all) - Math.min(...all) > 1e-6 * Math.max(1e-9, ...all.map(Math.abs));
}

function gapChart() {
  const r = hasGap(result()) ? result() : R.find(hasGap);
  const x = r.trace.map((p) => p[0]), bound = r.trace.map((p) => p[1]), value = r.trace.map((p) => p[2]);
  // The first bounds are far off; the axis shows where the story is.
  const all = [...value, ...bound].sort((a, b) => a - b), end = bound[bound.length - 1];
  const low = Math.max(all[0], end - 0.25 * Math.abs(end)), high = Math.min(all[all.length - 1], end + 0.25 * Math.abs(end));
  const pad = (high - low) * 0.06 || 1, clamp = (y) => Math.min(high, Math.max(low, y));
  legend("gaplegend", [["", theme.css.warm, "proven bound"], ["", theme.css.accent, `best plan of ${r.name}`]]);
  return {
    x: [0, x[x.length - 1] || 1], y: [low - pad, high + pad], xlabel: "seconds",
    lines: [
      { x, y: bound.map(clamp), colour: theme.css.warm, width: 2, stairs: true },
      { x, y: value.map(clamp), colour: theme.css.accent, width: 2, stairs: true },
    ],
  };
}
