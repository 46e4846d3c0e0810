// --- curves over time, with the cursor of a scene's clock ---

const HIGH = 230; // of a picture of curves, pixels
const ROOM = { left: 58, right: 14, top: 26, bottom: 36 };
const DASHES = ['', '7 4', '2 3', '9 3 2 3'];

class Curves {
  constructor(data, root, scene) {
    this.root = root;
    this.scene = scene;
    this.x = data.x;
    this.y = data.y;
    this.band = data.band;
    this.lines = data.lines.map((line, k) => ({
      name: line.name,
      x: unpack(line.x),
      y: unpack(line.y),
      low: unpack(line.low),
      high: unpack(line.high),
      shown: true,
      place: k,
    }));
    this.limits();
    this.legend = make('div', { class: 'lines' });
    this.fillLegend();
    this.svg = make('svg', { class: 'curves', role: 'img', 'aria-label': root.dataset.label });
    root.append(this.legend, this.svg);
    this.svg.addEventListener('pointermove', (event) => this.point(event, event.buttons > 0));
    this.svg.addEventListener('pointerdown', (event) => this.point(event, true));
    this.svg.addEventListener('pointerleave', () => this.showAt(null));
    new ResizeObserver(() => this.draw()).observe(root);
    if (scene) scene.clock.listeners.push(() => this.cursor());
    this.draw();
  }

  limits() {
    const out = [Infinity, -Infinity, Infinity, -Infinity];
    for (const line of this.lines.filter(({ shown }) => shown)) {
      for (const value of line.x) {
        if (value < out[0]) out[0] = value;
        if (value > out[1]) out[1] = value;
      }
      for (const values of [line.y, line.low, line.high]) {
        for (const value of values ?? []) {
          if (value < out[2]) out[2] = value;
          if (value > out[3]) out[3] = value;
        }
      }
    }
    if (!(out[1] >= out[0])) [out[0], out[1]] = [0, 1];
    if (!(out[3] >= out[2])) [out[2], out[3]] = [0, 1];
    if (out[0] === out[1]) [out[0], out[1]] = [out[0] - 0.5, out[1] + 0.5];
    // Zero belongs to the picture where it is not far.
    if (out[2] > 0 && out[2] < 0.5 * out[3]) out[2] = 0;
    const margin = (out[3] - out[2]) * 0.05 || Math.abs(out[3]) * 0.1 || 0.5;
    [this.left, this.right] = [out[0], out[1]];
    [this.low, this.high] = [out[2] === 0 ? 0 : out[2] - margin, out[3] + margin];
  }

  fillLegend() {
    this.values = this.lines.map((line) => {
      const value = make('b');
      const sign = make('svg', { viewBox: '0 0 24 12', class: 'swatch', 'aria-hidden': 'true' },
        make('line', { x1: 0, x2: 24, y1: 6, y2: 6, class: `line c${line.place % 8}`, 'stroke-dasharray': this.dash(line) }));
      const input = make('input', { type: 'checkbox' });
      input.checked = true;
      input.addEventListener('change', () => {
        line.shown = input.checked;
        this.limits();
        this.draw();
      });
      this.legend.append(make('label', {}, input, sign, make('span', {}, line.name), value));
      return value;
    });
    if (this.lines.some((line) => line.low)) this.legend.append(make('small', {}, `shaded: ${this.band}`));
  }

  /** Lines of one colour differ in their dashes. */
  dash(line) {
    return DASHES[Math.floor(line.place / 8) % DASHES.length] || 'none';
  }

  px(x) { return ROOM.left + ((x - this.left) / (this.right - this.left)) * (this.width - ROOM.left - ROOM.right); }
  py(y) { return HIGH - ROOM.bottom - ((y - this.low) / (this.high - this.low)) * (HIGH - ROOM.top - ROOM.bottom); }

