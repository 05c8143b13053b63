// SPDX-License-Identifier: Apache-2.0
// The list of sections at the top of the page.
export function buildContents() {
  const nav = document.querySelector("[data-contents]");
  for (const section of document.querySelectorAll("main > section")) {
    const link = document.createElement("a");
    link.href = `#${section.id}`;
    link.textContent = section.dataset.short ?? section.querySelector("h2").textContent;
    nav.append(link);
  }
}
