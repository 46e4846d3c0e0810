// --- a scene: its numbers, its view, what is chosen and switched on ---

const OPTIONS = [
  ['tracks', 'Tracks'],
  ['names', 'Track numbers'],
  ['ellipses', '1 and 2 sigma'],
  ['gates', 'Gates'],
  ['extents', 'Extents'],
  ['truth', 'Truth'],
  ['own', 'Own ship'],
  ['region', 'Region'],
];
const MANY_ROWS = 30000; // track rows from which on tails begin short

class Scene {
  constructor(data, root) {
    this.root = root;
    this.canvas = root.querySelector('canvas');
    this.context = this.canvas.getContext('2d', { alpha: false });
    this.still = document.createElement('canvas'); // what does not change from scan to scan
    this.read(data);
    this.clock = new Clock(this.times);
    this.chosen = -1;
    this.shown = new Set(['tracks', 'names', 'ellipses', 'gates', 'extents', 'truth', 'own', 'region']);
    this.sensors.forEach((_, k) => this.shown.add(`sensor${k}`));
    this.history = '5';
    this.tail = this.track.length > MANY_ROWS ? 'short' : 'whole';
    this.follow = false;
    this.dirty = false;
    this.frames = []; // milliseconds that the last pictures took to draw
    this.fillLegend(data);
    this.hands();
    this.clock.listeners.push(() => this.onClock());
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
    this.clock.show(this.busiest());
  }

  read(data) {
    this.axes = data.axes.map(split);
    this.centre = data.centre;
    this.bounds = data.bounds;
    this.times = unpack(data.times);
    this.sensors = data.sensors;
    this.ids = data.ids;
    this.region = data.region;
    this.gateProbability = data.gateProbability;
    for (const name of ['scanSensor', 'offsets', 'track', 'position', 'speed', 'cov', 'age', 'hits', 'gate', 'extent', 'own']) {
      this[name] = unpack(data[name]);
    }
    this.truth = data.truth.map((target) => ({
      id: target.id,
      times: unpack(target.times),
      position: unpack(target.position),
    }));
    this.detections = data.detections && {
      offsets: unpack(data.detections.offsets),
      position: unpack(data.detections.position),
    };
    // The scan of every row, the rows of every track, the scans of every sensor.
    const scans = this.times.length;
    this.scanOfRow = new Int32Array(this.track.length);
    for (let k = 0; k < scans; k += 1) this.scanOfRow.fill(k, this.offsets[k], this.offsets[k + 1]);
    this.rowsOf = this.ids.map(() => []);
    this.track.forEach((track, row) => this.rowsOf[track].push(row));
    this.rowsOf = this.rowsOf.map((rows) => Int32Array.from(rows));
    this.scansOf = this.sensors.map(() => []);
    this.scanSensor.forEach((sensor, k) => this.scansOf[sensor].push(k));
    // A sensor that has been silent for long shows nothing.
    this.patience = this.scansOf.map((list) => {
      const steps = list.slice(1).map((k, i) => this.times[k] - this.times[list[i]]).sort((a, b) => a - b);
      return steps.length ? 3 * Math.max(steps[steps.length >> 1], steps[Math.floor(steps.length * 0.95)]) : Infinity;
    });
  }

  /** The last scan with the most tracks: what a page opens on. */
  busiest() {
    let best = 0;
    for (let k = 0; k < this.times.length; k += 1) {
      if (this.rowsIn(k) >= this.rowsIn(best)) best = k;
    }
    return best;
  }

  rowsIn(scan) {
    return this.offsets[scan + 1] - this.offsets[scan];
  }

  /** The row of a track in the scan shown; -1 where it has none. */
  rowNow(track) {
    const rows = this.rowsOf[track];
    const place = this.placeIn(rows);
    return place >= 0 && this.scanOfRow[rows[place]] === this.clock.scan ? rows[place] : -1;
  }

  /** Where in the rows of a track the last one up to the scan shown stands. */
  placeIn(rows) {
    return lastAtMost(rows, this.offsets[this.clock.scan + 1] - 1);
  }

  // --- view ---