  draw() {
    const width = Math.max(this.root.clientWidth, 120);
    this.width = width;
    this.svg.setAttribute('viewBox', `0 0 ${width} ${HIGH}`);
    this.svg.setAttribute('height', HIGH);
    this.svg.replaceChildren();
    const across = ticks(this.left, this.right, width / 100);
    const up = ticks(this.low, this.high, 4);
    for (const value of up.values) {
      const y = this.py(value);
      this.svg.append(make('line', { x1: ROOM.left, x2: width - ROOM.right, y1: y, y2: y, class: 'grid' }));
      this.svg.append(make('text', { x: ROOM.left - 7, y: y + 4, 'text-anchor': 'end' }, fixed(value, up.digits)));
    }
    for (const value of across.values) {
      this.svg.append(make('text', { x: this.px(value), y: HIGH - ROOM.bottom + 16, 'text-anchor': 'middle' }, fixed(value, across.digits)));
    }
    this.svg.append(make('text', { x: width - ROOM.right, y: HIGH - 4, 'text-anchor': 'end', class: 'name' }, this.x));
    this.svg.append(make('text', { x: 4, y: 14, class: 'name' }, this.y));
    for (const line of this.lines.filter(({ shown }) => shown)) {
      if (line.low) this.svg.append(make('path', { d: this.area(line), class: `band c${line.place % 8}` }));
    }
    for (const line of this.lines.filter(({ shown }) => shown)) {
      this.svg.append(make('path', { d: this.path(line.x, line.y), class: `line c${line.place % 8}`, 'stroke-dasharray': this.dash(line) }));
    }
    this.mark = make('line', { y1: ROOM.top - 8, y2: HIGH - ROOM.bottom, class: 'cursor' });
    this.svg.append(this.mark);
    this.cursor();
  }

  path(xs, ys) {
    let [out, open] = ['', false];
    for (let i = 0; i < xs.length; i += 1) {
      const fine = Number.isFinite(xs[i] + ys[i]);
      if (fine) {
        out += `${open ? 'L' : 'M'}${this.px(xs[i]).toFixed(1)} ${this.py(ys[i]).toFixed(1)}`;
        // A point between two gaps still shows, as a dot.
        if (!open && !Number.isFinite(ys[i + 1])) out += 'h.01';
      }
      open = fine;
    }
    return out;
  }

  /** Bands, one for every stretch without a gap. */
  area(line) {
    let out = '';
    for (let i = 0; i < line.x.length; i += 1) {
      if (!Number.isFinite(line.low[i] + line.high[i] + line.x[i])) continue;
      let j = i;
      while (j + 1 < line.x.length && Number.isFinite(line.low[j + 1] + line.high[j + 1] + line.x[j + 1])) j += 1;
      const point = (k, values) => `${this.px(line.x[k]).toFixed(1)} ${this.py(values[k]).toFixed(1)}`;
      const above = [];
      const below = [];
      for (let k = i; k <= j; k += 1) {
        above.push(point(k, line.high));
        below.push(point(k, line.low));
      }
      out += `M${above.join('L')}L${below.reverse().join('L')}Z`;
      i = j;
    }
    return out;
  }

  cursor() {
    this.showAt(this.scene && this.scene.times.length ? this.scene.clock.time : null);
  }

  /** Puts the cursor at x and the values there into the legend. */
  showAt(x) {
    const at = x ?? (this.scene && this.scene.times.length ? this.scene.clock.time : null);
    const inside = at !== null && at >= this.left && at <= this.right;
    this.mark.setAttribute('visibility', inside ? 'visible' : 'hidden');
    if (inside) {
      this.mark.setAttribute('x1', this.px(at));
      this.mark.setAttribute('x2', this.px(at));
    }
    this.lines.forEach((line, k) => {
      const i = inside ? lastAtMost(line.x, at) : -1;
      this.values[k].textContent = i < 0 ? '' : figure(line.y[i]);
    });
  }

  point(event, set) {
    const box = this.svg.getBoundingClientRect();
    const share = (event.clientX - box.left - ROOM.left) / (this.width - ROOM.left - ROOM.right);
    const x = this.left + Math.min(Math.max(share, 0), 1) * (this.right - this.left);
    if (set && this.scene) {
      this.scene.clock.pause();
      this.scene.clock.showTime(x);
    }
    this.showAt(x);
  }
}
