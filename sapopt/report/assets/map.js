// The world: land, tasks, satellites with their trails, and the assignments of a step. Positions glide between steps.

const world = { on: Boolean(D.map), zoom: 1, lon: 0, lat: 0, back: document.createElement("canvas"), W: 0, H: 0 };
const RAD = Math.PI / 180, TRAIL = 9;

function startMap() {
  if (!world.on) return;
  byId("world").hidden = false;
  const { T, n, m } = D, tracks = new Int16Array(bytes(D.map.tracks)), places = new Int16Array(bytes(D.map.places));
  // Unit vectors, so that a position between two steps is right at the poles and at the date line as well.
  world.vectors = new Float32Array(3 * T * n);
  let most = 50;
  for (let s = 0; s < T * n; s++) {
    const lon = tracks[2 * s] / 180 * RAD, lat = tracks[2 * s + 1] / 180 * RAD;
    world.vectors[3 * s] = Math.cos(lat) * Math.cos(lon);
    world.vectors[3 * s + 1] = Math.cos(lat) * Math.sin(lon);
    world.vectors[3 * s + 2] = Math.sin(lat);
    most = Math.max(most, Math.abs(tracks[2 * s + 1] / 180));
  }
  world.tracks = tracks;
  world.places = Float32Array.from(places, (x) => x / 180);
  world.limit = Math.min(90, most + 7);
  world.now = new Float32Array(2 * n);
  world.priority = Math.max(...D.map.priority, 1e-9);
  world.land = D.map.land.rings.map((ring) => {
    const out = new Float32Array(ring.length);
    for (let k = 0, x = 0, y = 0; k < ring.length; k += 2) { x += ring[k]; y += ring[k + 1]; out[k] = x * D.map.land.unit; out[k + 1] = y * D.map.land.unit; }
    return out;
  });
  const chips = [["tracks", "trails"], ["links", "assignments"], ...(prices ? [["prices", "prices"]] : [])];
  byId("layers").replaceChildren(...chips.map(([key, text]) => element("button", {
    type: "button", "data-layer": key, "aria-pressed": String(state.layers[key]),
    onclick: (event) => { state.layers[key] = !state.layers[key]; event.currentTarget.setAttribute("aria-pressed", String(state.layers[key])); redraw(true); },
  }, text)));
  pointers(byId("map"));
  byId("zoomin").addEventListener("click", () => zoomBy(1.6));
  byId("zoomout").addEventListener("click", () => zoomBy(1 / 1.6));
  panels.push({ base: mapBase, step: mapStep });
}

const X = (lon) => world.W / 2 + (lon - world.lon) * world.sx;
const Y = (lat) => world.H / 2 - (lat - world.lat) * world.sy;

function mapSize() {
  const width = byId("map").parentElement.clientWidth, stretch = width < 600 ? 1.55 : 1.15;
  world.W = width;
  world.H = Math.round(width * 2 * world.limit / 360 * stretch);
  world.sx = width / 360 * world.zoom;
  world.sy = world.sx * stretch;
  const free = 180 - 180 / world.zoom, freeLat = world.limit - world.limit / world.zoom;
  world.lon = Math.min(free, Math.max(-free, world.lon));
  world.lat = Math.min(freeLat, Math.max(-freeLat, world.lat));
  byId("map").style.height = world.H + "px";
  byId("map").style.touchAction = world.zoom > 1 ? "none" : "pan-y";
}

function mapBase() {
  mapSize();
  const c = fit(world.back, world.W, world.H), css = theme.css;
  c.fillStyle = css.sea; c.fillRect(0, 0, world.W, world.H);
  c.strokeStyle = css.grid; c.lineWidth = 1; c.beginPath();
  for (let lon = -150; lon <= 150; lon += 30) { c.moveTo(X(lon), 0); c.lineTo(X(lon), world.H); }
  for (let lat = -60; lat <= 60; lat += 30) { c.moveTo(0, Y(lat)); c.lineTo(world.W, Y(lat)); }
  c.stroke();
  c.beginPath();
  for (const ring of world.land) {
    for (let k = 0; k < ring.length; k += 2) c[k ? "lineTo" : "moveTo"](X(ring[k]), Y(ring[k + 1]));
    c.closePath();
  }
  c.fillStyle = css.land; c.fill("evenodd");
  c.strokeStyle = css.shore; c.lineWidth = 0.8; c.stroke();
  legend("maplegend", [
    ["dot", css.accent, "satellite at work"], ["dot", css.muted, "idle satellite"],
    ["", css.good, "task served"], ["", css.shore, "task not served"],
    ["dash", css.warm, "handed over at this step"],
    ...(state.layers.prices ? [["ramp", gradient(HEATS[theme.name]), "price of the task now"]] : []),
  ]);
}

