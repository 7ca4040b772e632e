// The timeline: a row for each agent, drawn only where it is seen, so that thousands of agents scroll as well as ten.

const lanes = { order: [], at: null, row: 8, left: 0, width: 0, height: 0, base: document.createElement("canvas") };

const MOST_LISTED = 5000; // names to choose from while one types

// An agent by its name, by the beginning of a name that no other agent has, or by its number; -1 for none.
function agentTyped(typed) {
  if (typed === "") return -1;
  if (D.agents) {
    const text = typed.toLowerCase(), same = D.agents.findIndex((name) => name.toLowerCase() === text);
    if (same >= 0) return same;
    const alike = D.agents.map((name, i) => i).filter((i) => D.agents[i].toLowerCase().startsWith(text));
    if (alike.length === 1) return alike[0];
  }
  const i = Number(typed);
  return Number.isInteger(i) && i >= 0 && i < D.n ? i : -1;
}

function startTimeline() {
  const { n } = D, box = byId("timelinebox"), canvas = byId("timeline");
  lanes.row = n <= 24 ? 24 : n <= 60 ? 14 : 8;
  if (D.agents && n <= MOST_LISTED) byId("agents").append(...D.agents.map((name) => element("option", { value: name })));
  byId("order").addEventListener("change", () => redraw(true));
  byId("colour").addEventListener("change", () => redraw(true));
  byId("agent").addEventListener("input", (event) => {
    follow(agentTyped(event.target.value.trim()));
  });
  box.addEventListener("scroll", () => { lanesBase(); lanesStep(); });
  canvas.addEventListener("click", (event) => {
    const cell = laneCell(event.offsetX, event.offsetY);
    if (cell) { goTo(cell.k); follow(cell.i === state.agent ? -1 : cell.i, false); }
  });
  hover(canvas, (x, y) => { const cell = laneCell(x, y); return cell && describeCell(cell.i, cell.k); });
  box.addEventListener("keydown", (event) => {
    const move = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!move) return;
    event.preventDefault();
    const row = state.agent < 0 ? (move > 0 ? 0 : n - 1) : Math.min(n - 1, Math.max(0, lanes.at[state.agent] + move));
    follow(lanes.order[row]);
  });
  panels.push({ base: lanesSort, step: lanesStep });
}

function lanesSort() {
  const r = result(), key = byId("order").value, { n } = D;
  const score = key === "benefit" ? r.gain : key === "handovers" ? r.moves : null;
  lanes.order = Array.from({ length: n }, (_, i) => i);
  if (score) lanes.order.sort((a, b) => score[b] - score[a] || a - b);
  lanes.at = new Uint32Array(n);
  lanes.order.forEach((i, row) => { lanes.at[i] = row; });
  const byTask = byId("colour").value === "task";
  byId("timelinelegend").replaceChildren(
    byTask ? element("li", {}, "each task has its colour")
      : element("li", {}, "benefit 0", element("span", { class: "key ramp", style: `background:${gradient(RAMPS[theme.name])}` }), small(r.held.top)),
    element("li", {}, element("span", { class: "key", style: `background:${theme.css.idle}` }), "idle"),
    element("li", {}, element("span", { class: "key", style: `background:${theme.css.warm};width:4px;height:13px` }), "handover"));
  lanesBase();
}

function laneCell(x, y) {
  const row = Math.floor((y + byId("timelinebox").scrollTop) / lanes.row), k = Math.floor((x - lanes.left) / lanes.width * D.T);
  return row >= 0 && row < D.n && k >= 0 && k < D.T ? { i: lanes.order[row], k } : null;
}

