// Scale, transform and lens from pictures of a ring, a target and a chessboard, and the picture of what was found in them.
import { pictureUrl, say } from "./net.js";
import { browseButton } from "./browser.js";
import { digits, make } from "./elements.js";

const FILES = [["ring", "ring", "gives the scale"], ["target", "target with three discs", "only with two views"],
  ["background", "empty glass", "optional"], ["chessboard", "chessboard for the lens", "optional"]];

// `ask(files)` gives the scene, of which the new calibration is a part; `found(facts)` is called with it.
export class CalibrationCard {
  constructor(ask, found) {
    this.inputs = {};
    const row = (name, label, attributes) => {
      this.inputs[name] = make("input", attributes);
      this.inputs[name].setAttribute("aria-label", `calibrate ${name}`);
      const chosen = attributes.list ? [browseButton(this.inputs[name], label)] : [];
      return make("div", { className: "field" }, make("span", {}, label), make("span", { className: "row" }, this.inputs[name], chosen));
    };
    const rows = FILES.map(([name, label, placeholder]) => row(name, label, { type: "text", placeholder, list: "files" }));
    rows.push(row("corners", "its inner corners, a row and a column", { type: "text", placeholder: "such as 9 6" }));
    rows.push(row("hole_radius_mm", "radius of the hole (mm)", { type: "number", step: "any", min: 0, value: 2.75 }));
    this.button = make("button", { id: "calibrate", onclick: () => this.run(ask, found) }, "Find scale, transform and lens");
    this.said = make("div");
    this.image = make("img", { id: "calibration-picture", alt: "Calibration pictures with the detected outlines" });
    this.link = make("a", { target: "_blank", rel: "noopener", title: "Open at full size", hidden: true }, this.image);
    this.element = make("details", { className: "card", id: "calibration" }, make("summary", {}, "Calibrate from pictures"),
      make("p", { className: "soft" }, "Place the views first: the discs are searched for inside them. Writes calibration.toml and its overlay next to the scene."),
      rows, make("div", { className: "bar" }, this.button), this.said, this.link);
  }
  async run(ask, found) {
    const asked = Object.fromEntries(Object.entries(this.inputs).map(([name, box]) => [name, box.value]));
    asked.hole_radius_mm = +asked.hole_radius_mm;
    asked.corners = (asked.corners.match(/\d+/g) || []).map(Number);
    this.button.disabled = true;
    say("");
    try {
      const facts = await ask(asked), { mm_per_px: scale, warnings } = facts.calibrated;
      this.said.replaceChildren(make("p", { className: "good" }, `${digits(scale, 5)} mm per px. Check that the outlines match the ring and the discs:`),
        ...warnings.map(one => make("p", { className: "warned" }, one)));
      this.image.removeAttribute("src");  // the same address, another picture
      found(facts);
    } catch (error) {
      say(error.message);
    } finally { this.button.disabled = false; }
  }
  // Whether the calibration of the scene has a picture.
  async show(there) {
    this.link.hidden = !there;
    if (!there || this.image.src) return;
    try { this.link.href = this.image.src = await pictureUrl("api/calibration.png"); } catch (error) { say(error.message); }
  }
}
