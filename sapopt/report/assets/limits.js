// The table of limits, and why the plan does not hold some pairs.

const why = { chosen: -1, of: -1 };

function drawLimits() {
  const told = result().limits;
  byId("limits").hidden = !told;
  if (!told) return;
  const tight = told.rows.filter((row) => row.slack <= 0).length;
  const shown = told.rows.length < told.count ? ` The first ${told.rows.length} of ${whole(told.count)}.` : "";
  byId("limitshint").textContent = `Use and slack of each limit; the price is what one more would be worth. ${whole(tight)} leave nothing. Steps in names count from 0.${shown}`;
  const head = ["limit", "use", "at least", "at most", "slack", "price", "paid"];
  const cell = (value) => element("td", {}, value === null ? "" : small(value));
  const rows = told.rows.map((row) => element("tr", {}, element("td", {}, row.name), cell(row.use), cell(row.least),
    cell(row.most), cell(row.slack), cell(row.price), cell(row.cost || null)));
  byId("limittable").replaceChildren(element("thead", {}, element("tr", {}, ...head.map((text) => element("th", { scope: "col" }, text)))),
    element("tbody", {}, ...rows));
}

function whySaid(pair) {
  if (pair.bound === null) return `No plan has ${agentName(pair.agent)} on ${taskName(pair.task)} at step ${pair.step + 1}.`;
  const parts = [`Any plan with ${agentName(pair.agent)} on ${taskName(pair.task)} at step ${pair.step + 1} is worth at most ${number(pair.bound)}; this one is worth ${number(pair.value)}.`];
  if (pair.holders.length) parts.push(`The task is held by ${pair.holders.map(agentName).join(", ")}.`);
  if (pair.limits.length) parts.push(`In its way: ${pair.limits.slice(0, 6).join(", ")}${pair.limits.length > 6 ? " ..." : ""}.`);
  return parts.join(" ");
}

function drawWhy() {
  const pairs = result().why;
  byId("why").hidden = !pairs.length;
  if (why.of !== state.result) { why.of = state.result; why.chosen = -1; }
  byId("whypairs").replaceChildren(...pairs.map((pair, index) => {
    const button = element("button", { type: "button", "aria-pressed": String(index === why.chosen), onclick: () => askWhy(index) },
      `${agentName(pair.agent)} on ${taskName(pair.task)}, step ${pair.step + 1}`);
    return button;
  }));
  byId("whytext").textContent = why.chosen < 0 ? "" : whySaid(pairs[why.chosen]);
}

function askWhy(index) {
  why.chosen = index;
  const pair = result().why[index];
  play(false);
  goTo(pair.step);
  follow(pair.agent, false);
  drawWhy();
  byId("whypairs").children[index].focus();
}
