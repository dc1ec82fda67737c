// The page: its parts put together.
import { camera } from "./camera.js";
import { displayFromXyz } from "./colour.js";
import { dress, furnish, ofModel, operate, SAMPLES } from "./desk.js";
import { Drawing } from "./draw.js";
import { context, Unable } from "./gl.js";
import { probe } from "./probe.js";
import { showReading } from "./reading.js";
import { Refinement } from "./refine.js";
import { State } from "./state.js";
import { $, bind, nearest, theme } from "./ui.js";
import { unpack } from "./unpack.js";

const MOST_PIXELS = 2.2e6; // of the picture: more would be memory that phones do not have
const READ_MS = 60;

theme($("theme"));
start().catch((error) => {
  if (!(error instanceof Unable)) throw error;
  sorry(error.message);
});

function sorry(sentence) {
  for (const id of ["stage", "controls", "reading"]) $(id).hidden = true;
  $("save").hidden = true;
  $("sorry").textContent = `${sentence} A current desktop or phone browser shows the page; the maps and`
    + " pictures beside it can be looked at without.";
  $("sorry").hidden = false;
}

async function start() {
  const about = JSON.parse($("contents").textContent);
  $("name").textContent = about.name || "An environment";
  document.title = `${about.name || "environment"} – sixlight`;
  const canvas = $("picture"), gl = context(canvas);
  if (typeof DecompressionStream === "undefined") {
    throw new Unable("This page unpacks its map with DecompressionStream, which this browser does not offer.");
  }
  canvas.addEventListener("webglcontextlost", () => sorry("The graphics driver has stopped drawing. Load the page again."));
  const arrays = await unpack($("numbers").textContent, about.arrays, about.taps);
  $("numbers").remove();

  const drawing = new Drawing(gl, about, arrays);
  const ways = { six: drawing.way("six"), three: drawing.way("three") };
  const models = Object.fromEntries(about.models.map((model) => [model.id, model]));
  const materials = about.materials.filter(({ label }) => label);
  const state = new State(...settings(about, materials));
  let size = [0, 0];

  const viewOf = (now) => {
    const model = models[now.model];
    if (now.view === "map") {
      const high = Math.min(1, size[0] / 2 / size[1]), wide = Math.min(1, (2 * size[1]) / size[0]);
      const level = Math.max(0, Math.log2((4 * about.map.size) / (size[0] * wide)));
      return { map: { place: [(1 - wide) / 2, (1 - high) / 2, wide, high], level, turn: (now.turn * Math.PI) / 180 } };
    }
    const chosen = about.roughnesses.find(({ alpha }) => alpha === nearest(alphas(about), now.rough));
    return {
      model: now.model,
      camera: camera(now, model, size[0] / size[1]),
      turn: now.turn,
      blur: now.blur,
      lobe: now.lobe,
      samples: now.samples === "auto" ? undefined : Number(now.samples),
      things: model.things.map(({ shape, at, material }) => {
        const used = material === null ? materials[now.material] : about.materials[material];
        const { alpha, form } = material === null || model.rough ? chosen : used;
        return { shape, at, material: used, alpha, form };
      }),
    };
  };

  const refinement = new Refinement(drawing, (busy) => canvas.setAttribute("aria-busy", busy));
  const draw = (now) => {
    // Light itself has the same XYZ in three channels: only what it falls on differs.
    const at = now.view === "map" ? size[0] : { six: 1, split: now.divider, three: 0 }[now.compare] * size[0];
    const gain = about.map.scale * 2 ** (now.ev + exposure(about, now.white));
    const look = {
      display_from_xyz: displayFromXyz(about.look, now, gain),
      rgb_from_xyz: Float32Array.from({ length: 9 }, (_, k) => about.look.rgb_from_xyz[k % 3][Math.floor(k / 3)]),
      knee: now.tone === "clip" ? 1 : about.look.knee,
    };
    const edge = Math.round(at);
    refinement.see(viewOf(now), [
      { way: ways.six, look, scissor: [0, 0, edge, size[1]] },
      { way: ways.three, look, scissor: [edge, 0, size[0] - edge, size[1]] },
    ].filter(({ scissor }) => scissor[2] > 0), size);
  };

  // Reading waits for the GPU: the first at once, others when what is read has stood for a moment.
  let read = null, waiting = 0;
  const readProbe = (now) => {
    const view = viewOf(now), key = JSON.stringify([now.probe, view]);
    clearTimeout(waiting);
    $("mark").hidden = $("reading").hidden = !now.probe;
    if (!now.probe) return void (read = null);
    [$("mark").style.left, $("mark").style.top] = now.probe.map((share) => `${100 * share}%`);
    if (key === read) return;
    const first = read === null, found = () => {
      read = key;
      const told = probe(drawing, ways, view, size, now.probe);
      if (told) showReading(told, about);
      else state.set({ probe: null });
    };
    if (first) found();
    else waiting = setTimeout(found, READ_MS);
  };

  const reflect = bind(state, {
    steps: { rough: alphas(about) },
    outputs: {
      rough: (alpha) => `α ${alpha}`,
      turn: (degrees) => `${Math.round(degrees)}°`,
      blur: (level) => (level > 0 ? String(level) : "none"),
      ev: (ev) => `${ev < 0 ? "−" : "+"}${Math.abs(ev).toFixed(2)} EV`,
      degree: (degree) => `${Math.round(100 * degree)} %`,
    },
  });
  const changed = (now) => {
    furnish(now, models[now.model]);
    draw(now);
    readProbe(now);
  };
  state.onChange(changed);
  dress(about, materials);
  operate(state, models, canvas, refinement, about);

  $("stage").hidden = $("controls").hidden = false;
  $("hint").classList.toggle("gone", Boolean(state.now.probe));
  new ResizeObserver(() => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const wide = canvas.clientWidth * ratio, high = canvas.clientHeight * ratio;
    const fewer = Math.min(1, Math.sqrt(MOST_PIXELS / (wide * high)));
    const wanted = [wide, high].map((length) => Math.max(1, Math.round(length * fewer)));
    if (wanted[0] === size[0] && wanted[1] === size[1]) return;
    [canvas.width, canvas.height] = size = wanted;
    reflect(state.now);
    changed(state.now);
  }).observe(canvas);
}

