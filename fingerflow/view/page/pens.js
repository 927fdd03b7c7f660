// The same strokes on a canvas, or as SVG: what is saved is what is seen.
export class CanvasPen {
  constructor(canvas, width, height, ratio = window.devicePixelRatio || 1) {
    const across = Math.round(width * ratio), down = Math.round(height * ratio);
    if (canvas.width !== across || canvas.height !== down) { canvas.width = across; canvas.height = down; }
    this.context = canvas.getContext("2d");
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, width, height);
    this.context.lineJoin = "round";
  }
  line(points, { stroke, width = 1, fill, closed = false, dash = [] }) {
    const c = this.context;
    c.beginPath();
    let down = false;
    for (const [x, y] of points) {
      if (!(Number.isFinite(x) && Number.isFinite(y))) { down = false; continue; }
      if (down) c.lineTo(x, y); else c.moveTo(x, y);
      down = true;
    }
    if (closed) c.closePath();
    if (fill) { c.fillStyle = fill; c.fill(); }
    if (stroke) { c.setLineDash(dash); c.strokeStyle = stroke; c.lineWidth = width; c.stroke(); }
  }
  circle(x, y, radius, { stroke, width = 1, fill }) {
    const c = this.context;
    c.beginPath();
    c.arc(x, y, radius, 0, 7);
    if (fill) { c.fillStyle = fill; c.fill(); }
    if (stroke) { c.setLineDash([]); c.strokeStyle = stroke; c.lineWidth = width; c.stroke(); }
  }
  rect(x, y, width, height, style) {
    this.line([[x, y], [x + width, y], [x + width, y + height], [x, y + height]], { ...style, closed: true });
  }
  text(x, y, text, { fill = "#1c2733", size = 12, align = "start", halo, turn = 0 } = {}) {
    const c = this.context;
    c.save();
    c.translate(x, y);
    c.rotate(turn);
    c.font = `${size}px system-ui, sans-serif`;
    c.textAlign = align;
    if (halo) { c.strokeStyle = halo; c.lineWidth = 3; c.setLineDash([]); c.strokeText(text, 0, 0); }
    c.fillStyle = fill;
    c.fillText(text, 0, 0);
    c.restore();
  }
  // Pixels of a canvas; `matrix` [a, b, c, d, e, f] takes its pixels to this canvas.
  bitmap(image, matrix, alpha = 1) {
    const c = this.context;
    c.save();
    c.transform(...matrix);
    c.globalAlpha = alpha;
    c.imageSmoothingEnabled = Math.hypot(matrix[0], matrix[1]) < 3;
    c.drawImage(image, 0, 0);
    c.restore();
  }
  clip(x, y, width, height, draw) {
    const c = this.context;
    c.save();
    c.beginPath();
    c.rect(x, y, width, height);
    c.clip();
    draw();
    c.restore();
  }
}

const escaped = text => String(text).replace(/[&<>"]/g, c => `&#${c.charCodeAt(0)};`);
const short = value => +value.toFixed(2);

export class SvgPen {
  constructor(width, height) {
    this.size = [width, height];
    this.parts = [];
    this.clips = 0;
  }
  line(points, { stroke, width = 1, fill, closed = false, dash = [] }) {
    let path = "", down = false;
    for (const [x, y] of points) {
      if (!(Number.isFinite(x) && Number.isFinite(y))) { down = false; continue; }
      path += `${down ? "L" : "M"}${short(x)} ${short(y)}`;
      down = true;
    }
    if (!path) return;
    const dashes = dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : "";
    this.parts.push(`<path d="${path}${closed ? "Z" : ""}" fill="${fill || "none"}" stroke="${stroke || "none"}"` +
      ` stroke-width="${width}" stroke-linejoin="round"${dashes}/>`);
  }
  circle(x, y, radius, { stroke, width = 1, fill }) {
    this.parts.push(`<circle cx="${short(x)}" cy="${short(y)}" r="${short(radius)}" fill="${fill || "none"}"` +
      ` stroke="${stroke || "none"}" stroke-width="${width}"/>`);
  }
  rect(x, y, width, height, style) {
    this.line([[x, y], [x + width, y], [x + width, y + height], [x, y + height]], { ...style, closed: true });
  }
  text(x, y, text, { fill = "#1c2733", size = 12, align = "start", halo, turn = 0 } = {}) {
    const anchor = { center: "middle", right: "end", start: "start", left: "start" }[align];
    const around = halo ? ` stroke="${halo}" stroke-width="3" paint-order="stroke"` : "";
    const turned = turn ? ` transform="rotate(${short(turn * 180 / Math.PI)} ${short(x)} ${short(y)})"` : "";
    this.parts.push(`<text x="${short(x)}" y="${short(y)}" fill="${fill}" font-size="${size}"` +
      ` font-family="sans-serif" text-anchor="${anchor}"${around}${turned}>${escaped(text)}</text>`);
  }
  bitmap(image, matrix, alpha = 1) {
    this.parts.push(`<image href="${image.toDataURL("image/png")}" width="${image.width}" height="${image.height}"` +
      ` opacity="${alpha}" transform="matrix(${matrix.join(" ")})"/>`);
  }
  clip(x, y, width, height, draw) {
    const name = `clip${++this.clips}`;
    this.parts.push(`<clipPath id="${name}"><rect x="${short(x)}" y="${short(y)}" width="${short(width)}"` +
      ` height="${short(height)}"/></clipPath><g clip-path="url(#${name})">`);
    draw();
    this.parts.push("</g>");
  }
  blob() {
    const [width, height] = this.size;
    const text = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}"` +
      ` viewBox="0 0 ${width} ${height}"><rect width="100%" height="100%" fill="#fff"/>${this.parts.join("\n")}</svg>`;
    return new Blob([text], { type: "image/svg+xml" });
  }
}
