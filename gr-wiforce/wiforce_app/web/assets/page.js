// SPDX-License-Identifier: GPL-3.0-or-later
// Takes the messages of wiforce_app/web/server.py and keeps the page up to date.
"use strict";

const RECONNECT_MS = [500, 1000, 2000, 5000];
// Histories are redrawn five times per second, as those of the Qt display, or less often where a
// drawing takes long: at least four fifths of the time are left for readings that come in.
const HISTORY_MS = 200;
const PAUSE_PER_DRAWING = 4, LONGEST_PAUSE_MS = 1000;
// Numbers change as often, since nobody reads faster.
const NUMBERS_MS = 200;
const MOST_READINGS = 50000; // as many as the server keeps
const DEFAULT_LENGTH_MM = 80;
// Numbers of sensors from which on each gets a lower picture.
const SEVERAL = 3, CROWDED = 5;
// A run has at most 256; names of former runs are forgotten before they fill the window.
const MOST_TRACKS = 512;

const page = {
  tracks: new Map(), // by sensor: readings of the history, and its view
  status: { state: "connecting", reason: "", sensors: {}, ages: {} },
  statusAt: 0,
  newest: 0,
  oldest: 0,
  settings: { history_s: 600, length_mm: null },
  connected: false,
  lostAt: null,
  attempts: 0,
  socket: null,
  plots: null,
  times: null,
  asked: false,
  changed: true,
  messages: 0,
};
window.wiforce = page;

function trackOf(sensor) {
  if (!page.tracks.has(sensor)) {
    if (page.tracks.size >= MOST_TRACKS) {
      for (const { view } of page.tracks.values()) view.root.remove();
      page.tracks.clear();
    }
    const view = new SensorView(sensor, page.tracks.size, byId("sensors"), () => {
      page.changed = true;
    });
    page.tracks.set(sensor, {
      readings: [], latest: null, fresh: [], held: null, arrivedAt: -Infinity, view,
    });
    byId("empty").hidden = true;
    byId("sensors").classList.toggle("several", page.tracks.size >= SEVERAL);
    byId("sensors").classList.toggle("crowded", page.tracks.size >= CROWDED);
  }
  return page.tracks.get(sensor);
}

function take(message) {
  page.messages += 1;
  const now = performance.now();
  if (message.answer) takeAnswer(message.answer);
  if (message.restart) {
    page.newest = 0;
    for (const track of page.tracks.values()) {
      Object.assign(track, { readings: [], latest: null, fresh: [], held: null });
    }
    page.times.set({ end: null, zoom: null });
  }
  for (const row of message.rows ?? []) {
    const reading = asReading(row);
    const track = trackOf(reading.sensor);
    track.readings.push(reading);
    track.fresh.push(reading);
    track.latest = reading;
    track.across = track.across || reading.y !== null;
    track.arrivedAt = now;
    page.newest = Math.max(page.newest, reading.time);
  }
  if (message.rows?.length) page.changed = true;
  if (message.status) takeStatus(message.status, now);
  forget();
  drawPictures();
  if (message.status || message.answer) drawHead();
}

// Readings that are older than the history, or too many.
function forget() {
  const before = page.newest - (page.settings.history_s ?? Infinity);
  const most = Math.ceil(MOST_READINGS / Math.max(1, page.tracks.size));
  page.oldest = page.newest;
  for (const { readings } of page.tracks.values()) {
    const old = readings.findIndex((reading) => reading.time >= before);
    const stale = Math.max(old < 0 ? readings.length : old, readings.length - most);
    if (stale > 0) readings.splice(0, stale);
    if (readings.length) page.oldest = Math.min(page.oldest, readings[0].time);
  }
}

function takeStatus(status, now) {
  page.status = { ...status, sensors: status.sensors ?? {}, ages: status.ages ?? {} };
  page.statusAt = now;
  for (const sensor of Object.keys(page.status.sensors)) trackOf(sensor);
  // Readings of the history that comes first are older than their arrival here.
  for (const [sensor, ageS] of Object.entries(page.status.ages)) {
    trackOf(sensor).arrivedAt = Math.min(trackOf(sensor).arrivedAt, now - 1000 * ageS);
  }
}

