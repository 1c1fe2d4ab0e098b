// SPDX-License-Identifier: GPL-3.0-or-later
// One sensor: its reading as text, and the line with the press at its location.
"use strict";

// One per sensor, those of python/wiforce/io/palette.py. Further sensors have the same colours with
// dashed lines.
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e6c200", "#202428"];
// The last one on dark paper, where it would not be seen.
const LIGHT = "#e6e9ec", DARK_PAPER = matchMedia("(prefers-color-scheme: dark)");
const FORCE_SPAN_N = 8; // force of the longest arrow, unless a sensor is pressed harder
const STALE_S = 1;
const WARNING = "#a35500";
const SVG = "http://www.w3.org/2000/svg";

// As wiforce_app/web/sources.py arranges the columns.
function asReading(row) {
  const [
    sensor, time, touch, force, forceStd, location, locationStd, snr, interference, flags,
    y = null, yStd = null, covXY = null,
  ] = row;
  const warnings = flags.split(" ").filter((flag) => flag && flag !== "reference");
  return {
    sensor, time, touch, force, forceStd, location, locationStd, snr, interference, flags,
    y, yStd, covXY,
    doubtful: warnings.length > 0,
  };
}

function withSpread(value, std, decimals, unit) {
  if (value === null) return `? ${unit}`;
  const spread = std ? ` ± ${(2 * std).toFixed(decimals)}` : "";
  return `${value.toFixed(decimals)}${spread} ${unit}`;
}

function placeOf(reading) {
  const location = withSpread(reading.location, reading.locationStd, 1, "mm");
  return reading.y === null ? location : `x ${location}, y ${withSpread(reading.y, reading.yStd, 1, "mm")}`;
}

const byId = (id) => document.getElementById(id);

function element(tag, className, parent) {
  const made = document.createElement(tag);
  made.className = className;
  parent.append(made);
  return made;
}

// Changes the page only where the text is another one, which costs a hundred times less.
function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

class SensorView {
  constructor(name, index, parent, onToggle) {
    this.own = COLORS[index % COLORS.length];
    this.dash = index < COLORS.length ? "solid" : "dashed";
    this.root = element("article", "sensor", parent);
    this.root.dataset.sensor = name;
    const heading = element("div", "heading", this.root);
    this.name = element("button", `name ${this.dash}`, heading);
    this.name.textContent = name;
    this.name.title = `${name}: show or hide in the plots`;
    this.name.setAttribute("aria-pressed", "true");
    this.name.onclick = () => {
      this.shown = !this.shown;
      this.name.setAttribute("aria-pressed", String(this.shown));
      onToggle();
    };
    this.shown = true;
    this.force = element("span", "force", heading);
    this.location = element("span", "location", heading);
    this.flags = element("span", "flags warning", heading);
    const details = element("div", "details", this.root);
    this.snr = element("span", "snr", details);
    this.clock = element("span", "clock", details);
    this.interference = element("span", "interference", details);
    this.age = element("span", "age", details);
    this.problem = element("span", "problem warning", details);
    this.picture = document.createElementNS(SVG, "svg");
    this.picture.classList.add("picture");
    this.picture.setAttribute("role", "img");
    this.root.append(this.picture);
    this.drawn = "";
  }

  get color() {
    return DARK_PAPER.matches && this.own === COLORS.at(-1) ? LIGHT : this.own;
  }

  // The line with the press. `plane` is that of a surface, null for a sensor.
  draw(reading, ageS, lengthMm, plane) {
    const press = !isStale(reading, ageS) && reading.touch === 1 ? reading : null;
    const width = this.picture.clientWidth, height = this.picture.clientHeight;
    this.root.classList.toggle("plane", plane !== null);
    const drawn = JSON.stringify([press, lengthMm, plane, width, height]);
    if (drawn === this.drawn || !(width > 0)) return;
    this.drawn = drawn;
    const parts = plane !== null ? planeParts(press, plane, width, height, this.color)
      : this.lineParts(press, lengthMm, width, height);
    this.picture.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.picture.replaceChildren(...parts);
    const label = press === null ? "not pressed" : `${this.force.textContent} ${this.location.textContent}`;
    this.picture.setAttribute("aria-label", label);
  }

