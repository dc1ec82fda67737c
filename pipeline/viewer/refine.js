// When what is drawn: at once a draft, as fine as it can be without making one wait; when nothing
// has moved for a moment the finished picture, part by part, so that the page stays alive even
// where a processor does the drawing.
import { Drawing } from "./draw.js";

const STILL_MS = 140; // without a change, before the picture is finished
const WAIT_MS = [15, 60]; // what a draft takes, and a part of the finished picture
const LEAST = 96; // pixels along a side of a part: below, triangles take longer than light
const DRAFT_SAMPLES = 12;
export const POINTS = 2; // along a pixel's side in the finished picture, as in previews

export class Refinement {
  #coarse = 2; // pixels along a side of a draft's
  #part = 2 * LEAST; // pixels along a side of a part
  #drafts = {}; // pictures by way ...
  #drafted = {}; // ... and which of them show what is to be seen
  #fine = {}; // { picture, started, done } by way
  #queue = [];
  #fence = null;
  #size = [0, 0];
  #changed = 0;
  #drawn = null;
  #view = null;
  #frame = 0;

  // `onDone(busy)` is told whether something is left to draw.
  constructor(drawing, onDone) {
    Object.assign(this, { drawing, onDone });
  }

  // What is to be seen: `view` as Drawing takes it, `ways` and how to show them (see #show).
  see(view, shown, size) {
    const key = JSON.stringify([view, size]);
    if (key !== this.#drawn) {
      this.#drawn = key;
      this.#changed = performance.now();
      this.#drafted = {};
      this.#queue = [];
      for (const fine of Object.values(this.#fine)) fine.done = fine.started = false;
      this.#size = size;
    }
    this.#view = view;
    this.shown = shown;
    this.#ask();
  }

  // Draws what is on the screen once more, for whoever reads it right after.
  again() {
    this.#show();
  }

  get busy() {
    return !this.shown || this.shown.some(({ way }) => !this.#fine[way.name]?.done);
  }

  #ask() {
    this.onDone(this.busy);
    if (!this.#frame) this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.#step();
    });
  }

  #step() {
    const { gl } = this.drawing;
    if (this.#fence) {
      const { sync, began, then } = this.#fence;
      if (gl.clientWaitSync(sync, 0, 0) === gl.TIMEOUT_EXPIRED) return this.#ask();
      gl.deleteSync(sync);
      this.#fence = null;
      then(performance.now() - began);
    }
    const missing = this.shown.filter(({ way }) => !this.#drafted[way.name] && !this.#fine[way.name]?.done);
    if (missing.length) this.#draft(missing);
    else if (performance.now() - this.#changed > STILL_MS) this.#refine();
    this.#show();
    this.onDone(this.busy);
    if (this.busy || this.#fence) this.#ask();
  }

  #draft(missing) {
    const began = performance.now(), size = this.#size.map((s) => Math.ceil(s / this.#coarse));
    for (const { way } of missing) {
      this.#drafts[way.name] = this.#fitting(this.#drafts[way.name], size);
      for (const part of parts(size, Drawing.room(1))) {
        this.drawing.tile(way, this.#view, this.#drafts[way.name], part, 1, DRAFT_SAMPLES);
      }
      this.#drafted[way.name] = true;
    }
    this.#wait(began, (took) => {
      if (took > WAIT_MS[1]) this.#coarse = Math.min(this.#coarse + 1, 8);
      if (took < WAIT_MS[0]) this.#coarse = Math.max(this.#coarse - 1, 1);
    });
  }

  #refine() {
    if (!this.#queue.length) {
      for (const { way, scissor } of this.shown) {
        const fine = (this.#fine[way.name] ??= {});
        if (fine.done) continue;
        fine.picture = this.#fitting(fine.picture, this.#size);
        this.#copy(this.#drafts[way.name], fine.picture);
        fine.started = true;
        const all = parts(this.#size, Math.min(this.#part, Drawing.room(POINTS)));
        const seen = ([x, , width]) => x + width > scissor[0] && x < scissor[0] + scissor[2];
        this.#queue.push(...all.map((part) => ({ way, part, hidden: !seen(part) })));
      }
      this.#queue.sort((a, b) => a.hidden - b.hidden);
      if (!this.#queue.length) return;
    }
    const began = performance.now();
    const { way, part } = this.#queue.shift();
    this.drawing.tile(way, this.#view, this.#fine[way.name].picture, part, POINTS, this.#view.samples);
    if (!this.#queue.some((left) => left.way === way)) this.#fine[way.name].done = true;
    this.#wait(began, (took) => {
      if (took > WAIT_MS[1]) this.#part = Math.max(this.#part / 2, LEAST);
      if (took < WAIT_MS[0]) this.#part = Math.min(this.#part * 2, 512);
    });
  }

  #wait(began, then) {
    const { gl } = this.drawing;
    this.#fence = { sync: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), began, then };
    gl.flush();
  }

  #show() {
    const shown = this.shown.map(({ way, look, scissor }) => {
      const fine = this.#fine[way.name];
      return { picture: fine?.started ? fine.picture : this.#drafts[way.name], look, scissor };
    });
    this.drawing.show(shown.filter(({ picture }) => picture), this.#size);
  }

  #copy(from, to) {
    const { gl } = this.drawing;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from.framebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to.framebuffer);
    gl.blitFramebuffer(0, 0, from.width, from.height, 0, 0, to.width, to.height, gl.COLOR_BUFFER_BIT, gl.LINEAR);
  }

  #fitting(picture, [width, height]) {
    if (picture && picture.width === width && picture.height === height) return picture;
    if (picture) this.drawing.release(picture);
    return this.drawing.picture(width, height);
  }
}

// A picture in parts [x, y, width, height] of at most `most` pixels along a side, from the top.
function parts([width, height], most) {
  const all = [];
  for (let top = height; top > 0; top -= most) {
    for (let x = 0; x < width; x += most) {
      const y = Math.max(0, top - most);
      all.push([x, y, Math.min(most, width - x), top - y]);
    }
  }
  return all;
}