function takeAnswer(answer) {
  page.asked = false;
  const outcome = byId("outcome");
  outcome.textContent = answer.ok ? "tare complete" : answer.error || "tare failed";
  outcome.classList.toggle("bad", !answer.ok);
  if (!answer.ok && answer.error?.startsWith("tare refused")) askToForce(answer.error);
  page.answered = JSON.stringify(page.status.tare ?? null);
}

// The reader refuses what it takes for a touch; the user can see whether anything is touched.
function askToForce(refusal) {
  byId("refusal").textContent = refusal;
  byId("force").showModal();
}

function ask(request) {
  page.asked = true;
  byId("outcome").textContent = "";
  page.socket.send(request);
  drawHead();
}

function lengthOf(sensor) {
  const known = page.status.sensors[sensor]?.length_mm ?? page.settings.length_mm;
  if (known) return known;
  let farthest = DEFAULT_LENGTH_MM;
  for (const reading of page.tracks.get(sensor).readings) {
    if (!reading.doubtful && reading.location > farthest) farthest = reading.location;
  }
  return 10 * Math.ceil(farthest / 10);
}

// Where the strips of a surface are; null for a sensor. Files do not say where they are.
function planeOf(sensor, track) {
  const known = page.status.surface;
  if (known && (sensor === known.name || sensor === `${known.name}-2`)) {
    const ends = known.strips.flatMap((strip) => strip.x_mm);
    return {
      strips: known.strips, x: [Math.min(...ends), Math.max(...ends)], y: known.y_span_mm,
    };
  }
  if (!track.across) return null;
  // Both presses of a surface are on one skin, whose pictures have one size.
  let low = 0, high = 0, lengthMm = 0;
  for (const [name, { across, readings }] of page.tracks) {
    if (across) lengthMm = Math.max(lengthMm, lengthOf(name));
    for (const { y } of readings) {
      if (y !== null) [low, high] = [Math.min(low, y), Math.max(high, y)];
    }
  }
  low = 10 * Math.floor(low / 10);
  return { strips: [], x: [0, lengthMm], y: [low, Math.max(low + 10, 10 * Math.ceil(high / 10))] };
}

// The reading at the time that is looked at, with its age; the given one where that is now.
function lookedAt(track, current) {
  const { cursor } = page.times;
  if (cursor === null) return [current, (performance.now() - track.arrivedAt) / 1000];
  const reading = track.readings[firstAfter(track.readings, cursor) - 1] ?? null;
  return [reading, reading === null ? Infinity : cursor - reading.time];
}

function drawPictures() {
  for (const [sensor, track] of page.tracks) {
    const [reading, ageS] = lookedAt(track, track.latest);
    track.view.draw(reading, ageS, lengthOf(sensor), planeOf(sensor, track));
  }
}

// Of the readings since the last numbers the latest without a flag, so that those of a moment in
// which a press changes do not flash up.
function drawNumbers() {
  for (const [sensor, track] of page.tracks) {
    const clear = track.fresh.filter((reading) => !reading.doubtful);
    track.held = (clear.length ? clear : track.fresh).at(-1) ?? track.held;
    track.fresh = [];
    const [reading, ageS] = lookedAt(track, track.held);
    track.view.drawNumbers(reading, page.status.sensors[sensor] ?? {}, ageS);
  }
}

function drawHead() {
  const { status } = page;
  const ended = status.state === "ended";
  const state = page.connected || ended ? status.state : "disconnected";
  byId("state").dataset.state = state;
  setText(byId("state"), state);
  setText(byId("reason"), page.connected || ended ? status.reason ?? "" : "");
  setText(byId("scene"), status.scene ? `scene ${status.scene}` : "");
  setText(byId("time"), page.newest ? `${page.newest.toFixed(1)} s of signal` : "");
  setText(byId("run"), status.run ? `run ${status.run}` : status.source ?? "");
  setText(byId("losses"), lossesOf(status));
  document.title = `${state} – gr-wiforce`;
  drawTare(state);
  const notice = byId("connection");
  notice.hidden = page.connected || ended || page.lostAt === null;
  if (!notice.hidden) {
    const sinceS = (performance.now() - page.lostAt) / 1000;
    setText(notice, `No connection to gr-wiforce for ${ageText(sinceS)}; trying again.`);
  }
}

