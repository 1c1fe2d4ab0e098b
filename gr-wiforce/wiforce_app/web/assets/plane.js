// SPDX-License-Identifier: GPL-3.0-or-later
// A surface from above: its strips, the press as a dot whose area is the force, and the ellipse of
// two standard deviations of x and y.
"use strict";

const LARGEST_DOT_PX = 16, LEAST_DOT_PX = 2.5;
const MOST_SPANS = 4; // forces beyond so many spans have no larger dot

function planeParts(press, plane, width, height, color) {
  const [x0, x1] = plane.x, [y0, y1] = plane.y;
  const room = { left: 12, right: 12, top: 4, bottom: height > 60 ? 17 : 4 };
  const scale = Math.min(
    (width - room.left - room.right) / (x1 - x0), (height - room.top - room.bottom) / (y1 - y0));
  const left = (width - scale * (x1 - x0)) / 2;
  const x = (mm) => left + scale * (mm - x0), y = (mm) => room.top + scale * (y1 - mm);
  const parts = [shape("rect", {
    x: x(x0), y: y(y1), width: scale * (x1 - x0), height: scale * (y1 - y0),
    class: "edge",
  })];
  for (const strip of plane.strips) {
    const [from, to] = strip.x_mm;
    parts.push(shape("path", {
      d: `M${x(from)} ${y(strip.y_mm)}H${x(to)}`, class: "beam", "stroke-width": 5,
    }));
  }
  if (room.bottom > 4) {
    const label = `${Math.round(x1 - x0)} × ${Math.round(y1 - y0)} mm`;
    parts.push(shape("text", {
      x: x(x0), y: y(y0) + 13, "font-size": 11, class: "label",
    }, label));
  }
  if (press !== null && press.location !== null && press.y !== null) {
    parts.push(...pressOnPlane(press, x(press.location), y(press.y), scale, color));
  }
  return parts;
}

function pressOnPlane(press, atX, atY, scale, own) {
  const color = press.doubtful ? WARNING : own;
  const part = press.force === null ? 1 : Math.max(press.force, 0) / FORCE_SPAN_N;
  const radius = Math.max(LEAST_DOT_PX, LARGEST_DOT_PX * Math.sqrt(Math.min(part, MOST_SPANS)));
  const dot = { class: "press", cx: atX, cy: atY, r: radius, stroke: color, "stroke-width": 2 };
  if (press.doubtful) Object.assign(dot, { fill: "none", "stroke-dasharray": "4 3" });
  else Object.assign(dot, { fill: color, "fill-opacity": 0.5 });
  const parts = [shape("circle", dot)];
  const axes = ellipseOf(press);
  if (axes !== null) {
    parts.push(shape("ellipse", {
      class: "spread", rx: Math.max(1, scale * axes.major), ry: Math.max(1, scale * axes.minor),
      transform: `translate(${atX} ${atY}) rotate(${-axes.angle})`,
      "stroke-width": 1.5,
    }));
  }
  return parts;
}

// Half axes in mm of two standard deviations, and the angle of the first one, counterclockwise.
function ellipseOf(press) {
  if (press.locationStd === null || press.yStd === null) return null;
  const a = press.locationStd ** 2, c = press.yStd ** 2, b = press.covXY ?? 0;
  const middle = (a + c) / 2, apart = Math.hypot((a - c) / 2, b);
  return {
    major: 2 * Math.sqrt(middle + apart),
    minor: 2 * Math.sqrt(Math.max(0, middle - apart)),
    angle: (Math.atan2(2 * b, a - c) / 2) * 180 / Math.PI,
  };
}
