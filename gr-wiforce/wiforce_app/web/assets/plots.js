// SPDX-License-Identifier: GPL-3.0-or-later
// Fills the plots that wiforce_app/web/page.py describes.
"use strict";

// The axes show at least this much, so that noise of an untouched sensor does not fill them.
const LEAST_FORCE_N = 1;
// Beyond either end of an axis, so that a marker on it is whole.
const MARGIN = 0.04;
const LOWEST_PX = 170, HIGHEST_PX = 420;
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

class Plots {
  constructor(historyS) {
    this.historyS = historyS;
    this.models = null;
  }

  async embed(item) {
    await Bokeh.embed.embed_item(item, "plots");
    const plotted = Bokeh.documents[Bokeh.documents.length - 1];
    this.models = (name) => plotted.get_model_by_name(name);
  }

  // `tracks` holds the readings of each sensor that is shown, with its colour and dash.
  draw(tracks, newest, lengthMm) {
    if (this.models === null) return;
    let largest = LEAST_FORCE_N;
    for (const track of tracks) {
      for (const reading of track.readings) {
        const force = reading.doubtful ? null : forceOf(reading);
        if (force !== null && force > largest) largest = force;
      }
    }
    const tops = { force: 1.15 * largest, location: lengthMm };
    const start = Math.max(0, newest - this.historyS);
    this.setRange("time", start, Math.max(newest, start + Math.min(this.historyS, 5)));
    for (const [name, quantity] of Object.entries(QUANTITIES)) {
      this.setRange(`${name}-range`, -MARGIN * tops[name], (1 + MARGIN) * tops[name]);
      const filled = seriesOf(tracks, quantity, tops[name]);
      for (const [kind, data] of Object.entries(filled)) this.models(`${name}-${kind}`).data = data;
    }
  }

  // Both plots fill what the window has below them.
  fit() {
    const place = document.getElementById("plots").getBoundingClientRect();
    const beside = window.innerWidth > 760;
    const room = beside ? (window.innerHeight - place.top - 50) / 2 : 0;
    const height = Math.round(Math.min(HIGHEST_PX, Math.max(beside ? LOWEST_PX : 200, room)));
    for (const name of ["force", "location"]) this.models(`${name}-plot`).height = height;
  }

  setRange(name, start, end) {
    const range = this.models(name);
    if (range.start !== start || range.end !== end) range.setv({ start, end });
  }
}

// The data of one plot: readings without flags as lines, doubtful ones as hollow markers that stay
// within the axis.
function seriesOf(tracks, quantity, top) {
  const lines = { xs: [], ys: [], color: [], dash: [] };
  const bands = { xs: [], ys: [], color: [] };
  const points = { x: [], y: [], color: [] };
  const doubtful = { x: [], y: [], color: [], marker: [] };
  const whiskers = { x: [], low: [], high: [], color: [] };
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
      const value = quantity.value(reading);
      if (value === null) {
        finish();
      } else if (!reading.doubtful) {
        run.push(reading);
      } else {
        finish();
        const shown = Math.min(Math.max(value, 0), top);
        doubtful.x.push(reading.time);
        doubtful.y.push(shown);
        doubtful.color.push(color);
        doubtful.marker.push(value > top ? "triangle" : value < 0 ? "inverted_triangle" : "circle");
        const spread = 2 * (quantity.std(reading) ?? 0);
        whiskers.x.push(reading.time);
        whiskers.low.push(Math.max(0, Math.min(value - spread, top)));
        whiskers.high.push(Math.max(0, Math.min(value + spread, top)));
        whiskers.color.push(color);
      }
    }
    finish();
  }
  return { lines, bands, points, doubtful, whiskers };
}

function addBand(bands, run, quantity, color) {
  const bounds = (side) => run.map((r) => quantity.value(r) + side * 2 * (quantity.std(r) ?? 0));
  if (!run.some((r) => quantity.std(r))) return;
  const times = run.map((r) => r.time);
  bands.xs.push([...times, ...times.slice().reverse()]);
  bands.ys.push([...bounds(1), ...bounds(-1).reverse()]);
  bands.color.push(color);
}
