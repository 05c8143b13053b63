// SPDX-License-Identifier: Apache-2.0
// The time that all views and charts show, its slider, and playing.
const LONGEST_PLAY_S = 30; // a longer flight is played faster

export class Clock {
  /** Takes the element with button, slider and output; without one, time stands still. */
  constructor(element) {
    this.time = 0;
    this.end = 0;
    this.listeners = new Set();
    this.playing = false;
    this.element = element;
    if (!element) return;
    [this.button, this.slider, this.output] = ["button", "input", "output"].map((name) => element.querySelector(name));
    this.slider.addEventListener("input", () => this.set(Number(this.slider.value)));
    this.button.addEventListener("click", () => (this.playing ? this.pause() : this.play()));
  }

  /** Sets the last time [s] and shows it. */
  setEnd(end) {
    this.end = end;
    if (!this.element) return;
    this.slider.max = String(end);
    this.slider.step = String(Math.max(end / 1000, 0.001));
    this.set(end);
  }

  subscribe(listener) {
    this.listeners.add(listener);
  }

  set(time) {
    this.time = Math.min(Math.max(time, 0), this.end);
    this.slider.value = String(this.time);
    this.slider.setAttribute("aria-valuetext", `${this.time.toFixed(1)} seconds`);
    this.output.textContent = `${this.time.toFixed(1)} s`;
    this.listeners.forEach((listener) => listener(this.time));
  }

  play() {
    if (this.time >= this.end) this.set(0);
    this.playing = true;
    this.show("❚❚", "Pause");
    const speed = Math.max(1, this.end / LONGEST_PLAY_S);
    let last = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      this.set(this.time + (speed * (now - last)) / 1000);
      last = now;
      if (this.time >= this.end) this.pause();
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() {
    this.playing = false;
    this.show("▶", "Play");
  }

  show(sign, label) {
    this.button.textContent = sign;
    this.button.setAttribute("aria-label", label);
  }
}
