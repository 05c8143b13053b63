// SPDX-License-Identifier: Apache-2.0
// What both 3-D views share: renderer, camera with the vertical up, and drawing only when something has changed.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FIELD_DEG = 40;
const ELEVATION = 0.62; // [rad] of the first view
const FILLING = 0.94; // of the view, by the corners of what is framed
const HALVINGS = 24;
const AZIMUTH = -1.2; // [rad] from east

/** Returns a stage inside a holder; null, with a message to the reader, where the browser has no WebGL. */
export function makeStage(holder, label) {
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${label}; arrow keys turn it, + and - zoom`);
  const context = canvas.getContext("webgl2", { antialias: true });
  if (!context) {
    const message = document.createElement("p");
    message.className = "message";
    message.textContent = "This browser shows no 3-D graphics (WebGL 2).";
    holder.append(message);
    return null;
  }
  holder.append(canvas);
  const renderer = new THREE.WebGLRenderer({ canvas, context, antialias: true, alpha: true });
  renderer.debug.checkShaderErrors = false; // asking for them waits for the compiler, seconds without a graphics card
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(FIELD_DEG, 1, 0.1, 1e5);
  camera.up.set(0, 0, 1);
  const controls = new OrbitControls(camera, canvas);
  let waiting = false;
  const render = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      renderer.render(scene, camera);
    });
  };
  controls.addEventListener("change", render);
  steerByKeys(canvas, camera, controls, render);

  const resize = () => {
    const { clientWidth: width, clientHeight: height } = holder;
    if (!width || !height) return;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    render();
  };
  new ResizeObserver(resize).observe(holder);
  resize();

  const frame = (size) => {
    controls.target.set(0, 0, 0);
    let [near, far] = [size.length() / 10 || 0.1, size.length() * 10 || 10];
    for (let k = 0; k < HALVINGS; k++) {
      const middle = Math.sqrt(near * far);
      if (overflows(camera, size, middle)) near = middle;
      else far = middle;
    }
    place(camera, far);
    controls.update();
    render();
  };
  return { scene, camera, render, frame, canvas };
}

/** Looks at the origin from a distance. */
function place(camera, distance) {
  const level = distance * Math.cos(ELEVATION);
  camera.position.set(level * Math.cos(AZIMUTH), level * Math.sin(AZIMUTH), distance * Math.sin(ELEVATION));
  camera.near = distance / 1000;
  camera.far = distance * 50;
  camera.lookAt(0, 0, 0);
  camera.updateProjectionMatrix();
  camera.updateMatrixWorld();
}

/** Returns whether a box around the origin is larger than the view from a distance. */
function overflows(camera, size, distance) {
  place(camera, distance);
  const corner = new THREE.Vector3();
  for (let k = 0; k < 8; k++) {
    corner.set(k & 1 ? 0.5 : -0.5, k & 2 ? 0.5 : -0.5, k & 4 ? 0.5 : -0.5).multiply(size);
    corner.applyMatrix4(camera.matrixWorldInverse);
    const behind = corner.z >= 0;
    corner.applyMatrix4(camera.projectionMatrix);
    if (behind || Math.max(Math.abs(corner.x), Math.abs(corner.y)) > FILLING) return true;
  }
  return false;
}

function steerByKeys(canvas, camera, controls, render) {
  const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
  canvas.addEventListener("keydown", (event) => {
    const factor = { "+": 0.8, "=": 0.8, "-": 1.25 }[event.key];
    const offset = camera.position.clone().sub(controls.target);
    if (factor) offset.multiplyScalar(factor);
    else if (turns[event.key]) {
      const [around, down] = turns[event.key];
      const angles = new THREE.Spherical().setFromVector3(new THREE.Vector3(offset.x, offset.z, -offset.y));
      angles.theta += around;
      angles.phi = Math.min(Math.max(angles.phi + down, 0.01), Math.PI - 0.01);
      const turned = new THREE.Vector3().setFromSpherical(angles);
      offset.set(turned.x, -turned.z, turned.y);
    } else return;
    event.preventDefault();
    camera.position.copy(controls.target).add(offset);
    controls.update();
    render();
  });
}
