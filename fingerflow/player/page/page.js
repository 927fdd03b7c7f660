"use strict";
const $ = id => document.getElementById(id);
const TYPES = { uint8: Uint8Array, float32: Float32Array };
let range = 0.02;

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const live = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let place = 4 + length + (-length & 3);
  live.data = {};
  for (const { name, type, shape } of live.arrays) {
    const values = new TYPES[type](buffer, place, shape.reduce((a, b) => a * b, 1));
    live.data[name] = { values, shape };
    place += values.byteLength + (-values.byteLength & 3);
  }
  return live;
}

function picture(canvas, view, mask) {
  const [height, width] = view.shape;
  const scale = 2;
  canvas.width = width * scale; canvas.height = height * scale;
  const image = new ImageData(width, height), out = image.data;
  for (let i = 0; i < view.values.length; i++) {
    const grey = view.values[i], touch = mask && mask.values[i];
    out[4 * i] = touch ? (grey + 255) / 2 : grey;
    out[4 * i + 1] = touch ? (grey + 167) / 2 : grey;
    out[4 * i + 2] = touch ? (grey + 38) / 2 : grey;
    out[4 * i + 3] = 255;
  }
  const small = new OffscreenCanvas(width, height);
  small.getContext("2d").putImageData(image, 0, 0);
  const context = canvas.getContext("2d");
  context.drawImage(small, 0, 0, width * scale, height * scale);
  return context;
}

function colour(value) {  // blue, light grey, red over -1 to 1
  const t = Math.max(-1, Math.min(1, value)), end = t < 0 ? [33, 102, 172] : [178, 24, 43], a = Math.abs(t);
  return `rgb(${end.map(c => Math.round(238 + (c - 238) * a)).join()})`;
}

function drawTopography(live) {
  const { topography_view, position_px, divergence } = live.data;
  const context = picture($("topography"), topography_view), k = 2 / live.every;
  const known = Array.from(divergence ? divergence.values : []).filter(Number.isFinite).map(Math.abs);
  known.sort((a, b) => a - b);
  if (known.length) range += 0.1 * (Math.max(0.01, known[Math.floor(0.95 * (known.length - 1))]) - range);
  $("low").textContent = $("high").textContent = (100 * range).toFixed(1) + " %";
  if (!position_px) return;
  for (let i = 0; i < position_px.shape[0]; i++) {
    const [x, y] = position_px.values.subarray(2 * i, 2 * i + 2), d = divergence ? divergence.values[i] : NaN;
    if (!Number.isFinite(x)) continue;
    context.beginPath();
    context.arc((x + 0.5) * k, (y + 0.5) * k, 3, 0, 7);
    context.fillStyle = Number.isFinite(d) ? colour(d / range) : "#ffd54f";
    context.fill();
    context.lineWidth = 0.8; context.strokeStyle = "#0009"; context.stroke();
  }
}

function drawContact(live) {
  const { contact_view, real_contact_mask, ellipse_center, ellipse_semi_axes } = live.data;
  const context = picture($("contact"), contact_view, real_contact_mask), k = 2 / live.every;
  const angle = live.scalars.ellipse_angle;
  if (!ellipse_center || !ellipse_semi_axes || angle == null || !Number.isFinite(ellipse_center.values[0])) return;
  const [x, y] = Array.from(ellipse_center.values, v => v / live.mm_per_px);
  const [a, b] = Array.from(ellipse_semi_axes.values, v => v / live.mm_per_px * k);
  if (!(a > 0 && b > 0)) return;
  context.beginPath();
  context.ellipse((x + 0.5) * k, (y + 0.5) * k, a, b, angle, 0, 7);
  context.lineWidth = 3; context.strokeStyle = "#00acc1"; context.stroke();
}

