// WebGL 2: programs, textures and targets, and what is said where they are missing.

export const ATTRIBUTES = ["position", "normal"]; // of vertices, at places 0 and 1

export class Unable extends Error {}

export function context(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: false, depth: false, alpha: false });
  if (!gl) throw new Unable("This page draws with WebGL 2, which this browser or its graphics driver does not offer.");
  const float = gl.getExtension("EXT_color_buffer_float");
  if (!float && !gl.getExtension("EXT_color_buffer_half_float")) {
    throw new Unable("This page draws into half-float images, which the graphics driver of this device does not offer.");
  }
  gl.getExtension("OES_texture_float_linear");
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  return Object.assign(gl, { pointFormat: float ? gl.RGBA32F : gl.RGBA16F });
}

export function program(gl, vertex, fragment, defines = {}) {
  const lines = Object.entries(defines).map(([name, value]) => `#define ${name} ${value}\n`).join("");
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text.replace("\n", `\n${lines}`)); // after #version
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  ATTRIBUTES.forEach((name, place) => gl.bindAttribLocation(made, place, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
    const said = [gl.getProgramInfoLog(made), ...logs].join(" ").trim();
    throw new Unable(`The graphics driver refuses a shader of this page (${said}).`);
  }
  const uniforms = {};
  for (let k = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) - 1; k >= 0; --k) {
    const { name, type, size } = gl.getActiveUniform(made, k);
    uniforms[name.replace("[0]", "")] = { type, size, at: gl.getUniformLocation(made, name) };
  }
  return { made, uniforms };
}

// Uniforms by name, numbers or flat arrays of them; textures as lists. What a program has no use
// for is passed over.
export function set(gl, { made, uniforms }, values, textures = {}) {
  gl.useProgram(made);
  for (const [name, value] of Object.entries(values)) {
    const uniform = uniforms[name];
    if (uniform) setter(gl, uniform.type)(uniform.at, typeof value === "number" ? [value] : value);
  }
  let unit = 0;
  for (const [name, several] of Object.entries(textures)) {
    if (!uniforms[name]) continue;
    const units = several.map((texture) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(texture.target, texture.made);
      return unit++;
    });
    gl.uniform1iv(uniforms[name].at, units);
  }
}

function setter(gl, type) {
  switch (type) {
    case gl.FLOAT: return gl.uniform1fv.bind(gl);
    case gl.INT: return gl.uniform1iv.bind(gl);
    case gl.INT_VEC2: return gl.uniform2iv.bind(gl);
    case gl.FLOAT_VEC2: return gl.uniform2fv.bind(gl);
    case gl.FLOAT_VEC3: return gl.uniform3fv.bind(gl);
    case gl.FLOAT_VEC4: return gl.uniform4fv.bind(gl);
    case gl.FLOAT_MAT3: return (at, value) => gl.uniformMatrix3fv(at, false, value);
    case gl.FLOAT_MAT4: return (at, value) => gl.uniformMatrix4fv(at, false, value);
    case gl.FLOAT_MAT2x3: return (at, value) => gl.uniformMatrix2x3fv(at, false, value);
  }
  throw new Error(`a uniform of type ${type}`);
}

// A cube of half floats with its mips; `levels` of { size, faces: six Float32Arrays of RGB }.
export function cubeTexture(gl, levels) {
  const target = gl.TEXTURE_CUBE_MAP, made = gl.createTexture();
  gl.bindTexture(target, made);
  levels.forEach(({ size, faces }, level) => faces.forEach((texels, face) =>
    gl.texImage2D(gl.TEXTURE_CUBE_MAP_POSITIVE_X + face, level, gl.RGB16F, size, size, 0, gl.RGB, gl.FLOAT, texels)));
  gl.texParameteri(target, gl.TEXTURE_MAX_LEVEL, levels.length - 1);
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, levels.length > 1 ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  return { target, made };
}

// Images of one size to be drawn into, with or without depth.
export function images(gl, width, height, formats, { depth = false, filter = gl.NEAREST } = {}) {
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  const textures = formats.map((format, k) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    for (const which of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, which, filter);
    for (const which of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, which, gl.CLAMP_TO_EDGE);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, made, 0);
    return { target: gl.TEXTURE_2D, made };
  });
  gl.drawBuffers(formats.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
  let renderbuffer = null;
  if (depth) {
    renderbuffer = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, renderbuffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, renderbuffer);
  }
  if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
    throw new Unable("The graphics driver of this device refuses the half-float images this page draws into.");
  }
  return { framebuffer, textures, renderbuffer, width, height };
}

export function release(gl, { framebuffer, textures, renderbuffer }) {
  textures.forEach(({ made }) => gl.deleteTexture(made));
  gl.deleteRenderbuffer(renderbuffer);
  gl.deleteFramebuffer(framebuffer);
}
