// What the probe found, in words and figures.
import { chromaticity, spectrum, temperature } from "./colour.js";
import { plot } from "./plot.js";
import { $, definitions, text } from "./ui.js";

const ALL = 0.995; // of a texel: what rounds to 100 %

export function showReading(found, about) {
  const { what, values, xyz, three, sigma, valid } = found;
  $("reading-title").textContent = what === "light" ? "Light" : "Surface";
  $("reading-note").textContent = place(found);
  $("reading-trust").textContent = what === "light" ? trust(found) : "Its noise is the map’s, much averaged.";
  $("reading-trust").classList.toggle("alert", what === "light" && valid < ALL);
  plot($("plot"), spectrum(values, sigma, about.spectrum), about.channels);

  const xy = chromaticity(xyz), cct = xy && temperature(xy, about.locus);
  // Four digits of the largest, and as many places of the others.
  const largest = Math.max(...values.map(Math.abs), ...xyz.map(Math.abs)), power = exponent(largest);
  const places = Math.max(0, 3 - Math.floor(Math.log10(largest / 10 ** power || 1)));
  const scaled = (value) => (value / 10 ** power).toFixed(places);
  const triple = (numbers) => numbers.map(scaled).join("  ");
  const rows = [
    ["XYZ", triple(xyz)],
    ["x, y", xy ? xy.map((c) => c.toFixed(4)).join(", ") : "none"],
    ["CCT, Duv", cct ? `${Math.round(cct.kelvin)} K, ${signed(cct.duv, 4)}` : "none, so far from black bodies"],
  ];
  if (what === "surface") rows.push(["XYZ by three", triple(three)]);
  definitions($("colour"), rows);
  // In full, for those who read the page by program.
  Object.assign($("reading").dataset, { xyz: xyz.join(" "), values: values.join(" "), cct: cct ? cct.kelvin : "" });

  const unit = `${power ? `10${superscript(power)} ` : ""}${about.unit.replace("m2", "m²")}`;
  const withSigma = what === "light";
  const heads = [text("th", unit), text("th", "value"), text("th", "sigma")];
  $("values").tHead.replaceChildren(row(withSigma ? heads : heads.slice(0, 2)));
  $("values").tBodies[0].replaceChildren(...about.channels.map((channel, k) => {
    const name = document.createElement("th"), chip = text("span", "", { class: "chip" });
    chip.style.background = channel.colour;
    name.append(chip, `${channel.name}, ${Math.round(channel.peak_nm)} nm`);
    const cells = [name, text("td", scaled(values[k]))];
    const spread = sigma ? `± ${(sigma[k] / 10 ** power).toPrecision(2)}` : "–";
    return row(withSigma ? [...cells, text("td", spread)] : cells);
  }));
}

function place({ what, direction }) {
  if (what === "surface") return "What this spot of the model sends to the eye.";
  const [x, y, z] = direction;
  const degrees = (angle) => signed((180 / Math.PI) * angle, 1);
  return `From azimuth ${degrees(Math.atan2(x, z))}° (+Z towards +X), elevation ${degrees(Math.asin(y))}°.`;
}

// What `valid` and `sigma` say of a texel.
function trust({ values, sigma, valid }) {
  if (valid === 0) return "Not measured: the sphere does not show this direction. Filled smoothly from what is around it.";
  const measured = valid < ALL ? `${Math.round(100 * valid)} % of this texel was measured, the rest is filled.`
    : "All of this texel was measured.";
  if (!sigma) return `${measured} Its noise is not known.`;
  const norm = (numbers) => Math.hypot(...numbers);
  return `${measured} Noise: ${((100 * norm(sigma)) / norm(values)).toPrecision(2)} % (one standard deviation).`;
}

const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
const superscript = (power) => String(power).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻");

function row(cells) {
  const made = document.createElement("tr");
  made.append(...cells);
  return made;
}

// The power of ten, in threes, that leaves one to three digits before the point.
function exponent(value) {
  return value > 0 ? 3 * Math.floor(Math.log10(value) / 3) : 0;
}
