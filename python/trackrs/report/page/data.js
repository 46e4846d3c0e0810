// --- numbers and small helpers ---

const ARRAYS = { f32: Float32Array, f64: Float64Array, i32: Int32Array };

/** The typed array that `packed` in Python made text of. */
function unpack(packed) {
  if (packed === null) return null;
  const [[kind, text]] = Object.entries(packed);
  const bytes = atob(text);
  const out = new Uint8Array(bytes.length);
  for (let i = 0; i < bytes.length; i += 1) out[i] = bytes.charCodeAt(i);
  return new ARRAYS[kind](out.buffer);
}

/** The last index whose value is at most x; -1 if there is none. */
function lastAtMost(values, x) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= x) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Round numbers from low to high, about as many as asked for, and how many decimals they need. */
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  if (!(raw > 0) || !Number.isFinite(raw)) return { values: [low], digits: 2, step: 1 };
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.9999999);
  const values = [];
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  for (let k = first; k <= last && values.length < 100; k += 1) values.push(k * step);
  return { values, digits: Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 12), step };
}

const fixed = (value, digits) => {
  if (!Number.isFinite(value)) return '–';
  const text = value.toFixed(digits).replace('-', '−');
  return /^−[0.]*$/.test(text) ? text.slice(1) : text;
};
const figure = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(3))).replace('-', '−') : '–');

/** Name and unit of a label such as "north (m)". */
function split(label) {
  const found = /^(.*?)\s*\(([^()]*)\)\s*$/.exec(label);
  return found ? { name: found[1], unit: found[2] } : { name: label, unit: '' };
}

/** Semi-axes and direction of the ellipse of a covariance; null where it is none. */
function ellipse(xx, xy, yy) {
  const middle = (xx + yy) / 2;
  const half = Math.hypot((xx - yy) / 2, xy);
  if (!(middle + half >= 0) || !Number.isFinite(half)) return null;
  return {
    major: Math.sqrt(middle + half),
    minor: Math.sqrt(Math.max(middle - half, 0)),
    angle: Math.atan2(2 * xy, xx - yy) / 2,
  };
}

/** An element with attributes and children; children that are text stay text. */
function make(name, attributes = {}, ...children) {
  const svg = make.svg.has(name);
  const element = svg ? document.createElementNS('http://www.w3.org/2000/svg', name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}
make.svg = new Set(['svg', 'path', 'line', 'circle', 'text', 'g', 'rect', 'ellipse']);

const calm = window.matchMedia('(prefers-reduced-motion: reduce)');

/** Colours of the theme in force. Pictures are drawn anew when it changes. */
function colours() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(name).trim();
  return {
    back: value('--plane'),
    grid: value('--grid'),
    text: value('--text'),
    faint: value('--faint'),
    truth: value('--truth'),
    own: value('--own'),
    track: Array.from({ length: 8 }, (_, k) => value(`--c${k}`)),
    sensor: Array.from({ length: 4 }, (_, k) => value(`--d${k}`)),
  };
}