function lossesOf(status) {
  const dropped = status.groups?.dropped;
  const parts = [];
  if (status.gaps) parts.push(`${status.gaps} gaps`);
  if (dropped) parts.push(`${dropped} groups lost`);
  return parts.join(", ");
}

function drawTare(state) {
  const { status } = page;
  const tare = status.tare ?? { state: "none" };
  const measuring = tare.state === "measuring";
  const button = byId("tare");
  setText(button, measuring ? "Measuring…" : page.asked ? "Asked…" : "Tare");
  const idle = ["ending", "ended", "lost", "waiting", "connecting", "disconnected"].includes(state);
  button.disabled = !status.can_tare || measuring || page.asked || idle;
  button.title = status.can_tare
    ? "Measure the untouched reference again; nothing may press a sensor."
    : "The source takes no requests. Start with --control to tare from here.";
  // The outcome of a tare that somebody else has requested.
  const seen = JSON.stringify(status.tare ?? null);
  if (seen !== page.answered && !page.asked) {
    page.answered = seen;
    const outcome = byId("outcome");
    const shown = tare.state === "none" || measuring ? "" :
      `tare ${tare.state}${tare.forced ? " (forced)" : ""}${tare.reason ? `: ${tare.reason}` : ""}`;
    outcome.textContent = shown;
    outcome.classList.toggle("bad", shown !== "" && tare.state !== "complete");
  }
}

function drawHistory() {
  const tracks = [];
  let lengthMm = 0;
  for (const [sensor, track] of page.tracks) {
    lengthMm = Math.max(lengthMm, lengthOf(sensor));
    const { color, dash, shown } = track.view;
    if (shown) tracks.push({ readings: track.readings, color, dash });
  }
  const { start, end } = page.times.range;
  page.plots.draw(tracks, start, end, lengthMm || DEFAULT_LENGTH_MM);
  page.times.draw();
}

// Resolves when what was changed has been painted.
function painted() {
  return new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
}

async function keepHistory() {
  for (;;) {
    const begun = performance.now();
    if (page.changed) {
      page.changed = false;
      drawHistory();
      await painted();
    }
    const took = performance.now() - begun;
    const pause = Math.max(HISTORY_MS - took, PAUSE_PER_DRAWING * took);
    const longest = Math.min(pause, LONGEST_PAUSE_MS);
    await new Promise((resolve) => setTimeout(resolve, longest));
  }
}

function connect() {
  const address = new URL("readings", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  const socket = new WebSocket(address);
  page.socket = socket;
  socket.onopen = () => {
    Object.assign(page, { connected: true, attempts: 0, lostAt: null });
  };
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => {
    page.connected = page.asked = false;
    page.lostAt ??= performance.now();
    const wait = RECONNECT_MS[Math.min(page.attempts++, RECONNECT_MS.length - 1)];
    setTimeout(connect, wait);
  };
}

async function begin() {
  const response = await fetch("figures.json");
  const { figures, ...settings } = await response.json();
  page.settings = settings;
  page.plots = new Plots();
  await page.plots.embed(figures);
  page.times = new TimeView(page, () => {
    page.changed = true;
    drawPictures();
    drawNumbers();
  });
  page.times.listen();
  byId("tare").onclick = () => ask("tare");
  byId("forced").onclick = () => ask("tare force");
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  scheme.onchange = () => page.plots.paint();
  page.plots.paint();
  page.plots.fit();
  window.addEventListener("resize", () => {
    page.plots.fit();
    drawPictures();
  });
  setInterval(() => {
    drawPictures();
    drawNumbers();
    drawHead();
  }, NUMBERS_MS);
  connect();
  keepHistory();
}

begin();
