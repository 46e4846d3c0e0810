// --- drawing a scene ---

/** Signs of the sensors' detections: for the legend, and onto the plane. */
const SIGNS = [
  { d: 'M3 0A3 3 0 1 1 -3 0A3 3 0 1 1 3 0', draw(c, x, y, r) { c.moveTo(x + r, y); c.arc(x, y, r, 0, 2 * Math.PI); } },
  { d: 'M-4 0H4M0 -4V4', draw(c, x, y, r) { c.moveTo(x - r, y); c.lineTo(x + r, y); c.moveTo(x, y - r); c.lineTo(x, y + r); } },
  { d: 'M-3 -3L3 3M-3 3L3 -3', draw(c, x, y, r) { c.moveTo(x - r, y - r); c.lineTo(x + r, y + r); c.moveTo(x - r, y + r); c.lineTo(x + r, y - r); } },
  { d: 'M0 -4L4 3H-4Z', draw(c, x, y, r) { c.moveTo(x, y - r); c.lineTo(x + r, y + r); c.lineTo(x - r, y + r); c.closePath(); } },
];
const SHORT_TAIL = 0.08; // of the run
const BLOCK = 64; // scans whose tails are drawn anew at every scan; those before are part of what is still
const NEAR = 2; // pixels between two points of a line that are both worth drawing
const FONT = 'system-ui, sans-serif';

