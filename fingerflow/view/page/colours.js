// Colours that people who confuse red and green tell apart too: RdBu (ColorBrewer), viridis, Okabe & Ito (2008).
const DIVERGING = ["#2166ac", "#67a9cf", "#d1e5f0", "#f7f7f7", "#fddbc7", "#ef8a62", "#b2182b"];
const RISING = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"];
export const LINES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
export const UNKNOWN = "#b7bec7";
export const STATUS = ["#56b4e9", "#000000", "#999999", "#f0e442", "#d55e00", "#cc79a7", "#e69f00", "#7b3fb5", "#0072b2",
  "#5c6670"];

const parsed = stops => stops.map(one => [1, 3, 5].map(k => parseInt(one.slice(k, k + 2), 16)));
const table = stops => Array.from({ length: 256 }, (_, k) => {
  const place = k / 255 * (stops.length - 1), left = Math.min(Math.floor(place), stops.length - 2), part = place - left;
  return `rgb(${stops[left].map((c, i) => Math.round(c + (stops[left + 1][i] - c) * part)).join()})`;
});
const TABLES = { diverging: table(parsed(DIVERGING)), rising: table(parsed(RISING)) };

// Value to colour over a range; one that lies about 0 has its light middle there.
export function scale([low, high]) {
  const colours = TABLES[low < 0 ? "diverging" : "rising"];
  const colour = value => Number.isFinite(value)
    ? colours[Math.max(0, Math.min(255, Math.round((value - low) / (high - low) * 255)))] : null;
  colour.range = [low, high];
  colour.colours = colours;
  return colour;
}
