// Data, state, theme, and the small tools that every panel uses.

const byId = (id) => document.getElementById(id);
const D = JSON.parse(byId("data").textContent);

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let k = 0; k < raw.length; k++) out[k] = raw.charCodeAt(k);
  return out.buffer;
}
const wideTasks = D.m >= 65536;
function levels(told) {
  const data = told.bytes === 1 ? new Uint8Array(bytes(told.data)) : new Uint16Array(bytes(told.data));
  return { data, unit: told.top / (told.bytes === 1 ? 255 : 65535), top: told.top };
}

const COLOURS = {
  light: ["#0068a8", "#c9500a", "#0a7f5a", "#a6438c", "#b98500", "#3f51b5", "#7a5a3c", "#51606f"],
  dark: ["#5db4ee", "#ff9350", "#4fc79c", "#e08ac8", "#e8bf4d", "#98a5f5", "#cba583", "#a9b7c6"],
};
const RAMPS = {
  light: [[214, 231, 244], [82, 157, 209], [0, 104, 168], [4, 44, 84]],
  dark: [[23, 48, 72], [28, 92, 140], [93, 180, 238], [222, 243, 255]],
};
const HEATS = {
  light: [[255, 255, 255], [255, 226, 178], [246, 152, 72], [178, 36, 24], [74, 8, 22]],
  dark: [[19, 26, 36], [84, 36, 36], [196, 76, 34], [255, 168, 76], [255, 244, 200]],
};

// One result, with everything derived from its plan: changes of task, cumulative value, per-agent totals.
function unpack(told, index) {
  const { T, n } = D, size = T * n;
  const plan = wideTasks ? new Uint32Array(bytes(told.plan)) : new Uint16Array(bytes(told.plan));
  const held = levels(told.held), changed = new Uint8Array(size);
  const moves = new Float64Array(n), gain = new Float64Array(n), cumulative = new Float64Array(T);
  const busyAt = new Uint32Array(T), movesAt = new Uint32Array(T);
  let sum = 0;
  for (let k = 0; k < T; k++) {
    for (let i = 0; i < n; i++) {
      const at = k * n + i, before = k > 0 ? plan[at - n] : D.initial ? D.initial[i] : plan[at];
      if (plan[at] !== before) { changed[at] = 1; moves[i]++; movesAt[k]++; }
      if (held.data[at]) { gain[i] += held.data[at] * held.unit; busyAt[k]++; }
    }
    sum += told.benefit[k] + told.handover[k];
    cumulative[k] = sum;
  }
  // Penalties of limits and rewards of teams belong to the whole plan: they are counted where it ends.
  const beyond = told.value - sum;
  cumulative[T - 1] = told.value;
  return { ...told, index, plan, held, changed, moves, gain, cumulative, beyond, busyAt, movesAt };
}
const R = D.results.map(unpack);
const best = R.reduce((a, b) => (b.value > a.value ? b : a));
const prices = D.prices && D.prices.top > 0 ? levels(D.prices) : null;
const chosenAtFirst = best.index;

const state = {
  step: 0, clock: 0, result: chosenAtFirst, agent: -1, playing: false,
  layers: { tracks: true, links: true, prices: false },
};
const result = () => R[state.result];

// ---- words -------------------------------------------------------------------------------------------------------

const number = (x, digits = 1) =>
  x === null || x === undefined || !isFinite(x) ? "-" : x.toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits });
const whole = (x) => number(x, 0);
const small = (x) => (Math.abs(x) >= 100 ? number(x, 1) : Math.abs(x) >= 1 ? number(x, 2) : number(x, 3));
const percent = (x, digits = 1) => (x === null || !isFinite(x) ? "-" : number(100 * x, digits) + " %");
const agentName = (i) => (D.agents ? D.agents[i] : "agent " + i);
const taskName = (j) => (D.tasks ? D.tasks[j] : "task " + j);
// A step by its time where there are times, otherwise by its number, counted from 1.
const stepName = (k) => (D.times ? D.times[k] : "step " + (k + 1));
const share = (r) => (D.bound ? r.value / D.bound : null);
const gapOf = (r) => (D.bound === null ? null : D.bound === 0 ? (r.value === 0 ? 0 : Infinity) : (D.bound - r.value) / Math.abs(D.bound));

// ---- theme -------------------------------------------------------------------------------------------------------

