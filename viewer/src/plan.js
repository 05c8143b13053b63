// SPDX-License-Identifier: Apache-2.0
// The plan view: equal axes, drawn on a canvas.
import { ellipseStretch, extent, poseAt } from "./scene.js";
import { colour } from "./theme.js";

const MARGIN_PX = { left: 78, right: 14, top: 14, bottom: 40 };
const NEAR_PX = 14;
const LABEL_PX = 46; // room for a vehicle's name beside its start
const LINE_PX = 13; // and for the next one below it
const STEPS = [1, 2, 5];

export class PlanView {
  constructor(holder, state, clock) {
    Object.assign(this, { holder, state, clock });
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "Trajectories and landmarks from above");
    holder.setAttribute("role", "group");
    holder.setAttribute("aria-label", "Plan view of trajectories and landmarks; arrow keys move, + and - zoom, 0 fits");
    this.note = document.createElement("div");
    this.note.className = "note";
    this.note.hidden = true;
    this.button = document.createElement("button");
    Object.assign(this.button, { type: "button", className: "fit", textContent: "Fit" });
    this.button.addEventListener("click", () => { this.fit(); this.draw(); });
    holder.append(this.canvas, this.note, this.button);
    this.pointers = new Map();
    const [[west, east], [south, north]] = extent(state);
    this.stretch = ellipseStretch(state, Math.max(east - west, north - south));
    this.listen();
    new ResizeObserver(() => { this.fit(); this.draw(); }).observe(holder);
    this.fit();
    this.draw();
  }

  update() { this.draw(); }

  showTime() { this.schedule(); }

  /** Draws once before the next frame, however often it is asked. */
  schedule() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  get width() { return this.holder.clientWidth; }

  get height() { return this.holder.clientHeight; }

  fit() {
    const [[west, east], [south, north]] = extent(this.state);
    const room = [this.width - MARGIN_PX.left - MARGIN_PX.right, this.height - MARGIN_PX.top - MARGIN_PX.bottom];
    const [width, height] = [Math.max(east - west, 1e-3), Math.max(north - south, 1e-3)];
    this.scale = Math.min(Math.max(room[0] - 2 * LABEL_PX, 50) / width, (0.9 * room[1]) / height);
    this.x = (west + east) / 2;
    this.y = (south + north) / 2;
  }

  /** Returns the pixel of a point [m]. */
  pixel(x, y) {
    const centre = this.centre;
    return [centre[0] + (x - this.x) * this.scale, centre[1] - (y - this.y) * this.scale];
  }

  get centre() {
    return [
      (MARGIN_PX.left + this.width - MARGIN_PX.right) / 2,
      (MARGIN_PX.top + this.height - MARGIN_PX.bottom) / 2,
    ];
  }

  zoom(factor, px, py) {
    const [cx, cy] = this.centre;
    this.x += ((px - cx) / this.scale) * (1 - 1 / factor);
    this.y -= ((py - cy) / this.scale) * (1 - 1 / factor);
    this.scale *= factor;
    this.schedule();
  }

  move(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.schedule();
  }

  listen() {
    const at = (event) => {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), ...at(event));
    }, { passive: false });
    this.canvas.addEventListener("pointerdown", (event) => {
      this.pointers.set(event.pointerId, at(event));
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      const now = at(event);
      if (!before) return this.read(...now);
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
        this.zoom(apart(now) / apart(before), ...other);
      } else this.move(now[0] - before[0], now[1] - before[1]);
      this.pointers.set(event.pointerId, now);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      this.canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    this.canvas.addEventListener("pointerleave", () => { this.note.hidden = true; });
    this.holder.addEventListener("keydown", (event) => this.steer(event));
  }

  steer(event) {
    const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
    const factor = { "+": 1.3, "=": 1.3, "-": 1 / 1.3 }[event.key];
    if (factor) this.zoom(factor, ...this.centre);
    else if (moves[event.key]) this.move(...moves[event.key]);
    else if (event.key === "0") { this.fit(); this.schedule(); }
    else return;
    event.preventDefault();
  }

  /** Shows what is nearest to a pixel. */
  read(px, py) {
    let best = { distance: NEAR_PX, text: null };
    for (const track of this.state.shownTracks) {
      for (let k = 0; k < track.t.length; k++) {
        const [x, y] = this.pixel(track.x[k], track.y[k]);
        const distance = Math.hypot(x - px, y - py);
        if (distance < best.distance) best = { distance, x, y, text: () => this.describe(track, k) };
      }
    }
    for (const marks of this.state.shownLandmarks) {
      for (let k = 0; k < marks.x.length; k++) {
        const [x, y] = this.pixel(marks.x[k], marks.y[k]);
        const distance = Math.hypot(x - px, y - py) + 4; // a track goes first
        if (distance < best.distance) best = { distance, x, y, text: () => this.describeLandmark(marks, k) };
      }
    }
    this.note.hidden = !best.text;
    if (!best.text) return;
    this.note.textContent = best.text();
    const right = best.x + 14 + this.note.offsetWidth > this.width;
    this.note.style.left = `${right ? Math.max(best.x - 14 - this.note.offsetWidth, 0) : best.x + 14}px`;
    this.note.style.top = `${Math.min(best.y + 10, this.height - this.note.offsetHeight)}px`;
  }

  describe(track, k) {
    const whose = this.state.several ? `${track.flight}: ${track.vehicle}` : track.vehicle;
    const sigma = track.sigma_m ? `\n1σ ${track.sigma_m[k].toFixed(2)} m` : "";
    return `${whose} ${this.state.labels[track.kind]}, ${track.t[k].toFixed(2)} s\n${place(track, k)}${sigma}`;
  }

  describeLandmark(marks, k) {
    const [a, b, c] = deviations(marks.lower, k);
    const sigmas = `1σ east ${a.toFixed(2)}, north ${b.toFixed(2)}, up ${c.toFixed(2)} m`;
    return `landmark of ${marks.vehicle}\n${place(marks, k)}\n${sigmas}`;
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    if (!this.width) return;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    const ink = this.canvas.getContext("2d");
    ink.scale(ratio, ratio);
    ink.font = "12px system-ui, sans-serif";
    this.drawGrid(ink);
    ink.save();
    ink.beginPath();
    ink.rect(MARGIN_PX.left, 0, this.width - MARGIN_PX.left, this.height - MARGIN_PX.bottom);
    ink.clip();
    this.state.shownLandmarks.forEach((marks) => this.drawLandmarks(ink, marks));
    this.state.shownTracks.forEach((track) => this.drawTrack(ink, track));
    this.labels = [];
    this.state.leading.forEach((track) => this.drawStart(ink, track));
    this.state.leading.forEach((track) => this.drawVehicle(ink, track));
    ink.restore();
    this.drawStretch(ink);
  }

  drawGrid(ink) {
    const step = roundStep(80 / this.scale);
    const [west, north] = this.point(MARGIN_PX.left, 0);
    const [east, south] = this.point(this.width, this.height - MARGIN_PX.bottom);
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    const bottom = this.height - MARGIN_PX.bottom;
    ink.lineWidth = 1;
    ink.strokeStyle = colour("grid");
    ink.fillStyle = colour("faint");
    ink.textAlign = "center";
    ink.textBaseline = "top";
    ink.beginPath();
    for (let x = Math.ceil(west / step) * step; x <= east; x += step) {
      const [px] = this.pixel(x, 0);
      ink.moveTo(px, 0);
      ink.lineTo(px, bottom);
      if (px < this.width - 12) ink.fillText(tick(x, digits), px, bottom + 5);
    }
    ink.textAlign = "right";
    ink.textBaseline = "middle";
    for (let y = Math.ceil(south / step) * step; y <= north; y += step) {
      const [, py] = this.pixel(0, y);
      ink.moveTo(MARGIN_PX.left, py);
      ink.lineTo(this.width, py);
      if (py > 8) ink.fillText(tick(y, digits), MARGIN_PX.left - 5, py);
    }
    ink.stroke();
    ink.textAlign = "center";
    ink.fillText(`${this.state.axes[0]} [m]`, (MARGIN_PX.left + this.width) / 2, this.height - 9);
    ink.save();
    ink.translate(10, bottom / 2);
    ink.rotate(-Math.PI / 2);
    ink.fillText(`${this.state.axes[1]} [m]`, 0, 0);
    ink.restore();
  }

  /** Returns the point [m] of a pixel. */
  point(px, py) {
    const [cx, cy] = this.centre;
    return [this.x + (px - cx) / this.scale, this.y - (py - cy) / this.scale];
  }

  drawLandmarks(ink, marks) {
    ink.fillStyle = ink.strokeStyle = colour(marks.colour);
    ink.globalAlpha = 0.7;
    for (let k = 0; k < marks.x.length; k++) {
      const [x, y] = this.pixel(marks.x[k], marks.y[k]);
      ink.fillRect(x - 1, y - 1, 2, 2);
    }
    ink.globalAlpha = 0.55;
    ink.lineWidth = 0.8;
    if (!this.state.hidden.has("ellipses")) {
      for (let k = 0; k < marks.x.length; k++) this.drawEllipse(ink, marks.x[k], marks.y[k], planeCovariance(marks.lower, k));
    }
    ink.globalAlpha = 1;
  }

  drawEllipse(ink, x, y, [xx, xy, yy]) {
    const half = (xx + yy) / 2;
    const root = Math.hypot((xx - yy) / 2, xy);
    const size = this.scale * this.stretch;
    ink.beginPath();
    ink.ellipse(
      ...this.pixel(x, y),
      size * Math.sqrt(half + root),
      size * Math.sqrt(Math.max(half - root, 0)),
      -Math.atan2(2 * xy, xx - yy) / 2,
      0,
      2 * Math.PI,
    );
    ink.stroke();
  }

  drawTrack(ink, track) {
    ink.strokeStyle = colour(track.colour);
    ink.lineWidth = track.width;
    ink.lineJoin = "round";
    ink.setLineDash(track.dash);
    ink.beginPath();
    track.x.forEach((x, k) => ink.lineTo(...this.pixel(x, track.y[k])));
    ink.stroke();
    ink.setLineDash([]);
  }

  drawStart(ink, track) {
    const [x, y] = this.pixel(track.x[0], track.y[0]);
    ink.fillStyle = colour("panel");
    ink.strokeStyle = colour("ink");
    ink.lineWidth = 1.2;
    ink.beginPath();
    ink.arc(x, y, 4.5, 0, 2 * Math.PI);
    ink.fill();
    ink.stroke();
    const row = Math.min(track.x.length - 1, Math.max(1, Math.round(track.x.length / 20)));
    const ahead = Math.atan2(track.y[row] - track.y[0], track.x[row] - track.x[0]);
    const text = [x - 12 * Math.cos(ahead), y + 12 * Math.sin(ahead)]; // behind the start, where no track is
    const near = ([left, top]) => Math.abs(left - text[0]) < LABEL_PX && Math.abs(top - text[1]) < LINE_PX;
    if (this.labels.some((label) => label.name === track.vehicle && near(label.place))) return; // of another run
    for (const { place } of this.labels) if (near(place)) text[1] = place[1] + LINE_PX;
    this.labels.push({ name: track.vehicle, place: text });
    ink.textAlign = Math.cos(ahead) > 0.3 ? "right" : Math.cos(ahead) < -0.3 ? "left" : "center";
    ink.textBaseline = "middle";
    ink.fillStyle = colour("ink");
    ink.lineWidth = 3;
    ink.strokeStyle = colour("panel");
    ink.strokeText(track.vehicle, ...text);
    ink.fillText(track.vehicle, ...text);
  }

  /** Draws the vehicle as an arrow along its heading, with its own uncertainty. */
  drawVehicle(ink, track) {
    const pose = poseAt(track, this.clock.time);
    if (!pose) return;
    if (track.cov_plane && !this.state.hidden.has("ellipses")) {
      ink.strokeStyle = colour("ink");
      ink.lineWidth = 1;
      this.drawEllipse(ink, pose.x, pose.y, track.cov_plane.slice(3 * pose.row, 3 * pose.row + 3));
    }
    const [w, x, y, z] = track.q_wxyz.slice(4 * pose.row, 4 * pose.row + 4);
    const yaw = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
    ink.save();
    ink.translate(...this.pixel(pose.x, pose.y));
    ink.rotate(-yaw);
    ink.beginPath();
    for (const [ahead, left] of [[10, 0], [-7, 6], [-4, 0], [-7, -6]]) ink.lineTo(ahead, left);
    ink.closePath();
    ink.fillStyle = colour(track.colour);
    ink.strokeStyle = colour("ink");
    ink.lineWidth = 1.2;
    ink.fill();
    ink.stroke();
    ink.restore();
  }

  drawStretch(ink) {
    if (!this.state.landmarks.length || this.state.hidden.has("ellipses")) return;
    ink.textAlign = "left";
    ink.textBaseline = "top";
    ink.fillStyle = colour("faint");
    ink.fillText(`1σ ellipses${this.stretch > 1 ? `, ${this.stretch} times as large` : ""}`, MARGIN_PX.left + 8, 8);
  }
}

const place = (item, k) => `east ${item.x[k].toFixed(2)}, north ${item.y[k].toFixed(2)}, up ${item.z[k].toFixed(2)} m`;

/** Returns xx, xy and yy of the covariance of a landmark from its lower factor (l00, l10, l20, l11, l21, l22). */
function planeCovariance(lower, k) {
  const [a, b, , c] = lower.slice(6 * k, 6 * k + 4);
  return [a * a, a * b, b * b + c * c];
}

/** Returns the standard deviations of a landmark along the axes. */
function deviations(lower, k) {
  const [a, b, c, d, e, f] = lower.slice(6 * k, 6 * k + 6);
  return [Math.abs(a), Math.hypot(b, d), Math.hypot(c, e, f)];
}

export function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * (STEPS.find((step) => step * power >= least) ?? 10);
}

const tick = (value, digits) => (Math.abs(value) < 1e-9 ? 0 : value).toFixed(digits).replace("-", "−");
