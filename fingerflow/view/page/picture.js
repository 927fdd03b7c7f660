// A frame with what is drawn over it. Places are pixels of the frame, whole numbers the middles of pixels.
import { CanvasPen, SvgPen } from "./pens.js";

const grey = Uint32Array.from({ length: 256 }, (_, v) => (255 << 24 | v << 16 | v << 8 | v) >>> 0);
const touching = Uint32Array.from({ length: 256 }, (_, v) => {  // orange over grey
  const [r, g, b] = [0.45 * v + 0.55 * 240, 0.45 * v + 0.55 * 150, 0.45 * v].map(Math.round);
  return (255 << 24 | b << 16 | g << 8 | r) >>> 0;
});

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.bitmap = document.createElement("canvas");
    this.layers = () => {};
    this.shape = [1, 1];
    this.zoom = null;
    this.gestures = null;  // { down(x, y, event) -> true where it takes the drag, move(x, y), up(), click(x, y), hover }
    new ResizeObserver(() => this.redraw()).observe(canvas.parentElement);
    canvas.addEventListener("wheel", event => this.wheel(event), { passive: false });
    canvas.addEventListener("dblclick", () => { this.zoom = null; this.redraw(); });
    canvas.addEventListener("pointerdown", event => this.down(event));
    canvas.addEventListener("pointermove", event => this.hover(event));
  }
  // found: an answer with `every`, `shape` and arrays `picture` and `mask`; `contact` is where the mask lies.
  show(found, contact) {
    const { picture, mask } = found.arrays;
    if (found.shape) this.shape = found.shape;
    if (picture) {
      const [rows, columns] = picture.shape, every = found.every, values = picture.values;
      if (this.bitmap.width !== columns || this.bitmap.height !== rows) {
        this.bitmap.width = columns;
        this.bitmap.height = rows;
        this.image = new ImageData(columns, rows);
      }
      const out = new Uint32Array(this.image.data.buffer);
      for (let i = 0; i < values.length; i++) out[i] = grey[values[i]];
      if (mask && contact) {
        const [height, width] = mask.shape, top = contact.rows[0], left = contact.columns[0];
        for (let y = Math.ceil(top / every); y * every < top + height && y < rows; y++) {
          const row = (y * every - top) * width - left;
          for (let x = Math.ceil(left / every); x * every < left + width && x < columns; x++) {
            if (mask.values[row + x * every]) out[y * columns + x] = touching[values[y * columns + x]];
          }
        }
      }
      this.bitmap.getContext("2d").putImageData(this.image, 0, 0);
      this.every = every;
    }
    this.empty = !picture;
    this.redraw();
  }
  fit() {
    const width = this.canvas.parentElement.clientWidth;
    const scale = Math.min(width / this.shape[1], Math.max(260, window.innerHeight * 0.62) / this.shape[0]);
    this.size = [Math.min(width, Math.ceil(this.shape[1] * scale)), Math.ceil(this.shape[0] * scale)];
    return { scale, x: 0, y: 0 };
  }
  redraw() {
    const fitted = this.fit();
    this.view = this.zoom || fitted;
    const [width, height] = this.size;
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.draw(new CanvasPen(this.canvas, width, height));
  }
  draw(pen) {
    const { scale, x, y } = this.view, [width, height] = this.size;
    pen.clip(0, 0, width, height, () => {
      if (!this.empty && this.every) pen.bitmap(this.bitmap, [scale * this.every, 0, 0, scale * this.every, -x * scale, -y * scale]);
      else pen.rect(0, 0, width, height, { fill: "#2b333b" });
      this.layers(pen, (px, py) => [(px + 0.5 - x) * scale, (py + 0.5 - y) * scale], scale);
    });
  }
  place(event) {
    const { scale, x, y } = this.view;
    return [event.offsetX / scale + x - 0.5, event.offsetY / scale + y - 0.5];
  }
  wheel(event) {
    event.preventDefault();
    const { scale, x, y } = this.view, factor = Math.exp(-event.deltaY * 0.0015), least = this.fit().scale;
    const larger = Math.min(Math.max(scale * factor, least), least * 24);
    if (larger === least) this.zoom = null;
    else this.zoom = { scale: larger, x: x + event.offsetX * (1 / scale - 1 / larger), y: y + event.offsetY * (1 / scale - 1 / larger) };
    this.redraw();
  }
  down(event) {
    const canvas = this.canvas, start = this.place(event), from = [event.offsetX, event.offsetY];
    const taken = this.gestures?.down?.(...start, event), { scale, x, y } = this.view, zoomed = this.zoom;
    let moved = false;
    canvas.setPointerCapture(event.pointerId);
    const move = now => {
      if (Math.hypot(now.offsetX - from[0], now.offsetY - from[1]) > 3) moved = true;
      if (taken) this.gestures.move(...this.place(now));
      else if (zoomed && moved) {
        this.zoom = { scale, x: x - (now.offsetX - from[0]) / scale, y: y - (now.offsetY - from[1]) / scale };
        this.redraw();
      }
    };
    const up = now => {
      canvas.removeEventListener("pointermove", move);
      canvas.removeEventListener("pointerup", up);
      canvas.removeEventListener("pointercancel", up);
      if (taken) this.gestures.up(moved);
      else if (!moved) this.gestures?.click?.(...this.place(now));
    };
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
  }
  hover(event) {
    if (!event.buttons) this.canvas.style.cursor = this.gestures?.hover?.(...this.place(event)) || "default";
  }
  svg() {
    const pen = new SvgPen(...this.size);
    this.draw(pen);
    return pen.blob();
  }
}
