// The numbers of packing.py, back from text. Maps come as codes, planar: face, channel, row, column.

const ALPHABET =
  "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%:()*+-;,=.?@^_/{|}~";

export async function unpack(text, index, taps) {
  const bytes = await inflated(from85(text));
  const arrays = {};
  let at = 0;
  for (const { name, told, shape, base } of index) {
    const count = shape.reduce((a, b) => a * b);
    if (told === "bytes") {
      arrays[name] = besides(bytes.slice(at, (at += count)), shape[1]);
      continue;
    }
    const low = bytes.subarray(at, at + count), high = bytes.subarray(at + count, at + 2 * count);
    at += 2 * count;
    const differences = Int32Array.from(low, (byte, k) => {
      const folded = byte | (high[k] << 8);
      return folded & 1 ? -(folded + 1) >> 1 : folded >> 1;
    });
    arrays[name] = tell[told](differences, shape, arrays[base], taps);
  }
  return arrays;
}

// What each code stands for: half floats with `bits` after the point; index by code + most.
export function valuesOfCodes(bits) {
  const most = 0x7bff >> (10 - bits);
  const values = new Float32Array(2 * most + 1);
  for (let code = 0; code <= most; ++code) {
    const pattern = code << (10 - bits), exponent = pattern >> 10, fraction = pattern & 1023;
    const value = exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24;
    values[most + code] = value;
    values[most - code] = -value;
  }
  return { most, values };
}

const tell = {
  cube(differences, [, n, , channels]) {
    const codes = differences;
    for (let plane = 0; plane < 6 * channels; ++plane) {
      for (let y = 0, k = plane * n * n; y < n; ++y) {
        for (let x = 0; x < n; ++x, ++k) {
          const a = x ? codes[k - 1] : 0, b = y ? codes[k - n] : 0, c = x && y ? codes[k - n - 1] : 0;
          const low = a < b ? a : b, high = a < b ? b : a, sum = a + b - c;
          codes[k] += sum < low ? low : sum > high ? high : sum;
        }
      }
    }
    return codes;
  },

  mip(differences, [, n, , channels], finer, taps) {
    const m = 2 * n, across = new Float64Array(n * m);
    const inside = (k) => Math.min(Math.max(k, 0), m - 1);
    for (let plane = 0; plane < 6 * channels; ++plane) {
      for (let y = 0; y < m; ++y) {
        for (let x = 0; x < n; ++x) {
          let sum = 0;
          for (let k = 0; k < 8; ++k) sum += taps[k] * finer[(plane * m + y) * m + inside(2 * x + k - 3)];
          across[y * n + x] = sum;
        }
      }
      for (let y = 0; y < n; ++y) {
        for (let x = 0; x < n; ++x) {
          let sum = 0;
          for (let k = 0; k < 8; ++k) sum += taps[k] * across[inside(2 * y + k - 3) * n + x];
          differences[(plane * n + y) * n + x] += Math.floor(sum / 2 ** 24 + 0.5);
        }
      }
    }
    return differences;
  },

  like: (differences, shape, other) => differences.map((d, k) => d + other[k]),

  vectors(differences, [count, width]) {
    const rows = new Int32Array(count * width);
    for (let column = 0; column < width; ++column) {
      for (let row = 0, slope = 0, value = 0; row < count; ++row) {
        slope += differences[column * count + row];
        value += slope;
        rows[row * width + column] = (value << 16) >> 16;
      }
    }
    return rows;
  },
};

function besides(bytes, n) {
  for (let k = 0; k < bytes.length; ++k) if (k % n) bytes[k] += bytes[k - 1];
  return bytes;
}

function from85(text) {
  const digit = new Uint8Array(128);
  for (let k = 0; k < 85; ++k) digit[ALPHABET.charCodeAt(k)] = k;
  const bytes = new Uint8Array((text.length / 5) * 4), view = new DataView(bytes.buffer);
  for (let k = 0, at = 0; k < text.length; k += 5, at += 4) {
    let word = 0;
    for (let j = 0; j < 5; ++j) word = 85 * word + digit[text.charCodeAt(k + j)];
    view.setUint32(at, word);
  }
  return bytes.subarray(4, 4 + view.getUint32(0, true));
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
