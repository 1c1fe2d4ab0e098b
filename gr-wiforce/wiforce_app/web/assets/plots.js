// SPDX-License-Identifier: GPL-3.0-or-later
// Fills the plots that wiforce_app/web/server.py describes.
"use strict";

// The axes show at least this much, so that noise of an untouched sensor does not fill them.
const LEAST_FORCE_N = 1, LEAST_SPAN_S = 5;
// Beyond either end of an axis, so that a line on it is whole.
const MARGIN = 0.04;
const LOWEST_PX = 150, HIGHEST_PX = 420;
const STRIP_PX = 14, STRIP_ROW_PX = 7, KEY_PX = 64;
const RIGHT_PX = 10; // as in server.py
const DRAG_PX = 8; // of a zoom; less is a click
const QUANTITIES = {
  force: { value: (r) => forceOf(r), std: (r) => (r.touch === 1 ? r.forceStd : null) },
  location: {
    value: (r) => (r.touch === 1 ? r.location : null),
    std: (r) => (r.touch === 1 ? r.locationStd : null),
  },
};

// An untouched sensor carries no force, whether or not the file has a number.
function forceOf(reading) {
  return reading.touch === 0 ? 0 : reading.touch === 1 ? reading.force : null;
}

// Index of the first reading that is later than a time; readings are in order of time.
function firstAfter(readings, time) {
  let low = 0, high = readings.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (readings[middle].time > time) high = middle;
    else low = middle + 1;
  }
  return low;
}

class Plots {
  constructor() {
    this.models = null;
    this.shown = { start: 0, end: 1 };
    this.rows = 1;
  }

  async embed(item) {
    await Bokeh.embed.embed_item(item, "plots");
    const plotted = Bokeh.documents[Bokeh.documents.length - 1];
    this.models = (name) => plotted.get_model_by_name(name);
  }

  // `tracks` holds the readings of each sensor that is shown, with its colour and dash; `start` and
  // `end` are those of the time axis.
  draw(tracks, start, end, lengthMm) {
    if (this.models === null) return;
    const seen = tracks.map((track) => {
      const from = Math.max(0, firstAfter(track.readings, start) - 1);
      return { ...track, readings: track.readings.slice(from, firstAfter(track.readings, end)) };
    });
    let largest = LEAST_FORCE_N;
    for (const track of seen) {
      for (const reading of track.readings) {
        const force = reading.doubtful ? null : forceOf(reading);
        if (force !== null && force > largest) largest = force;
      }
    }
    const tops = { force: 1.15 * largest, location: lengthMm };
    this.shown = { start, end: Math.max(end, start + LEAST_SPAN_S / 100) };
    this.setRange("time", this.shown.start, this.shown.end);
    for (const [name, quantity] of Object.entries(QUANTITIES)) {
      this.setRange(`${name}-range`, -MARGIN * tops[name], (1 + MARGIN) * tops[name]);
      const filled = seriesOf(seen, quantity);
      for (const [kind, data] of Object.entries(filled)) this.models(`${name}-${kind}`).data = data;
    }
    this.setRange("strip-range", -seen.length + 0.5, 0.5);
    this.models("strip-marks").data = marksOf(seen);
    if (this.rows !== seen.length) {
      this.rows = seen.length;
      this.fit();
    }
  }

  // The plots fill what the window has below them.
  fit() {
    const strip = STRIP_PX + STRIP_ROW_PX * Math.max(1, this.rows);
    const place = byId("plots").getBoundingClientRect();
    const beside = window.innerWidth > 760;
    const room = beside ? (window.innerHeight - place.top - window.scrollY - strip - KEY_PX) / 2 : 0;
    const height = Math.round(Math.min(HIGHEST_PX, Math.max(beside ? LOWEST_PX : 200, room)));
    for (const name of ["force", "location"]) this.models(`${name}-plot`).height = height;
    this.models("strip-plot").height = strip;
  }

  // The colours of the page, which follow the system's light or dark scheme.
  paint() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(`--${name}`).trim();
    for (const name of ["strip", "force", "location"]) {
      const plot = this.models(`${name}-plot`);
      plot.background_fill_color = plot.border_fill_color = of("paper");
      plot.outline_line_color = of("rule");
      for (const axis of [...plot.below, ...plot.left].filter((each) => "axis_label" in each)) {
        axis.axis_label_text_color = axis.major_label_text_color = of("ink");
        axis.axis_line_color = axis.major_tick_line_color = of("faint");
      }
      for (const grid of plot.center) if (grid.grid_line_color) grid.grid_line_color = of("rule");
    }
  }

  // Time at a place of the pointer; null beside the axis.
  timeAt(clientX) {
    const { inner_width: width, outer_width: outer } = this.models("force-plot");
    const left = byId("plots").getBoundingClientRect().left;
    const part = (clientX - left - (outer - RIGHT_PX - width)) / width;
    if (!(part >= 0 && part <= 1)) return null;
    return this.shown.start + part * (this.shown.end - this.shown.start);
  }

  setRange(name, start, end) {
    const range = this.models(name);
    if (range.start !== start || range.end !== end) range.setv({ start, end });
  }
}

// The data of one plot: readings without flags as lines. Doubtful ones interrupt them.
function seriesOf(tracks, quantity) {
  const lines = { xs: [], ys: [], color: [], dash: [] };
  const bands = { xs: [], ys: [], color: [] };
  const points = { x: [], y: [], color: [] };
  for (const { readings, color, dash } of tracks) {
    let run = [];
    const finish = () => {
      if (run.length === 1) {
        points.x.push(run[0].time);
        points.y.push(quantity.value(run[0]));
        points.color.push(color);
      } else if (run.length > 1) {
        lines.xs.push(run.map((r) => r.time));
        lines.ys.push(run.map(quantity.value));
        lines.color.push(color);
        lines.dash.push(dash);
        addBand(bands, run, quantity, color);
      }
      run = [];
    };
    for (const reading of readings) {
      if (quantity.value(reading) === null || reading.doubtful) finish();
      else run.push(reading);
    }
    finish();
  }
  return { lines, bands, points };
}

function marksOf(tracks) {
  const marks = { x: [], y: [], color: [] };
  tracks.forEach(({ readings, color }, row) => {
    for (const reading of readings) {
      if (!reading.doubtful) continue;
      marks.x.push(reading.time);
      marks.y.push(-row);
      marks.color.push(color);
    }
  });
  return marks;
}

function addBand(bands, run, quantity, color) {
  const bounds = (side) => run.map((r) => quantity.value(r) + side * 2 * (quantity.std(r) ?? 0));
  if (!run.some((r) => quantity.std(r))) return;
  const times = run.map((r) => r.time);
  bands.xs.push([...times, ...times.slice().reverse()]);
  bands.ys.push([...bounds(1), ...bounds(-1).reverse()]);
  bands.color.push(color);
}