const prefersDark = window.matchMedia("(prefers-color-scheme: dark)");
const theme = { name: "light", css: {} };
function setTheme(name) {
  theme.name = name;
  document.documentElement.dataset.theme = name;
  const style = getComputedStyle(document.documentElement);
  for (const key of ["bg", "card", "text", "muted", "line", "soft", "accent", "accent-soft", "warm", "good", "idle", "sea", "land", "shore", "grid"])
    theme.css[key] = style.getPropertyValue("--" + key).trim();
  theme.ramp = table(RAMPS[name]);
  theme.heat = table(HEATS[name]);
  theme.heatRgb = rgbTable(HEATS[name]);
}
function mixed(stops, x) {
  const at = Math.min(Math.max(x, 0), 1) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2), part = at - low;
  return stops[low].map((v, c) => Math.round(v + part * (stops[low + 1][c] - v)));
}
const rgbTable = (stops) => Array.from({ length: 256 }, (_, k) => mixed(stops, k / 255));
const table = (stops) => rgbTable(stops).map((c) => `rgb(${c})`);
const colourOf = (index) => COLOURS[theme.name][index % COLOURS[theme.name].length];
const ramp = (x) => theme.ramp[Math.min(255, Math.max(0, Math.round(255 * x)))];
const gradient = (stops) => `linear-gradient(90deg, ${stops.map((c) => `rgb(${c})`).join(", ")})`;
function taskColour(j) {
  return `hsl(${(j * 137.508) % 360} ${theme.name === "dark" ? "52% 58%" : "55% 62%"})`;
}

// ---- drawing -----------------------------------------------------------------------------------------------------

// A canvas as sharp as the screen; returns its context in CSS pixels.
function fit(canvas, width, height) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2.5);
  const w = Math.max(1, Math.round(width * ratio)), h = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}
const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", Arial, sans-serif';

// Panels register what they draw: `base` when result, size or theme change, `step` whenever the step changes.
const panels = [];
const waiting = { base: false, step: false, frame: 0 };
function redraw(base) {
  waiting.base = waiting.base || base;
  waiting.step = true;
  if (!waiting.frame) waiting.frame = requestAnimationFrame(flush);
}
function flush() {
  const base = waiting.base;
  waiting.frame = 0;
  waiting.base = waiting.step = false;
  for (const panel of panels) {
    if (base && panel.base) panel.base();
    if (panel.step) panel.step();
  }
}

// ---- elements ----------------------------------------------------------------------------------------------------

function element(tag, attributes, ...children) {
  const out = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (key === "class") out.className = value;
    else if (key === "style") out.style.cssText = value;
    else if (key.startsWith("on")) out.addEventListener(key.slice(2), value);
    else out.setAttribute(key, value);
  }
  out.append(...children);
  return out;
}
function legend(id, entries) {
  byId(id).replaceChildren(...entries.map(([kind, colour, text]) =>
    element("li", {}, element("span", { class: "key " + kind, style: kind === "dash" ? `border-color:${colour}` : `background:${colour}` }), text)));
}

const tip = byId("tip");
function showTip(event, text) {
  if (!text) { tip.hidden = true; return; }
  tip.textContent = text;
  tip.hidden = false;
  const box = tip.getBoundingClientRect(), gap = 14;
  let x = event.clientX + gap, y = event.clientY + gap;
  if (x + box.width > innerWidth - 6) x = Math.max(6, event.clientX - gap - box.width);
  if (y + box.height > innerHeight - 6) y = Math.max(6, event.clientY - gap - box.height);
  tip.style.left = x + "px";
  tip.style.top = y + "px";
}
function hover(canvas, describe) {
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse") showTip(event, describe(event.offsetX, event.offsetY));
  });
  canvas.addEventListener("pointerleave", () => showTip(null, ""));
}
function describeCell(i, k) {
  const r = result(), at = k * D.n + i, benefit = r.held.data[at] * r.held.unit;
  const was = k > 0 ? r.plan[at - D.n] : D.initial ? D.initial[i] : null;
  const lines = [`${agentName(i)}, ${stepName(k)}`, taskName(r.plan[at]) + (r.held.data[at] ? `, benefit ${small(benefit)}` : ", idle")];
  if (r.changed[at]) lines.push("handover from " + taskName(was));
  return lines.join("\n");
}