  resize() {
    const box = this.canvas.getBoundingClientRect();
    const grown = this.width > 0;
    const [width, height] = [Math.max(box.width, 1), Math.max(box.height, 1)];
    this.ratio = window.devicePixelRatio || 1;
    for (const canvas of [this.canvas, this.still]) {
      canvas.width = Math.round(width * this.ratio);
      canvas.height = Math.round(height * this.ratio);
    }
    const fitted = !grown || this.fitted;
    [this.width, this.height] = [width, height];
    if (fitted) this.fit();
    this.redraw(true);
  }

  fit() {
    const [left, bottom, right, top] = this.bounds;
    this.scale = Math.min((this.width - 64) / (right - left), (this.height - 56) / (top - bottom));
    this.scale = Math.max(this.scale, 1e-9);
    // The labels of the axes need room to the left and below.
    this.x = (left + right) / 2 - 18 / this.scale;
    this.y = (bottom + top) / 2 - 10 / this.scale;
    this.fitted = true;
    this.redraw(true);
  }

  zoom(factor, at = [this.width / 2, this.height / 2]) {
    const [x, y] = this.onPlane(at);
    this.scale = Math.min(Math.max(this.scale * factor, 1e-9), 1e9);
    const [newX, newY] = this.onPlane(at);
    this.x += x - newX;
    this.y += y - newY;
    this.fitted = false;
    this.redraw(true);
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.fitted = false;
    this.redraw(true);
  }

  centreOn(row) {
    if (!Number.isFinite(this.position[2 * row] + this.position[2 * row + 1])) return;
    this.x = this.position[2 * row];
    this.y = this.position[2 * row + 1];
    this.fitted = false;
    this.redraw(true);
  }

  onPlane([px, py]) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  // --- what is chosen ---

  choose(track, centre = false) {
    this.chosen = track === this.chosen && !centre ? -1 : track;
    if (this.chosen >= 0 && centre) {
      const rows = this.rowsOf[track];
      if (this.rowNow(track) < 0) {
        this.clock.pause();
        this.clock.show(this.scanOfRow[rows[Math.max(this.placeIn(rows), 0)]]);
      }
      this.centreOn(this.rowNow(track));
    }
    for (const row of this.root.querySelectorAll('tr[data-track]')) {
      const pressed = Number(row.dataset.track) === this.chosen;
      row.classList.toggle('chosen-row', pressed);
      row.querySelector('button').setAttribute('aria-pressed', String(pressed));
    }
    this.tellChosen();
    this.redraw();
  }

  tellChosen() {
    const box = this.root.querySelector('.chosen');
    box.setAttribute('aria-live', this.clock.playing ? 'off' : 'polite');
    box.replaceChildren();
    if (this.chosen < 0) return;
    const row = this.rowNow(this.chosen);
    if (row >= 0) box.append(this.describe(row));
    else box.append(make('strong', {}, `Track ${this.ids[this.chosen]}`), make('p', {}, 'not there in this scan'));
  }

  /** The numbers of a row, as a list. */
  describe(row) {
    const [x, y] = this.axes;
    const pairs = [
      ['time', `${fixed(this.times[this.scanOfRow[row]], 2)} s`],
      [x.name, `${fixed(this.centre[0] + this.position[2 * row], 2)} ${x.unit}`],
      [y.name, `${fixed(this.centre[1] + this.position[2 * row + 1], 2)} ${y.unit}`],
    ];
    if (Number.isFinite(this.speed[row])) pairs.push(['speed', `${figure(this.speed[row])} ${x.unit}/s`]);
    const [xx, xy, yy] = this.cov.subarray(3 * row, 3 * row + 3);
    pairs.push([`σ ${x.name}`, `${figure(Math.sqrt(xx))} ${x.unit}`]);
    pairs.push([`σ ${y.name}`, `${figure(Math.sqrt(yy))} ${y.unit}`]);
    pairs.push(['correlation', figure(xy / Math.sqrt(xx * yy))]);
    pairs.push(['reports', String(this.hits[row])]);
    if (this.age[row] > 0) pairs.push(['last report', `${figure(this.age[row])} s ago`]);
    const list = make('dl');
    for (const [name, value] of pairs) list.append(make('dt', {}, name), make('dd', {}, value));
    const out = document.createDocumentFragment();
    out.append(make('strong', {}, `Track ${this.ids[this.track[row]]}`), list);
    return out;
  }

  // --- legend and clock ---

