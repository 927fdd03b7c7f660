// After processing: a result's frames, maps, curves, points and regions.
import { arrays, download, get, newest, post, postArrays, postText, say } from "./net.js";
import { $, allShown, digits, labelOf, make, select, shown, titleOf, toggle, unitOf, words } from "./elements.js";
import * as marks from "./marks.js";
import { UNKNOWN, scale } from "./colours.js";
import { follow } from "./runs.js";

const FIRST_MAPS = ["divergence", "displacement:length", "strain:exx"];
const FIRST_CURVES = ["normal_force", "real_contact_area", "gross_contact_area", "median_divergence"];
const STATUS_KEY = "status";

export class ResultsView {
  constructor(app) {
    this.app = app;
    this.layer = { contact: true, ellipse: true, points: true, arrows: false, regions: true };
    this.chosen = [];
    this.last = new Map();
    this.history = null;
    this.curvesChanged = newest(async () => this.courses());
    this.selected = newest(async () => this.select());
  }
  get frames() { return this.facts?.frames || 0; }
  get first() { return this.facts?.first_frame || 0; }
  async load() {
    this.facts = await get("api/result");
    this.views = this.facts.views || {};
    this.maps = new Map(this.facts.maps.map(one => [one.key, one]));
    this.curves = new Map(this.facts.curves.map(one => [one.key, one]));
    this.shown = FIRST_MAPS.find(key => this.maps.has(key)) || "";
    this.ticked = FIRST_CURVES.filter(key => this.curves.has(key));
    this.x = "time";
    this.chosen = [];
    this.history = null;
    this.arrows = this.facts.arrow_scale;
    const [triangles, range] = await Promise.all([
      this.facts.triangles ? arrays("api/result/triangles") : null, this.shown ? this.rangeOf(this.shown) : null]);
    this.triangles = triangles?.arrays.triangles.values;
    this.range = range;
  }
  async rangeOf(key) { return (await get(`api/result/range?key=${encodeURIComponent(key)}`)).range; }
  async enter() {
    const { app } = this;
    app.picture.layers = (pen, at, size) => this.draw(pen, at, size);
    app.picture.gestures = { down: (...a) => this.hold(...a), move: (x, y) => this.outline(x, y), up: () => this.close(),
      click: (x, y) => this.pick(x, y), hover: () => this.drawing ? "crosshair" : "pointer" };
    const has = name => this.facts.curves.some(one => one.key.startsWith(name));
    $("layers").replaceChildren(...[
      this.maps.size ? make("label", {}, "Map ", this.mapBox()) : null,
      toggle("contact", this.layer.contact, on => this.set("contact", on), "Real contact, recomputed with the settings of the result"),
      has("ellipse") ? toggle("ellipse", this.layer.ellipse, on => this.set("ellipse", on)) : null,
      this.facts.points ? toggle("points", this.layer.points, on => this.set("points", on)) : null,
      this.arrows ? toggle("displacement", this.layer.arrows, on => this.set("arrows", on),
        `Arrows, ${this.arrows} times as long as the displacement`) : null,
      this.facts.cells.length ? toggle("regions", this.layer.regions, on => this.set("regions", on)) : null,
      this.facts.points ? make("button", { id: "region", onclick: () => this.startRegion() }, "Draw region") : null,
    ].filter(Boolean));
    $("hint").textContent = this.facts.points ? "Click a point for its curve; scroll to zoom, double-click to see all." : "";
    $("save-csv").hidden = !this.facts.points;
    $("chart-csv").hidden = false;
    this.panel();
    this.legend();
    this.courseBar();
    $("courses").hidden = !this.curves.size;
    await this.courses();
  }
  set(name, on) {
    this.layer[name] = on;
    this.legend();
    if (name === "contact") this.app.show();
    else this.app.picture.redraw();
  }
  mapBox() {
    const group = { point: "per point", triangle: "per triangle" };
    const options = [{ key: "", label: "none", group: "" }, ...[...this.maps.values()].map(one =>
      ({ key: one.key, label: labelOf(one.key), group: group[one.of] }))];
    return select(options, this.shown, key => this.show(key), { id: "map" });
  }
  show = newest(async key => {
    const range = key && key !== STATUS_KEY ? await this.rangeOf(key) : null;
    [this.shown, this.range] = [key, range];
    await this.app.show();
    this.legend();
    this.selected();
  });
  panel() {
    const { facts } = this, wrong = facts.recording_error;
    this.numbers = make("dl", { className: "numbers" });
    this.point = make("div", { id: "point" }, make("p", { className: "soft" }, "Click a point, or draw a region around several."));
    $("panel").replaceChildren(...[
      make("div", { className: "card" }, make("h2", {}, "This frame"), this.numbers),
      facts.points ? make("div", { className: "card" }, make("h2", {}, "Selected points"), this.point) : null,
      make("div", { className: "card" }, make("div", { className: "bar" }, make("h2", {}, "Report"),
        make("button", { id: "report", disabled: Boolean(wrong), onclick: () => this.report() }, "Write report"), make("span", { id: "report-link" })),
        make("div", { id: "report-progress" })),
      make("details", { className: "card", open: facts.warnings.length > 0 && facts.warnings.length < 3 },
        make("summary", {}, facts.warnings.length ? `Warnings of this result (${facts.warnings.length})` : "No warnings"),
        facts.warnings.map(one => make("p", { className: "warned" }, one))),
      wrong ? make("div", { className: "card wrong" }, `The recording cannot be opened: ${wrong}`) : null,
      make("div", { className: "card" }, make("p", { className: "soft" },
        "NaN means unknown, drawn as a grey ring or a gap. A point has no values before it touches and while it is lost.")),
    ].filter(Boolean));
  }
  async frame(k) {
    const { shown, range } = this;  // of this frame, whatever is chosen meanwhile
    const query = `frame=${k}${shown ? `&shown=${encodeURIComponent(shown)}` : ""}${this.layer.contact && this.app.ready ? "&contact=1" : ""}`;
    this.found = { key: shown, range, ...await arrays(`api/result/frame?${query}`) };
    const place = this.found.arrays.position?.values, status = this.found.arrays.status?.values;
    if (place) for (let i = 0; i < status.length; i++) {
      if (Number.isFinite(place[2 * i])) this.last.set(i, [place[2 * i], place[2 * i + 1]]);
    }
    return [this.found, this.views.contact || this.views.camera];
  }
  after(k) {
    const numbers = this.found.numbers, force = numbers.normal_force;
    $("where").value = `frame ${k + this.first}   ${digits(numbers.time, 4)} s${force === undefined ? "" : `   ${digits(force, 3)} N`}`;
    const rows = this.facts.curves.filter(({ key }) => key in numbers.text && !key.startsWith("ellipse"));
    if (!this.cells) {
      this.cells = new Map(rows.map(({ key }) => [key, make("dd")]));
      this.numbers.replaceChildren(...rows.map(({ key, said }) => make("div", { title: said },
        make("dt", {}, labelOf(key)), this.cells.get(key), make("dd", { className: "unit" }, unitOf(key)))));
    }
    for (const { key } of rows) this.cells.get(key).textContent = numbers.text[key];
    if (this.chosen.length === 1) this.tell();
    this.app.chart.cursor(k);
  }
  colourOf() {
    const { key, range, arrays: { status, shown } } = this.found;
    if (key === STATUS_KEY) return i => marks.statusColour(status.values[i]);
    if (shown && this.maps.get(key)?.of === "point") {
      const colour = scale(range);
      return i => colour(shown.values[i]);
    }
    return () => "#7dff9b";
  }
  places() { return marks.placesIn(this.views, this.facts.mm_per_px, this.facts.topography_to_contact); }
  draw(pen, at, size) {
    if (!this.found) return;
    const { numbers, arrays: found } = this.found, places = this.places(), of = this.maps.get(this.found.key)?.of;
    const position = found.position?.values;
    if (!Object.keys(this.views).length) {
      pen.text(14, 26, "Recording not found: curves and tables only.", { fill: "#fff" });
      return;
    }
    if (of === "triangle" && position && this.triangles && found.shown) {
      const colour = scale(this.found.range), angles = found.principal_angle?.values;
      for (const { of: to } of places) marks.drawTriangles(pen, at, to, position, this.triangles, found.shown.values, colour, angles);
    }
    if (this.layer.regions) for (const name of this.facts.cells) if (found[name] && (name === "stuck_region" || !this.layer.ellipse)) {
      for (const { of: to } of places) marks.drawCells(pen, at, to, found[name].values, found[name].shape, numbers[name]);
    }
    if (this.layer.ellipse) marks.drawEllipse(pen, at, places, numbers.ellipse_center, numbers.ellipse_semi_axes, numbers.ellipse_angle);
    if (position) {
      const chosen = new Set(this.chosen), colour = this.colourOf(), radius = Math.max(1.2, Math.min(6, (of === "triangle" ? 1.8 : 4.2) * size));
      for (const { of: to } of places) {
        if (this.layer.arrows && found.displacement) marks.drawArrows(pen, at, to, position, found.displacement.values, this.arrows);
        if (this.layer.points) {
          marks.drawPoints(pen, at, to, position, of === "triangle" ? () => "#222" : colour, { radius, chosen });
          const lost = [...this.last].filter(([i]) => !Number.isFinite(position[2 * i])).map(([, place]) => place);
          marks.drawLost(pen, at, to, lost);
        }
      }
    }
    if (this.drawing?.length) pen.line(this.drawing.map(([x, y]) => at(x, y)), { stroke: "#fff", width: 2, dash: [5, 3] });
    if (this.region) pen.line(this.region.map(([x, y]) => at(x, y)), { stroke: "#fff", width: 1.4, dash: [5, 3], closed: true });
  }
  legend() {
    const entries = [], one = this.maps.get(this.shown), mark = (name, text) => make("span", {}, make("i", { className: name }), text);
    if (one && this.shown === STATUS_KEY) {
      (this.facts.flags.status || []).forEach((name, k) => {
        const swatch = make("i", { className: "swatch" });
        swatch.style.background = marks.statusColour(k);
        entries.push(make("span", {}, swatch, words(name)));
      });
    } else if (one && this.range) {
      const bar = make("canvas", { className: "scale", width: 256, height: 1 }), pen = bar.getContext("2d");
      scale(this.range).colours.forEach((colour, k) => { pen.fillStyle = colour; pen.fillRect(k, 0, 1, 1); });
      const limit = k => {
        const box = make("input", { type: "number", step: "any", value: +shown(this.shown, this.range[k]).toPrecision(3) });
        box.setAttribute("aria-label", k ? "largest colour" : "smallest colour");
        box.addEventListener("change", () => {
          const range = [...this.range];
          range[k] = +box.value / shown(this.shown, 1);
          if (!(range[0] < range[1])) return say("The smallest value of the colour scale must be below the largest.");
          this.range = this.found.range = range;
          say("");
          this.legend();
          this.app.picture.redraw();
        });
        return box;
      };
      const ring = make("i", { className: "ring" });
      ring.style.borderColor = UNKNOWN;
      entries.push(make("span", { className: "wide" }, limit(0), bar, limit(1), ` ${unitOf(this.shown)}  ${one.said}`));
      entries.push(make("span", {}, one.of === "point" ? ring : "", one.of === "point" ? "unknown (NaN)" : "no colour: NaN"));
    }
    if (this.shown.startsWith("principal_strains")) entries.push(make("span", {}, "— direction of the major principal strain"));
    if (this.layer.contact) entries.push(mark("mask", "real contact"));
    if (this.layer.ellipse && this.facts.curves.some(({ key }) => key.startsWith("ellipse"))) entries.push(mark("ellipse", "gross contact (ellipse)"));
    if (this.layer.arrows) entries.push(mark("arrow", `displacement × ${this.arrows}`));
    if (this.layer.points && this.facts.points) entries.push(make("span", {}, make("i", { className: "lost" }, "×"), "lost (last position)"));
    if (this.layer.regions && this.facts.cells.includes("stuck_region")) entries.push(mark("stuck", "border of the stick region"));
    $("legend").replaceChildren(...entries);
  }
  // Points.
  pick(x, y) {
    const position = this.found?.arrays.position?.values, reach = 12 / this.app.picture.view.scale;
    let best = null, least = reach;
    if (position) for (const { of } of this.places()) for (let i = 0; 2 * i < position.length; i++) {
      const [px, py] = of(position[2 * i], position[2 * i + 1]), off = Math.hypot(px - x, py - y);
      if (off < least) { least = off; best = i; }
    }
    this.region = null;
    this.choose(best === null ? [] : [best]);
  }
  choose(points) {
    this.chosen = points;
    this.app.picture.redraw();
    this.selected();
  }
  async select() {
    const key = this.shown && this.shown !== STATUS_KEY && this.maps.get(this.shown)?.of === "point" ? this.shown : FIRST_MAPS.find(one => this.maps.get(one)?.of === "point");
    this.history = this.chosen.length && key ? { key, ...await postArrays("api/result/history", { key, points: this.chosen }) } : null;
    this.tell();
    await this.courses();
  }
  tell() {
    if (!this.chosen.length) {
      return this.point.replaceChildren(make("p", { className: "soft" }, "Click a point, or draw a region around several."));
    }
    const k = this.app.frame, found = this.found.arrays, key = this.history?.key, label = key && labelOf(key);
    const units = key && unitOf(key), here = key && shown(key, this.history.arrays.values.values[k]);
    if (this.chosen.length === 1) {
      const i = this.chosen[0], status = this.history?.arrays.status?.values, names = (this.facts.flags.status || []);
      const counts = names.map((name, s) => [name, status ? status.filter(one => one === s).length : 0]).filter(([, n]) => n);
      const at = [0, 1].map(c => found.position.values[2 * i + c]);
      return this.point.replaceChildren(make("dl", { className: "numbers" }, [
        ["point", `${i}`, ""], ["status now", words(names[found.status.values[i]] || "–"), ""],
        ["position on the glass", at.map(v => digits(v, 5)).join(", "), "mm"], [`${label} now`, Number.isNaN(here) ? "NaN" : digits(here), units],
      ].map(([name, value, unit]) => make("div", {}, make("dt", {}, name), make("dd", {}, value), make("dd", { className: "unit" }, unit)))),
      make("p", { className: "soft" }, `Over all frames: ${counts.map(([name, n]) => `${words(name)} in ${n}`).join(", ")}.`));
    }
    this.point.replaceChildren(make("p", {}, `${this.chosen.length} points, selected in frame ${this.regionFrame + this.first}: their median ${label} is plotted below.`),
      make("p", { className: "soft" }, `${digits(here)} ${units} in this frame, from ${this.history?.arrays.known.values[k]} points with a value. The same points in all frames, with equal weights.`));
  }
  startRegion() {
    this.drawing = this.drawing ? null : [];
    $("region").classList.toggle("on", Boolean(this.drawing));
  }
  hold(x, y) {
    if (!this.drawing) return false;
    this.drawing = [[x, y]];
    return true;
  }
  outline(x, y) {
    this.drawing.push([x, y]);
    this.app.picture.redraw();
  }
  close() {
    const outline = this.drawing, position = this.found.arrays.position.values;
    this.drawing = null;
    $("region").classList.remove("on");
    const inside = new Set();
    for (const { of } of this.places()) for (let i = 0; 2 * i < position.length; i++) {
      if (marks.inside(outline, ...of(position[2 * i], position[2 * i + 1]))) inside.add(i);
    }
    this.region = outline;
    this.regionFrame = this.app.frame;
    if (!inside.size) say("No tracked point lies inside the region.");
    else say("");
    this.choose([...inside]);
  }
  async report() {
    try {
      const state = await post("api/report", {});
      $("report").disabled = true;
      $("report-link").replaceChildren();
      const { failed, to, page } = await follow("report", state, $("report-progress"));
      $("report").disabled = false;
      if (!failed) $("report-link").replaceChildren(make("a", { href: page, target: "_blank", rel: "noopener", title: to }, "Open the report"));
    } catch (error) { say(error.message); }
  }
  // Curves.
  courseBar() {
    const numeric = [{ key: "time", label: titleOf("time") }, ...[...this.curves.values()].map(one => ({ key: one.key, label: labelOf(one.key) }))];
    const boxes = [...this.curves.values()].filter(one => !["frame_status"].includes(one.key)).map(one => {
      return toggle(labelOf(one.key), this.ticked.includes(one.key), on => {
        this.ticked = on ? [...this.ticked, one.key] : this.ticked.filter(key => key !== one.key);
        this.curvesChanged();
      }, one.said);
    });
    $("course-bar").replaceChildren(make("h2", {}, "Curves"), make("label", {}, "against ", select(numeric, this.x, key => { this.x = key; this.curvesChanged(); }, { id: "against" })),
      make("details", { className: "menu", id: "curve-menu" }, make("summary", {}, "Choose curves"), make("div", {}, boxes)));
    $("chart-hint").textContent = "Click or drag to choose a frame. Gaps are NaN.";
  }
  async courses() {
    if (!this.curves.size) return;
    const keys = [...new Set([this.x, ...this.ticked])];
    const found = (await postArrays("api/result/courses", { keys })).arrays;
    const curves = this.ticked.map(key => ({ label: labelOf(key), units: unitOf(key), values: allShown(key, found[key].values) }));
    if (this.history) {
      const who = this.chosen.length === 1 ? `point ${this.chosen[0]}` : `median of ${this.chosen.length} points`;
      const { key, arrays: { values } } = this.history;
      curves.push({ label: `${labelOf(key)} of ${who}`, units: unitOf(key), values: allShown(key, values.values), dashed: true });
    }
    this.app.chart.show({ label: titleOf(this.x), values: allShown(this.x, found[this.x].values) }, curves);
    this.app.chart.cursor(this.app.frame);
  }
  async saveTable() {
    const text = await postText("api/result/table", { of: "courses", keys: this.ticked, points: this.chosen, shown: this.history?.key });
    download("curves.csv", new Blob([text], { type: "text/csv" }));
  }
  async saveFrame() {
    const text = await postText("api/result/table", { of: "frame", frame: this.app.frame, shown: this.shown || null });
    download(`frame-${this.app.frame + this.first}.csv`, new Blob([text], { type: "text/csv" }));
  }
}
