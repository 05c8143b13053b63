// SPDX-License-Identifier: Apache-2.0
// The 3-D view of trajectories and landmarks.
import * as THREE from "three";
import { Line2 } from "three/addons/lines/Line2.js";
import { LineGeometry } from "three/addons/lines/LineGeometry.js";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { roundStep } from "./plan.js";
import { ellipseStretch, extent, poseAt } from "./scene.js";
import { makeStage } from "./stage.js";
import { colour } from "./theme.js";

const DOT_PX = 3;

export class SpaceView {
  /** Returns the view, null where the browser shows no 3-D graphics. */
  static make(holder, state, clock) {
    const stage = makeStage(holder, "3-D view of trajectories and landmarks");
    return stage && new SpaceView(holder, state, clock, stage);
  }

  constructor(holder, state, clock, stage) {
    Object.assign(this, { holder, state, clock, stage });
    const box = extent(state);
    this.centre = box.map(([low, high]) => (low + high) / 2);
    this.size = new THREE.Vector3(...box.map(([low, high]) => high - low));
    this.length = Math.max(this.size.x, this.size.y, this.size.z) || 1;
    this.floor = box[2][0] - this.centre[2];
    this.stretch = ellipseStretch(state, this.length);
    this.things = new THREE.Group();
    this.vehicles = new THREE.Group();
    stage.scene.add(this.things, this.vehicles);
    this.note = document.createElement("div");
    this.note.className = "note";
    Object.assign(this.note.style, { left: "0.5rem", top: "0.5rem" });
    holder.append(this.note);
    stage.frame(this.size);
    new ResizeObserver(() => this.update()).observe(holder); // the width of lines depends on it
    this.update();
  }

  update() {
    discard(this.things);
    this.addFloor();
    this.state.shownTracks.forEach((track) => this.addTrack(track));
    this.state.shownLandmarks.forEach((marks) => this.addLandmarks(marks));
    discard(this.vehicles);
    this.leading = this.state.leading.map((track) => [track, this.addVehicle(track)]);
    this.showTime();
  }

  showTime() {
    for (const [track, arrow] of this.leading) {
      const pose = poseAt(track, this.clock.time);
      arrow.visible = Boolean(pose);
      if (!pose) continue;
      arrow.position.set(...this.near(pose.x, pose.y, pose.z));
      const [w, x, y, z] = track.q_wxyz.slice(4 * pose.row, 4 * pose.row + 4);
      arrow.quaternion.set(x, y, z, w);
    }
    this.stage.render();
  }

  near(x, y, z) {
    return [x - this.centre[0], y - this.centre[1], z - this.centre[2]];
  }

  addFloor() {
    const step = roundStep(this.length / 12);
    const count = 2 * Math.ceil((0.6 * this.length) / step);
    const grid = new THREE.GridHelper(count * step, count, colour("grey"), colour("rule"));
    grid.rotation.x = Math.PI / 2; // three.js has y up
    grid.position.z = this.floor;
    this.things.add(grid);
    const reach = (count / 2 + 0.4) * step;
    const directions = [[reach, 0, "E"], [0, reach, "N"], [-reach, 0, "W"], [0, -reach, "S"]];
    const place = this.state.axes[0] === "East" ? directions : [[reach, 0, "x"], [0, reach, "y"]];
    place.forEach(([x, y, text]) => this.things.add(this.sign(text, x, y)));
    const larger = this.stretch > 1 ? `, ellipsoids ${this.stretch} times as large` : "";
    const drawn = this.state.landmarks.length && !this.state.hidden.has("ellipses");
    this.note.textContent = `grid ${step} m${drawn ? `\n1σ${larger}` : ""}`;
  }

  sign(text, x, y) {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 64;
    const ink = canvas.getContext("2d");
    Object.assign(ink, { font: "bold 44px sans-serif", textAlign: "center", textBaseline: "middle", fillStyle: colour("faint") });
    ink.fillText(text, 32, 34);
    const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas) }));
    sprite.position.set(x, y, this.floor);
    sprite.scale.setScalar(this.length / 14);
    return sprite;
  }

  addTrack(track) {
    if (track.t.length < 2) return;
    const geometry = new LineGeometry();
    geometry.setPositions(track.x.flatMap((x, k) => this.near(x, track.y[k], track.z[k])));
    const material = new LineMaterial({
      color: colour(track.colour),
      linewidth: track.kind === "truth" ? 4 : Math.max(track.width, 1.5),
      dashed: track.dash.length > 0,
      dashSize: ((track.dash[0] ?? 1) * this.length) / 480,
      gapSize: ((track.dash[1] ?? 1) * this.length) / 480,
      depthWrite: false, // tracks lie within each other: those added later are drawn above
    });
    material.resolution.set(this.holder.clientWidth, this.holder.clientHeight);
    const line = new Line2(geometry, material);
    line.computeLineDistances();
    line.renderOrder = 1 + this.state.kinds.indexOf(track.kind);
    this.things.add(line);
  }

  addLandmarks(marks) {
    const places = marks.x.map((x, k) => this.near(x, marks.y[k], marks.z[k]));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(places.flat(), 3));
    const dots = new THREE.PointsMaterial({ color: colour(marks.colour), size: DOT_PX, sizeAttenuation: false });
    this.things.add(new THREE.Points(geometry, dots));
    if (!this.state.hidden.has("ellipses")) this.things.add(this.ellipsoids(marks, places));
  }

  /** Maps the unit sphere by each landmark's lower factor onto its 1-sigma ellipsoid. */
  ellipsoids(marks, places) {
    const material = new THREE.MeshBasicMaterial({ color: colour(marks.colour), transparent: true, opacity: 0.3 });
    const mesh = new THREE.InstancedMesh(new THREE.SphereGeometry(this.stretch, 10, 7), material, places.length);
    const matrix = new THREE.Matrix4();
    places.forEach(([x, y, z], k) => {
      const [a, b, c, d, e, f] = marks.lower.slice(6 * k, 6 * k + 6);
      matrix.set(a, 0, 0, x, b, d, 0, y, c, e, f, z, 0, 0, 0, 1);
      mesh.setMatrixAt(k, matrix);
    });
    mesh.frustumCulled = false;
    return mesh;
  }

  addVehicle(track) {
    const size = this.length / 35;
    const shape = new THREE.ConeGeometry(0.35 * size, size, 12);
    shape.rotateZ(-Math.PI / 2); // the body's x axis points ahead
    const arrow = new THREE.Mesh(shape, new THREE.MeshBasicMaterial({ color: colour(track.colour) }));
    const rim = new THREE.LineSegments(new THREE.EdgesGeometry(shape), new THREE.LineBasicMaterial({ color: colour("ink") }));
    const whole = new THREE.Group();
    whole.add(arrow, rim);
    this.vehicles.add(whole);
    return whole;
  }
}

/** Empties a group and frees what the graphics card holds of it. */
function discard(group) {
  group.traverse((item) => {
    item.geometry?.dispose();
    item.material?.map?.dispose();
    item.material?.dispose();
  });
  group.clear();
}
