// SPDX-License-Identifier: Apache-2.0
// Trajectories and landmarks: what is shown of them, and both views of it.
import { PlanView } from "./plan.js";
import { colour, onScheme } from "./theme.js";
import { SpaceView } from "./space.js";

const ORDER = ["truth", "ins", "s_slam", "smoothed", "c_slam"]; // drawn one above another
const DASHES = { one: { ins: [6, 4] }, several: { ins: [2, 3], s_slam: [6, 4], smoothed: [12, 3, 2, 3] } }; // [px], else solid
const FIRST_SHOWN = { one: ORDER, several: ["truth", "c_slam"] };

/** Shows the scene; the clock's end becomes the end of the longest flight. */
export function showScene(element, scene, clock) {
  if (!element || !scene) return;
  const state = new SceneState(scene);
  buildLayers(element.querySelector(".layers"), state);
  clock.setEnd(state.end);
  const views = [new PlanView(element.querySelector(".plan"), state, clock)];
  const space = SpaceView.make(element.querySelector(".space"), state, clock);
  if (space) views.push(space);
  const update = () => views.forEach((view) => view.update());
  state.onChange = update;
  onScheme(update);
  clock.subscribe(() => views.forEach((view) => view.showTime()));
}

/** All tracks and landmark sets with their colours, and which of them are hidden. */
class SceneState {
  constructor({ flights, tracks, axes }) {
    this.axes = axes;
    this.several = flights.length > 1;
    this.dashes = this.several ? DASHES.several : DASHES.one; // of several runs, whose colours tell the runs apart
    this.flights = flights.map((flight) => flight.label);
    this.vehicles = [...new Set(flights.flatMap((flight) => flight.vehicles.map((vehicle) => vehicle.name)))];
    this.tracks = [];
    this.landmarks = [];
    this.labels = Object.fromEntries(Object.entries(tracks).map(([name, style]) => [name, style.label]));
    flights.forEach((flight, k) => flight.vehicles.forEach((vehicle) => this.add(flight.label, k, vehicle, tracks)));
    this.tracks.sort((a, b) => ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind));
    this.kinds = ORDER.filter((kind) => this.tracks.some((track) => track.kind === kind));
    this.hidden = new Set(this.firstHidden());
    this.onChange = () => {};
    this.end = this.tracks.filter((track) => track.kind !== "truth" && track.kind !== "ins")
      .reduce((end, track) => Math.max(end, track.t.at(-1)), 0);
  }

  add(flight, k, vehicle, styles) {
    const own = `line-${(this.several ? k : this.vehicles.indexOf(vehicle.name)) % 7}`;
    for (const [kind, track] of Object.entries(vehicle.tracks)) {
      const name = this.several && kind !== "truth" ? own : `track-${kind}`;
      const [dash, { width }] = [this.dashes[kind] ?? [], styles[kind]];
      this.tracks.push({ ...track, kind, flight, vehicle: vehicle.name, colour: name, width, dash });
    }
    if (vehicle.landmarks) this.landmarks.push({ ...vehicle.landmarks, flight, vehicle: vehicle.name, colour: own });
  }

  firstHidden() {
    const shown = this.several ? FIRST_SHOWN.several : FIRST_SHOWN.one;
    const owner = (track) => `${track.flight} ${track.vehicle}`;
    const cooperative = new Set(this.tracks.filter((track) => track.kind === "c_slam").map(owner));
    const best = this.tracks.every((track) => cooperative.has(owner(track))) ? [] : ["s_slam"];
    return this.kinds.filter((kind) => !shown.includes(kind) && !best.includes(kind)).map((kind) => `track ${kind}`);
  }

  shows(item) {
    const keys = [`flight ${item.flight}`, `vehicle ${item.vehicle}`, item.kind ? `track ${item.kind}` : "landmarks"];
    return !keys.some((key) => this.hidden.has(key));
  }

  get shownTracks() { return this.tracks.filter((track) => this.shows(track)); }

  get shownLandmarks() { return this.landmarks.filter((landmarks) => this.shows(landmarks)); }

  /** The tracks whose vehicle is drawn at the clock's time: the best one shown of each. */
  get leading() {
    const best = new Map();
    for (const track of this.shownTracks) if (track.q_wxyz) best.set(`${track.flight} ${track.vehicle}`, track);
    return [...best.values()];
  }
}

