"use strict";
// The token stands in the address that opens the page; only pages of this very address can read its session storage.
const token = new URLSearchParams(location.hash.slice(1)).get("token") || sessionStorage.getItem("token") || "";
sessionStorage.setItem("token", token);
history.replaceState(null, "", location.pathname);
const ask = (path, method = "GET") => fetch(path, { method, headers: { "X-Fingerflow": token } });
const $ = id => document.getElementById(id);
const TYPES = { uint8: Uint8Array, float32: Float32Array };
const LEAST_RANGE = 0.001;  // of divergence: below it, noise would be coloured
let shown = null;  // label, unit, factor and decimals of variables, which do not change
const POINTS = { tracked: "#ffd54f", outside: "#ffd54f", lacking: "#111" };
let range = LEAST_RANGE, inPercent = false, over = false;

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const live = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  let place = 8 + length + (-length & 7);
  live.data = {};
  for (const { name, type, shape } of live.arrays) {
    const values = new TYPES[type](buffer, place, shape.reduce((a, b) => a * b, 1));
    live.data[name] = { values, shape };
    place += values.byteLength + (-values.byteLength & 7);
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

function rounded(value) {  // up to 1, 2 or 5 times a power of ten
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 2, 5, 10].find(step => step * power >= value * 0.999);
}

// The ends of the colour scale: nineteen of twenty points lie between them. They give way at once where points lie
// beyond, and come closer only where all points would do with two fifths: no flicker.
function scaleTo(values) {
  const sizes = values.filter(Number.isFinite).map(Math.abs).sort((a, b) => a - b);
  const most = sizes[Math.floor(0.95 * (sizes.length - 1))];
  if (sizes.length && (most > range || most < 0.4 * range)) range = rounded(Math.max(LEAST_RANGE, most));
}

function scaleBar(context, mm_per_px) {
  const { width, height } = context.canvas, mm = rounded(0.1 * width * mm_per_px), length = mm / mm_per_px;
  const size = Math.round(height / 24), y = height - size;
  context.font = `${size}px system-ui, sans-serif`;
  context.textAlign = "center"; context.lineCap = "butt";
  for (const [style, extra] of [["#000b", 4], ["#fff", 0]]) {
    context.strokeStyle = context.fillStyle = style; context.lineWidth = 3 + extra;
    context.beginPath(); context.moveTo(size - extra / 2, y); context.lineTo(size + length + extra / 2, y);
    context.stroke();
    context.lineWidth = extra;
    if (extra) context.strokeText(`${mm} mm`, size + length / 2, y - size / 2);
    else context.fillText(`${mm} mm`, size + length / 2, y - size / 2);
  }
}

const swatch = (style, name) => `<span><i style="background:${style}"></i>${name}</span>`;

function drawTopography(live) {
  const { topography_view, position_px, divergence, in_contact } = live.data;
  const context = picture($("topography"), topography_view), k = 2 / live.every;
  scaleBar(context, live.topography_mm_per_px / k);
  if (!position_px) { $("pointLegend").innerHTML = ""; return; }
  if (divergence) scaleTo(Array.from(divergence.values));
  const counts = { known: 0, lacking: 0, outside: 0 };
  for (let i = 0; i < position_px.shape[0]; i++) {
    const [x, y] = position_px.values.subarray(2 * i, 2 * i + 2), d = divergence ? divergence.values[i] : NaN;
    if (!Number.isFinite(x)) continue;
    const touches = !in_contact || in_contact.values[i];
    const kind = !divergence || Number.isFinite(d) ? "known" : touches ? "lacking" : "outside";
    counts[kind]++;
    context.beginPath();
    context.arc((x + 0.5) * k, (y + 0.5) * k, 3.5, 0, 7);
    context.fillStyle = kind != "known" ? POINTS[kind] : divergence ? colour(d / range) : POINTS.tracked;
    context.fill();
    context.lineWidth = 0.8; context.strokeStyle = "#0009"; context.stroke();
  }
  const { unit, factor } = live.shown.divergence, end = `${+(factor * range).toPrecision(1)} ${unit}`;
  const scale = counts.known ? `: \u2212${end}<i class="bar"></i>${end}` : "";
  $("pointLegend").innerHTML = !divergence ? swatch(POINTS.tracked, `${counts.known} points`) : [
    `<span>${counts.known} points with divergence${scale}</span>`,
    ...(in_contact ? [swatch(POINTS.outside, `${counts.outside} not in contact`)] : []),
    ...(counts.lacking ? [swatch(POINTS.lacking, `${counts.lacking} ${in_contact ? "in contact, " : ""}divergence unknown`)] : []),
  ].join("");
}