  // The numbers: `health` is what a heartbeat says of the sensor; `ageS` counts from the arrival of
  // the reading.
  drawNumbers(reading, health, ageS) {
    const stale = isStale(reading, ageS), touched = !stale && reading.touch === 1;
    this.root.style.setProperty("--color", this.color);
    this.root.classList.toggle("stale", stale);
    this.root.classList.toggle("untouched", !stale && reading.touch === 0);
    this.root.classList.toggle("doubtful", !stale && reading.doubtful);
    let force = reading === null ? "no readings" : "no new readings", location = "";
    if (touched) {
      force = withSpread(reading.force, reading.forceStd, 2, "N");
      location = placeOf(reading);
    } else if (!stale) {
      force = reading.touch === 0 ? "0 N" : "no reading";
      location = reading.touch === 0 ? "not touched" : "";
    }
    setText(this.force, force);
    setText(this.location, location);
    setText(this.flags, stale ? "" : reading.flags);
    this.flags.title = this.flags.textContent;
    this.flags.classList.toggle("warning", !stale && reading.doubtful);
    const snr = stale || reading.snr === null ? "–" : `${reading.snr.toFixed(1)} dB`;
    setText(this.snr, `SNR ${snr}`);
    const clock = health.clock_offset_ppm;
    setText(this.clock, typeof clock === "number" ? `clock ${signed(clock)} ppm` : "");
    const share = stale || reading.interference === null ? null : reading.interference;
    setText(this.interference, `interference ${share === null ? "–" : `${Math.round(100 * share)} %`}`);
    setText(this.age, Number.isFinite(ageS) ? `last reading ${ageText(ageS)} ago` : "");
    const silence = health.received === false && health.age_s !== null ? "not received" : "";
    setText(this.problem, health.reference_problem || silence);
  }

  lineParts(press, lengthMm, width, height) {
    const left = 12, right = width - 12, labelled = height > 45;
    const ground = labelled ? height - 17 : height - 4;
    const x = (mm) => left + Math.min(Math.max(mm / lengthMm, 0), 1) * (right - left);
    const at = press !== null && press.location !== null ? x(press.location) : null;
    const color = press !== null && press.doubtful ? WARNING : this.color;
    const parts = [];
    if (at !== null && press.locationStd !== null) {
      const [from, to] = [-2, 2].map((factor) => x(press.location + factor * press.locationStd));
      parts.push(shape("rect", {
        x: from, y: 0, width: Math.max(1, to - from), height: ground, fill: color, opacity: 0.2,
      }));
    }
    parts.push(shape("rect", { x: left, y: ground - 2, width: right - left, height: 3, class: "ground" }));
    parts.push(shape("path", {
      d: beam(left, right, ground, at), class: "beam", "stroke-width": 5,
    }));
    if (labelled) parts.push(...scale(x, ground, lengthMm, width));
    if (at !== null) parts.push(...arrow(press, at, ground, color));
    return parts;
  }
}

function isStale(reading, ageS) {
  return reading === null || !(ageS <= STALE_S);
}

function signed(value) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(1)}`;
}

function ageText(ageS) {
  if (ageS < 10) return `${ageS.toFixed(1)} s`;
  return ageS < 120 ? `${Math.round(ageS)} s` : `${Math.round(ageS / 60)} min`;
}

function shape(tag, attributes, text) {
  const made = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

// A picture of a bent beam, not its mechanics.
function beam(left, right, ground, at) {
  const top = ground - 13, low = ground - 5, reach = 0.14 * (right - left);
  if (at === null) return `M${left} ${top}H${right}`;
  const from = Math.max(left, at - reach), to = Math.min(right, at + reach);
  const [down, up] = [(from + at) / 2, (at + to) / 2];
  return `M${left} ${top}H${from}C${down} ${top} ${down} ${low} ${at} ${low}` +
    `C${up} ${low} ${up} ${top} ${to} ${top}H${right}`;
}

function scale(x, ground, lengthMm, width) {
  const wanted = (width > 420 ? 10 : 20) * Math.max(1, Math.ceil(lengthMm / 100));
  const parts = [];
  for (let mark = 0; mark <= lengthMm + 1e-9; mark += wanted) {
    const last = mark + wanted > lengthMm + 1e-9;
    parts.push(shape("path", { d: `M${x(mark)} ${ground + 1}v4`, class: "tick" }));
    const anchor = mark === 0 ? "start" : last && x(mark) > width - 30 ? "end" : "middle";
    const edge = { start: -6, middle: 0, end: 12 }[anchor];
    parts.push(shape("text", {
      x: x(mark) + edge, y: ground + 15, "font-size": 11, class: "label", "text-anchor": anchor,
    }, last ? `${mark} mm` : String(mark)));
  }
  return parts;
}

// The length is the force; dashed while the force is not known.
function arrow(press, at, ground, color) {
  const tip = ground - 3, longest = tip - 2;
  const span = Math.max(FORCE_SPAN_N, press.force ?? 0);
  const part = press.force === null ? 1 : Math.max(press.force, 0) / span;
  const length = Math.max(12, part * longest);
  const stem = { d: `M${at} ${tip - length}V${tip - 7}`, stroke: color, "stroke-width": 3 };
  if (press.force === null) stem["stroke-dasharray"] = "3 3";
  return [
    shape("path", stem),
    shape("path", { d: `M${at} ${tip}l-5 -9h10z`, fill: color }),
  ];
}
