// A spectrum with its uncertainty, as a small SVG.

const WIDTH = 320, HEIGHT = 132, FOOT = 16, TOP = 4;

export function plot(svg, { nm, power, around }, channels) {
  const first = nm[0], last = nm[nm.length - 1];
  const most = Math.max(...power.map((p, k) => p + around[k]), 1e-30);
  const least = Math.min(0, ...power);
  const x = (wavelength) => ((wavelength - first) / (last - first)) * WIDTH;
  const y = (value) => TOP + (1 - (Math.max(value, least) - least) / (most - least)) * (HEIGHT - FOOT - TOP);
  const line = (values) => values.map((value, k) => `${x(nm[k]).toFixed(1)},${y(value).toFixed(1)}`);
  const upper = line(power.map((p, k) => p + around[k]));
  const lower = line(power.map((p, k) => p - around[k])).reverse();
  svg.replaceChildren(
    ...[400, 500, 600, 700].flatMap((wavelength) => [
      element("line", { class: "axis", x1: x(wavelength), x2: x(wavelength), y1: TOP, y2: HEIGHT - FOOT }),
      element("text", { x: x(wavelength), y: HEIGHT - 3 }, `${wavelength} nm`),
    ]),
    element("path", { class: "band", d: `M${[...upper, ...lower].join("L")}Z` }),
    element("line", { class: "zero", x1: 0, x2: WIDTH, y1: y(0), y2: y(0) }),
    ...channels.map(({ peak_nm, colour }) =>
      element("rect", { x: x(peak_nm) - 3, y: HEIGHT - FOOT - 1.5, width: 6, height: 3, fill: colour })),
    element("path", { class: "line", d: `M${line(power).join("L")}` }),
  );
}

function element(name, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}