function drawContact(live) {
  const { contact_view, real_contact_mask, ellipse_center, ellipse_semi_axes } = live.data;
  const context = picture($("contact"), contact_view, real_contact_mask), k = 2 / live.every;
  scaleBar(context, live.mm_per_px / k);
  const angle = live.scalars.ellipse_angle, has = ellipse_center && ellipse_semi_axes && angle !== undefined;
  const known = has && angle != null && Number.isFinite(ellipse_center.values[0]) && ellipse_semi_axes.values[1] > 0;
  $("contactLegend").innerHTML = live.threshold == null ? "no contact yet" : [
    ...(real_contact_mask ? [swatch("#ffa726", "real contact")] : []),
    ...(has ? [known ? swatch("#00acc1", "ellipse of the gross contact") : "<span>no gross contact</span>"] : []),
  ].join("");
  if (!known) return;
  const [x, y] = Array.from(ellipse_center.values, v => v / live.mm_per_px);
  const [a, b] = Array.from(ellipse_semi_axes.values, v => v / live.mm_per_px * k);
  context.beginPath();
  context.ellipse((x + 0.5) * k, (y + 0.5) * k, a, b, angle, 0, 7);
  context.lineWidth = 3; context.strokeStyle = "#00acc1"; context.stroke();
}

function trace(live, name, title, drawn) {  // drawn: [variable, colour, name in the legend]
  const canvas = $(name), rows = live.data.traces, names = live.trace_columns, wide = names.length;
  const here = drawn.filter(([variable]) => live.fields.includes(variable) || live.forces.includes(variable));
  $(name + "Card").hidden = !here.length;
  if (!here.length) return;
  const { unit, factor: scale } = live.shown[here[0][0]];
  $(name + "Title").textContent = `${title}, ${unit}`;
  const columns = here.map(([variable, style]) => [names.indexOf(variable), style, []]);
  for (const [variable] of here) {
    const place = names.indexOf("expected_" + variable);
    const known = place >= 0 && rows.values.some((value, i) => i % wide == place && Number.isFinite(value));
    if (known) columns.push([place, "#c0392b", [3, 4]]);
  }
  const expected = columns.length > here.length;
  const legend = here.map(([, style, said]) => swatch(style, said));
  if (expected) legend.push(swatch("#c0392b", "expected"));
  $(name + "Legend").innerHTML = legend.length > 1 || name == "forces" ? legend.join("") : "";
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "11px system-ui, sans-serif";
  const count = rows.shape[0], at = (i, c) => rows.values[wide * i + c] * scale;
  let low = 0, high = 0;
  for (const [c] of columns) for (let i = 0; i < count; i++) if (Number.isFinite(at(i, c))) {
    low = Math.min(low, at(i, c)); high = Math.max(high, at(i, c));
  }
  const span = high - low || 1, step = 10 ** Math.floor(Math.log10(span));
  const tick = step * (span / step > 5 ? 2 : span / step > 2 ? 1 : 0.5);
  const end = count ? rows.values[wide * (count - 1)] : 0, left = 40;
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
    const said = s ? `\u2212${s} s` : live.state == "running" ? "now" : "end";
    context.fillText(said, Math.min(X(end - s), width - 16), height - 6);
  }
  context.lineWidth = 1.8; context.lineJoin = "round";
  for (const [c, style, dashes] of columns) {
    context.beginPath(); context.strokeStyle = style; context.setLineDash(dashes);
    let open = false;
    for (let i = 0; i < count; i++) {
      const t = rows.values[wide * i], v = at(i, c);
      if (!Number.isFinite(v) || t < end - 30) { open = false; continue; }
      if (open) context.lineTo(X(t), Y(v)); else context.moveTo(X(t), Y(v));
      open = true;
    }
    context.stroke();
  }
}

