// The page: two tabs about one recording, a picture with a slider, and curves.
import { download, get, newest, post, say } from "./net.js";
import { $, setVariables, unitOf } from "./elements.js";
import { Chart } from "./chart.js";
import { Picture } from "./picture.js";
import { ResultsView } from "./results.js";
import { Setup } from "./setup.js";

const PLAY_MS = 33;

class App {
  constructor() {
    this.frame = 0;
    this.drawn = 0;
    this.ready = false;  // for more than pictures
    this.picture = new Picture($("picture"));
    this.chart = new Chart($("chart"), k => this.go(this.tab.frameOfChart ? this.tab.frameOfChart(k) : k));
    this.setup = new Setup(this);
    this.results = new ResultsView(this);
    this.frames = newest(async () => this.draw());
  }
  async start() {
    const units = table => { setVariables(table); $("unit").textContent = `Deformation in ${unitOf("divergence")}`; };
    units(await get("api/variables"));
    $("unit").onclick = async () => {
      units(await post("api/percent", {}));
      this.results.cells = null;
      await this.tab.enter();
      await this.show();
    };
    const draft = await this.setup.load();
    $("tab-setup").disabled = !draft;
    $("tab-results").disabled = !this.setup.facts.result;
    $("tab-setup").onclick = () => this.open(this.setup);
    $("tab-results").onclick = () => this.openResult();
    $("frame").addEventListener("input", () => this.go(+$("frame").value));
    $("play").onclick = () => this.play();
    $("save-png").onclick = () => $("picture").toBlob(blob => download(`${this.name()}.png`, blob));
    $("save-svg").onclick = () => download(`${this.name()}.svg`, this.picture.svg());
    $("save-csv").onclick = () => this.results.saveFrame().catch(error => say(error.message));
    $("chart-png").onclick = () => $("chart").toBlob(blob => download("curves.png", blob));
    $("chart-svg").onclick = () => download("curves.svg", this.chart.svg());
    $("chart-csv").onclick = () => this.results.saveTable().catch(error => say(error.message));
    document.addEventListener("keydown", event => this.key(event));
    const run = await get("api/progress?of=process");
    if (this.setup.facts.result && !run.running) return this.openResult();
    await this.open(this.setup);
    if (run.running) await this.setup.processed(run);  // the page was closed meanwhile
  }
  name() { return `frame-${this.frame + this.tab.first}`; }
  async openResult() {
    try {
      await this.results.load();
      this.results.cells = null;
    } catch (error) { return say(error.message); }
    $("tab-results").disabled = false;
    await this.open(this.results);
  }
  async open(tab) {
    const number = this.tab ? this.frame + this.tab.first : null;
    this.tab = tab;
    say("");
    $("tab-setup").className = tab === this.setup ? "on" : "";
    $("tab-results").className = tab === this.results ? "on" : "";
    $("about").textContent = tab === this.results ? tab.facts.path : tab.facts.recording?.path || tab.facts.draft || "";
    await this.measure();
    const unseen = number === null || tab === this.results && !this.seen;
    // A recording opens in its middle: the first frame shows empty glass.
    const start = !unseen ? number - tab.first : tab === this.results ? tab.facts.frame_of_largest_load : tab.frames >> 1;
    this.seen ||= tab === this.results;  // from then on both tabs show the same frame
    this.frame = Math.max(0, Math.min(tab.frames - 1, start));
    const first = this.show();
    await tab.enter();
    await first;
    if (!this.ready) {
      await get("api/ready");
      this.ready = true;
      await this.show();
    }
    if (this.tab === this.setup) this.setup.later();
  }
  async measure() { $("frame").max = Math.max(0, this.tab.frames - 1); }
  go(k) {
    this.frame = Math.max(0, Math.min(this.tab.frames - 1, k));
    $("frame").value = this.frame;
    return this.show();
  }
  show() {
    $("frame").value = this.frame;
    return this.frames();
  }
  async draw() {
    const { tab, frame } = this;
    if (!tab.frames) return;
    const [found, contact] = await tab.frame(frame);
    if (tab !== this.tab) return;
    this.picture.show(found, contact);
    this.drawn += 1;
    tab.after(frame);
    Object.assign($("picture").dataset, { frame, drawn: this.drawn, mask: "mask" in found.arrays });
  }
  play() {
    const running = this.playing;
    clearInterval(running);
    this.playing = null;
    $("play").textContent = "▶";
    if (running) return;
    $("play").textContent = "❚❚";
    this.playing = setInterval(() => this.go((this.frame + 1) % this.tab.frames), PLAY_MS);
  }
  key(event) {
    if (["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) && event.target.type !== "range" && event.target.type !== "checkbox") return;
    const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: 10, PageDown: -10, Home: -1e9, End: 1e9 };
    if (event.target.type === "range") return;
    if (event.key in steps) this.go(this.frame + steps[event.key]);
    else if (event.key === " " && event.target.tagName !== "BUTTON" && event.target.tagName !== "SUMMARY") this.play();
    else return;
    event.preventDefault();
  }
}

const app = new App();
app.start().catch(error => say(error.message));
