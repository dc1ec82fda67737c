// Where the viewer stands, and the matrices of a part of the picture. World axes as in
// stages/cube.py; matrices are column by column, as WebGL takes them.

const radians = Math.PI / 180;

// A vector turned about +Y, from +Z towards +X.
export function turnedAboutY([x, y, z], degrees) {
  const cos = Math.cos(degrees * radians), sin = Math.sin(degrees * radians);
  return [cos * x + sin * z, y, cos * z - sin * x];
}

// The viewer of a model. The environment turns about the model; the world is the environment's, so
// model and viewer turn against it.
export function camera(state, model, aspect) {
  const yaw = state.yaw * radians, pitch = state.pitch * radians;
  const away = model.distance / state.zoom;
  const eye = [
    model.target[0] + away * Math.sin(yaw) * Math.cos(pitch),
    model.target[1] + away * Math.sin(pitch),
    model.target[2] + away * Math.cos(yaw) * Math.cos(pitch),
  ];
  return {
    eye: turnedAboutY(eye, -state.turn),
    target: turnedAboutY(model.target, -state.turn),
    distance: away,
    // In a picture narrower than the model asks for, the view widens until all of it is in.
    slope: Math.tan((model.view_deg / 2) * radians) * Math.max(1, model.aspect / aspect),
    aspect,
  };
}

// For a part of a picture: [x, y, width, height] in points of one of `size`, row 0 below.
export function matrices(camera, size, part) {
  const { eye, target, distance, slope, aspect } = camera;
  const forward = target.map((t, k) => (t - eye[k]) / distance);
  const level = Math.hypot(forward[0], forward[2]);
  const right = [-forward[2] / level, 0, forward[0] / level];
  const up = cross(right, forward);
  const scale = [size[0] / part[2], size[1] / part[3]];
  const shift = [0, 1].map((k) => (size[k] - 2 * part[k] - part[2 + k]) / part[2 + k]);
  const fx = scale[0] / (slope * aspect), fy = scale[1] / slope;
  const near = distance / 20, far = distance * 20;
  const zz = (near + far) / (near - far), zw = (2 * near * far) / (near - far);

  // Rows of clip from world; depth is dot(p - eye, forward).
  const rows = [
    right.map((r, k) => fx * r + shift[0] * forward[k]),
    up.map((u, k) => fy * u + shift[1] * forward[k]),
    forward.map((f) => -zz * f),
    forward,
  ].map((row) => [...row, -dot(row, eye)]);
  rows[2][3] += zw;
  const clipFromWorld = new Float32Array(16);
  rows.forEach((row, r) => row.forEach((value, c) => (clipFromWorld[4 * c + r] = value)));

  // Directions of clip positions (x, y, 1, 1), of any length.
  const worldFromClip = new Float32Array(16);
  for (let k = 0; k < 3; ++k) {
    worldFromClip[k] = right[k] / fx;
    worldFromClip[4 + k] = up[k] / fy;
    worldFromClip[12 + k] = forward[k] - (right[k] * shift[0]) / fx - (up[k] * shift[1]) / fy;
  }
  worldFromClip[15] = 1;
  return { clipFromWorld, worldFromClip };
}

// Pixels [x, y, width, height] of a part that a box may cover; null: none of it.
export function covered(clipFromWorld, low, high, size) {
  const least = [1, 1], most = [-1, -1];
  for (let corner = 0; corner < 8; ++corner) {
    const p = [0, 1, 2].map((k) => (corner & (1 << k) ? high[k] : low[k]));
    const [x, y, , w] = [0, 1, 2, 3].map((r) =>
      clipFromWorld[r] * p[0] + clipFromWorld[4 + r] * p[1] + clipFromWorld[8 + r] * p[2] + clipFromWorld[12 + r]);
    if (w <= 0) return [0, 0, ...size];
    [x / w, y / w].forEach((value, k) => {
      least[k] = Math.min(least[k], Math.max(value, -1));
      most[k] = Math.max(most[k], Math.min(value, 1));
    });
  }
  const [x, y] = least.map((value, k) => Math.floor(((value + 1) / 2) * size[k]));
  const [right, top] = most.map((value, k) => Math.ceil(((value + 1) / 2) * size[k]));
  return right > x && top > y ? [x, y, right - x, top - y] : null;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
