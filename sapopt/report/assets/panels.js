// Numbers, table of solvers, the step in words, and the heat map of prices.

function drawTiles() {
  const r = result(), tiles = [
    [number(r.value), "value of " + r.name, null],
    [percent(share(r), 2), D.bound === null ? "no bound was proven" : "of the proven bound " + number(D.bound), share(r)],
    [gapOf(r) === null ? "-" : percent(gapOf(r), 2), "at most this far from the optimum", null],
    [whole(r.handovers), "handovers (changes of task)" + (r.paid === null ? "" : `; ${whole(r.paid)} cost something, ${whole(r.switches)} go straight from one task to another`), null],
    [percent(r.busy), "of the agents' time is useful", r.busy],
    [r.seconds < 1 ? number(1e3 * r.seconds, 0) + " ms" : number(r.seconds) + " s", `${number(1e3 * r.seconds / D.T, r.seconds / D.T < 0.01 ? 2 : 0)} ms a step; ${r.status}`, null],
  ];
  byId("tiles").replaceChildren(...tiles.map(([value, text, part]) => {
    const tile = element("div", { class: "tile" }, element("b", {}, value), element("span", {}, text));
    if (part !== null && isFinite(part)) tile.append(element("div", { class: "meter" }, element("i", { style: `width:${100 * Math.min(Math.max(part, 0), 1)}%` })));
    return tile;
  }));
}

function drawTable() {
  if (R.length < 2) return;
  byId("solvers").hidden = false;
  const top = Math.max(D.bound || 0, best.value, 1e-12);
  const head = element("tr", {}, ...["solver", "value", D.bound ? "share of the bound" : "", "gap", "handovers", "ms a step"].map((text) => element("th", { scope: "col" }, text)));
  const rows = R.map((r) => {
    const radio = element("input", { type: "radio", name: "solver", value: r.index, onchange: () => choose(r.index) });
    radio.checked = r.index === state.result;
    const width = 100 * Math.max(0, r.value) / top;
    return element("tr", { class: (r.index === state.result ? "chosen " : "") + (r === best ? "best" : "") },
      element("td", {}, element("label", {}, radio, element("span", { class: "swatch", style: `background:${colourOf(r.index)}` }), r.name)),
      element("td", { class: "value" }, number(r.value)),
      element("td", { class: "bar" }, element("div", {},
        element("span", { class: "track" }, element("i", { style: `width:${width}%;background:${colourOf(r.index)}` })),
        element("b", {}, percent(share(r))))),
      element("td", {}, percent(gapOf(r), 2)),
      element("td", {}, whole(r.handovers)),
      element("td", {}, number(1e3 * r.seconds / D.T, r.seconds / D.T < 0.01 ? 2 : 0)));
  });
  const focused = document.activeElement && document.activeElement.name === "solver";
  byId("table").replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
  if (focused) byId("table").querySelector("input:checked").focus();
}

