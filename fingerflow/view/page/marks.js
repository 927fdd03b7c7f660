// What is drawn over a frame, in both views: matrices are [[a, b, x], [c, d, y]], from topography to contact pixels.
import { STATUS, UNKNOWN } from "./colours.js";

export const VIEW = { contact: "#ffb000", camera: "#ffb000", topography: "#4cc9f0" };
const LINE = 0.9;  // length of a direction, of the side of a square of the triangle's area
const ELLIPSE = "#00d5ff", ARROW = "#ffd54f", STUCK = "#ff4fd8", LOST = "#d55e00";

export function inverse([[a, b, x], [c, d, y]]) {
  const det = a * d - b * c;
  return [[d / det, -b / det, (b * y - d * x) / det], [-c / det, a / det, (c * x - a * y) / det]];
}
const applied = ([[a, b, x], [c, d, y]], px, py) => [a * px + b * py + x, c * px + d * py + y];

// Places in mm on the glass, or px of the topography view, to pixels of the frame, one map a view.
export function placesIn(views, mmPerPx, matrix) {
  const back = inverse(matrix), maps = [];
  const single = views.camera || !views.topography || same(views.contact, views.topography);
  const contact = views.contact || views.camera;
  if (contact) maps.push({ name: "contact", view: contact,
    of: (x, y) => [x / mmPerPx + contact.columns[0], y / mmPerPx + contact.rows[0]] });
  if (!single) maps.push({ name: "topography", view: views.topography, of: (x, y) => {
    const [px, py] = applied(back, x / mmPerPx, y / mmPerPx);
    return [px + views.topography.columns[0], py + views.topography.rows[0]];
  } });
  return maps;
}
const same = (a, b) => a && b && a.rows + "" === b.rows + "" && a.columns + "" === b.columns + "";

export function drawEllipse(pen, at, maps, centre, axes, angle) {
  if (!centre || !axes || ![...centre, ...axes, angle].every(Number.isFinite)) return;
  const outline = Array.from({ length: 96 }, (_, k) => {
    const turn = k / 96 * 2 * Math.PI, a = axes[0] * Math.cos(turn), b = axes[1] * Math.sin(turn);
    return [centre[0] + a * Math.cos(angle) - b * Math.sin(angle), centre[1] + a * Math.sin(angle) + b * Math.cos(angle)];
  });
  for (const { of } of maps) {
    pen.line(outline.map(([x, y]) => at(...of(x, y))), { stroke: "#0008", width: 4, closed: true });
    pen.line(outline.map(([x, y]) => at(...of(x, y))), { stroke: ELLIPSE, width: 2, closed: true });
  }
}

export function drawViews(pen, at, views, handles) {
  for (const [name, view] of Object.entries(views)) {
    const [left, top] = at(view.columns[0] - 0.5, view.rows[0] - 0.5), [right, bottom] = at(view.columns[1] - 0.5, view.rows[1] - 0.5);
    pen.rect(left + 1, top + 1, right - left - 2, bottom - top - 2, { stroke: VIEW[name], width: 2 });
    pen.text(left + 8, top + 20, `${name} view`, { fill: VIEW[name], size: 13, halo: "#000a" });
    if (handles) for (const [x, y] of [[left, top], [right, top], [left, bottom], [right, bottom]]) {
      pen.rect(x - 5, y - 5, 10, 10, { fill: VIEW[name], stroke: "#000" });
    }
  }
}

// Points (N, 2) of which each has a value to colour, or null for one that is not known.
export function drawPoints(pen, at, of, positions, colourOf, { radius = 3, chosen = new Set() } = {}) {
  const count = positions.length / 2;
  for (let i = 0; i < count; i++) {
    const x = positions[2 * i], y = positions[2 * i + 1];
    if (!Number.isFinite(x)) continue;
    const colour = colourOf(i);
    const [px, py] = at(...of(x, y));
    if (chosen.has(i)) pen.circle(px, py, radius + 4, { stroke: "#000", width: 4 });
    if (chosen.has(i)) pen.circle(px, py, radius + 4, { stroke: "#fff", width: 2 });
    if (colour) pen.circle(px, py, radius, { fill: colour, stroke: "#0006", width: 0.6 });
    else pen.circle(px, py, radius * 0.8, { stroke: UNKNOWN, width: 1.2 });
  }
}

