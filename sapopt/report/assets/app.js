// Puts the panels together: which result, which step, which agent; playing; keys; theme.

const slider = byId("slider"), clock = byId("clock");
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
const STEPS_PER_SECOND = Math.min(8, Math.max(1.6, D.T / 30));

function setStep(k) {
  state.step = Math.min(D.T - 1, Math.max(0, k));
  slider.value = state.step;
  const minutes = D.map && D.map.step_s ? `${whole(state.step * D.map.step_s / 60)} min` : "", when = D.times ? D.times[state.step] : minutes;
  clock.textContent = `${state.step + 1} / ${D.T}${when ? " · " + when : ""}`;
  slider.setAttribute("aria-valuetext", `step ${state.step + 1} of ${D.T}${when ? ", " + when : ""}`);
}
function goTo(k) {
  setStep(k);
  state.clock = state.step;
  redraw(false);
}
function choose(index) {
  state.result = index;
  redraw(true);
}
function follow(i, scroll = true) {
  state.agent = i;
  if (document.activeElement !== byId("agent")) byId("agent").value = i < 0 ? "" : D.agents ? D.agents[i] : i;
  redraw(true);
  if (i >= 0 && scroll) requestAnimationFrame(() => showLane(i));
}

let before = 0;
function play(on) {
  state.playing = on;
  byId("play").setAttribute("aria-pressed", String(on));
  byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
  byId("playicon").setAttribute("d", on ? "M6.5 4.5h4v15h-4zM13.5 4.5h4v15h-4z" : "M7 4.5v15l12.5-7.5z");
  if (!on) { state.clock = state.step; redraw(false); return; }
  if (state.step === D.T - 1) goTo(0);
  before = 0;
  requestAnimationFrame(tick);
}
function tick(now) {
  if (!state.playing) return;
  if (before) {
    state.clock = Math.min(D.T - 1, state.clock + Math.min(now - before, 200) / 1000 * STEPS_PER_SECOND);
    const k = Math.floor(state.clock + 1e-9);
    const changed = k !== state.step;
    if (changed) setStep(k);
    if (calm.matches) { if (changed) { const exact = state.clock; state.clock = k; flushStep(true); state.clock = exact; } }
    else flushStep(changed);
  }
  before = now;
  if (state.clock >= D.T - 1) { play(false); return; }
  requestAnimationFrame(tick);
}
// Between two steps only the map moves.
function flushStep(all) {
  for (const panel of panels) if (panel.step && (all || panel.step === mapStep)) panel.step();
}

function keys(event) {
  const target = event.target, tag = target.tagName;
  if (event.ctrlKey || event.metaKey || event.altKey || tag === "SELECT" || (tag === "INPUT" && (target.type === "number" || target.type === "search"))) return;
  if (event.key === " " && tag !== "BUTTON" && tag !== "INPUT") { event.preventDefault(); play(!state.playing); }
  if (tag === "INPUT") return;
  const move = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[event.key];
  if ((event.key === "ArrowLeft" || event.key === "ArrowRight") && move) { event.preventDefault(); play(false); goTo(state.step + move); }
  if (event.key === "Escape") follow(-1);
}

function start() {
  setTheme(prefersDark.matches ? "dark" : "light");
  const size = D.sized ? [] : [`${whole(D.n)} agents`, `${whole(D.m)} tasks`, `${whole(D.T)} steps`];
  const span = D.times ? [`from ${D.times[0]} to ${D.days ? D.times[D.T - 1] : D.times[D.T]}${D.zone ? " " + D.zone : ""}`] : [];
  byId("subtitle").textContent = [...size, ...span, D.dynamics].join(" · ");
  byId("made").textContent = `Made by ${D.made}.${D.map ? ` Land: ${D.map.land.source}, public domain.` : ""} Everything shown is inside this file.`;
  slider.max = D.T - 1;
  slider.addEventListener("input", () => { play(false); goTo(Number(slider.value)); });
  byId("play").addEventListener("click", () => play(!state.playing));
  byId("theme").addEventListener("click", () => { setTheme(theme.name === "dark" ? "light" : "dark"); redraw(true); });
  prefersDark.addEventListener("change", (event) => { setTheme(event.matches ? "dark" : "light"); redraw(true); });
  document.addEventListener("keydown", keys);
  panels.push({ base: () => { drawTiles(); drawTable(); drawLimits(); drawWhy(); }, step: () => { drawNow(); drawFollow(); } });
  startMap();
  chart("cumulative", cumulativeChart, goTo);
  chart("steps", stepsChart, goTo);
  startTimeline();
  startStays();
  startHeat();
  if (R.some(hasGap)) { byId("proof").hidden = false; chart("gap", gapChart); }
  setStep(0);
  new ResizeObserver(() => redraw(true)).observe(document.querySelector("main"));
  redraw(true);
  document.documentElement.dataset.ready = "true";
}
start();
