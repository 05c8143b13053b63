// SPDX-License-Identifier: Apache-2.0
// The textured model of the map, to be turned.
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { makeStage } from "./stage.js";

/** Shows every model of the page; resolves once all are there. */
export async function showModels() {
  await Promise.all([...document.querySelectorAll("[data-model]")].map(showModel));
}

async function showModel(holder) {
  const content = holder.querySelector("script").textContent;
  const stage = makeStage(holder, "Textured model of the map");
  if (!stage) return;
  const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
  const { scene } = await new GLTFLoader().parseAsync(bytes.buffer, "");
  stage.scene.add(scene, new THREE.HemisphereLight(0xffffff, 0xbbbbbb, 3));
  const box = new THREE.Box3().setFromObject(scene);
  const centre = box.getCenter(new THREE.Vector3());
  scene.position.sub(centre); // near the origin single precision suffices
  stage.frame(box.getSize(new THREE.Vector3()));
  stage.render();
}
