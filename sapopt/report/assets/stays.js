// Who does what, from when to when: a row for each stay that earns something, to search and to copy.

const stays = { all: [], found: [] };
const STAY_ROWS = 200;
const timeOf = (k) => (D.times ? D.times[k] : String(k + 1));
// Numbers and whole days name the last one that belongs to the stay; otherwise a stay ends when the step after it begins.
const endOf = (k) => (D.days ? D.times[k - 1] : D.times ? D.times[k] : String(k));
const stayHead = () => (D.days ? ["first day", "last day"] : D.times ? ["from", "to"].map((text) => text + (D.zone ? ` (${D.zone})` : "")) : ["first step", "last step"]);

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

// Date and time may stand in two lines, but neither is broken.
function moment(text) {
  return element("td", {}, ...text.split(" ").flatMap((word, at) => (at ? [" ", element("span", { class: "word" }, word)] : [element("span", { class: "word" }, word)])));
}

function showStays() {
  const words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
  const matches = (s) => { const text = `${agentName(s.i)} ${taskName(s.j)}`.toLowerCase(); return words.every((word) => text.includes(word)); };
  stays.found = words.length ? stays.all.filter(matches) : stays.all;
  const head = ["agent", "task", ...stayHead(), "benefit"];
  const rows = stays.found.slice(0, STAY_ROWS).map((s) => element("tr", {},
    element("td", {}, element("button", { type: "button", onclick: () => { play(false); goTo(s.first); follow(s.i); } }, agentName(s.i))),
    element("td", {}, taskName(s.j)), moment(timeOf(s.first)), moment(endOf(s.stop)), element("td", { class: "extra" }, small(s.benefit))));
  byId("staytable").replaceChildren(
    element("thead", {}, element("tr", {}, ...head.map((text, at) => element("th", at === 4 ? { scope: "col", class: "extra" } : { scope: "col" }, text)))), element("tbody", {}, ...rows));
  const more = stays.found.length - rows.length;
  byId("staycount").textContent = stays.found.length === 0 ? "nothing found"
    : `${whole(stays.found.length)} of ${whole(stays.all.length)} stays` + (more > 0 ? `, the first ${STAY_ROWS} are shown; copying takes all` : "");
}

async function copyStays() {
  const lines = [["agent", "task", ...stayHead(), "benefit"], ...stays.found.map((s) => [agentName(s.i), taskName(s.j), timeOf(s.first), endOf(s.stop), String(s.benefit)])];
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