// Where everyone is at the clock's time, in degrees.
function positionsNow() {
  const { T, n } = D, k = Math.min(Math.floor(state.clock), T - 1), next = Math.min(k + 1, T - 1), f = state.clock - k;
  const v = world.vectors, out = world.now;
  for (let i = 0; i < n; i++) {
    const a = 3 * (k * n + i), b = 3 * (next * n + i);
    const x = v[a] + f * (v[b] - v[a]), y = v[a + 1] + f * (v[b + 1] - v[a + 1]), z = v[a + 2] + f * (v[b + 2] - v[a + 2]);
    out[2 * i] = Math.atan2(y, x) / RAD;
    out[2 * i + 1] = Math.atan2(z, Math.hypot(x, y)) / RAD;
  }
}

// A line between two places, the short way round; over the date line it is drawn at both edges.
function strand(c, lon0, lat0, lon1, lat1) {
  if (Math.abs(lon1 - lon0) <= 180) { c.moveTo(X(lon0), Y(lat0)); c.lineTo(X(lon1), Y(lat1)); return; }
  const turn = lon1 > lon0 ? 360 : -360;
  c.moveTo(X(lon0), Y(lat0)); c.lineTo(X(lon1 - turn), Y(lat1));
  c.moveTo(X(lon0 + turn), Y(lat0)); c.lineTo(X(lon1), Y(lat1));
}

function mapStep() {
  const { n } = D, canvas = byId("map"), c = fit(canvas, world.W, world.H), css = theme.css, r = result(), k = state.step;
  c.drawImage(world.back, 0, 0, world.W, world.H);
  positionsNow();
  const size = Math.max(0.9, Math.min(3.2, 46 / Math.sqrt(n)) * Math.min(1.25, Math.max(0.45, world.W / 900))) * Math.min(1.8, Math.sqrt(world.zoom));
  if (state.layers.tracks) trails(c);
  drawTasks(c, size);
  if (state.layers.links) assignments(c);
  if (state.agent >= 0) drawFollowed(c);
  for (const busy of [0, 1]) {
    c.fillStyle = busy ? css.accent : css.muted; c.globalAlpha = busy ? 1 : 0.55;
    c.beginPath();
    for (let i = 0; i < n; i++) {
      if (Boolean(r.held.data[k * n + i]) !== Boolean(busy)) continue;
      const x = X(world.now[2 * i]), y = Y(world.now[2 * i + 1]);
      c.moveTo(x + size, y); c.arc(x, y, size, 0, 6.2832);
    }
    c.fill();
  }
  c.globalAlpha = 1;
  if (state.agent >= 0) {
    const x = X(world.now[2 * state.agent]), y = Y(world.now[2 * state.agent + 1]);
    c.fillStyle = css.warm; c.strokeStyle = css.card; c.lineWidth = 2;
    c.beginPath(); c.arc(x, y, size + 3.5, 0, 6.2832); c.fill(); c.stroke();
  }
}

function trails(c) {
  const { n } = D, tracks = world.tracks, k = state.step, strength = world.W < 600 ? 0.3 : 0.4;
  c.strokeStyle = theme.css.accent; c.lineWidth = Math.max(0.4, Math.min(1.1, 20 / Math.sqrt(n)) * Math.min(1, world.W / 800));
  for (let age = Math.min(TRAIL, k); age >= 1; age--) {
    c.globalAlpha = strength * (1 - age / (TRAIL + 1));
    c.beginPath();
    for (let i = 0; i < n; i++) {
      const a = 2 * ((k - age) * n + i), b = 2 * ((k - age + 1) * n + i);
      strand(c, tracks[a] / 180, tracks[a + 1] / 180, tracks[b] / 180, tracks[b + 1] / 180);
    }
    c.stroke();
  }
  const part = state.clock - k;
  if (part > 0) {
    c.globalAlpha = strength;
    c.beginPath();
    for (let i = 0; i < n; i++) { const a = 2 * (k * n + i); strand(c, tracks[a] / 180, tracks[a + 1] / 180, world.now[2 * i], world.now[2 * i + 1]); }
    c.stroke();
  }
  c.globalAlpha = 1;
}

function drawTasks(c, size) {
  const { n, m } = D, r = result(), k = state.step, css = theme.css, priority = D.map.priority;
  const served = new Uint8Array(m);
  for (let i = 0; i < n; i++) if (r.held.data[k * n + i]) served[r.plan[k * n + i]] = 1;
  const showPrices = state.layers.prices && prices;
  const half = (j) => size * (0.75 + 0.55 * priority[j] / world.priority) * (m > 1500 ? 0.7 : 1);
  for (const on of [0, 1]) {
    c.fillStyle = on ? css.good : css.shore;
    for (let j = 0; j < m; j++) {
      if (served[j] !== on || priority[j] <= 0) continue;
      let h = half(j);
      if (showPrices) {
        const level = Math.sqrt(prices.data[k * m + j] * prices.unit / prices.top);
        c.fillStyle = level > 0 ? theme.heat[Math.min(255, Math.round(60 + 195 * level))] : css.shore;
        h *= 0.8 + 1.9 * level;
      }
      c.fillRect(X(world.places[2 * j]) - h, Y(world.places[2 * j + 1]) - h, 2 * h, 2 * h);
    }
  }
}

