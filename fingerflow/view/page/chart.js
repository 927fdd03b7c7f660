// Curves in panels, one a unit, above a common axis, with a cursor at the frame.
import { CanvasPen, SvgPen } from "./pens.js";
import { LINES } from "./colours.js";

const LEFT = 62, RIGHT = 14, TOP = 24, GAP = 34, PANEL = 132, BOTTOM = 40;
const GRID = "#e4e9ee", INK = "#1c2733", SOFT = "#5b6b7b";

function ticks(low, high, most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find(k => k * power >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(+(k * step).toPrecision(12));
  return found;
}

const number = value => +value.toPrecision(5) + "";

function extent(lists) {
  let low = Infinity, high = -Infinity;
  for (const values of lists) for (const v of values) if (Number.isFinite(v)) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (!(low <= high)) return [0, 1];
  return low === high ? [low - Math.abs(low || 1) / 2, high + Math.abs(high || 1) / 2] : [low, high];
}

export class Chart {
  // `chosen(frame)` is called where somebody clicks or drags in it.
  constructor(canvas, chosen) {
    this.canvas = canvas;
    this.curves = [];
    this.frame = 0;
    this.still = document.createElement("canvas");
    const pick = event => {
      if (event.type === "pointermove" && !event.buttons) return;
      const frame = this.nearest(event.offsetX);
      if (frame !== null) chosen(frame);
    };
    canvas.addEventListener("pointerdown", pick);
    canvas.addEventListener("pointermove", pick);
    new ResizeObserver(() => this.redraw()).observe(canvas.parentElement);
  }
  // x: { label, values }; curves: [{ label, units, values, dashed }], each value a frame's.
  show(x, curves) {
    this.x = x;
    this.curves = curves;
    this.redraw();
  }
  get height() { return TOP + this.units.length * (PANEL + GAP) - GAP + BOTTOM; }
  get units() { return [...new Set(this.curves.map(one => one.units))]; }
  redraw() {
    const width = this.canvas.parentElement.clientWidth - 24;
    if (!this.curves.length || width < 50) {
      this.canvas.style.height = "0";
      return;
    }
    this.width = width;
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${this.height}px`;
    this.xRange = extent([this.x.values]);
    this.draw(new CanvasPen(this.still, width, this.height));
    this.cursor(this.frame);
  }
  cursor(frame) {
    this.frame = frame;
    if (!this.curves.length || !this.width) return;
    const pen = new CanvasPen(this.canvas, this.width, this.height), ratio = this.still.width / this.width;
    pen.bitmap(this.still, [1 / ratio, 0, 0, 1 / ratio, 0, 0]);
    this.drawCursor(pen);
  }
  at(value) {
    const [low, high] = this.xRange;
    return LEFT + (this.width - LEFT - RIGHT) * (value - low) / (high - low);
  }
  nearest(x) {
    let best = null, least = Infinity;
    if (this.x) this.x.values.forEach((value, k) => {
      const off = Math.abs(this.at(value) - x);
      if (off < least) { least = off; best = k; }
    });
    return best;
  }
  panels() {
    return this.units.map((units, k) => {
      const curves = this.curves.filter(one => one.units === units), [low, high] = extent(curves.map(one => one.values));
      const margin = (high - low) * 0.06, top = TOP + k * (PANEL + GAP);
      const range = [low - margin, high + margin];
      return { units, curves, top, range, y: v => top + PANEL * (1 - (v - range[0]) / (range[1] - range[0])) };
    });
  }
  draw(pen) {
    const right = this.width - RIGHT;
    for (const { units, curves, top, range, y } of this.panels()) {
      for (const value of ticks(...range, 4)) {
        pen.line([[LEFT, y(value)], [right, y(value)]], { stroke: value === 0 ? "#9aa7b4" : GRID });
        pen.text(LEFT - 6, y(value) + 4, number(value), { align: "right", fill: SOFT, size: 11 });
      }
      for (const value of ticks(...this.xRange, Math.max(2, this.width / 110))) {
        pen.line([[this.at(value), top], [this.at(value), top + PANEL]], { stroke: GRID });
      }
      pen.rect(LEFT, top, right - LEFT, PANEL, { stroke: "#c3ccd5" });
      pen.text(14, top + PANEL / 2, units || "no unit", {
        align: "center", turn: -Math.PI / 2, fill: SOFT, size: 11 });
      if (!curves.some(one => one.values.some(Number.isFinite))) {
        pen.text((LEFT + right) / 2, top + PANEL / 2, "NaN in all frames: see the warnings of the result", { align: "center", fill: SOFT });
      }
      let place = LEFT;
      for (const one of curves) {
        const colour = LINES[this.curves.indexOf(one) % LINES.length];
        const points = Array.from(one.values, (v, k) => [this.at(this.x.values[k]), y(v)]);
        pen.line(points, { stroke: colour, width: 1.8, dash: one.dashed ? [5, 3] : [] });
        if (place + 18 + one.label.length * 6.2 <= right || place === LEFT) {
          pen.line([[place, top - 8], [place + 14, top - 8]], { stroke: colour, width: 3, dash: one.dashed ? [5, 3] : [] });
          pen.text(place + 18, top - 4, one.label, { size: 11.5, fill: INK });
          place += 32 + one.label.length * 6.2;
        }
      }
    }
    const bottom = this.height - BOTTOM;
    for (const value of ticks(...this.xRange, Math.max(2, this.width / 110))) {
      pen.text(this.at(value), bottom + 16, number(value), { align: "center", fill: SOFT, size: 11 });
    }
    pen.text((LEFT + right) / 2, bottom + 33, this.x.label, { align: "center", size: 12 });
  }
  drawCursor(pen) {
    const here = this.at(this.x.values[this.frame]);
    for (const { curves, top, y } of this.panels()) {
      if (!Number.isFinite(here)) continue;
      pen.line([[here, top], [here, top + PANEL]], { stroke: INK, width: 1, dash: [3, 3] });
      for (const one of curves) {
        const value = one.values[this.frame];
        if (Number.isFinite(value)) pen.circle(here, y(value), 3.5, { fill: INK, stroke: "#fff" });
      }
    }
  }
  svg() {
    const pen = new SvgPen(this.width, this.height);
    this.draw(pen);
    this.drawCursor(pen);
    return pen.blob();
  }
}
