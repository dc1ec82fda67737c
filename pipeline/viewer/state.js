// What the page shows, in plain values; all that differs from the defaults stands in the address.

const REMEMBER_MS = 150;
// How many places a number has in the address.
const NUMBERS = { yaw: 1, pitch: 1, zoom: 3, turn: 1, rough: 3, blur: 2, divider: 3, ev: 2, degree: 2 };

export class State {
  #listeners = [];
  #waiting = 0;
  #defaults;

  // `choices` maps each word to the values it may take; `ranges` each number to [least, most].
  constructor(defaults, choices, ranges) {
    Object.assign(this, { choices, ranges, now: { ...defaults } });
    this.#defaults = defaults;
    this.read(location.hash);
    addEventListener("hashchange", () => {
      if (location.hash.slice(1) !== this.words()) this.read(location.hash);
    });
  }

  onChange(listener) {
    this.#listeners.push(listener);
  }

  set(changes) {
    this.now = { ...this.now, ...this.#checked(changes) };
    // Not for each step of a drag: Safari allows a hundred changes of the address in half a minute.
    clearTimeout(this.#waiting);
    this.#waiting = setTimeout(() => this.#remember(), REMEMBER_MS);
    this.#listeners.forEach((listener) => listener(this.now));
  }

  // All as at first.
  reset() {
    this.set(this.#defaults);
  }

  // Takes what a deep link says; what it does not say, or says wrongly, is as at first.
  read(hash) {
    const said = Object.fromEntries(new URLSearchParams(hash.replace(/^#/, "")));
    this.now = { ...this.#defaults, ...this.#checked(said) };
    this.#listeners.forEach((listener) => listener(this.now));
  }

  words() {
    const said = new URLSearchParams();
    for (const [name, value] of Object.entries(this.now)) {
      const words = written(name, value);
      if (words !== written(name, this.#defaults[name])) said.set(name, words);
    }
    return said.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
  }

  #remember() {
    const words = this.words();
    history.replaceState(null, "", words ? `#${words}` : location.pathname + location.search);
  }

  #checked(changes) {
    const kept = {};
    for (const [name, value] of Object.entries(changes)) {
      if (!Object.hasOwn(this.#defaults, name)) continue;
      if (name === "probe") {
        const place = Array.isArray(value) || !value ? value : value.split(",").map(Number);
        if (!place || (place.length === 2 && place.every((p) => p >= 0 && p <= 1))) kept.probe = place || null;
      } else if (Object.hasOwn(this.ranges, name)) {
        const number = Number(value), [least, most, around] = this.ranges[name];
        if (value === "" || !Number.isFinite(number)) continue;
        kept[name] = around ? least + ((((number - least) % around) + around) % around)
          : Math.min(Math.max(number, least), most);
      } else if (this.choices[name].includes(String(value))) {
        kept[name] = String(value);
      }
    }
    return kept;
  }
}

function written(name, value) {
  if (name === "probe") return value ? value.map((p) => p.toFixed(4)).join(",") : "";
  return Object.hasOwn(NUMBERS, name) ? String(Number(Number(value).toFixed(NUMBERS[name]))) : String(value);
}