const alphas = (about) => about.roughnesses.map(({ alpha }) => alpha);
const exposure = ({ look }, white) => look.exposure_ev[white] ?? look.exposure_ev.map ?? 0;

// Defaults, choices and ranges of the state.
function settings(about, materials) {
  const [first] = about.models, form = $("controls").elements;
  const whites = about.look.whites.map(({ id }) => id), alpha = alphas(about);
  const range = ({ min, max }) => [Number(min), Number(max)];
  return [
    {
      view: "model", model: first.id, ...ofModel(first), material: "0", rough: nearest(alpha, 0.05),
      lobe: about.lobes[0].id, samples: "auto", turn: 0, compare: "split", divider: 0.5, ev: 0,
      tone: "shoulder", adapt: "cat02", white: whites[0], degree: 1, probe: null,
    },
    {
      view: ["model", "map"], model: about.models.map(({ id }) => id), material: materials.map((_, k) => String(k)),
      lobe: about.lobes.map(({ id }) => id), samples: SAMPLES, compare: ["six", "split", "three"],
      tone: ["shoulder", "clip"], adapt: [...Object.keys(about.look.adaptation), "none"], white: whites,
    },
    {
      yaw: [-180, 180, 360], pitch: [-85, 85], zoom: [0.4, 6], turn: [0, 360, 360], divider: [0, 1],
      rough: [alpha[0], alpha[alpha.length - 1]],
      blur: range(form.blur), ev: range(form.ev), degree: range(form.degree),
    },
  ];
}
