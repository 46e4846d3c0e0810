// --- the clock of a scene: which scan is shown, and how it runs on ---

const LONGEST = 30; // seconds that a run should take to play, about
const SPEEDS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const CALM_RATE = 4; // scans a second at most, for those who want less motion

class Clock {
  constructor(times) {
    this.times = times;
    this.scan = 0;
    this.playing = false;
    this.listeners = [];
    const duration = times.length > 1 ? times[times.length - 1] - times[0] : 0;
    this.duration = Number.isFinite(duration) ? duration : 0;
    this.speed = SPEEDS.find((speed) => this.duration / speed <= LONGEST) ?? SPEEDS[SPEEDS.length - 1];
  }

  get time() {
    return this.times[this.scan];
  }

  /** Tells everybody; `moved` is false where only playing began or ended. */
  tell() {
    for (const listener of this.listeners) listener(this);
  }

  show(scan) {
    const last = Math.max(this.times.length - 1, 0);
    this.scan = Math.min(Math.max(Math.round(scan), 0), last);
    this.now = this.time;
    this.tell();
  }

  showTime(time) {
    this.show(lastAtMost(this.times, time));
  }

  step(by) {
    this.pause();
    this.show(this.scan + by);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (!(this.duration > 0)) return;
    if (this.scan === this.times.length - 1) this.show(0);
    this.playing = true;
    this.now = this.time;
    this.before = null;
    this.tell();
    requestAnimationFrame((at) => this.frame(at));
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.tell();
  }

  frame(at) {
    if (!this.playing) return;
    const seconds = this.before === null ? 0 : (at - this.before) / 1000;
    if (this.before === null || !calm.matches || seconds >= 1 / CALM_RATE) {
      this.before = at;
      // A page that was hidden does not jump.
      this.now += Math.min(seconds, 1) * this.speed;
      const scan = lastAtMost(this.times, this.now);
      if (scan !== this.scan) {
        this.scan = scan;
        this.tell();
      }
      if (scan >= this.times.length - 1) this.pause();
    }
    requestAnimationFrame((next) => this.frame(next));
  }
}
