// --- what hands do to a scene: buttons, keys, wheel, drag, pinch, tap ---

const DOUBLE = 1.4; // of a zoom step
const STILL = 5; // pixels that a tap may move

Object.assign(Scene.prototype, {
  hands() {
    const acts = {
      play: () => this.clock.toggle(),
      back: () => this.clock.step(-1),
      next: () => this.clock.step(1),
      in: () => this.zoom(DOUBLE),
      out: () => this.zoom(1 / DOUBLE),
      fit: () => this.fit(),
    };
    for (const button of this.root.querySelectorAll('[data-do]')) {
      button.addEventListener('click', acts[button.dataset.do]);
    }
    const slider = this.root.querySelector('input[type=range]');
    slider.addEventListener('input', () => {
      this.clock.pause();
      this.clock.show(Number(slider.value));
    });
    const follow = this.root.querySelector('[data-set=follow]');
    follow.addEventListener('change', () => {
      this.follow = follow.checked;
      this.onClock();
    });
    for (const row of this.root.querySelectorAll('tr[data-track]')) {
      row.addEventListener('click', () => this.choose(Number(row.dataset.track), true));
    }
    const plane = this.root.querySelector('.plane');
    plane.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-Math.min(Math.max(event.deltaY, -200), 200) / 400), this.at(event));
    }, { passive: false });
    this.pointers = new Map();
    this.canvas.addEventListener('pointerdown', (event) => this.down(event));
    this.canvas.addEventListener('pointermove', (event) => this.move(event));
    for (const name of ['pointerup', 'pointercancel']) this.canvas.addEventListener(name, (event) => this.up(event));
    this.canvas.addEventListener('pointerleave', () => this.tip(null));
  },

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  },

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, this.at(event));
    this.moved = this.pointers.size > 1 ? Infinity : 0;
  },

  move(event) {
    const at = this.at(event);
    const before = this.pointers.get(event.pointerId);
    if (before === undefined) {
      this.tip(at);
      return;
    }
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
    this.pointers.set(event.pointerId, at);
    if (others.length > 0) {
      // Two fingers: the plane moves and grows with them.
      const [other] = others;
      const middle = (point) => [(point[0] + other[0]) / 2, (point[1] + other[1]) / 2];
      const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      const [was, is] = [middle(before), middle(at)];
      this.pan(is[0] - was[0], is[1] - was[1]);
      if (apart(before) > 1) this.zoom(apart(at) / apart(before), is);
      return;
    }
    this.moved += Math.hypot(at[0] - before[0], at[1] - before[1]);
    if (this.moved > STILL) {
      this.pan(at[0] - before[0], at[1] - before[1]);
      this.tip(null);
    }
  },

  up(event) {
    const known = this.pointers.delete(event.pointerId);
    if (!known || event.type === 'pointercancel' || this.moved > STILL || this.pointers.size > 0) return;
    const at = this.at(event);
    const row = this.rowAt(at, event.pointerType === 'touch' ? 30 : 18);
    this.choose(row < 0 ? -1 : this.track[row]);
    this.tip(at, event.pointerType === 'touch' ? 30 : 18);
  },

  /** Shows what lies under a point, beside it. */
  tip(at, reach = 18) {
    const box = this.root.querySelector('.tip');
    const row = at === null ? -1 : this.rowAt(at, reach);
    const words = at === null || row >= 0 ? null : this.wordsAt(at, reach / 2);
    box.hidden = row < 0 && words === null;
    this.canvas.classList.toggle('over', !box.hidden);
    if (box.hidden) return;
    if (row >= 0) box.replaceChildren(this.describe(row));
    else box.replaceChildren(make('strong', {}, words.head), make('p', {}, words.text));
    const left = at[0] + 14 + box.offsetWidth > this.width ? at[0] - 14 - box.offsetWidth : at[0] + 14;
    box.style.left = `${Math.max(left, 4)}px`;
    box.style.top = `${Math.max(Math.min(at[1] + 10, this.height - box.offsetHeight - 4), 4)}px`;
  },

  /** What a key does here; false if nothing. */
  key(event) {
    const far = 40;
    if (event.shiftKey && event.key.startsWith('Arrow')) {
      const to = { ArrowLeft: [far, 0], ArrowRight: [-far, 0], ArrowUp: [0, far], ArrowDown: [0, -far] }[event.key];
      this.pan(to[0], to[1]);
      return true;
    }
    const act = {
      ' ': () => this.clock.toggle(),
      ArrowLeft: () => this.clock.step(-1),
      ArrowRight: () => this.clock.step(1),
      '+': () => this.zoom(DOUBLE),
      '=': () => this.zoom(DOUBLE),
      '-': () => this.zoom(1 / DOUBLE),
      Home: () => this.fit(),
      Escape: () => this.choose(-1),
    }[event.key];
    if (act) act();
    return act !== undefined;
  },
});
