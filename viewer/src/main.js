// SPDX-License-Identifier: Apache-2.0
// Fills the report page: Python wrote its tables, captions and data; here are charts, views and what can be operated.
import { buildContents } from "./contents.js";
import { Clock } from "./clock.js";
import { drawFigures } from "./charts.js";
import { showModels } from "./model.js";
import { makePannable } from "./pan.js";
import { showScene } from "./scene.js";
import { filterTables, sortTables } from "./tables.js";
import { startScheme } from "./theme.js";

const root = document.documentElement;
root.dataset.errors = "0";
const countError = () => { root.dataset.errors = String(Number(root.dataset.errors) + 1); };
window.addEventListener("error", countError);
window.addEventListener("unhandledrejection", countError);

/** Returns the page's data, compressed JSON in base64. */
async function unpacked() {
  const bytes = Uint8Array.from(atob(document.getElementById("data").textContent), (letter) => letter.charCodeAt(0));
  const text = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(text).json();
}

async function start() {
  const data = await unpacked();
  startScheme();
  buildContents();
  sortTables();
  filterTables();
  document.querySelectorAll("[data-pan]").forEach(makePannable);
  const clock = new Clock(document.querySelector("[data-clock]"));
  showScene(document.querySelector("[data-scene]"), data.scene, clock);
  drawFigures(data.figures ?? {}, clock);
  showModels();
  root.dataset.ready = String(Math.round(performance.now()));
}

start();