Object.assign(Scene.prototype, {
  draw() {
    const begun = performance.now();
    const { context: c, clock } = this;
    this.colours ??= colours();
    // Whole tails are long: all but the newest part is drawn once, until who is there or chosen changes.
    const { offsets } = this;
    const old = this.tail === 'whole' ? Math.floor(clock.scan / BLOCK) * BLOCK : 0;
    const key = old > 0 ? `${old} ${this.chosen} ${this.track.subarray(offsets[clock.scan], offsets[clock.scan + 1])}` : '';
    if (this.stale || key !== this.oldKey) {
      [this.old, this.oldKey] = [old, key];
      this.drawStill(this.still.getContext('2d'));
      this.stale = false;
    }
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.drawImage(this.still, 0, 0);
    c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (this.times.length === 0) return;
    if (this.detections) this.drawDetections(c);
    if (this.own) this.drawOwnShip(c);
    if (this.shown.has('truth')) this.drawTruth(c);
    this.drawTracks(c);
    this.frames.push(performance.now() - begun);
    if (this.frames.length > 1000) this.frames.shift();
    this.canvas.dataset.scan = String(clock.scan);
  },

  px(x) { return (x - this.x) * this.scale + this.width / 2; },
  py(y) { return this.height / 2 - (y - this.y) * this.scale; },

  /** A line through points first to last, leaving out those that are too close to see. */
  trace(c, position, first, last, rows = null) {
    let [beforeX, beforeY, open] = [0, 0, false];
    for (let i = first; i <= last; i += 1) {
      const k = rows ? rows[i] : i;
      const x = this.px(position[2 * k]);
      const y = this.py(position[2 * k + 1]);
      if (!(Math.abs(x) < 1e6 && Math.abs(y) < 1e6)) {
        open = false;
      } else if (!open) {
        c.moveTo(x, y);
        [beforeX, beforeY, open] = [x, y, true];
      } else if (i === last || Math.abs(x - beforeX) + Math.abs(y - beforeY) > NEAR) {
        c.lineTo(x, y);
        [beforeX, beforeY] = [x, y];
      }
    }
  },

  drawStill(c) {
    const k = this.colours;
    c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    c.fillStyle = k.back;
    c.fillRect(0, 0, this.width, this.height);
    this.drawAxes(c);
    if (this.detections && this.history === 'all') this.drawAllDetections(c);
    if (this.own && this.shown.has('own')) {
      c.beginPath();
      this.trace(c, this.own, 0, this.own.length / 2 - 1);
      Object.assign(c, { strokeStyle: k.own, lineWidth: 1, globalAlpha: 0.45 });
      c.stroke();
    }
    if (this.shown.has('truth')) {
      c.beginPath();
      for (const target of this.truth) this.trace(c, target.position, 0, target.times.length - 1);
      Object.assign(c, { strokeStyle: k.truth, lineWidth: 1.2, globalAlpha: 0.75 });
      c.setLineDash([5, 4]);
      c.stroke();
      c.setLineDash([]);
    }
    if (this.old > 0) this.eachTail((track, rows, last, alpha) => this.drawTail(c, track, rows, 0, this.oldPlace(rows), alpha));
    c.globalAlpha = 1;
  },

  drawAxes(c) {
    const k = this.colours;
    const [left, top] = this.onPlane([0, 0]);
    const [right, bottom] = this.onPlane([this.width, this.height]);
    const count = Math.max(this.width / 110, 2);
    const across = ticks(left + this.centre[0], right + this.centre[0], count);
    const up = ticks(bottom + this.centre[1], top + this.centre[1], (count * this.height) / this.width);
    Object.assign(c, { strokeStyle: k.grid, lineWidth: 1, globalAlpha: 1 });
    c.beginPath();
    for (const value of across.values) {
      const x = Math.round(this.px(value - this.centre[0])) + 0.5;
      c.moveTo(x, 0);
      c.lineTo(x, this.height);
    }
    for (const value of up.values) {
      const y = Math.round(this.py(value - this.centre[1])) + 0.5;
      c.moveTo(0, y);
      c.lineTo(this.width, y);
    }
    c.stroke();
    Object.assign(c, { font: `11px ${FONT}`, fillStyle: k.faint, textAlign: 'center', textBaseline: 'alphabetic' });
    const label = ({ name, unit }) => (unit ? `${name} (${unit})` : name);
    const rightLabel = label(this.axes[0]);
    const room = c.measureText(rightLabel).width + 16;
    for (const value of across.values) {
      const x = this.px(value - this.centre[0]);
      if (x > 40 && x < this.width - room - 14) c.fillText(fixed(value, across.digits), x, this.height - 7);
    }
    c.textAlign = 'left';
    for (const value of up.values) {
      const y = this.py(value - this.centre[1]);
      if (y > 70 && y < this.height - 22) c.fillText(fixed(value, up.digits), 7, y - 3);
    }
    Object.assign(c, { font: `600 11px ${FONT}`, textAlign: 'right' });
    c.fillText(rightLabel, this.width - 8, this.height - 7);
    c.textAlign = 'left';
    c.fillText(label(this.axes[1]), 7, 50);
  },

  /** Every detection as a dot, set pixel by pixel: a hundred thousand rectangles would take a quarter of a second. */
  drawAllDetections(c) {
    const { offsets, position } = this.detections;
    const { width, height } = this.still;
    const image = new ImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    const size = Math.max(Math.round(2 * this.ratio), 1);
    this.sensors.forEach((_, sensor) => {
      if (!this.shown.has(`sensor${sensor}`)) return;
      const [red, green, blue] = this.colours.sensor[sensor % 4].match(/[0-9a-f]{2}/gi).map((part) => parseInt(part, 16));
      const [ink] = new Uint32Array(Uint8Array.of(red, green, blue, 110).buffer);
      for (const scan of this.scansOf[sensor]) {
        for (let i = offsets[scan]; i < offsets[scan + 1]; i += 1) {
          const x = Math.round(this.px(position[2 * i]) * this.ratio);
          const y = Math.round(this.py(position[2 * i + 1]) * this.ratio);
          if (!(x >= 0 && y >= 0 && x < width - size && y < height - size)) continue;
          for (let down = 0; down < size; down += 1) pixels.fill(ink, (y + down) * width + x, (y + down) * width + x + size);
        }
      }
    });
    this.dots ??= document.createElement('canvas');
    this.dots.width = width;
    this.dots.height = height;
    this.dots.getContext('2d').putImageData(image, 0, 0);
    c.drawImage(this.dots, 0, 0, this.width, this.height);
  },

  /** The scans of a sensor whose detections are shown, the newest first. */
  scansShown(sensor) {
    if (!this.shown.has(`sensor${sensor}`)) return [];
    const list = this.scansOf[sensor];
    const last = lastAtMost(list, this.clock.scan);
    if (last < 0 || this.clock.time - this.times[list[last]] > this.patience[sensor]) return [];
    const count = this.history === 'all' ? 1 : Number(this.history);
    return list.slice(Math.max(last - count + 1, 0), last + 1).reverse();
  },

  drawDetections(c) {
    const { offsets, position } = this.detections;
    this.sensors.forEach((_, sensor) => {
      const sign = SIGNS[sensor % SIGNS.length];
      const scans = this.scansShown(sensor);
      c.strokeStyle = this.colours.sensor[sensor % 4];
      scans.forEach((scan, back) => {
        c.globalAlpha = back === 0 ? 1 : 0.55 * (1 - back / scans.length);
        c.lineWidth = back === 0 ? 1.5 : 1;
        c.beginPath();
        for (let i = offsets[scan]; i < offsets[scan + 1]; i += 1) {
          const x = this.px(position[2 * i]);
          const y = this.py(position[2 * i + 1]);
          if (x > -9 && y > -9 && x < this.width + 9 && y < this.height + 9) sign.draw(c, x, y, back === 0 ? 3.5 : 2.5);
        }
        c.stroke();
      });
    });
    c.globalAlpha = 1;
  },

  drawOwnShip(c) {
    const k = this.colours;
    const { scan } = this.clock;
    const x = this.px(this.own[2 * scan]);
    const y = this.py(this.own[2 * scan + 1]);
    if (!Number.isFinite(x + y)) return;
    if (this.shown.has('own')) {
      c.beginPath();
      this.trace(c, this.own, 0, scan);
      Object.assign(c, { strokeStyle: k.own, fillStyle: k.own, lineWidth: 2.5 });
      c.stroke();
      c.beginPath();
      c.moveTo(x, y - 7);
      c.lineTo(x + 6, y);
      c.lineTo(x, y + 7);
      c.lineTo(x - 6, y);
      c.fill();
    }
    if (this.region !== null && this.shown.has('region')) {
      c.beginPath();
      c.arc(x, y, this.region * this.scale, 0, 2 * Math.PI);
      Object.assign(c, { strokeStyle: k.own, lineWidth: 1 });
      c.setLineDash([2, 4]);
      c.stroke();
      c.setLineDash([]);
    }
  },

  /** Where a target is now, between two rows of its truth; null before and after. */
  truthNow(target) {
    const { times, position } = target;
    const i = lastAtMost(times, this.clock.time);
    if (i < 0 || (i === times.length - 1 && this.clock.time > times[i])) return null;
    const j = Math.min(i + 1, times.length - 1);
    const share = j > i ? (this.clock.time - times[i]) / (times[j] - times[i]) : 0;
    const between = (k) => position[2 * i + k] + share * (position[2 * j + k] - position[2 * i + k]);
    return [between(0), between(1)];
  },

  drawTruth(c) {
    Object.assign(c, { strokeStyle: this.colours.truth, lineWidth: 2 });
    c.beginPath();
    for (const target of this.truth) {
      const at = this.truthNow(target);
      if (at !== null) {
        const [x, y] = [this.px(at[0]), this.py(at[1])];
        c.rect(x - 5, y - 5, 10, 10);
      }
    }
    c.stroke();
  },

  oval(c, x, y, found, sigmas) {
    if (found === null || !Number.isFinite(x + y)) return;
    c.beginPath();
    c.ellipse(x, y, sigmas * found.major * this.scale, sigmas * found.minor * this.scale, -found.angle, 0, 2 * Math.PI);
  },

  /** How strongly a track is drawn: the others step back behind one that is chosen. */
  weight(track) {
    return this.chosen < 0 || track === this.chosen ? 1 : 0.3;
  },

  /** Calls back for every tail that is shown, with the place of its last row. */
  eachTail(act) {
    if (this.tail === 'none' || !this.shown.has('tracks')) return;
    this.rowsOf.forEach((rows, track) => {
      const last = this.placeIn(rows);
      const alive = last >= 0 && this.scanOfRow[rows[last]] === this.clock.scan;
      if (alive || (last >= 0 && this.tail === 'whole')) act(track, rows, last, this.weight(track) * (alive ? 0.9 : 0.45));
    });
  },

  /** Where in the rows of a track the part that is drawn once ends; -1 if it has none. */
  oldPlace(rows) {
    return this.old > 0 ? lastAtMost(rows, this.offsets[this.old + 1] - 1) : -1;
  },

  drawTracks(c) {
    this.eachTail((track, rows, last, alpha) => {
      let first = Math.max(this.oldPlace(rows), 0);
      if (this.tail === 'short') {
        const since = this.clock.time - SHORT_TAIL * this.clock.duration;
        first = last;
        while (first > 0 && this.times[this.scanOfRow[rows[first - 1]]] >= since) first -= 1;
      }
      this.drawTail(c, track, rows, first, last, alpha);
    });
    const now = [];
    for (let row = this.offsets[this.clock.scan]; row < this.offsets[this.clock.scan + 1]; row += 1) {
      now.push({ track: this.track[row], row, weight: this.weight(this.track[row]) });
    }
    for (const each of now) this.drawRow(c, each);
    c.globalAlpha = 1;
    if (this.shown.has('names')) this.drawNames(c, now);
  },

  drawTail(c, track, rows, first, last, alpha) {
    if (last <= first) return;
    c.beginPath();
    this.trace(c, this.position, first, last, rows);
    c.globalAlpha = alpha;
    c.lineWidth = track === this.chosen ? 3.5 : 2;
    c.strokeStyle = this.colours.track[track % 8];
    c.lineJoin = 'bevel'; // round ones take twice as long, and nobody sees them
    c.stroke();
  },

  drawRow(c, { track, row, weight }) {
    const colour = this.colours.track[track % 8];
    const x = this.px(this.position[2 * row]);
    const y = this.py(this.position[2 * row + 1]);
    if (!(x > -2000 && y > -2000 && x < this.width + 2000 && y < this.height + 2000)) return;
    Object.assign(c, { strokeStyle: colour, fillStyle: colour, lineWidth: 1 });
    if (this.extent && this.shown.has('extents')) {
      const [xx, xy, yy] = this.extent.subarray(3 * row, 3 * row + 3);
      this.oval(c, x, y, ellipse(xx, xy, yy), 2);
      c.globalAlpha = 0.1 * weight;
      c.fill();
      c.globalAlpha = weight;
      c.lineWidth = 2;
      c.stroke();
      c.lineWidth = 1;
    }
    if (this.gate && this.shown.has('gates')) {
      const [gateX, gateY, xx, xy, yy] = this.gate.subarray(5 * row, 5 * row + 5);
      const found = ellipse(xx, xy, yy);
      if (found !== null && Number.isFinite(gateX + gateY)) {
        this.oval(c, this.px(gateX), this.py(gateY), found, 1);
        c.globalAlpha = 0.8 * weight;
        c.setLineDash([4, 3]);
        c.stroke();
        c.setLineDash([]);
      }
    }
    if (this.shown.has('ellipses')) {
      const [xx, xy, yy] = this.cov.subarray(3 * row, 3 * row + 3);
      const found = ellipse(xx, xy, yy);
      for (const sigmas of found === null ? [] : [2, 1]) {
        this.oval(c, x, y, found, sigmas);
        c.globalAlpha = 0.16 * weight;
        c.fill();
        c.globalAlpha = 0.7 * weight;
        c.stroke();
      }
    }
    if (!this.shown.has('tracks')) return;
    c.globalAlpha = weight;
    c.beginPath();
    c.arc(x, y, track === this.chosen ? 6 : 4, 0, 2 * Math.PI);
    // A hollow dot is a prediction: no report was given to the track in this scan.
    if (this.age[row] > 0) c.fillStyle = this.colours.back;
    c.fill();
    c.lineWidth = 2;
    c.stroke();
  },

  drawNames(c, now) {
    Object.assign(c, { font: `600 12px ${FONT}`, textAlign: 'left', textBaseline: 'alphabetic', lineJoin: 'round' });
    for (const { track, row, weight } of now) {
      const x = this.px(this.position[2 * row]) + 8;
      const y = this.py(this.position[2 * row + 1]) - 8;
      c.globalAlpha = weight;
      Object.assign(c, { strokeStyle: this.colours.back, fillStyle: this.colours.track[track % 8], lineWidth: 4 });
      c.strokeText(this.ids[track], x, y);
      c.fillText(this.ids[track], x, y);
    }
    c.globalAlpha = 1;
  },

  // --- what lies under a point ---

  /** The row nearest to a point of the picture: a track where it is now, else its tail; -1 if nothing is near. */
  rowAt([px, py], reach) {
    let [best, nearest] = [-1, reach * reach];
    const look = (row, limit) => {
      const far = (this.px(this.position[2 * row]) - px) ** 2 + (this.py(this.position[2 * row + 1]) - py) ** 2;
      if (far < Math.min(nearest, limit)) [best, nearest] = [row, far];
    };
    const { scan } = this.clock;
    for (let row = this.offsets[scan]; row < this.offsets[scan + 1]; row += 1) look(row, Infinity);
    if (best >= 0 || this.tail === 'none') return best;
    for (const rows of this.rowsOf) {
      const last = this.placeIn(rows);
      if (last < 0 || (this.tail !== 'whole' && this.scanOfRow[rows[last]] !== scan)) continue;
      const since = this.tail === 'short' ? this.clock.time - SHORT_TAIL * this.clock.duration : -Infinity;
      for (let i = last; i >= 0 && this.times[this.scanOfRow[rows[i]]] >= since; i -= 1) look(rows[i], 100);
    }
    return best;
  },

  /** What else is there: a target's true place or a detection, in words; null if nothing. */
  wordsAt([px, py], reach) {
    const near = (x, y) => (this.px(x) - px) ** 2 + (this.py(y) - py) ** 2 < reach * reach;
    const [xAxis, yAxis] = this.axes;
    const place = (x, y) => `${xAxis.name} ${fixed(this.centre[0] + x, 2)} ${xAxis.unit}, `
      + `${yAxis.name} ${fixed(this.centre[1] + y, 2)} ${yAxis.unit}`;
    if (this.shown.has('truth')) {
      for (const target of this.truth) {
        const at = this.truthNow(target);
        if (at !== null && near(at[0], at[1])) return { head: `Truth ${target.id}`, text: place(at[0], at[1]) };
      }
    }
    for (let sensor = 0; this.detections && sensor < this.sensors.length; sensor += 1) {
      const { offsets, position } = this.detections;
      for (const scan of this.scansShown(sensor)) {
        for (let i = offsets[scan]; i < offsets[scan + 1]; i += 1) {
          const [x, y] = [position[2 * i], position[2 * i + 1]];
          if (near(x, y)) return { head: this.sensors[sensor], text: `${fixed(this.times[scan], 2)} s, ${place(x, y)}` };
        }
      }
    }
    return null;
  },
});
