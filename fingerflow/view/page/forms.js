// Inputs for the keys of a scene, made from the table that the scene is checked with.
import { browseButton } from "./browser.js";
import { make, select, title, words } from "./elements.js";

const SLIDERS = { "contact.threshold": [0.02, 0.9, 0.01], "contact.median_px": [3, 15, 2], "contact.gross_radius_px": [1, 40, 1] };
const OPEN = new Set(["contact"]);

// `changed(key, value)` is called with null where a key is left out; `live` says that more of it will come.
export function makeForms(setup, changed) {
  const kind = select(setup.kinds.map(key => ({ key, label: words(key) })), setup.kind, value => changed("kind", value));
  const made = [make("label", { className: "field" }, make("span", {}, "Kind of scene"), kind)];
  const updates = [found => { kind.value = found.kind; }];
  for (const [table, { help, keys }] of Object.entries(setup.forms)) {
    if (!keys.length || table === "stream") continue;
    const rows = keys.map(key => row(`${table}.${key.name}`, key, changed, updates));
    const group = make("details", { open: OPEN.has(table) }, make("summary", { title: help }, title(table)), rows);
    group.dataset.table = table;
    made.push(group);
  }
  const files = make("datalist", { id: "files" });
  made.push(files);
  updates.push(found => files.replaceChildren(...found.files.map(value => make("option", { value }))));
  const update = found => {
    updates.forEach(one => one(found));
    const wrong = new Map(found.problems.map(({ key, said }) => [key, said]));
    made.forEach(group => group.querySelectorAll?.("[data-key]").forEach(field => {
      const said = wrong.get(field.dataset.key) || "";
      field.classList.toggle("wrong", Boolean(said));
      field.querySelector(".said").textContent = said;
      if (said && group.tagName === "DETAILS") group.open = true;
    }));
  };
  update(setup);
  return { elements: made, update };
}

function valueAt(values, key) {
  return key.split(".").reduce((place, name) => place?.[name], values);
}

const listed = value => value === null || value === undefined ? [] : Array.isArray(value) ? value : [value];

// Menus of the columns of the force file: one, or `several` of which all but the first may stay empty.
function columns(key, several, send, updates) {
  const boxes = Array.from({ length: several }, (_, k) => make("select"));
  let values = [];
  boxes.forEach((box, k) => {
    box.setAttribute("aria-label", k ? `${key} ${k + 1}` : key);
    box.addEventListener("change", () => {
      const chosen = boxes.map(one => values[one.selectedIndex]).filter(one => one !== null);
      send(chosen.length > 1 ? chosen : chosen[0] ?? null);
    });
  });
  updates.push(found => {
    const set = listed(valueAt(found.values, key));
    const wanted = [null, ...new Set([...found.channels, ...set])], same = wanted.join() === values.join();  // else an open menu closes
    values = wanted;
    boxes.forEach((box, k) => {
      if (!same) box.replaceChildren(...values.map(one => make("option", {}, one === null ? (k ? "no second column" : "none") : `${one}`)));
      box.selectedIndex = values.indexOf(set[k] ?? null);
    });
  });
  return make("span", { className: "row" }, boxes);
}

// A button for each force channel, normal force first, that turns its sign.
function signs(key, send, updates) {
  const place = make("span", { className: "row" });
  updates.push(found => {
    const names = ["normal", "tangential"].flatMap(name => listed(valueAt(found.values, `forces.${name}`)));
    const set = listed(valueAt(found.values, key)), all = names.map((_, k) => (set.length > 1 ? set[k] : set[0]) ?? 1);
    place.replaceChildren(...names.map((name, k) => {
      const button = make("button", { title: "Turns the sign of this channel: pressing must be positive", onclick: () => {
        const turned = all.map((sign, n) => n === k ? -sign : sign);
        send(turned.every(sign => sign === turned[0]) ? (turned[0] === 1 ? null : turned[0]) : turned);
      } }, `${all[k] < 0 ? "\u2212" : "+"} ${name}`);
      button.setAttribute("aria-label", `${key} ${k + 1}`);
      return button;
    }));
  });
  return place;
}

function row(key, form, changed, updates) {
  const send = value => changed(key, value === "" ? null : value);
  const name = make("span", { title: form.help }, form.label);
  const field = make("div", { className: "field" }, name);
  field.dataset.key = key;
  const placeholder = form.default === null || form.default === undefined ? (form.needed ? "needed" : "none")
    : typeof form.default === "string" ? form.default : JSON.stringify(form.default);
  const add = (input, read, write) => {
    input.setAttribute("aria-label", key);
    field.append(input);
    input.addEventListener("change", () => send(read()));
    updates.push(found => { if (document.activeElement !== input) write(valueAt(found.values, key) ?? null); });
  };
  const slider = SLIDERS[key];
  if (form.input === "switch") {
    const box = make("input", { type: "checkbox" });
    add(box, () => box.checked, value => { box.checked = value ?? form.default; });
  } else if (form.input === "choice") {
    const options = form.words.map(word => ({ key: word, label: words(word) }));
    if (form.number) options.push({ key: "number", label: "a number" });
    if (form.default === null) options.unshift({ key: "", label: "none" });
    const range = slider && make("input", { type: "range", min: slider[0], max: slider[1], step: slider[2] });
    const shown = slider && make("output");
    const box = select(options, form.default ?? "", value => send(value === "number" ? +range.value : value));
    box.setAttribute("aria-label", key);
    field.append(box);
    if (range) {
      range.setAttribute("aria-label", `${key} number`);
      range.addEventListener("input", () => { shown.value = range.value; box.value = "number"; send(+range.value); });
      field.append(range, shown);
    }
    updates.push(found => {
      const value = valueAt(found.values, key) ?? form.default ?? "";
      box.value = typeof value === "number" ? "number" : value;
      if (range && document.activeElement !== range) range.value = typeof value === "number" ? value : 0.25;
      if (range) range.disabled = shown.disabled = false;
      if (shown) shown.value = typeof value === "number" ? value : "";
    });
  } else if (slider) {
    const range = make("input", { type: "range", min: slider[0], max: slider[1], step: slider[2] });
    const shown = make("output");
    range.setAttribute("aria-label", key);
    range.addEventListener("input", () => { shown.value = range.value; send(+range.value); });
    field.append(range, shown);
    updates.push(found => {
      const value = valueAt(found.values, key) ?? form.default;
      if (document.activeElement !== range) range.value = value;
      shown.value = value;
    });
  } else if (form.input === "whole" || form.input === "number") {
    const input = make("input", { type: "number", placeholder, step: form.input === "whole" ? (form.odd ? 2 : 1) : "any" });
    if (form.odd) input.min = form.least;
    add(input, () => input.value === "" ? null : +input.value, value => { input.value = value ?? ""; });
  } else if (form.input === "column") {
    field.append(columns(key, form.several, send, updates));
  } else if (form.input === "signs") {
    field.append(signs(key, send, updates));
  } else if (form.input === "toml") {
    const input = make("input", { type: "text", placeholder });
    add(input, () => input.value === "" ? null : { toml: input.value },
      value => { input.value = value === null ? "" : typeof value === "string" ? value : JSON.stringify(value); });
  } else {
    const input = make("input", { type: "text", placeholder, list: form.input === "file" ? "files" : "" });
    add(input, () => input.value, value => { input.value = value ?? ""; });
    if (form.input === "file") field.append(make("span", { className: "row" }, input, browseButton(input, key, form.label)));
  }
  field.append(make("small", { className: "said" }));
  return field;
}
