// Before processing: views, contact, points and forces of a scene that is being set up.
import { arrays, get, newest, post, say, unsay } from "./net.js";
import { $, allShown, digits, labelOf, make, shown, title, titleOf, toggle, unitOf } from "./elements.js";
import { VIEW, MARKS, drawEllipse, drawPoints, drawViews, inverse, placesIn } from "./marks.js";
import { CalibrationCard } from "./calibration.js";
import { makeForms } from "./forms.js";
import { follow } from "./runs.js";

const CORNERS = 40;  // of a region, at most
const REACH = 9;  // screen px around an edge that take hold of it

export class Setup {
  constructor(app) {
    this.app = app;
    this.layer = { contact: true, points: true, blend: false };
    this.points = null;
    this.forces = null;
    this.found = null;
    this.question = null;  // { text, to }: whether a file may be replaced
    this.edited = newest(async () => this.send());
    this.pending = new Map();
    this.turn = Promise.resolve();
  }
  get frames() { return this.facts?.recording?.frames || 0; }
  get first() { return 0; }
  async load() {
    this.take(await get("api/setup"));
    return this.facts.draft !== null;
  }
  async enter() {
    const { app } = this;
    app.picture.layers = (pen, at, scale) => this.draw(pen, at, scale);
    app.picture.gestures = { down: (...a) => this.hold(...a), move: (...a) => this.drag(...a), up: () => this.drop(),
      hover: (x, y) => this.drawing ? "crosshair" : this.cursor(x, y) };
    $("layers").replaceChildren(
      toggle("contact", this.layer.contact, on => this.set("contact", on), "Real contact that process will find"),
      toggle("points", this.layer.points, on => this.set("points", on), "The points that process would track"),
      toggle("Check calibration: overlay the views", this.layer.blend, on => this.set("blend", on),
        "Topography view over the contact view, aligned by the calibration: ridges should match ridges"),
      make("button", { id: "region", title: "Limits contact (in the contact view) or tracked points (in the topography view) to a region",
        onclick: () => this.startRegion() }, "Draw region"),
      make("button", { id: "no-region", hidden: true, onclick: () => this.noRegions() }, "Remove regions"));
    $("hint").textContent = "Drag a view or its edges; scroll to zoom, double-click to see all.";
    $("save-csv").hidden = true;
    this.panel();
    app.chart.show({ label: "", values: [] }, []);
    $("courses").hidden = true;
    this.legend();
    if (this.facts.draft) $("no-region").hidden = !this.regions().length;
  }
  set(name, on) {
    this.layer[name] = on;
    this.legend();
    this.app.show();
  }
  panel() {
    if (!this.facts.draft) return $("panel").replaceChildren(make("p", {}, "A result is open, without its scene file. Run fingerflow view with the scene file to change settings."));
    this.form = makeForms(this.facts, (key, value) => this.edit(key, value));
    this.status = make("div", { id: "setup-status" });
    this.asking = make("div");
    this.numbers = make("dl", { className: "numbers" });
    this.name = make("input", { type: "text", id: "scene-name", value: this.facts.draft.split(/[\\/]/).pop() });
    this.name.setAttribute("aria-label", "Scene file");
    this.calibration = new CalibrationCard(asked => this.change("api/calibrate", asked).catch(error => {
      this.changed();  // what was set before it
      throw error;
    }), facts => this.changed(facts));
    $("panel").replaceChildren(
      make("div", { className: "card" }, make("h2", {}, "Scene"),
        make("div", { className: "bar" }, this.name,
          make("button", { id: "write", className: "main", onclick: () => this.write(false) }, "Write scene"),
          make("button", { id: "process", onclick: () => this.process() }, "Process")),
        this.asking, this.status,
        toggle("Also compute principal strains and shear", false, on => { this.all = on; },
          "And all other variables that a default run leaves out"),
        make("div", { id: "progress" })),
      make("div", { className: "card" }, make("h2", {}, "This frame"), this.numbers),
      this.calibration.element,
      make("div", { className: "card forms" }, make("h2", {}, "Settings"), this.form.elements),
      make("details", { className: "card" }, make("summary", {}, "Scene file as it will be written"), make("pre", { id: "text" })));
    this.update();
    this.ask(this.question);
  }
  // Of the scene, and of what has been set since and is not in it yet.
  get values() {
    const values = structuredClone(this.facts.values || {});
    for (const [key, value] of this.pending) {
      const tables = key.split("."), last = tables.pop();
      const table = tables.reduce((place, name) => Object(place) === place ? place[name] ??= {} : place, values);
      if (Object(table) === table) table[last] = value?.toml ?? value;
    }
    return values;
  }
  take(facts) {
    const moving = this.held && this.views[this.held.name];
    this.facts = facts;
    this.views = Object.fromEntries(Object.entries(this.values.views || {}).filter(([name, view]) =>
      name in VIEW && Array.isArray(view?.rows) && Array.isArray(view?.columns)));
    if (this.held && this.views[this.held.name]) this.views[this.held.name] = moving;
  }
  update() {
    const { facts } = this;
    this.form.update({ ...facts, values: this.values, kind: this.pending.get("kind") ?? facts.kind });
    this.calibration.show(facts.calibration_picture);
    $("text").textContent = facts.text;
    const other = facts.problems.map(({ field, said }) => make("li", {}, make("b", {}, field), ` ${said}`));
    const tables = [...new Set(facts.problems.map(({ key }) => title(key.split(".")[0])))].join(", ");
    const refused = other.length ? `${other.length} problem${other.length > 1 ? "s" : ""} in ${tables}`
      : facts.recording_error || this.why ? "see the error above" : "";
    const warned = [...(facts.recording?.warnings || []), ...(this.forces?.warnings || []), ...(this.points?.warnings || [])];
    this.status.replaceChildren(...[
      facts.recording_error ? make("p", { className: "wrong" }, facts.recording_error) : null,
      refused ? make("p", { className: "wrong" }, `Cannot process: ${refused}`)
        : make("p", { className: "good" }, facts.stored && !this.pending.size ? `${facts.draft} has these settings.` : "Complete. Not written yet: choose Write scene."),
      other.length ? make("ul", { className: "wrong", id: "problems" }, other) : null,
      ...[...new Set(warned)].map(one => make("p", { className: "warned" }, one)),
    ].filter(Boolean));
    $("process").disabled = !facts.stored || this.pending.size > 0 || other.length > 0;
    if ($("no-region")) $("no-region").hidden = !this.regions().length;
  }
  edit(key, value) {
    this.pending.set(key, value);
    this.why = undefined;
    say("");  // here, and not where it has succeeded: that is when another may have failed
    this.edited();
  }
  // One change waits for the answer of another, and for what has been set by then: answers come in the order in which
  // the scene changed, and what is written is what is seen.
  change(path, content) {
    const next = this.turn.then(async () => {
      if (this.pending.size) await this.sendPending();
      return path && post(path, content);
    });
    this.turn = next.catch(() => {});
    return next;
  }
  // What has no answer is asked again with the next change; what is refused is seen no more.
  async sendPending() {
    const set = [...this.pending];
    this.pending.clear();
    try {
      this.take(await post("api/edit", { set }));
    } catch (error) {
      if (error.refused) await get("api/setup").then(facts => this.take(facts), () => {});
      else this.pending = new Map([...set, ...this.pending]);
      throw error;
    }
  }
  async send() {
    if (!this.pending.size) return;
    try {
      await this.change();
    } finally { await this.changed(); }
  }
  async changed(facts) {
    if (facts) this.take(facts);
    this.update();
    await this.app.measure();
    await this.app.show();
    this.later();
  }
  // What takes longer than a frame, once nothing moves any more.
  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.refreshed(), 250);
  }
  refreshed = newest(async () => {
    if (!this.facts.draft) return;
    const said = this.why;
    this.why = undefined;
    if (this.facts.problems.length) {
      this.points = this.forces = null;
    } else {
      const found = await arrays("api/forces").catch(error => ({ why: error.message }));
      this.forces = found.arrays ? found : null;
      this.points = await arrays("api/points").catch(error => ({ why: error.message }));
      this.why = found.why;
    }
    if (this.why) say(this.why);
    else if (said) unsay(said);
    if (this.app.tab !== this) return;
    this.update();
    this.courses();
    this.after(this.app.frame);
    this.legend();
    this.app.picture.redraw();
  });
  courses() {
    const found = this.forces?.arrays;
    const names = Object.keys(found || {}).filter(name => name !== "time");
    $("courses").hidden = !names.length;
    if (!names.length) return;
    $("course-bar").replaceChildren(make("h2", {}, "Forces at the times of the frames"));
    $("chart-hint").textContent = "Click to choose a frame. Low-pass filtered at half the frame rate, as in process.";
    $("chart-csv").hidden = true;
    this.app.chart.show({ label: titleOf("time"), values: found.time.values },
      names.map(name => ({ label: labelOf(name), units: unitOf(name), values: allShown(name, found[name].values) })));
    this.app.chart.cursor(this.app.frame - this.forces.first_frame);
  }
  frameOfChart(k) { return k + (this.forces?.first_frame || 0); }
  async frame(k) {
    const contact = this.layer.contact && !this.facts.problems.length && this.app.ready;
    this.found = await arrays(`api/frame?frame=${k}${contact ? "&contact=1" : ""}`);
    this.found.asked = contact;
    return [this.found, this.views.contact || this.views.camera];
  }
  after(k) {
    const numbers = this.found?.numbers, rate = this.facts.recording?.frame_rate;
    const time = numbers?.time ?? (rate ? (k - (this.facts.values.recording?.trigger_frame ?? 0)) / rate : null);
    $("where").value = `frame ${k} of 0–${this.frames - 1}${time === null ? "" : `   ${digits(time, 4)} s`}`;
    if (!this.numbers) return;
    const forces = this.forces?.arrays, place = k - (this.forces?.first_frame || 0);
    const rows = [
      ...["contact_threshold", "real_contact_area", "gross_contact_area"].map(name => [name, numbers?.[name]]),
      ...["normal_force", "tangential_force"].map(name => [name, forces?.[name]?.values[place]]),
    ];
    this.numbers.replaceChildren(...rows.filter(([, value]) => value !== undefined).map(([name, value]) =>
      make("div", {}, make("dt", {}, labelOf(name)), make("dd", {}, digits(shown(name, value)), make("small", {}, ` ${unitOf(name)}`)))));
    const why = this.found?.why_no_contact || (numbers?.counts === false ? "This frame lies before the first or after the last frame of the scene: it is not processed." : "");
    const waits = this.facts.problems.length ? "The contact is shown once the settings are complete." : this.layer.contact ? "Loading …" : "";
    if (why || (waits && !rows.some(([, value]) => value !== undefined))) this.numbers.append(make("p", { className: "soft" }, why || waits));
    if (this.forces) this.app.chart.cursor(place);
  }
  draw(pen, at, scale) {
    const contact = this.views.contact || this.views.camera, forces = this.forces;
    if (this.layer.blend && forces && this.views.topography && contact) this.blend(pen, at, scale, contact);
    const numbers = this.found?.numbers;
    if (forces && numbers?.ellipse_center && this.layer.contact) {
      drawEllipse(pen, at, placesIn(this.views, forces.mm_per_px, forces.topography_to_contact),
        numbers.ellipse_center, numbers.ellipse_semi_axes, numbers.ellipse_angle);
    }
    const points = this.points?.arrays?.points, view = this.views.topography || this.views.camera;
    if (points && view && this.layer.points) {
      drawPoints(pen, at, (x, y) => [x + view.columns[0], y + view.rows[0]], points.values, () => "#7dff9b", { radius: Math.max(1.2, Math.min(4, 3 * scale)) });
    }
    this.drawRegions(pen, at);
    drawViews(pen, at, this.views, true);
  }
  blend(pen, at, scale, contact) {
    const { topography } = this.views, [[a, b, x], [c, d, y]] = this.forces.topography_to_contact, every = this.app.picture.every;
    const [x0, y0] = at(contact.columns[0] - 0.5, contact.rows[0] - 0.5), [x1, y1] = at(contact.columns[1] - 0.5, contact.rows[1] - 0.5);
    // Pixel p of the bitmap has its middle at every * (p + 0.5) - 0.5 of the frame.
    const fx = px => every * px - 0.5 - topography.columns[0], fy = py => every * py - 0.5 - topography.rows[0];
    const map = (px, py) => at(a * fx(px) + b * fy(py) + x + contact.columns[0], c * fx(px) + d * fy(py) + y + contact.rows[0]);
    const [o, u, v] = [map(0, 0), map(1, 0), map(0, 1)];
    pen.clip(x0, y0, x1 - x0, y1 - y0, () => {
      const back = inverse(this.forces.topography_to_contact), cut = this.app.picture.bitmap;
      if (!back.flat().every(Number.isFinite)) return;
      const part = document.createElement("canvas");  // the topography view alone
      [part.width, part.height] = [cut.width, cut.height];
      const [l, t, r, e] = [topography.columns[0], topography.rows[0], topography.columns[1], topography.rows[1]].map(n => n / every);
      part.getContext("2d").drawImage(cut, l, t, r - l, e - t, l, t, r - l, e - t);
      pen.bitmap(part, [u[0] - o[0], u[1] - o[1], v[0] - o[0], v[1] - o[1], o[0], o[1]], 0.5);
    });
  }
  legend() {
    const points = this.points?.arrays?.points;
    const entries = [];
    if (!this.facts.problems?.length && this.layer.contact) {
      entries.push(make("span", {}, make("i", { className: "mask" }), "real contact"), make("span", {}, make("i", { className: "ellipse" }), "gross contact (ellipse)"));
    }
    if (points && this.layer.points) entries.push(make("span", {}, make("i", { className: "point" }),
      `${points.shape[0]} of ${this.facts.values.tracking?.points ?? 700} points, seeded in frame ${this.points.frame}`));
    else if (this.points?.why) entries.push(make("span", { className: "soft" }, `no points: ${this.points.why}`));
    $("legend").replaceChildren(...entries);
  }
  // Regions of views: a polygon, in px of its view.
  regions() {
    return Object.entries(this.facts.values.views).filter(([name, view]) => name in VIEW && view?.region).map(([name]) => name);
  }
  startRegion() {
    this.drawing = this.drawing ? null : [];
    $("region").classList.toggle("on", Boolean(this.drawing));
  }
  closeRegion() {
    const outline = this.drawing, [[x, y]] = outline, every = Math.ceil(outline.length / CORNERS);
    this.drawing = null;
    $("region").classList.remove("on");
    const within = ({ rows, columns }) => x >= columns[0] && x < columns[1] && y >= rows[0] && y < rows[1];
    const [name, view] = Object.entries(this.views).find(([, one]) => within(one)) || [];
    if (!view) return say("Start inside a view to draw its region.");
    const clamped = (value, [first, end]) => Math.max(0, Math.min(end - first - 1, Math.round(value - first)));
    const corners = outline.filter((_, k) => k % every === 0).map(([px, py]) => [clamped(px, view.columns), clamped(py, view.rows)]);
    for (const other of ["ellipse", "mask"]) this.pending.set(`views.${name}.region.${other}`, null);
    this.edit(`views.${name}.region.polygon`, corners);
  }
  noRegions() {
    for (const name of this.regions()) for (const key of ["polygon", "ellipse", "mask"]) this.edit(`views.${name}.region.${key}`, null);
  }
  drawRegions(pen, at) {
    for (const name of this.regions()) {
      const { polygon, ellipse } = this.facts.values.views[name].region, { rows, columns } = this.views[name];
      const corners = polygon || (ellipse?.center && ellipse.semi_axes && Array.from({ length: 96 }, (_, k) => {
        const turn = k / 48 * Math.PI, angle = ellipse.angle || 0, [a, b] = ellipse.semi_axes;
        const [u, v] = [a * Math.cos(turn), b * Math.sin(turn)];
        return [ellipse.center[0] + u * Math.cos(angle) - v * Math.sin(angle), ellipse.center[1] + u * Math.sin(angle) + v * Math.cos(angle)];
      }));
      if (Array.isArray(corners)) pen.line(corners.map(([x, y]) => at(x + columns[0], y + rows[0])), { stroke: VIEW[name], width: 2, dash: [6, 4], closed: true });
    }
    if (this.drawing?.length) pen.line(this.drawing.map(([x, y]) => at(x, y)), { stroke: "#fff", width: 2, dash: [5, 3] });
  }
  // Dragging of views.
  edge(x, y) {
    const reach = REACH / this.app.picture.view.scale;
    let best = null, least = reach;
    for (const [name, { rows, columns }] of Object.entries(this.views)) {
      if (x < columns[0] - reach || x > columns[1] + reach || y < rows[0] - reach || y > rows[1] + reach) continue;
      const off = { left: x - columns[0], right: columns[1] - x, top: y - rows[0], bottom: rows[1] - y };  // > 0 within
      const nearest = Math.min(...Object.values(off).map(Math.abs)), within = Math.min(...Object.values(off)) > -0.5;
      if (nearest - (within ? 0.5 : 0) >= least) continue;  // of two edges in one place, that of the view one points at
      least = nearest - (within ? 0.5 : 0);
      best = { name, ...Object.fromEntries(Object.entries(off).map(([side, value]) => [side, Math.abs(value) < reach])) };
    }
    if (best) return best;
    for (const [name, { rows, columns }] of Object.entries(this.views)) {
      if (x > columns[0] && x < columns[1] && y > rows[0] && y < rows[1]) return { name, whole: true };
    }
    return null;
  }
  cursor(x, y) {
    const found = this.edge(x, y);
    if (!found) return "default";
    if (found.whole) return "move";
    const across = found.left || found.right, down = found.top || found.bottom;
    return across && down ? (found.left === found.top ? "nwse-resize" : "nesw-resize") : across ? "ew-resize" : "ns-resize";
  }
  hold(x, y, event) {
    if (this.drawing) {
      this.drawing = [[x, y]];
      return true;
    }
    const found = this.app.picture.zoom && !event.shiftKey && this.edge(x, y)?.whole ? null : this.edge(x, y);
    if (!found) return false;
    const view = this.views[found.name];
    this.held = { ...found, x, y, rows: [...view.rows], columns: [...view.columns] };
    return true;
  }
  drag(x, y) {
    if (this.drawing) {
      this.drawing.push([x, y]);
      return this.app.picture.redraw();
    }
    const { name, whole, left, right, top, bottom, rows, columns } = this.held, [height, width] = this.app.picture.shape;
    const dx = Math.round(x - this.held.x), dy = Math.round(y - this.held.y), least = 16;
    const clamp = (value, low, high) => Math.max(low, Math.min(high, value));
    let [r0, r1] = rows, [c0, c1] = columns;
    if (whole) {
      const sx = clamp(dx, -c0, width - c1), sy = clamp(dy, -r0, height - r1);
      [r0, r1, c0, c1] = [r0 + sy, r1 + sy, c0 + sx, c1 + sx];
    } else {
      if (left) c0 = clamp(c0 + dx, 0, c1 - least);
      if (right) c1 = clamp(c1 + dx, c0 + least, width);
      if (top) r0 = clamp(r0 + dy, 0, r1 - least);
      if (bottom) r1 = clamp(r1 + dy, r0 + least, height);
    }
    this.views[name] = { rows: [r0, r1], columns: [c0, c1] };
    this.app.picture.redraw();
  }
  drop() {
    if (this.drawing) return this.closeRegion();
    const { name, rows: from, columns: across } = this.held, { rows, columns } = this.views[name];
    this.held = null;
    if (rows + "" === from + "" && columns + "" === across + "") return;
    this.pending.set(`views.${name}.rows`, rows);
    this.edit(`views.${name}.columns`, columns);
  }
  async write(replace, to = this.name.value) {
    this.ask(null);
    say("");
    try {
      const facts = await this.change("api/write", { to, replace });
      await this.changed(facts);
    } catch (error) {
      this.changed();
      if (error.asks) this.ask({ text: `${error.message}. Replace it?`, to });
      else say(error.message);
    }
  }
  // In a place of its own, drawn once: what else is updated meanwhile does not take it away under the pointer.
  ask(question) {
    this.question = question;
    this.asking.replaceChildren(...(question ? [make("div", { className: "ask", id: "ask" }, make("p", {}, question.text),
      make("button", { id: "replace", onclick: () => this.write(true, question.to) }, "Replace"),
      make("button", { id: "keep", onclick: () => this.ask(null) }, "Keep it"))] : []));
  }
  async process() {
    try {
      await this.processed(await this.change("api/process", { all: Boolean(this.all) }));
    } catch (error) {
      this.changed();
      say(error.message);
    }
  }
  async processed(state) {
    $("process").disabled = true;
    const { failed } = await follow("process", state, $("progress"));
    $("process").disabled = false;
    if (!failed) await this.app.openResult();
  }
}
