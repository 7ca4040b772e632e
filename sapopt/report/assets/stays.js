// Who does what, from when to when: a row for each stay that earns something, to search and to copy.

const stays = { all: [], found: [] };
const STAY_ROWS = 200;
const timeOf = (k) => (D.times ? D.times[k] : String(k + 1));
// Without times, the last step counts as a part of the stay: "steps 3 to 5"; with times a stay ends where the next begins.
const endOf = (k) => (D.times ? D.times[k] : String(k));

function startStays() {
  byId("search").addEventListener("input", showStays);
  byId("copy").addEventListener("click", copyStays);
  panels.push({ base: () => { findStays(); showStays(); } });
}

function findStays() {
  const r = result(), { T, n } = D;
  stays.all = [];
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < T;) {
      const first = k, j = r.plan[k * n + i];
      let benefit = 0;
      for (; k < T && r.plan[k * n + i] === j; k++) benefit += r.held.data[k * n + i] * r.held.unit;
      if (benefit > 0) stays.all.push({ i, j, first, stop: k, benefit });
    }
  }
}

function showStays() {
  const words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
  const matches = (s) => { const text = `${agentName(s.i)} ${taskName(s.j)}`.toLowerCase(); return words.every((word) => text.includes(word)); };
  stays.found = words.length ? stays.all.filter(matches) : stays.all;
  const head = ["agent", "task", D.times ? "from" : "first step", D.times ? "to" : "last step", "benefit"];
  const rows = stays.found.slice(0, STAY_ROWS).map((s) => element("tr", {},
    element("td", {}, element("button", { type: "button", onclick: () => { play(false); goTo(s.first); follow(s.i); } }, agentName(s.i))),
    ...[taskName(s.j), timeOf(s.first), endOf(s.stop), small(s.benefit)].map((text) => element("td", {}, text))));
  byId("staytable").replaceChildren(
    element("thead", {}, element("tr", {}, ...head.map((text) => element("th", { scope: "col" }, text)))), element("tbody", {}, ...rows));
  const more = stays.found.length - rows.length;
  byId("staycount").textContent = stays.found.length === 0 ? "nothing found"
    : `${whole(stays.found.length)} of ${whole(stays.all.length)} stays` + (more > 0 ? `, the first ${STAY_ROWS} are shown; copying takes all` : "");
}

async function copyStays() {
  const lines = [["agent", "task", "from", "to", "benefit"], ...stays.found.map((s) => [agentName(s.i), taskName(s.j), timeOf(s.first), endOf(s.stop), String(s.benefit)])];
  const text = lines.map((line) => line.map((cell) => cell.replace(/[\t\n\r]/g, " ")).join("\t")).join("\n");
  byId("staycount").textContent = (await copied(text)) ? `${whole(stays.found.length)} rows copied; paste them into a spreadsheet` : "this browser does not let the page copy";
}
async function copied(text) {
  try { await navigator.clipboard.writeText(text); return true; } catch { /* not allowed from a file in some browsers: the old way */ }
  const area = element("textarea", { class: "visually-hidden" });
  area.value = text;
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  byId("copy").focus();
  return done;
}