  fillLegend(data) {
    const box = this.root.querySelector('.legend');
    const has = {
      tracks: true,
      names: true,
      ellipses: true,
      gates: this.gate !== null,
      extents: this.extent !== null,
      truth: this.truth.length > 0,
      own: this.own !== null,
      region: this.region !== null && this.own !== null,
    };
    const entries = OPTIONS.filter(([key]) => has[key]);
    if (this.gate) entries.find(([key]) => key === 'gates')[1] = `Gates (${figure(100 * data.gateProbability)} %)`;
    if (this.detections) {
      this.sensors.forEach((name, k) => {
        const first = this.scansOf[k].find((scan) => this.detections.offsets[scan + 1] > this.detections.offsets[scan]);
        if (first !== undefined) entries.push([`sensor${k}`, name]);
      });
    }
    for (const [key, name] of entries) {
      const input = make('input', { type: 'checkbox' });
      input.checked = true;
      input.addEventListener('change', () => {
        if (input.checked) this.shown.add(key);
        else this.shown.delete(key);
        this.redraw(true);
      });
      box.append(make('label', {}, input, swatch(key), make('span', {}, name)));
    }
    for (const select of this.root.querySelectorAll('.panel select')) {
      const key = select.dataset.set;
      select.value = this[key];
      select.closest('label').hidden = key === 'history' && !this.detections;
      select.addEventListener('change', () => {
        this[key] = select.value;
        this.redraw(true);
      });
    }
    const speeds = this.root.querySelector('[data-set=speed]');
    for (const speed of SPEEDS) speeds.append(make('option', { value: speed }, `× ${speed}`));
    speeds.value = String(this.clock.speed);
    speeds.addEventListener('change', () => { this.clock.speed = Number(speeds.value); });
  }

  onClock() {
    const { clock } = this;
    const slider = this.root.querySelector('input[type=range]');
    const count = this.times.length;
    const time = count ? `${fixed(clock.time, this.timeDigits())} s` : 'no scans';
    slider.max = String(Math.max(count - 1, 0));
    slider.disabled = count < 2;
    slider.value = String(clock.scan);
    slider.setAttribute('aria-valuetext', count ? `${time}, scan ${clock.scan + 1} of ${count}` : time);
    const place = count ? `scan ${clock.scan + 1} of ${count}, ${this.sensors[this.scanSensor[clock.scan]]}` : '';
    this.root.querySelector('.time').replaceChildren(make('strong', {}, time), ` ${place}`);
    const play = this.root.querySelector('.play');
    play.textContent = clock.playing ? '❚❚' : '▶';
    play.setAttribute('aria-label', clock.playing ? 'Pause' : 'Play');
    play.disabled = !(clock.duration > 0);
    if (this.follow && this.chosen >= 0 && this.rowNow(this.chosen) >= 0) this.centreOn(this.rowNow(this.chosen));
    this.tellChosen();
    this.redraw();
  }

  /** As many decimals as two scans need to differ. */
  timeDigits() {
    const step = this.times.length > 1 ? this.clock.duration / (this.times.length - 1) : 1;
    return step > 0 ? Math.min(Math.max(Math.ceil(-Math.log10(step)) + 1, 0), 3) : 2;
  }

  /** Draws at the next frame, the still part too if that changed. */
  redraw(still = false) {
    this.stale = this.stale || still;
    if (this.dirty) return;
    this.dirty = true;
    requestAnimationFrame(() => {
      this.dirty = false;
      this.draw();
    });
  }
}

/** The sign of a legend entry. */
function swatch(key) {
  const sensor = key.startsWith('sensor') ? Number(key.slice(6)) % SIGNS.length : null;
  const kind = sensor === null ? key : `sensor d${sensor}`;
  const svg = make('svg', { viewBox: '0 0 24 12', class: `swatch ${kind}`, 'aria-hidden': 'true' });
  const round = { cx: 12, cy: 6, rx: 8, ry: 4.5 };
  if (key === 'ellipses' || key === 'extents' || key === 'gates') svg.append(make('ellipse', round));
  else if (key === 'names') svg.append(make('text', { x: 12, y: 10 }, '7'));
  else if (key === 'region') svg.append(make('circle', { cx: 12, cy: 6, r: 5 }));
  else if (sensor !== null) svg.append(make('path', { d: SIGNS[sensor].d, transform: 'translate(12 6)' }));
  else svg.append(make('path', { d: 'M1 8C8 8 12 4 23 4' }));
  return svg;
}
