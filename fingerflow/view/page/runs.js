// Commands that run beside the page: how far they are, their end, and what they said.
import { get, post } from "./net.js";
import { make } from "./elements.js";

const ASKED_MS = 400;

// Shows in `place` how far the run `of` is, until it ends; gives its last state.
export async function follow(of, state, place) {
  const bar = make("progress", { max: 1 }), words = make("span");
  place.replaceChildren(bar, words, make("button", { onclick: () => post("api/end", { of }) }, "End"));
  while (state.running) {
    if (state.of) bar.value = state.done / state.of;
    words.textContent = state.of ? ` ${state.step} ${state.done} of ${state.of} ` : " starting ";
    await new Promise(later => setTimeout(later, ASKED_MS));
    state = await get(`api/progress?of=${of}`);
  }
  const said = state.said.map(one => make("p", { className: "warned" }, one.replace(/^warning: /, "")));
  place.replaceChildren(...(state.failed ? [make("p", { className: "wrong" }, "The command failed:"), ...said] : said.slice(0, -1)));
  return state;
}
