// The table of limits, and why the plan does not hold some pairs.

const why = { chosen: -1, of: -1 };

function drawLimits() {
  const told = result().limits;
  byId("limits").hidden = !told;
  if (!told) return;
  const tight = told.rows.filter((row) => row.slack <= 0).length;
  const shown = told.rows.length < told.count ? ` The first ${told.rows.length} of ${whole(told.count)}.` : "";
  byId("limitshint").textContent = `How far each limit is used. The slack is what is left; the price is what one more would be worth; paid is what going beyond costs. ${whole(tight)} of ${whole(told.rows.length)} leave no slack.${shown}`;
  const paid = told.rows.some((row) => row.cost), priced = told.rows.some((row) => row.price !== null);
  const head = ["limit", "use", "allowed", "slack", ...(priced ? ["price"] : []), ...(paid ? ["paid"] : [])];
  const cell = (value, name = "") => element("td", name ? { class: name } : {}, value === null ? "" : short(Math.abs(value) < 1e-6 ? 0 : +value.toPrecision(4)));
  const allowed = (row) => (row.least === null ? `at most ${short(row.most)}` : row.most === null ? `at least ${short(row.least)}`
    : row.least === row.most ? `just ${short(row.most)}` : `${short(row.least)} to ${short(row.most)}`);
  const rows = told.rows.map((row) => element("tr", {}, element("td", {}, row.name), cell(row.use), element("td", {}, allowed(row)),
    cell(row.slack, "extra"), ...(priced ? [cell(row.price)] : []), ...(paid ? [cell(row.cost || null)] : [])));
  byId("limittable").replaceChildren(element("thead", {}, element("tr", {}, ...head.map((text) => element("th", text === "slack" ? { scope: "col", class: "extra" } : { scope: "col" }, text)))),
    element("tbody", {}, ...rows));
}

function whySaid(pair) {
  if (pair.bound === null) return `No plan has ${agentName(pair.agent)} on ${taskName(pair.task)} at ${stepName(pair.step)}.`;
  const parts = [`Any plan with ${agentName(pair.agent)} on ${taskName(pair.task)} at ${stepName(pair.step)} is worth at most ${number(pair.bound)}; this one is worth ${number(pair.value)}.`];
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
      `${agentName(pair.agent)} on ${taskName(pair.task)}, ${stepName(pair.step)}`);
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
