// SPDX-License-Identifier: Apache-2.0
// Light and dark: the style sheet has the colours, scripts read them and draw again when the scheme changes.
const root = document.documentElement;
const listeners = new Set();
let known = new Map();

/** Returns the colour of a name of the palette, such as "track-c_slam". */
export function colour(name) {
  if (!known.has(name)) known.set(name, getComputedStyle(root).getPropertyValue(`--${name}`).trim() || "#888888");
  return known.get(name);
}

/** Calls back whenever the scheme has changed. */
export function onScheme(listener) {
  listeners.add(listener);
}

/** Takes the system's scheme and follows it until the reader presses the button. */
export function startScheme() {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let chosen = false;
  apply(dark.matches);
  dark.addEventListener("change", () => { if (!chosen) apply(dark.matches); });
  document.querySelector("[data-scheme-button]").addEventListener("click", () => {
    chosen = true;
    apply(root.dataset.scheme !== "dark");
  });
}

function apply(isDark) {
  root.dataset.scheme = isDark ? "dark" : "light";
  known = new Map();
  listeners.forEach((listener) => listener());
}
