// The picture, drawn as stages/preview.py draws it: what is seen is written down point by point,
// lit by the shaders they share, and brought to fewer pixels.
import { covered, matrices, turnedAboutY } from "./camera.js";
import { times } from "./colour.js";
import { ATTRIBUTES, cubeTexture, images, program, release, set } from "./gl.js";
import { valuesOfCodes } from "./unpack.js";

const TILE = 512; // points along a side of what is drawn at once, at most

export class Drawing {
  constructor(gl, about, arrays) {
    Object.assign(this, { gl, about, arrays });
    this.codes = valuesOfCodes(about.bits);
    this.programs = new Map();
    this.lights = new Map();
    this.facing = images(gl, TILE, TILE, [gl.pointFormat, gl.pointFormat], { depth: true });
    this.points = images(gl, TILE, TILE, [gl.pointFormat]);
    this.shapes = about.shapes.map((shape) => this.#shape(shape));
    this.triangles = gl.createVertexArray();
    this.placedAs = null;
  }

  // What a way of rendering needs: "six" or "three". Its maps are made when first asked for.
  way(name) {
    const { xyz, light, surface } = this.about.ways[name];
    const channels = xyz[0].length, triples = Math.ceil(channels / 3);
    const triple = (values) => Float32Array.from({ length: 3 * triples }, (_, k) => values[k] ?? 0);
    const through = (matrix) => (values) => (matrix ? times(matrix, values) : values);
    return {
      name,
      channels,
      triples,
      light: through(light),
      fromPrimaries: light,
      surface: (values) => triple(through(surface)(values)),
      flat: (rows) => Float32Array.from(rows.flatMap((row) => [...triple(through(light)(row))])),
      matrix: Float32Array.from({ length: 9 * triples }, (_, k) => xyz[k % 3][Math.floor(k / 3)] ?? 0),
    };
  }

  // One of the forms of the light: its mips and its lamps.
  light(way, form) {
    const key = `${way.name} ${form}`;
    if (!this.lights.has(key)) {
      const { mips, directions, flux } = this.about.forms[form];
      this.lights.set(key, {
        maps: this.#maps(way, mips),
        size: this.#size(mips[0]),
        count: flux.length,
        directions: Float32Array.from(directions.flat()),
        flux: way.flat(flux),
      });
    }
    return this.lights.get(key);
  }

  // Draws the pixels [x, y, width, height] of the picture of a state into `target`.
  tile(way, view, target, [x, y, width, height], supersampling, samples) {
    const { gl } = this;
    if (view.map) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
      gl.viewport(x, y, width, height);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(x, y, width, height);
      gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 1]);
      gl.disable(gl.SCISSOR_TEST);
      const place = view.map.place.map((share, k) => share * (k % 2 ? target.height : target.width));
      this.#environment("latlong.frag", way, { ...view.map, place });
      return;
    }
    const [w, h] = [target.width, target.height];
    const margin = [x > 0, y > 0, x + width < w, y + height < h].map(Number);
    const part = [x - margin[0], y - margin[1], width + margin[0] + margin[2], height + margin[1] + margin[3]]
      .map((value) => value * supersampling);
    this.shadedPoints(way, view, [w * supersampling, h * supersampling], part, supersampling, samples);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(x, y, width, height);
    gl.disable(gl.SCISSOR_TEST);
    const reduce = this.program("screen.vert", "reduce.frag");
    set(gl, reduce, {
      corner: [x - margin[0], y - margin[1]], last: [part[2] - 1, part[3] - 1], supersampling,
    }, { points: this.points.textures });
    this.#everywhere();
  }

  // How many pixels of a picture a tile may be wide and high, margins counted.
  static room(supersampling) {
    return Math.floor(TILE / supersampling) - 2;
  }

  // Writes down and lights a part of the picture, both in points; `matrix` in place of the way's.
  shadedPoints(way, view, size, part, supersampling, samples, matrix = way.matrix) {
    const { gl } = this;
    const seen = matrices(view.camera, size, part);
    const extent = part.slice(2);
    this.#place(view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.facing.framebuffer);
    gl.viewport(0, 0, ...extent);
    gl.enable(gl.DEPTH_TEST);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.COLOR, 1, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    const surface = this.program("surface.vert", "surface.frag", { TRIPLES: way.triples, SHADED: 0 });
    const boxes = this.placed.map(({ low, high }) => covered(seen.clipFromWorld, low, high, extent));
    view.things.forEach((thing, k) => {
      if (!boxes[k]) return;
      set(gl, surface, { clip_from_world: seen.clipFromWorld, thing: k + 1 });
      gl.bindVertexArray(this.placed[k].array);
      gl.drawElements(gl.TRIANGLES, this.shapes[thing.shape].count, gl.UNSIGNED_SHORT, 0);
    });
    gl.disable(gl.DEPTH_TEST);

    gl.bindFramebuffer(gl.FRAMEBUFFER, this.points.framebuffer);
    gl.viewport(0, 0, ...extent);
    this.#environment("environment.frag", way, { world_from_clip: seen.worldFromClip, level: view.blur }, matrix);
    gl.enable(gl.SCISSOR_TEST);
    view.things.forEach((thing, k) => {
      if (!boxes[k]) return;
      gl.scissor(...boxes[k]);
      this.#shade(way, view, thing, k + 1, seen, supersampling, samples, matrix);
    });
    gl.disable(gl.SCISSOR_TEST);
  }

  program(vertex, fragment, defines = {}) {
    const key = JSON.stringify([vertex, fragment, defines]);
    if (!this.programs.has(key)) {
      const { shaders } = this.about;
      this.programs.set(key, program(this.gl, shaders[vertex], shaders[fragment], defines));
    }
    return this.programs.get(key);
  }

  // Sends pictures to the screen: each of `shown` is { picture, look, scissor }.
  show(shown, size) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, ...size);
    gl.enable(gl.SCISSOR_TEST);
    for (const { picture, look, scissor } of shown) {
      gl.scissor(...scissor);
      set(gl, this.program("screen.vert", "display.frag"), { ...look, size }, { picture: picture.textures });
      this.#everywhere();
    }
    gl.disable(gl.SCISSOR_TEST);
  }

  // Numbers, four a point, of one of the images drawn into, from its lower left corner.
  read({ framebuffer }, image, width, height) {
    const { gl } = this, numbers = new Float32Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.readBuffer(gl.COLOR_ATTACHMENT0 + image);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, numbers);
    return numbers;
  }

  picture(width, height) {
    return images(this.gl, width, height, [this.gl.RGBA16F], { filter: this.gl.LINEAR });
  }

  release(picture) {
    release(this.gl, picture);
  }

  // Light (P) from the texel a direction meets, in the map's own unit, and its place.
  texel(direction) {
    const { faces, size, scale } = this.about.map;
    const dot = (vector) => vector.reduce((sum, v, k) => sum + v * direction[k], 0);
    const along = faces.map(([a]) => dot(a));
    const face = along.indexOf(Math.max(...along));
    const [x, y] = [1, 2].map((k) => {
      const place = dot(faces[face][k]) / along[face];
      return Math.min(Math.max(Math.floor(((place + 1) / 2) * size), 0), size - 1);
    });
    const codes = this.arrays["whole.0"], { most, values } = this.codes;
    const channels = this.about.channels.length;
    const light = Array.from({ length: channels }, (_, c) =>
      scale * values[most + codes[((face * channels + c) * size + y) * size + x]]);
    return { face, x, y, light };
  }

  #environment(file, way, uniforms, matrix = way.matrix) {
    const compiled = this.program("screen.vert", file, { TRIPLES: way.triples });
    set(this.gl, compiled, { ...uniforms, xyz_from_triple: matrix }, { radiance: this.light(way, "whole").maps });
    this.#everywhere();
  }

  #shade(way, view, thing, number, seen, supersampling, samples, matrix) {
    const { gl, about } = this;
    const { material, alpha, form } = thing;
    const gloss = about.glosses[material.gloss], angular = Array.isArray(gloss[0]);
    const compiled = this.program("screen.vert", `${view.lobe}.frag`,
      { TRIPLES: way.triples, SHADED: 0, ANGULAR: Number(angular), TEXTURED: 0 });
    const light = this.light(way, form), matt = this.light(way, "matt");
    const wanted = samples ?? material.samples[form];
    set(gl, compiled, {
      world_from_clip: seen.worldFromClip,
      xyz_from_triple: matrix,
      thing: number,
      face_size: light.size,
      samples: Math.max(1, Math.ceil(wanted / supersampling ** 2)),
      supersampling,
      lamps: light.count,
      ...(light.count && { lamp_direction: light.directions, lamp_flux: light.flux }),
      matt_lamps: matt.count,
      ...(matt.count && { matt_direction: matt.directions, matt_flux: matt.flux }),
      roughness: [alpha, alpha],
      rho_d: way.surface(material.diffuse),
      rho_s: angular ? Float32Array.from(gloss.flatMap((row) => [...way.surface(row)])) : way.surface(gloss),
    }, { radiance: light.maps, irradiance: matt.maps, facing: [this.facing.textures[0]], what: [this.facing.textures[1]] });
    this.#everywhere();
  }

  #everywhere() {
    this.gl.bindVertexArray(this.triangles);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  #size(name) {
    return this.about.arrays.find((array) => array.name === name).shape[1];
  }

  #maps(way, names) {
    const { most, values } = this.codes, from = this.about.channels.length;
    return Array.from({ length: way.triples }, (_, triple) => cubeTexture(this.gl, names.map((name) => {
      const size = this.#size(name), codes = this.arrays[name], plane = size * size;
      const faces = Array.from({ length: 6 }, (_, face) => {
        const texels = new Float32Array(3 * plane);
        for (let k = 0; k < 3 && 3 * triple + k < way.channels; ++k) {
          const row = way.fromPrimaries?.[3 * triple + k];
          for (let c = 0; c < from; ++c) {
            const weight = row ? row[c] : Number(c === 3 * triple + k);
            if (!weight) continue;
            const at = (face * from + c) * plane;
            for (let texel = 0; texel < plane; ++texel) texels[3 * texel + k] += weight * values[most + codes[at + texel]];
          }
        }
        return texels;
      });
      return { size, faces };
    })));
  }

  #shape({ name, extent }) {
    const { gl } = this;
    const [places, normals, triangles] = ["places", "normals", "triangles"].map((part) => this.arrays[`${name}.${part}`]);
    const elements = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(triangles), gl.STATIC_DRAW);
    return {
      elements,
      count: triangles.length,
      places: Float32Array.from(places, (step) => (step * extent) / 32767),
      normals: Float32Array.from(normals, (step) => step / 32767),
    };
  }

  // Vertices of each thing in the world, anew where the model or its turn has changed.
  #place({ model, things, turn }) {
    const key = `${model} ${turn}`;
    if (this.placedAs === key) return;
    this.placedAs = key;
    const { gl } = this;
    this.placed?.forEach(({ array, buffer }) => {
      gl.deleteVertexArray(array);
      gl.deleteBuffer(buffer);
    });
    this.placed = things.map(({ shape, at }) => {
      const { places, normals, elements } = this.shapes[shape];
      const vertices = new Float32Array(2 * places.length);
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (let k = 0; k < places.length; k += 3) {
        const place = turnedAboutY([places[k] + at[0], places[k + 1] + at[1], places[k + 2] + at[2]], -turn);
        vertices.set(place, 2 * k);
        vertices.set(turnedAboutY(normals.subarray(k, k + 3), -turn), 2 * k + 3);
        for (let axis = 0; axis < 3; ++axis) {
          low[axis] = Math.min(low[axis], place[axis]);
          high[axis] = Math.max(high[axis], place[axis]);
        }
      }
      const array = gl.createVertexArray(), buffer = gl.createBuffer();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.DYNAMIC_DRAW);
      ATTRIBUTES.forEach((_, k) => {
        gl.enableVertexAttribArray(k);
        gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
      return { array, buffer, low, high };
    });
    gl.bindVertexArray(null);
  }
}
