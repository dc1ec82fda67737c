// What numbers say of a light: chromaticity, temperature, spectrum. Tables come from Python.

export const times = (matrix, vector) => matrix.map((row) => row.reduce((sum, m, k) => sum + m * vector[k], 0));

export function chromaticity([x, y, z]) {
  const total = x + y + z;
  return total > 0 ? [x / total, y / total] : null;
}

// Correlated colour temperature and distance from the Planckian locus, { kelvin, duv }, by rows
// T, u, v of black bodies; null further than .05 away, where CIE 15 defines none, and off its ends.
export function temperature([x, y], locus) {
  const divisor = -2 * x + 12 * y + 3;
  if (divisor <= 0) return null;
  const u = (4 * x) / divisor, v = (6 * y) / divisor;
  let best = null;
  for (let k = 0; k + 1 < locus.length; ++k) {
    const [t0, u0, v0] = locus[k], [t1, u1, v1] = locus[k + 1];
    const du = u1 - u0, dv = v1 - v0, length = Math.hypot(du, dv);
    const along = ((u - u0) * du + (v - v0) * dv) / length ** 2;
    const share = Math.min(Math.max(along, 0), 1);
    const off = (k === 0 && along < 0) || (k + 2 === locus.length && along > 1); // an end is nearest
    const away = Math.hypot(u - u0 - share * du, v - v0 - share * dv);
    const above = Math.sign((u - u0) * dv - (v - v0) * du) || 1;
    if (!best || away < Math.abs(best.duv)) best = { kelvin: t0 * (t1 / t0) ** share, duv: above * away, off };
  }
  return !best.off && Math.abs(best.duv) <= 0.05 ? best : null;
}

// The spectrum that six values most probably come from, and one standard deviation of it: of what
// they do not say, and of their own noise.
export function spectrum(values, sigma, { nm, estimate, deviation }) {
  const power = estimate.map((row) => row.reduce((sum, e, k) => sum + e * values[k], 0));
  const rms = Math.sqrt(power.reduce((sum, p) => sum + p * p, 0) / power.length);
  const around = estimate.map((row, k) =>
    Math.hypot(rms * deviation[k], ...row.map((e, c) => e * (sigma?.[c] ?? 0))));
  return { nm, power, around };
}

// The matrix from XYZ to what looks the same on the display, exposed; column by column.
export function displayFromXyz(look, { adapt, white, degree }, gain) {
  const whole = look.adaptation[adapt]?.[white];
  const matrix = new Float32Array(9);
  for (let row = 0; row < 3; ++row) {
    for (let column = 0; column < 3; ++column) {
      const same = Number(row === column);
      matrix[3 * column + row] = gain * (whole ? degree * whole[row][column] + (1 - degree) * same : same);
    }
  }
  return matrix;
}