function trace(canvas, rows, columns, scale) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "11px system-ui, sans-serif";
  const count = rows.shape[0], at = (i, c) => rows.values[4 * i + c] * scale;
  let low = 0, high = 0;
  for (const [c] of columns) for (let i = 0; i < count; i++) if (Number.isFinite(at(i, c))) {
    low = Math.min(low, at(i, c)); high = Math.max(high, at(i, c));
  }
  const span = high - low || 1, step = 10 ** Math.floor(Math.log10(span));
  const tick = step * (span / step > 5 ? 2 : span / step > 2 ? 1 : 0.5);
  const end = count ? rows.values[4 * (count - 1)] : 0, left = 40;
  const X = t => left + (width - left - 6) * (1 + (t - end) / 30);
  low = Math.floor(low / tick + 1e-6) * tick; high = Math.max(Math.ceil(high / tick - 1e-6) * tick, low + tick);
  const Y = v => 8 + (height - 30) * (1 - (v - low) / (high - low));
  context.textAlign = "right";
  for (let v = low; v <= high + tick / 2; v += tick) {
    context.strokeStyle = Math.abs(v) < tick / 2 ? "#aab4bf" : "#e8ecf0";
    context.beginPath(); context.moveTo(left, Y(v)); context.lineTo(width - 6, Y(v)); context.stroke();
    context.fillStyle = "#647384"; context.fillText(+v.toPrecision(4), left - 6, Y(v) + 4);
  }
  context.textAlign = "center";
  for (let s = 30; s >= 0; s -= 10) {
    context.fillText(s ? `\u2212${s} s` : "now", Math.min(X(end - s), width - 16), height - 6);
  }
  context.lineWidth = 1.8; context.lineJoin = "round";
  for (const [c, style] of columns) {
    context.beginPath(); context.strokeStyle = style;
    let open = false;
    for (let i = 0; i < count; i++) {
      const t = rows.values[4 * i], v = at(i, c);
      if (!Number.isFinite(v) || t < end - 30) { open = false; continue; }
      if (open) context.lineTo(X(t), Y(v)); else context.moveTo(X(t), Y(v));
      open = true;
    }
    context.stroke();
  }
}

const text = (value, digits) => value == null || !Number.isFinite(value) ? "\u2013" : value.toFixed(digits);

function numbers(live) {
  const s = live.scalars, ms = live.recent_ms;
  const left = Object.values(live.not_usable).reduce((sum, count) => sum + count, 0);
  const why = Object.entries(live.not_usable).map(([name, count]) => `${count} ${name.replaceAll("_", " ")}`).join(", ");
  const cells = [
    ["Rate", text(live.rate, 1), "frames/s"],
    ["Latency, median", text(ms.median, 2), "ms"],
    ["Latency, 99 %", text(ms.p99, 2), "ms"],
    ["Worst so far", text(live.latency_ms.worst, 1), "ms"],
    ["Frames", live.processed, `of ${live.frames_in}`],
    ["Not counted", left, why, left > 0],
    ["Dropped", live.dropped, "", live.dropped > 0],
    ["Overruns", live.overruns, "", live.overruns > 0],
    ["Reconnects", live.reconnects, "", live.reconnects > 0],
    ["Points", live.tracked, `of ${live.found}`],
    ["Partial slip", s.slip_flag == null ? "\u2013" : s.slip_flag ? "slipping" : "none", "", s.slip_flag > 0],
    ["Threshold", live.threshold == null ? "no contact yet" : text(100 * live.threshold, 1), "%"],
    ["Real area", text(s.real_contact_area, 1), "mm\u00b2"],
    ["Gross area", text(s.gross_contact_area, 1), "mm\u00b2"],
    ["Median divergence", text(s.median_divergence == null ? null : 100 * s.median_divergence, 2), "%"],
  ];
  $("numbers").innerHTML = cells.map(([name, value, unit, bad]) =>
    `<div><dt>${name}</dt><dd${bad ? ' class="bad"' : ""}>${value} <small>${unit}</small></dd></div>`).join("");
}

async function refresh() {
  try {
    const answer = await fetch("live");
    if (!answer.ok) throw new Error(answer.status);
    const live = unpack(await answer.arrayBuffer());
    $("about").textContent = `${live.bundle} \u00b7 ${live.provider} \u00b7 ${live.source}`;
    $("state").textContent = "running"; $("state").className = "";
    numbers(live);
    if (live.data.topography_view) { drawTopography(live); drawContact(live); }
    trace($("areas"), live.data.traces, [[2, "#8fb8dc"], [1, "#1668b0"]], 1);
    trace($("divergence"), live.data.traces, [[3, "#1668b0"]], 100);
  } catch (error) {
    console.info(error);
    $("state").textContent = "no stream"; $("state").className = "gone";
  }
  setTimeout(refresh, 66);
}
$("restart").onclick = () => fetch("restart", { method: "POST", headers: { "X-Fingerflow": "1" } });
refresh();
