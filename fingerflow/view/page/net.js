// What is asked of the server: JSON, and answers of JSON with arrays (see packing.py).
const TYPES = { uint8: Uint8Array, int32: Int32Array, float32: Float32Array, float64: Float64Array };
// The token stands in the address that opens the page; only pages of this very address can read its session storage.
const token = new URLSearchParams(location.hash.slice(1)).get("token") || sessionStorage.getItem("token") || "";
sessionStorage.setItem("token", token);
history.replaceState(null, "", location.pathname);
const headers = { "Content-Type": "application/json", "X-Fingerflow": token };
const box = document.getElementById("error");

export function say(text) {
  box.textContent = text || "";
  box.hidden = !text;
}

// What was said is so no more; something else stays.
export function unsay(text) {
  if (box.textContent === text) say("");
}

async function answered(answer) {
  if (answer.ok) return answer;
  let said = {};
  try { said = await answer.json(); } catch { said = { error: `${answer.status} ${answer.statusText}` }; }
  throw Object.assign(new Error(said.error || "refused"), { asks: said.asks, refused: true });
}

const got = async path => answered(await fetch(path, { headers }));
export const get = async path => (await got(path)).json();
export const arrays = async path => unpacked(await (await got(path)).arrayBuffer());
export const pictureUrl = async path => URL.createObjectURL(await (await got(path)).blob());

async function sent(path, content) {
  return answered(await fetch(path, { method: "POST", headers, body: JSON.stringify(content) }));
}

export const post = async (path, content) => (await sent(path, content)).json();
export const postArrays = async (path, content) => unpacked(await (await sent(path, content)).arrayBuffer());
export const postText = async (path, content) => (await sent(path, content)).text();

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  let place = 8 + length + (-length & 7);
  const found = {};
  for (const { name, type, shape } of facts.arrays) {
    const values = new TYPES[type](buffer, place, shape.reduce((a, b) => a * b, 1));
    found[name] = { values, shape };
    place += values.byteLength + (-values.byteLength & 7);
  }
  return { ...facts, arrays: found };
}

// Runs `act` for what was asked last; what was asked while it ran, and asked again since, is left out.
export function newest(act) {
  let wanted, running = false;
  return async what => {
    wanted = { what };
    if (running) return;
    running = true;
    while (wanted) {
      const { what: now } = wanted;
      wanted = undefined;
      try { await act(now); } catch (error) { say(error.message); }
    }
    running = false;
  };
}

export function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
