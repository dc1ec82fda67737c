// Controls, pointers and keys on one side, the state on the other. Names from captures are only
// ever set as text.

export const $ = (id) => document.getElementById(id);

// `outputs` writes a number as people read it; `steps` are the values that a slider counts.
export function bind(state, { outputs, steps }) {
  const form = $("controls");
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", ({ target }) => {
    if (target.name) state.set({ [target.name]: steps[target.name]?.[target.value] ?? target.value });
  });
  const reflect = (now) => {
    for (const input of form.elements) {
      const value = now[input.name];
      if (value === undefined) continue;
      if (input.type === "radio") input.checked = input.value === value;
      else input.value = steps[input.name] ? steps[input.name].indexOf(nearest(steps[input.name], value)) : value;
      const output = input.type === "range" && input.parentElement.querySelector("output");
      if (output) input.setAttribute("aria-valuetext", (output.textContent = outputs[input.name](value)));
    }
  };
  state.onChange(reflect);
  return reflect;
}

export const nearest = (values, wanted) =>
  values.reduce((best, value) => (Math.abs(value - wanted) < Math.abs(best - wanted) ? value : best));

export function fill(select, entries) {
  select.replaceChildren(...entries.map(({ id, label }) => text("option", label, { value: id })));
}

export function text(tag, words, attributes = {}) {
  const made = document.createElement(tag);
  made.textContent = words;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

export function definitions(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([term, words]) => [text("dt", term), text("dd", words)]));
}

// Drags, pinches, wheel, taps and keys on the picture: `moved(dx, dy, light)` in shares of its
// height, `zoomed(factor)`, `tapped([across, down])`, `pressed(key, shift)` -> whether it was known.
export function gestures(canvas, { moved, zoomed, tapped, pressed }) {
  const pointers = new Map();
  let travelled = 0, apart = 0;
  const share = ({ clientX, clientY }) => {
    const box = canvas.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  };
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    if (pointers.size === 1) travelled = 0;
    else apart = spread();
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    pointers.set(event.pointerId, event);
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    travelled += Math.hypot(dx, dy);
    if (pointers.size === 2) {
      const now = spread();
      if (apart > 0 && now > 0) zoomed(now / apart);
      apart = now;
    } else if (travelled > 4) {
      moved(dx / canvas.clientHeight, dy / canvas.clientHeight, event.shiftKey || (event.buttons & 2) !== 0);
    }
  });
  const ended = (event) => {
    const known = pointers.delete(event.pointerId);
    if (known && !pointers.size && travelled <= 4 && event.type === "pointerup") tapped(share(event));
  };
  canvas.addEventListener("pointerup", ended);
  canvas.addEventListener("pointercancel", ended);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomed(Math.exp(-event.deltaY * (event.deltaMode ? 0.03 : 0.0015)));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.altKey && pressed(event.key, event.shiftKey)) event.preventDefault();
  });
}

// The divider: dragged, or moved by keys; `set` takes its share of the width.
export function divider(handle, stage, get, set) {
  handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
  handle.addEventListener("pointermove", (event) => {
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const box = stage.getBoundingClientRect();
    set((event.clientX - box.left) / box.width);
  });
  handle.addEventListener("keydown", (event) => {
    const step = {
      ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02,
      PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1,
    }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    set(get() + step);
  });
}

export function theme(button) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const show = (isDark) => (document.documentElement.dataset.theme = isDark ? "dark" : "light");
  show(dark.matches);
  dark.addEventListener("change", () => show(dark.matches));
  button.addEventListener("click", () => show(document.documentElement.dataset.theme === "light"));
}