const text = (value, digits) => value == null || !Number.isFinite(value) ? "\u2013" : value.toFixed(digits);

const CELLS = ["real_contact_area", "gross_contact_area", "median_divergence"];  // of the last frame
const FORCES = { normal_force: "#1668b0", tangential_force: "#d17a00" };
const AXES = { ellipse_major: "semi-major axis", ellipse_minor: "semi-minor axis" };  // of the ellipse
const capital = words => words[0].toUpperCase() + words.slice(1);

function cell(live, name, value, after = "") {
  const { label, unit, factor, decimals } = live.shown[name];
  return [capital(label), text(value == null ? null : factor * value, decimals), unit + after];
}

function numbers(live) {
  const s = live.scalars, over = live.state == "ended" || live.state == "failed";
  const ms = over ? live.latency_ms : live.recent_ms;
  const kinds = Object.entries(live.not_usable);
  const left = kinds.reduce((sum, [, count]) => sum + count, 0);
  const why = kinds.map(([name, count]) => `${count} ${name.replaceAll("_", " ")}`).join(", ");
  const cells = [
    [over ? "Rate, whole stream" : "Rate", text(over ? live.rate_hz : live.rate, 1), "frames/s"],
    ["Latency, median", text(ms.median, 2), "ms", !over && live.behind.endsWith("behind")],
    ["Latency, 99 %", text(ms.p99, 2), "ms"],
    ["Latency, worst", text(live.latency_ms.worst, 1), "ms"],
    ["Frames", live.processed, `of ${live.frames_in}`],
    ["Not counted", left, why || "frames", left > 0],
    ["Dropped", live.dropped, "frames", live.dropped > 0],
    ["Overruns", live.overruns, "frames", live.overruns > 0],
    ["Reconnects", live.reconnects, "", live.reconnects > 0],
    ["Points tracked", live.tracked, `of ${live.found}`],
    live.threshold == null ? ["Contact threshold", "none yet", ""] : cell(live, "contact_threshold", live.threshold, "of the light lost"),
    // Before there is a threshold nothing counts as contact, which is no area that was measured.
    ...CELLS.filter(name => live.fields.includes(name)).map(name => cell(live, name, live.threshold == null ? null : s[name])),
    ...live.forces.map(name => cell(live, name, s[name])),
  ];
  if (live.fields.includes("slip_flag")) {
    cells.push([capital(live.shown.slip_flag.label), s.slip_flag == null ? "\u2013" : s.slip_flag ? "slipping" : "none", "", s.slip_flag > 0]);
  }
  $("numbers").innerHTML = cells.map(([name, value, unit, bad]) =>
    `<div><dt>${name}</dt><dd${bad ? ' class="bad"' : ""}>${value} <small>${unit}</small></dd></div>`).join("");
}

const signed = (value, digits) => (value < 0 ? "-" : "+") + text(Math.abs(value), digits);