function lanesBase() {
  const { T, n } = D, r = result(), box = byId("timelinebox"), full = n * lanes.row, row = lanes.row;
  byId("timelinespace").style.height = full + "px";
  const width = box.clientWidth, height = Math.min(box.clientHeight || full, full);
  byId("timeline").style.height = height + "px";
  const c = fit(lanes.base, width, height);
  c.font = FONT;
  const named = row >= 14, label = (i) => (named && D.agents ? D.agents[i] : String(i));
  const labelled = lanes.order.slice(0, 400).map((i) => c.measureText(label(i)).width);
  lanes.left = Math.min(Math.max(...labelled) + 16, width * 0.32);
  lanes.width = width - lanes.left;
  lanes.height = height;
  const w = lanes.width / T, top = box.scrollTop, byTask = byId("colour").value === "task", byNumber = byId("order").value === "number";
  const first = Math.floor(top / row), last = Math.min(n - 1, Math.ceil((top + height) / row));
  const every = named ? 1 : 5, gap = row >= 14 ? 2 : 1, scale = 255 / (r.held.top / r.held.unit || 1);
  c.textBaseline = "middle"; c.textAlign = "right";
  for (let at = first; at <= last; at++) {
    const i = lanes.order[at], y = at * row - top;
    for (let k = 0; k < T;) {
      // Equal neighbours are one rectangle: fewer, and without seams.
      const cell = k * n + i, busy = r.held.data[cell];
      let end = k + 1;
      if (!busy) while (end < T && !r.held.data[end * n + i] && !r.changed[end * n + i]) end++;
      else if (byTask) while (end < T && r.held.data[end * n + i] && !r.changed[end * n + i]) end++;
      c.fillStyle = !busy ? theme.css.idle : byTask ? taskColour(r.plan[cell]) : theme.ramp[Math.min(255, Math.round(busy * scale))];
      c.fillRect(lanes.left + k * w, y, (end - k) * w + (end < T ? 0.5 : 0), row - gap);
      k = end;
    }
    c.fillStyle = theme.css.warm;
    const stroke = Math.max(1.5, Math.min(3, w * 0.22));
    for (let k = 0; k < T; k++) if (r.changed[k * n + i]) c.fillRect(lanes.left + k * w - stroke / 2, y, stroke, row - gap);
    if (row >= 20) {
      c.textAlign = "left";
      for (let k = 0; k < T;) {
        let end = k + 1;
        while (end < T && !r.changed[end * n + i]) end++;
        const text = D.tasks ? D.tasks[r.plan[k * n + i]] : String(r.plan[k * n + i]), wide = c.measureText(text).width + 10;
        if (wide < (end - k) * w && !(D.idle && r.plan[k * n + i] === D.m)) {
          let on = false; // whether a coloured cell lies under the letters
          for (let under = k; under < end && (under - k) * w < wide; under++) on = on || r.held.data[under * n + i] > 0;
          if (on) {
            // A dark outline keeps white letters readable on every colour.
            c.strokeStyle = "rgba(6, 30, 54, .72)"; c.lineWidth = 3; c.lineJoin = "round";
            c.strokeText(text, lanes.left + k * w + 6, y + (row - gap) / 2);
          }
          c.fillStyle = on ? "#ffffff" : theme.css.muted;
          c.fillText(text, lanes.left + k * w + 6, y + (row - gap) / 2);
        }
        k = end;
      }
      c.textAlign = "right";
    }
    if (i === state.agent || (byNumber ? i : at) % every === 0) {
      c.fillStyle = i === state.agent ? theme.css.text : theme.css.muted;
      c.fillText(label(i), lanes.left - 8, Math.max(y + (row - gap) / 2, 6), lanes.left - 10);
    }
  }
}

function lanesStep() {
  const canvas = byId("timeline"), width = byId("timelinebox").clientWidth, c = fit(canvas, width, lanes.height);
  c.drawImage(lanes.base, 0, 0, width, lanes.height);
  const w = lanes.width / D.T, top = byId("timelinebox").scrollTop;
  c.strokeStyle = theme.css.text; c.lineWidth = 1.4; c.globalAlpha = 0.7;
  c.strokeRect(lanes.left + state.step * w, -2, w, lanes.height + 4);
  c.globalAlpha = 1;
  if (state.agent >= 0) {
    const y = lanes.at[state.agent] * lanes.row - top;
    c.strokeStyle = theme.css.warm; c.lineWidth = 2;
    c.strokeRect(lanes.left - 1, y - 1, lanes.width, lanes.row);
  }
}

function showLane(i) {
  const box = byId("timelinebox"), y = lanes.at[i] * lanes.row;
  if (y < box.scrollTop || y + lanes.row > box.scrollTop + box.clientHeight) box.scrollTop = y - box.clientHeight / 2;
}

function drawFollow() {
  const i = state.agent, r = result();
  if (i < 0) { byId("follow").textContent = ""; return; }
  const at = state.step * D.n + i, benefit = r.held.data[at] * r.held.unit;
  byId("follow").textContent = `${agentName(i)} (agent ${i}) at ${stepName(state.step)}: ${taskName(r.plan[at])}, ` +
    `${r.held.data[at] ? "benefit " + small(benefit) : "idle"}. In all: benefit ${small(r.gain[i])}, ${r.moves[i]} handovers.`;
}