function assignments(c) {
  const { n } = D, r = result(), k = state.step, levels = 3, top = r.held.top / r.held.unit || 1;
  for (let level = 0; level <= levels; level++) {
    const fresh = level === levels;
    c.strokeStyle = fresh ? theme.css.warm : theme.css.good;
    c.globalAlpha = fresh ? 0.95 : 0.35 + 0.25 * level;
    c.lineWidth = (fresh ? 1.9 : 0.9 + 0.3 * level) * Math.min(1.3, Math.max(0.75, world.W / 900));
    c.beginPath();
    for (let i = 0; i < n; i++) {
      const at = k * n + i, held = r.held.data[at];
      if (!held || Boolean(r.changed[at]) !== fresh) continue;
      if (!fresh && Math.min(levels - 1, Math.floor(levels * held / top)) !== level) continue;
      const j = r.plan[at];
      strand(c, world.now[2 * i], world.now[2 * i + 1], world.places[2 * j], world.places[2 * j + 1]);
    }
    c.stroke();
  }
  c.globalAlpha = 1;
}

// The whole ground track of the satellite that is followed, and what it can see.
function drawFollowed(c) {
  const { T, n } = D, i = state.agent, tracks = world.tracks;
  c.strokeStyle = theme.css.warm; c.lineWidth = 1.6; c.globalAlpha = 0.85;
  c.beginPath();
  for (let k = 1; k < T; k++) {
    const a = 2 * ((k - 1) * n + i), b = 2 * (k * n + i);
    strand(c, tracks[a] / 180, tracks[a + 1] / 180, tracks[b] / 180, tracks[b + 1] / 180);
  }
  c.stroke();
  if (D.map.footprint) {
    const lat = world.now[2 * i + 1] * RAD, lon = world.now[2 * i] * RAD, r = D.map.footprint * RAD;
    c.setLineDash([4, 3]); c.beginPath();
    let before = null;
    for (let turn = 0; turn <= 72; turn++) {
      const a = turn * 5 * RAD, y = Math.asin(Math.sin(lat) * Math.cos(r) + Math.cos(lat) * Math.sin(r) * Math.cos(a));
      const x = lon + Math.atan2(Math.sin(a) * Math.sin(r) * Math.cos(lat), Math.cos(r) - Math.sin(lat) * Math.sin(y));
      const here = [((x / RAD + 540) % 360 + 360) % 360 - 180, y / RAD];
      if (before) strand(c, before[0], before[1], here[0], here[1]);
      before = here;
    }
    c.stroke(); c.setLineDash([]);
  }
  c.globalAlpha = 1;
}

// ---- pointer: follow, zoom, pan ------------------------------------------------------------------------------------

function zoomBy(factor, x, y) {
  const lon = x === undefined ? world.lon : world.lon + (x - world.W / 2) / world.sx;
  const lat = y === undefined ? world.lat : world.lat - (y - world.H / 2) / world.sy;
  const before = world.zoom;
  world.zoom = Math.min(12, Math.max(1, world.zoom * factor));
  world.lon = lon - (lon - world.lon) * before / world.zoom;
  world.lat = lat - (lat - world.lat) * before / world.zoom;
  redraw(true);
}

function nearest(x, y) {
  let found = -1, least = 18 * 18;
  for (let i = 0; i < D.n; i++) {
    const dx = X(world.now[2 * i]) - x, dy = Y(world.now[2 * i + 1]) - y, d = dx * dx + dy * dy;
    if (d < least) { least = d; found = i; }
  }
  return found;
}

function pointers(canvas) {
  const down = new Map();
  let moved = 0, spread = 0;
  canvas.addEventListener("pointerdown", (event) => { down.set(event.pointerId, [event.offsetX, event.offsetY]); moved = 0; spread = 0; });
  canvas.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) return;
    const dx = event.offsetX - last[0], dy = event.offsetY - last[1];
    moved += Math.abs(dx) + Math.abs(dy);
    down.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (down.size === 2) {
      const [a, b] = [...down.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (spread) zoomBy(now / spread, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
      spread = now;
    } else if (world.zoom > 1 && moved > 4) {
      world.lon -= dx / world.sx; world.lat += dy / world.sy;
      redraw(true);
    }
  });
  for (const name of ["pointerup", "pointercancel", "pointerleave"]) canvas.addEventListener(name, (event) => down.delete(event.pointerId));
  canvas.addEventListener("click", (event) => { if (moved < 6) follow(nearest(event.offsetX, event.offsetY)); });
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && world.zoom === 1) return; // the wheel scrolls the page until one has zoomed in
    event.preventDefault();
    zoomBy(Math.exp(-event.deltaY / 300), event.offsetX, event.offsetY);
  }, { passive: false });
  hover(canvas, (x, y) => { const i = down.size ? -1 : nearest(x, y); return i < 0 ? "" : describeCell(i, state.step); });
}
