// SPDX-License-Identifier: Apache-2.0
// Tables that are sorted by a click on a title, and filtered by a word.

/** Gives each column title of the sortable tables a button. */
export function sortTables() {
  for (const table of document.querySelectorAll("table[data-sortable]")) {
    [...table.querySelectorAll("thead th")].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      button.addEventListener("click", () => sortBy(table, head, column));
      head.replaceChildren(button);
      const cells = [...table.querySelectorAll(`tbody td:nth-child(${column + 1})`)];
      if (cells.some((cell) => cell.classList.contains("number"))) head.classList.add("number");
    });
  }
}

function sortBy(table, head, column) {
  const falling = head.getAttribute("aria-sort") === "ascending";
  table.querySelectorAll("th").forEach((other) => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", falling ? "descending" : "ascending");
  const body = table.querySelector("tbody");
  const keyed = [...body.rows].map((row) => ({ row, key: keyOf(row.cells[column].textContent) }));
  keyed.sort((a, b) => compare(a.key, b.key, falling));
  body.replaceChildren(...keyed.map(({ row }) => row));
}

function keyOf(text) {
  const number = Number.parseFloat(text);
  return Number.isNaN(number) ? text.trim() : number;
}

/** Orders numbers before words, and dashes, which stand for nothing, last whichever way the rest goes. */
function compare(a, b, falling) {
  const absent = (key) => key === "–" || key === "";
  if (absent(a) || absent(b)) return Number(absent(a)) - Number(absent(b));
  if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
  const order = typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
  return falling ? -order : order;
}

/** Shows only the rows that hold what is typed. */
export function filterTables() {
  for (const input of document.querySelectorAll("input[data-filter]")) {
    const rows = [...document.getElementById(input.dataset.filter).querySelectorAll("tbody tr")];
    input.addEventListener("input", () => {
      const wanted = input.value.trim().toLowerCase();
      rows.forEach((row) => { row.hidden = !row.textContent.toLowerCase().includes(wanted); });
    });
  }
}