export function drawLost(pen, at, of, last) {
  for (const [x, y] of last) {
    const [px, py] = at(...of(x, y));
    pen.line([[px - 3, py - 3], [px + 3, py + 3]], { stroke: LOST, width: 1.6 });
    pen.line([[px + 3, py - 3], [px - 3, py + 3]], { stroke: LOST, width: 1.6 });
  }
}

export function drawArrows(pen, at, of, positions, displacement, times) {
  for (let i = 0; i < positions.length; i += 2) {
    const [x, y, u, v] = [positions[i], positions[i + 1], displacement[i], displacement[i + 1]];
    if (!Number.isFinite(x + y + u + v)) continue;
    pen.line([at(...of(x, y)), at(...of(x + times * u, y + times * v))], { stroke: ARROW, width: 1.2 });
  }
}

export function drawTriangles(pen, at, of, positions, triangles, values, colour, angles) {
  for (let k = 0; k * 3 < triangles.length; k++) {
    const fill = colour(values[k]);
    if (!fill) continue;
    const corners = [0, 1, 2].map(j => 2 * triangles[3 * k + j]).map(j => at(...of(positions[j], positions[j + 1])));
    if (!corners.flat().every(Number.isFinite)) continue;
    pen.line(corners, { fill, closed: true });
    if (angles && Number.isFinite(angles[k])) {
      const mean = c => [0, 1, 2].reduce((sum, j) => sum + positions[2 * triangles[3 * k + j] + c], 0) / 3;
      const [mx, my] = [mean(0), mean(1)], step = 0.01;  // mm, along the direction on the glass
      const [x, y] = at(...of(mx, my)), [tx, ty] = at(...of(mx + step * Math.cos(angles[k]), my + step * Math.sin(angles[k])));
      const area = Math.abs((corners[1][0] - corners[0][0]) * (corners[2][1] - corners[0][1]) -
        (corners[2][0] - corners[0][0]) * (corners[1][1] - corners[0][1]));
      const part = LINE * Math.sqrt(area) / 2 / Math.hypot(tx - x, ty - y), u = (tx - x) * part, v = (ty - y) * part;
      pen.line([[x - u, y - v], [x + u, y + v]], { stroke: "#111", width: 1.1 });
    }
  }
}

// Cells that are 1, by their outer edges.
export function drawCells(pen, at, of, cells, [rows, columns], { cell_mm: side, first_cell_mm: first }) {
  const is = (r, c) => r >= 0 && c >= 0 && r < rows && c < columns && cells[r * columns + c] > 0;
  const edge = (r, c) => at(...of(first + (c - 0.5) * side, first + (r - 0.5) * side));
  for (let r = 0; r < rows; r++) for (let c = 0; c < columns; c++) if (is(r, c)) {
    if (!is(r - 1, c)) pen.line([edge(r, c), edge(r, c + 1)], { stroke: STUCK, width: 2 });
    if (!is(r + 1, c)) pen.line([edge(r + 1, c), edge(r + 1, c + 1)], { stroke: STUCK, width: 2 });
    if (!is(r, c - 1)) pen.line([edge(r, c), edge(r + 1, c)], { stroke: STUCK, width: 2 });
    if (!is(r, c + 1)) pen.line([edge(r, c + 1), edge(r + 1, c + 1)], { stroke: STUCK, width: 2 });
  }
}

export const statusColour = status => STATUS[status % STATUS.length];

export function inside(outline, x, y) {
  let odd = false;
  for (let i = 0, j = outline.length - 1; i < outline.length; j = i++) {
    const [ax, ay] = outline[i], [bx, by] = outline[j];
    if (ay > y !== by > y && x < (bx - ax) * (y - ay) / (by - ay) + ax) odd = !odd;
  }
  return odd;
}
export const MARKS = { ellipse: ELLIPSE, arrow: ARROW, stuck: STUCK, lost: LOST, mask: "#f0b04a" };