function truth(live) {
  const axes = live.data.ellipse_semi_axes, s = live.scalars;
  const measured = { ...s, ...(axes && { ellipse_major: axes.values[0], ellipse_minor: axes.values[1] }) };
  const rows = Object.entries(live.expected).filter(([name]) => measured[name] !== undefined);
  $("truthCard").hidden = !rows.length;
  $("truth").innerHTML = rows.map(([name, value]) => {
    const { label, unit, factor, decimals: digits } = live.shown[name in AXES ? "ellipse_semi_axes" : name];
    const said = capital(AXES[name] || label), found = measured[name];
    const known = found != null && Number.isFinite(found);
    const share = ` (${signed(100 * (found / value - 1), 1)} %)`;
    const cells = [known ? text(factor * found, digits) : "\u2013", text(factor * value, digits),
      known ? signed(factor * (found - value), digits) + share : "\u2013"];
    return `<tr><th>${said}, ${unit}</th>${cells.map(cell => `<td>${cell}</td>`).join("")}</tr>`;
  }).join("");
}

// What outputs were sent, and when: from the camera's stamp to the end of sending.
function outputs(live) {
  $("outputsCard").hidden = !live.outputs.length;
  $("outputs").innerHTML = live.outputs.map(({ output, sent, overtaken, failed, latency_ms }) => {
    const cells = [sent, overtaken, failed, text(latency_ms.median, 2), text(latency_ms.p99, 2)];
    const bad = place => (place == 1 && overtaken) || (place == 2 && failed);
    const name = output.replace(/[&<>]/g, sign => `&#${sign.charCodeAt()};`);
    return `<tr><th>${name}</th>${cells.map((cell, i) => `<td${bad(i) ? ' class="bad"' : ""}>${cell}</td>`).join("")}</tr>`;
  }).join("");
}

const STATES = { waiting: "waiting for frames", running: "running", ended: "ended", failed: "stopped by an error" };

function say(state, sentence, behind = "") {
  $("state").textContent = (STATES[state] || state) + (behind && `, ${behind}`);
  $("state").className = state == "running" ? behind ? "late" : "good" : state == "failed" || state == "no answer" ? "gone" : "";
  $("said").textContent = sentence; $("said").hidden = !sentence;
  $("restart").disabled = state != "running";
}

async function refresh() {
  try {
    const answer = await ask("live");
    if (answer.status == 403) {  // another player answers here, whose token this page does not have
      say("closed", "This page belongs to an earlier stream: open the address that the player has printed.");
      return;
    }
    if (!answer.ok) throw new Error(answer.status);
    shown ||= await (await ask("shown")).json();
    const units = Object.entries(shown).map(([name, one]) => [name, inPercent ? { ...one, ...one.percent } : one]);
    const live = { ...unpack(await answer.arrayBuffer()), shown: Object.fromEntries(units) };
    $("unit").hidden = !live.shown.divergence.percent;
    $("unit").textContent = `Deformation in ${live.shown.divergence.unit}`;
    $("about").textContent = `${live.bundle} \u00b7 ${live.computed_by} \u00b7 ${live.source}`;
    numbers(live);
    truth(live);
    outputs(live);
    if (live.data.topography_view) { drawTopography(live); drawContact(live); }
    trace(live, "areas", "Contact area", [["gross_contact_area", "#8fb8dc", "gross"], ["real_contact_area", "#1668b0", "real"]]);
    trace(live, "forces", "Force", Object.entries(FORCES).map(([name, style]) => [name, style, live.shown[name].label.split(" ")[0]]));
    trace(live, "divergence", "Median divergence", [["median_divergence", "#1668b0", "measured"]]);
    const frames = `after ${live.processed} frames, ${live.seconds.toFixed(1)} s`;
    const where = live.results ? ` Results: ${live.results}` : "";
    say(live.state, live.state == "ended" ? `The stream has ended ${frames}.${where}`
      : live.state == "failed" ? `The stream was stopped ${frames}: ${live.said}${where}` : "", live.state == "running" ? live.behind : "");
    over = live.state == "ended" || live.state == "failed";
    if (over) return;
  } catch (error) {
    console.info(error);
    say("no answer", "Nothing answers here: the stream has ended, or the connection to its computer is lost.");
  }
  setTimeout(refresh, 66);
}
$("unit").onclick = () => { inPercent = !inPercent; if (over) refresh(); };
$("restart").onclick = () => ask("restart", "POST");
refresh();
