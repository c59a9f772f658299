const data = JSON.parse(document.getElementById("cells").textContent);
const bytes = Uint8Array.from(atob(data.values), (each) => each.charCodeAt(0));
const values = new DataView(bytes.buffer);
const days = data.days.map((each) => Date.parse(each));
const map = document.getElementById("map"), parts = document.getElementById("parts");
const mark = map.appendChild(document.createElement("span"));
let chosen = 0;

const series = (cell) => days.map((day, number) => {
  const read = (axis) => values.getInt16(2 * (3 * (cell * days.length + number) + axis), true);
  const [col, row, sigma] = [0, 1, 2].map(read);
  return col < -32767 ? null : { day, moved: [col * data.unit_px, row * data.unit_px], sigma: sigma * data.unit_px };
}).filter(Boolean);

function element(name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function step(range) {
  const rough = range / 4, ten = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((each) => each * ten).find((each) => each >= rough);
}

function panel(picture, points, axis, top, velocity) {
  const [left, width, height] = [60, 720, 130];
  const year = 365.25 * 864e5, span = Math.max(days[days.length - 1] - days[0], 1);
  const ends = points.flatMap((each) => [each.moved[axis] - each.sigma, each.moved[axis] + each.sigma]);
  const low = Math.min(0, ...ends), range = Math.max(0.01, Math.max(0, ...ends) - low);
  const x = (day) => left + (day - days[0]) / span * width, y = (moved) => top + height - (moved - low) / range * height;
  const colour = axis ? "var(--row)" : "var(--col)";
  picture.append(element("text", { x: left, y: top - 8 }, (axis ? "row" : "column") + ", px"));
  for (let at = Math.ceil(low / step(range)) * step(range); at <= low + range; at += step(range)) {
    picture.append(element("line", { x1: left, x2: left + width, y1: y(at), y2: y(at), class: "grid" }));
    const digits = Math.max(0, -Math.floor(Math.log10(step(range)) + 1e-9));
    picture.append(element("text", { x: left - 8, y: y(at) + 4, "text-anchor": "end" }, at.toFixed(digits).replace(/^-(0\.?0*)$/, "$1")));
  }
  const middle = points.reduce((sum, each) => sum + each.day, 0) / points.length;
  const mean = points.reduce((sum, each) => sum + each.moved[axis], 0) / points.length;
  const line = [days[0], days[days.length - 1]].map((day) => `${x(day)},${y(mean + velocity * (day - middle) / year)}`);
  const inside = element("svg", { x: left, y: top, width, height, viewBox: `${left} ${top} ${width} ${height}` });
  inside.append(element("polyline", { points: line.join(" "), class: "line" }));
  picture.append(inside);
  for (const each of points) {
    const at = x(each.day), [high, below] = [each.sigma, -each.sigma].map((sigma) => y(each.moved[axis] + sigma));
    picture.append(element("line", { x1: at, x2: at, y1: high, y2: below, stroke: colour, opacity: 0.5 }));
    const dot = element("circle", { cx: at, cy: y(each.moved[axis]), r: points.length > 150 ? 1.5 : 3, fill: colour });
    dot.append(element("title", {}, `${new Date(each.day).toISOString().slice(0, 10)}: ${each.moved[axis].toFixed(3)} ± ${each.sigma.toFixed(3)} px`));
    picture.append(dot);
  }
  const years = span / year, first = new Date(days[0]).getUTCFullYear(), apart = Math.ceil(years / 10);
  for (let month = 0; month <= 12 * (years + 1); month += years > 2 ? 12 * apart : years > 0.7 ? 3 : 1) {
    const day = Date.UTC(first, month, 1);
    if (!axis || day < days[0] || day > days[0] + span) continue;
    picture.append(element("text", { x: x(day), y: top + height + 18, "text-anchor": "middle" }, new Date(day).toISOString().slice(0, years > 2 ? 4 : 7)));
  }
}

function choose(number) {
  chosen = number;
  const cell = data.cells[number], col = cell % data.cols, row = Math.floor(cell / data.cols);
  const [left, top, width, height] = data.box, [across, down] = data.across;
  const place = { left: left + col / across * width, top: top + row / down * height, width: width / across, height: height / down };
  mark.className = "mark";
  for (const [name, share] of Object.entries(place)) mark.style[name] = 100 * share + "%";
  const points = series(number), [x, y] = data.at[number], [first, second, sigma] = data.velocity[number];
  const part = data.region[number], state = part ? `moving part ${part}` : "stands still, as far as can be told";
  const sign = (each) => (each < 0 ? "−" : "+") + Math.abs(each).toFixed(3);
  const text = `x ${x}, y ${y}: (${sign(first)}, ${sign(second)}) ± ${sigma.toFixed(3)} px a year, ${points.length} of ${days.length} dates; ${state}.`;
  document.getElementById("told").textContent = text;
  const picture = element("svg", { viewBox: "0 0 800 360", class: "time", role: "img", "aria-label": "Displacement over time. " + text });
  if (points.length) [first, second].forEach((velocity, axis) => panel(picture, points, axis, 24 + 165 * axis, velocity));
  document.getElementById("time").replaceChildren(picture);
  parts.value = part;
}

function nearest(col, row, allowed = () => true) {
  const away = data.cells.map((cell) => {
    const [right, below] = [cell % data.cols + 0.5 - col, Math.floor(cell / data.cols) + 0.5 - row];
    return allowed(right, below) ? right * right + below * below : Infinity;
  });
  const least = away.reduce((best, each) => Math.min(best, each), Infinity);
  return least === Infinity ? chosen : away.indexOf(least);
}

map.addEventListener("click", (event) => {
  const shown = map.getBoundingClientRect(), [left, top, width, height] = data.box;
  const [col, row] = [(event.clientX - shown.left) / shown.width - left, (event.clientY - shown.top) / shown.height - top];
  if (col >= 0 && row >= 0 && col <= width && row <= height) choose(nearest(col / width * data.across[0], row / height * data.across[1]));
});
map.addEventListener("keydown", (event) => {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!way) return;
  event.preventDefault();
  const cell = data.cells[chosen], [col, row] = [cell % data.cols + 0.5, Math.floor(cell / data.cols) + 0.5];
  const ahead = (right, below) => {
    const [along, aside] = way[0] ? [right * way[0], below] : [below * way[1], right];
    return along > 0.5 && Math.abs(aside) <= along;
  };
  choose(nearest(col, row, ahead));
});

const middles = new Map();
data.region.forEach((part, number) => { if (part) middles.set(part, [...(middles.get(part) || []), number]); });
parts.add(new Option("none", 0));
[...middles.keys()].sort((one, other) => one - other).forEach((part) => parts.add(new Option(part, part)));
const middleOf = (part) => {
  const own = middles.get(part), sum = own.reduce(([col, row], number) => [col + data.cells[number] % data.cols, row + Math.floor(data.cells[number] / data.cols)], [0, 0]);
  const inside = nearest(sum[0] / own.length + 0.5, sum[1] / own.length + 0.5);
  return own.includes(inside) ? inside : own[Math.floor(own.length / 2)];
};
parts.addEventListener("change", () => { if (middles.has(Number(parts.value))) choose(middleOf(Number(parts.value))); });
document.getElementById("one").hidden = false;
choose(middles.has(1) ? middleOf(1) : nearest(data.across[0] / 2, data.across[1] / 2));
