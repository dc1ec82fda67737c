// What is known of one place of the picture: a direction of the map, or a spot of the model.
import { matrices } from "./camera.js";
import { times } from "./colour.js";
import { POINTS } from "./refine.js";

// `at` is [across, down] in shares of the picture. Returns null where nothing is shown.
//   what       "light" that arrives from a direction, or "surface" that sends it on
//   values     (P) in the map's unit
//   xyz        from them
//   three      the XYZ that the three-channel way has there
//   direction, sigma, valid   of light alone; sigma null where it is not known
export function probe(drawing, ways, view, size, at) {
  if (view.map) {
    const direction = directionOnMap(view.map, at);
    return direction && light(drawing, ways, direction);
  }
  const found = pointed(drawing, ways.six, view, size, at);
  return found.direction ? light(drawing, ways, found.direction) : surface(drawing, ways, view, found);
}

function light(drawing, ways, direction) {
  const { face, x, y, light: values } = drawing.texel(direction);
  const { map, ways: known, channels } = drawing.about;
  const half = Math.max(1, map.size >> 1), row = Math.min(y >> 1, half - 1), column = Math.min(x >> 1, half - 1);
  const sigma = channels.map((_, c) => {
    const step = drawing.arrays.sigma[((face * channels.length + c) * half + row) * half + column];
    return step ? map.sigma.largest * 2 ** ((step - 255) / map.sigma.steps) : null;
  });
  return {
    what: "light",
    direction,
    values,
    sigma: sigma.includes(null) ? null : sigma,
    valid: drawing.arrays.valid[(face * map.size + y) * map.size + x] / 255,
    xyz: times(known.six.xyz, values),
    three: times(known.three.xyz, ways.three.light(values)),
  };
}

// The direction seen at a place of the unwrapped map, as shaders/latlong.frag has it.
function directionOnMap({ place: [x, y, width, height], turn }, [across, down]) {
  const u = (across - x) / width, v = (1 - down - y) / height;
  if (u < 0 || u > 1 || v < 0 || v > 1) return null;
  const azimuth = 2 * Math.PI * (u - 0.5) + turn, elevation = Math.PI * (v - 0.5);
  return [Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation), -Math.cos(elevation) * Math.cos(azimuth)];
}

// Which pixel that is, and the direction in which it shows the environment, if it does.
function pointed(drawing, way, view, size, [across, down]) {
  const pixel = [across * size[0], (1 - down) * size[1]].map((place, k) =>
    Math.min(Math.max(Math.floor(place), 0), size[k] - 1));
  const part = [...pixel.map((p) => p * POINTS), POINTS, POINTS], points = size.map((s) => s * POINTS);
  drawing.shadedPoints(way, view, points, part, POINTS, 1);
  const things = drawing.read(drawing.facing, 1, POINTS, POINTS).filter((_, k) => k % 4 === 0);
  if (things.some((thing) => thing > 0)) return { part, points };
  const { worldFromClip } = matrices(view.camera, points, part);
  const along = [0, 1, 2].map((k) => worldFromClip[12 + k]), length = Math.hypot(...along);
  return { direction: along.map((value) => value / length) };
}

function surface(drawing, ways, view, { part, points }) {
  const { map, ways: known } = drawing.about;
  const { six } = ways;
  const read = (way, matrix) => {
    drawing.shadedPoints(way, view, points, part, POINTS, view.samples, matrix);
    const read = drawing.read(drawing.points, 0, POINTS, POINTS);
    return [0, 1, 2].map((k) => map.scale * (read[k] + read[4 + k] + read[8 + k] + read[12 + k]) / 4);
  };
  // The shaders give XYZ by a matrix for each triple; with the identity for one, its channels.
  const values = [];
  for (let triple = 0; triple < six.triples; ++triple) {
    const matrix = new Float32Array(9 * six.triples);
    for (let k = 0; k < 3; ++k) matrix[9 * triple + 4 * k] = 1;
    values.push(...read(six, matrix));
  }
  values.length = six.channels;
  return { what: "surface", values, xyz: times(known.six.xyz, values), three: read(ways.three, ways.three.matrix) };
}
