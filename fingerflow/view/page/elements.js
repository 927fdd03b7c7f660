// Small pieces of the page.
export const $ = id => document.getElementById(id);

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && name !== "list") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children.flat().filter(one => one !== null && one !== undefined));
  return element;
}

export function toggle(label, on, changed, title = "") {
  const box = make("input", { type: "checkbox", checked: on });
  box.addEventListener("change", () => changed(box.checked));
  return make("label", { className: "toggle", title }, box, label);
}

export function select(options, value, changed, attributes = {}) {
  const groups = new Map();
  for (const one of options) groups.set(one.group || "", [...(groups.get(one.group || "") || []), one]);
  const made = [...groups].map(([group, those]) => {
    const found = those.map(one => make("option", { value: one.key, textContent: one.label }));
    return group ? make("optgroup", { label: group }, found) : found;
  }).flat();
  const box = make("select", { ...attributes }, made);
  box.value = value;
  box.addEventListener("change", () => changed(box.value));
  return box;
}

// Variables as people read them: label, unit, and factor from the unit of the data set. A key may name a component.
let variables = {};
export const setVariables = table => { variables = table; };
const variable = key => variables[key.split(":")[0]] || { label: words(key), unit: "", factor: 1 };
export const labelOf = key => [variable(key).label, words(key.split(":")[1] || "")].filter(Boolean).join(" ");
export const unitOf = key => variable(key).unit;
export const titleOf = key => unitOf(key) ? `${labelOf(key)} (${unitOf(key)})` : labelOf(key);
export const shown = (key, value) => typeof value === "number" ? value * variable(key).factor : value;
export const allShown = (key, values) => Float64Array.from(values, value => value * variable(key).factor);

export function digits(value, count = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(2) : +value.toPrecision(count) + "";
}

// "gross_contact_area" -> "gross contact area", "strain:exx" -> "strain exx"
export const words = key => key.replace(/[_:]/g, " ");

// Heading of a table of the scene: "forces" -> "Forces".
export const title = table => table[0].toUpperCase() + table.slice(1);