function buildLayers(element, state) {
  const groups = [];
  if (state.several) groups.push(["Runs", state.flights.map((name, k) => [`flight ${name}`, name, line(`line-${k % 7}`)])]);
  const isMapped = !state.several && state.landmarks.length; // a vehicle's own colour is that of its landmarks
  groups.push(["Vehicles", state.vehicles.map((name, k) => [`vehicle ${name}`, name, isMapped ? dot(`line-${k % 7}`) : ""])]);
  const colourOf = (name) => (state.several && name !== "truth" ? "ink" : `track-${name}`);
  const kind = (name) => [`track ${name}`, state.labels[name], line(colourOf(name), state.dashes[name])];
  groups.push(["Tracks", state.kinds.map(kind)]);
  if (state.landmarks.length) {
    groups.push(["Map", [["landmarks", "Landmarks", ""], ["ellipses", "1σ ellipses", ""]]]);
  }
  for (const [title, items] of groups) {
    const set = document.createElement("fieldset");
    const legend = document.createElement("legend");
    legend.textContent = title;
    set.append(legend, ...items.map((item) => checkbox(state, ...item)));
    element.append(set);
  }
}

function checkbox(state, key, text, mark) {
  const label = document.createElement("label");
  const box = document.createElement("input");
  box.type = "checkbox";
  box.checked = !state.hidden.has(key);
  box.addEventListener("change", () => {
    state.hidden[box.checked ? "delete" : "add"](key);
    state.onChange();
  });
  label.append(box, text);
  label.insertAdjacentHTML("beforeend", mark);
  return label;
}

const swatch = (name, shape) => `<svg class="swatch" width="28" height="8" style="color:var(--${name})">${shape}</svg>`;
const line = (name, dash = []) => swatch(name, `<path d="M0 4H28" stroke-width="3" stroke-dasharray="${dash}"/>`);
const dot = (name) => swatch(name, '<circle cx="6" cy="4" r="3"/>');

/** Returns the place of a track at a time, linearly between its poses, and the pose before; null outside its span. */
export function poseAt(track, time) {
  const { t, x, y, z } = track;
  if (!t.length || time < t[0] - 1e-6) return null;
  let low = 0;
  let high = t.length - 1;
  if (time >= t[high]) low = high;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle;
    else high = middle;
  }
  const next = Math.min(low + 1, t.length - 1);
  const share = next > low ? Math.min(Math.max((time - t[low]) / (t[next] - t[low]), 0), 1) : 0;
  const between = (values) => values[low] + share * (values[next] - values[low]);
  return { x: between(x), y: between(y), z: between(z), row: low };
}

/** Returns lowest and highest coordinates of what is drawn; a runaway INS does not count, nor the farthest landmarks. */
export function extent(state) {
  const core = state.tracks.filter((track) => track.kind !== "ins");
  const tracks = core.length ? core : state.tracks;
  return ["x", "y", "z"].map((axis) => {
    const inner = state.landmarks.flatMap((landmarks) => quantiles(landmarks[axis]));
    const values = [...tracks.flatMap((track) => [least(track[axis]), most(track[axis])]), ...inner];
    return values.length ? [least(values), most(values)] : [-1, 1];
  });
}

/** Returns by how much ellipses are enlarged so that the median one can be seen in a view of this size [m]. */
export function ellipseStretch(state, size) {
  const lengths = state.landmarks.flatMap((marks) => marks.x.map((_, k) => Math.hypot(...marks.lower.slice(6 * k, 6 * k + 6))));
  if (!lengths.length) return 1;
  const median = lengths.sort((a, b) => a - b)[lengths.length >> 1];
  return [1, 2, 5, 10, 20, 50, 100].find((factor) => factor * median >= 0.006 * size) ?? 200;
}

export const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
export const most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);

function quantiles(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return [sorted[Math.floor(0.01 * (sorted.length - 1))], sorted[Math.ceil(0.99 * (sorted.length - 1))]];
}

export { colour };