function drawNow() {
  const r = result(), k = state.step, { n } = D;
  byId("nowstep").textContent = `${k + 1} of ${D.T}${D.times ? ", " + D.times[k] : ""}`;
  const facts = [
    ["benefit", small(r.benefit[k])],
    ["handovers", `${small(r.handover[k])} for ${r.movesAt[k]}`],
    ["agents at work", `${r.busyAt[k]} of ${n}`],
    ["value so far", number(r.cumulative[k])],
  ];
  if (prices) {
    let sum = 0;
    for (let j = 0; j < D.m; j++) sum += prices.data[k * D.m + j];
    facts.push(["sum of the prices", small(sum * prices.unit)]);
  }
  byId("facts").setAttribute("aria-live", state.playing ? "off" : "polite");
  byId("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]));
  const list = [];
  for (let i = 0; i < n && list.length < 60; i++) {
    const at = k * n + i;
    if (!r.changed[at]) continue;
    const was = k > 0 ? r.plan[at - n] : D.initial[i];
    list.push(element("li", {}, element("button", { type: "button", onclick: () => follow(i) }, agentName(i)),
      element("em", {}, ` ${taskName(was)} → ${taskName(r.plan[at])}`)));
  }
  if (!list.length) list.push(element("li", {}, "none"));
  else if (r.movesAt[k] > list.length) list.push(element("li", {}, `and ${r.movesAt[k] - list.length} more`));
  byId("moves").replaceChildren(...list);
}

// ---- heat map ----------------------------------------------------------------------------------------------------

const heat = { order: [], shown: [], image: document.createElement("canvas"), box: null, totals: null };
const TOP_ROWS = 40;

function startHeat() {
  if (!prices) return;
  byId("scarce").hidden = false;
  const { T, m } = D;
  heat.totals = new Float64Array(m);
  for (let k = 0; k < T; k++) for (let j = 0; j < m; j++) heat.totals[j] += prices.data[k * m + j] * prices.unit;
  heat.order = Array.from({ length: m }, (_, j) => j).sort((a, b) => heat.totals[b] - heat.totals[a]);
  if (m <= TOP_ROWS) byId("rows").parentElement.hidden = true;
  byId("rows").addEventListener("change", () => redraw(true));
  const most = heat.totals[heat.order[0]];
  byId("topprices").replaceChildren(...heat.order.slice(0, 8).filter((j) => heat.totals[j] > 0).map((j) =>
    element("li", {}, element("span", {}, taskName(j)), element("b", {}, small(heat.totals[j])),
      element("span", { class: "track" }, element("i", { style: `width:${100 * heat.totals[j] / most}%` })))));
  hover(byId("heat"), (x, y) => {
    const cell = heatCell(x, y);
    return cell && `${taskName(cell.j)}, ${stepName(cell.k)}\nprice ${small(prices.data[cell.k * m + cell.j] * prices.unit)}\n${small(heat.totals[cell.j])} over all steps`;
  });
  byId("heat").style.cursor = "pointer";
  byId("heat").addEventListener("click", (event) => { const cell = heatCell(event.offsetX, event.offsetY); if (cell) goTo(cell.k); });
  panels.push({ base: heatBase, step: heatStep });
}
function heatCell(x, y) {
  const b = heat.box, k = Math.floor((x - b.x) / b.w * D.T), row = Math.floor((y - b.y) / b.h * heat.shown.length);
  return k >= 0 && k < D.T && row >= 0 && row < heat.shown.length ? { k, j: heat.shown[row] } : null;
}
function heatBase() {
  const { T, m } = D, canvas = byId("heat"), width = canvas.parentElement.clientWidth;
  heat.shown = byId("rows").value === "all" ? heat.order : heat.order.slice(0, TOP_ROWS);
  const rows = heat.shown.length, named = rows <= TOP_ROWS, height = named ? rows * Math.max(9, Math.min(24, 260 / rows)) : 420;
  const image = heat.image, rgb = theme.heatRgb, c = image.getContext("2d");
  image.width = T; image.height = rows;
  const pixels = c.createImageData(T, rows);
  const scale = 255 / (prices.top / prices.unit);
  for (let row = 0; row < rows; row++) {
    for (let k = 0; k < T; k++) {
      // The square root: most prices are far below the greatest, and still worth telling apart.
      const share = Math.sqrt(prices.data[k * m + heat.shown[row]] * scale / 255), colour = rgb[Math.min(255, Math.round(255 * share))];
      pixels.data.set([colour[0], colour[1], colour[2], 255], 4 * (row * T + k));
    }
  }
  c.putImageData(pixels, 0, 0);
  heat.box = { x: 0, y: 0, w: width, h: height };
  canvas.style.height = height + "px";
  byId("heatlegend").replaceChildren(
    element("li", {}, "0", element("span", { class: "key ramp", style: `background:${gradient(HEATS[theme.name])}` }), small(prices.top)),
    element("li", {}, named ? `rows: the ${rows} scarcest tasks, from the top` : "rows: all tasks, the scarcest on top"), element("li", {}, "across: the steps"));
}
function heatStep() {
  const b = heat.box, canvas = byId("heat"), c = fit(canvas, b.w, b.h);
  c.imageSmoothingEnabled = heat.shown.length > b.h;
  c.drawImage(heat.image, b.x, b.y, b.w, b.h);
  const w = b.w / D.T;
  c.strokeStyle = theme.css.text; c.lineWidth = 1.4; c.globalAlpha = 0.75;
  c.strokeRect(b.x + state.step * w, b.y - 2, w, b.h + 4);
  c.globalAlpha = 1;
}
