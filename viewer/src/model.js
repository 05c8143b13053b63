// SPDX-License-Identifier: Apache-2.0
// The textured model of the map, to be turned.
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { makeStage } from "./stage.js";

const AHEAD = "800px"; // a model is made when the reader comes near: its textures take time

/** Shows every model of the page once it is about to be seen. */
export function showModels() {
  const near = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      near.unobserve(target);
      showModel(target);
    }
  }, { rootMargin: AHEAD });
  document.querySelectorAll("[data-model]").forEach((holder) => near.observe(holder));
}

async function showModel(holder) {
  const content = holder.querySelector("script").textContent;
  const stage = makeStage(holder, "Textured model of the map");
  if (!stage) return;
  const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
  const { scene } = await new GLTFLoader().parseAsync(bytes.buffer, "");
  scene.traverse(unlight);
  stage.scene.add(scene);
  const box = new THREE.Box3().setFromObject(scene);
  const centre = box.getCenter(new THREE.Vector3());
  scene.position.sub(centre); // near the origin single precision suffices
  stage.frame(box.getSize(new THREE.Vector3()));
  stage.render();
  holder.dataset.ready = "1";
}

/** Shows a mesh as it was photographed: the light is in the texture already. */
function unlight(item) {
  if (!item.isMesh) return;
  const { map, color, vertexColors } = item.material;
  item.material.dispose();
  item.material = new THREE.MeshBasicMaterial({ map, color, vertexColors, side: THREE.DoubleSide });
}
