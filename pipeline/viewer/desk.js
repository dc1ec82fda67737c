// The page's own furniture: what is written on it once, what is switched off when, what each
// button, drag and key does to the state.
import { $, definitions, divider, fill, gestures, text } from "./ui.js";

export const SAMPLES = ["auto", "16", "64", "256", "1024"];

// The viewer's place and the background that suit a model.
export const ofModel = ({ pitch, blur }) => ({ yaw: 0, pitch: Number(pitch.toFixed(1)), zoom: 1, blur });

// What the page says of the map, once.
export function dress(about, materials) {
  const form = $("controls").elements;
  const count = about.channels.length === 6 ? "Six" : about.channels.length;
  $("tag-six").textContent = `${count} channels`;
  $("subtitle").textContent = `${count} channels against three, in measured light`;
  fill(form.model, about.models);
  fill(form.material, materials.map(({ label }, k) => ({ id: String(k), label })));
  fill(form.lobe, about.lobes);
  fill(form.samples, SAMPLES.map((id) => ({ id, label: id === "auto" ? "By roughness" : id })));
  fill(form.white, about.look.whites);
  form.rough.max = about.roughnesses.length - 1;
  definitions($("about"), [...about.facts, ["Numbers", `right to 1 in ${2 ** (about.bits + 1)}`]]);
  $("notes").replaceChildren(...about.notes.map((note) => text("li", note)));
}

// What of the form makes sense for what is shown.
export function furnish(now, model) {
  const form = $("controls").elements, onMap = now.view === "map";
  for (const name of ["model", "lobe", "samples", "blur"]) form[name].disabled = onMap;
  form.material.disabled = onMap || !model.chosen;
  form.rough.disabled = onMap || !(model.chosen || model.rough);
  form.white.disabled = form.degree.disabled = now.adapt === "none";
  for (const choice of form.compare) choice.disabled = onMap;
  const split = now.compare === "split";
  $("tag-six").hidden = onMap || now.compare === "three" || (split && now.divider < 0.12);
  $("tag-three").hidden = onMap || now.compare === "six" || (split && now.divider > 0.88);
  $("divider").hidden = onMap || !split;
  $("divider").style.left = `${100 * now.divider}%`;
  $("divider").setAttribute("aria-valuenow", Math.round(100 * now.divider));
  const sides = onMap ? [] : model.sides ?? [];
  $("sides").hidden = $("apart").hidden = !sides.length;
  const at = sides.findIndex(({ turn, white }) => Math.abs(turn - now.turn) < 0.5 && white === now.white);
  [...$("sides").children].forEach((button, k) => button.setAttribute("aria-pressed", k === at));
  if (at >= 0) {
    const [six, three] = ["six", "three"].map((way) => sides[at].apart[way].toFixed(1));
    $("apart").textContent = `The two paints are ${six} CIEDE2000 apart here by six channels, ${three} by three.`;
  } else if (sides.length) {
    $("apart").textContent = "Two paints that match where the first light prevails, and part where the other does.";
  }
  $("picture").setAttribute("aria-label", onMap ? "The environment, unwrapped" : `${model.label} in the environment`);
}

export function operate(state, models, canvas, refinement, about) {
  const form = $("controls").elements;
  // Another model is shown from where it looks best, in its own light.
  form.model.addEventListener("change", () => {
    const model = models[form.model.value], [side] = model.sides ?? [];
    state.set({ ...ofModel(model), probe: null,
      // A pair is compared with itself, in its own light; the rest six against three.
      ...(side ? { turn: side.turn, white: side.white, compare: "six" } : { white: about.look.whites[0].id, compare: "split" }) });
  });
  const every = about.models.flatMap(({ sides }) => sides ?? []);
  $("sides").replaceChildren(...every.map(({ label, turn, white }) => {
    const button = text("button", label[0].toUpperCase() + label.slice(1), { type: "button" });
    button.addEventListener("click", () => state.set({ turn, white, yaw: 0 }));
    return button;
  }));

  const orbit = (yaw, pitch) => state.set({ yaw: state.now.yaw + yaw, pitch: state.now.pitch + pitch });
  const turn = (degrees) => state.set({ turn: state.now.turn + degrees });
  const zoom = (factor) => state.set({ zoom: state.now.zoom * factor });
  const mark = (place) => {
    $("hint").classList.add("gone");
    state.set({ probe: place.map((share) => Math.min(Math.max(share, 0), 1)) });
  };
  const close = () => state.set({ probe: null });
  gestures(canvas, {
    moved(dx, dy, light) {
      if (light || state.now.view === "map") turn(-180 * dx);
      else orbit(-180 * dx, 180 * dy);
    },
    zoomed: (factor) => state.now.view === "model" && zoom(factor),
    tapped: mark,
    pressed(key, shift) {
      const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
      if (arrow && shift) mark((state.now.probe ?? [0.5, 0.5]).map((share, k) => share + 0.02 * arrow[k]));
      else if (arrow && state.now.view === "map") turn(5 * arrow[0]);
      else if (arrow) orbit(5 * arrow[0], -5 * arrow[1]);
      else if (key === "+" || key === "=") zoom(1.1);
      else if (key === "-") zoom(1 / 1.1);
      else if (key === "[" || key === "]") turn(key === "[" ? -5 : 5);
      else if (key === "p" || key === "P") mark([0.5, 0.5]);
      else if (key === "Escape") close();
      else return false;
      return true;
    },
  });
  divider($("divider"), $("stage"), () => state.now.divider, (share) => state.set({ divider: share }));
  $("reading-close").addEventListener("click", close);
  $("reset").addEventListener("click", () => state.reset());
  $("save").addEventListener("click", () => {
    refinement.again();
    canvas.toBlob((blob) => {
      const link = text("a", "", { download: `${words(about.name)}-${state.now.view === "map" ? "map" : state.now.model}.png` });
      link.href = URL.createObjectURL(blob);
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    });
  });
}

const words = (name) => name.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(0, 60) || "environment";
