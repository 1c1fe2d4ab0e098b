// SPDX-License-Identifier: GPL-3.0-or-later
// Which time the plots show, and the values under the pointer.
"use strict";

const NEAR_S = 1; // of the pointer: a reading that is further away is not its value

class TimeView {
  // `page`: of page.js; `onChange`: draws what another time shows.
  constructor(page, onChange) {
    this.page = page;
    this.onChange = onChange;
    this.spanS = 30; // null: all
    this.end = null; // null: the newest reading
    this.zoom = null;
  }

  // Start and end of the time axis.
  get range() {
    if (this.zoom !== null) return this.zoom;
    const { oldest, newest } = this.page;
    const end = this.end ?? newest;
    const start = this.spanS === null ? oldest : Math.max(0, end - this.spanS);
    return { start, end: Math.max(end, start + Math.min(this.spanS ?? LEAST_SPAN_S, LEAST_SPAN_S)) };
  }

  // Time of the readings whose numbers are shown; null: the newest ones.
  get cursor() {
    return this.zoom === null ? this.end : this.zoom.end;
  }

  set(change) {
    Object.assign(this, change);
    this.draw();
    this.onChange();
  }

  draw() {
    const { oldest, newest } = this.page;
    const stopped = this.cursor !== null;
    const pause = byId("pause");
    setText(pause, stopped ? "Go on" : "Pause");
    pause.setAttribute("aria-pressed", String(stopped));
    const scrub = byId("scrub");
    scrub.min = oldest;
    scrub.max = newest;
    scrub.value = this.cursor ?? newest;
    setText(byId("cursor"), stopped ? `at ${this.cursor.toFixed(2)} s` : "");
  }

  listen() {
    byId("span").onchange = (event) => {
      this.set({ spanS: event.target.value === "" ? null : Number(event.target.value), zoom: null });
    };
    byId("pause").onclick = () => {
      this.set(this.cursor === null ? { end: this.page.newest } : { end: null, zoom: null });
    };
    byId("scrub").oninput = (event) => {
      const end = Number(event.target.value);
      this.set({ end: end >= this.page.newest ? null : end, zoom: null });
    };
    const plots = byId("plots");
    let from = null;
    plots.onpointerdown = (event) => {
      if (event.pointerType === "mouse") from = { x: event.clientX, at: this.page.plots.timeAt(event.clientX) };
      else this.hover(event); // a finger scrolls
    };
    plots.onpointermove = (event) => this.hover(event);
    plots.onpointerleave = () => this.leave();
    plots.onpointerup = (event) => {
      const at = this.page.plots.timeAt(event.clientX);
      if (from !== null && from.at !== null && at !== null && Math.abs(event.clientX - from.x) > DRAG_PX) {
        this.set({ zoom: { start: Math.min(at, from.at), end: Math.max(at, from.at) } });
      }
      from = null;
    };
    plots.ondblclick = () => this.set({ zoom: null });
  }

  leave() {
    byId("hover").hidden = true;
  }

  hover(event) {
    const at = this.page.plots.timeAt(event.clientX);
    if (at === null) return this.leave();
    const lines = [`${at.toFixed(2)} s`];
    for (const [sensor, track] of this.page.tracks) {
      const reading = track.view.shown ? nearest(track.readings, at) : null;
      if (reading !== null) lines.push(`${sensor}: ${valuesOf(reading)}`);
    }
    const box = byId("hover");
    setText(box, lines.join("\n"));
    box.hidden = false;
    const frame = byId("plots").getBoundingClientRect();
    const x = event.clientX - frame.left;
    const left = x > frame.width / 2 ? x - box.offsetWidth - 12 : x + 12;
    box.style.left = `${Math.max(0, left)}px`;
    box.style.top = `${Math.max(0, event.clientY - frame.top - box.offsetHeight - 8)}px`;
  }
}

function nearest(readings, time) {
  const after = firstAfter(readings, time);
  const near = readings.slice(Math.max(0, after - 1), after + 1)
    .sort((one, other) => Math.abs(one.time - time) - Math.abs(other.time - time))[0];
  return near !== undefined && Math.abs(near.time - time) < NEAR_S ? near : null;
}

// A reading in words, with its flags.
function valuesOf(reading) {
  const values = reading.touch === 1
    ? `${withSpread(reading.force, reading.forceStd, 2, "N")}, ${placeOf(reading)}`
    : reading.touch === 0 ? "not touched" : "no reading";
  return reading.flags ? `${values} (${reading.flags})` : values;
}
