// One cursor through all curves: a frame is pointed at in one figure, and every figure says its values there.
"use strict";
const facts = JSON.parse(document.getElementById("curves").textContent);
const NS = document.querySelector("svg") ? document.querySelector("svg").namespaceURI : null;
const figures = [...document.querySelectorAll("figure.curves")].map((element) => {
  const fact = facts[element.dataset.figure];
  const svg = element.querySelector("svg");
  const [, , width, height] = svg.getAttribute("viewBox").split(/\s+/).map(Number);
  const layer = svg.appendChild(document.createElementNS(NS, "g"));
  const [left, top, wide, high] = fact.box;
  const [x0, x1] = fact.xlim, [y0, y1] = fact.ylim;
  return {
    element, fact, svg, layer,
    across: (x) => width * (left + (wide * (x - x0)) / (x1 - x0)),
    down: (y) => height * (top + high * (1 - (y - y0) / (y1 - y0))),
    value: (share) => x0 + ((share - left) / wide) * (x1 - x0),
    ends: [height * top, height * (top + high)],
  };
});

function add(layer, tag, attributes) {
  const one = layer.appendChild(document.createElementNS(NS, tag));
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
}

let frame = -1;
function show(wanted) {
  const count = figures.length ? figures[0].fact.x.length : 0;
  frame = Math.max(0, Math.min(count - 1, wanted));
  for (const { element, fact, layer, across, down, ends } of figures) {
    layer.replaceChildren();
    const x = fact.x[frame];
    const told = fact.curves.map(({ name, y }) => `${name} ${y[frame] === null ? "not known" : `${Number(y[frame].toPrecision(4))} ${fact.unit}`.trim()}`);
    const where = x === null ? `frame ${facts.frames[frame]}` : `frame ${facts.frames[frame]}, ${fact.label} ${Number(x.toPrecision(4))}`;
    element.querySelector("output").textContent = `${where}: ${told.join(", ")}`;
    if (x === null) continue;
    add(layer, "line", { x1: across(x), x2: across(x), y1: ends[0], y2: ends[1], stroke: "#5b6b7a", "stroke-width": 0.7 });
    for (const { colour, y } of fact.curves) {
      if (y[frame] !== null) add(layer, "circle", { cx: across(x), cy: down(y[frame]), r: 2.6, fill: colour, stroke: "white" });
    }
  }
}

for (const { element, fact, svg, value } of figures) {
  const point = (event) => {
    const place = svg.getBoundingClientRect();
    const x = value((event.clientX - place.left) / place.width);
    let best = -1, least = Infinity;
    fact.x.forEach((one, index) => {
      if (one !== null && Math.abs(one - x) < least) [best, least] = [index, Math.abs(one - x)];
    });
    if (best >= 0) show(best);
  };
  element.addEventListener("pointermove", point);
  element.addEventListener("pointerdown", point);
  element.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (step) { event.preventDefault(); show(frame < 0 ? 0 : frame + step); }
  });
}
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => { one.open = true; }));
