// A dialog to choose a file, from the folder of the scene on.
import { get } from "./net.js";
import { make } from "./elements.js";

// A button that puts the path of a chosen file, relative to the scene file, into `input`; `words` say which file.
export function browseButton(input, what, words = what) {
  const button = make("button", { type: "button", title: "Choose a file", onclick: () => choose(input, words) }, "Browse");
  button.setAttribute("aria-label", `browse ${what}`);
  return button;
}

async function choose(input, words) {
  const place = make("p", { className: "soft" }), entries = make("div", { className: "entries" });
  const dialog = make("dialog", { className: "browser" }, make("h2", {}, `Choose a file: ${words}`), place, entries,
    make("button", { onclick: () => dialog.close() }, "Cancel"));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  const pick = path => {
    dialog.close();
    input.value = path;
    input.dispatchEvent(new Event("change"));
  };
  const show = async at => {
    try {
      const found = await get(`api/folder?at=${encodeURIComponent(at)}`), inside = name => found.at ? `${found.at}/${name}` : name;
      place.textContent = found.folder;
      entries.replaceChildren(
        make("button", { onclick: () => show(found.at ? `${found.at}/..` : "..") }, "↑ folder above"),
        ...found.folders.map(name => make("button", { onclick: () => show(inside(name)) }, `${name}/`)),
        ...found.files.map(name => make("button", { className: "file", onclick: () => pick(inside(name)) }, name)));
    } catch (error) { place.textContent = error.message; }
  };
  await show(input.value.includes("/") ? input.value.slice(0, input.value.lastIndexOf("/")) : "");
  dialog.showModal();
}
