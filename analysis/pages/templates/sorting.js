"use strict";
// Tables whose headings sort them: numbers from the highest, text from A, and a second click turns the order round.
(() => {
  const empty = /^[–-]?$/;
  const said = (row, place) => row.cells[place].innerText.trim();
  const number = (text) => parseFloat(text.replaceAll(",", "").replace("−", "-"));

  function sort(table, place, ascending) {
    const rows = [...table.tBodies[0].rows].map((row) => ({ row, text: said(row, place) }));
    const known = rows.filter(({ text }) => !empty.test(text));
    const numeric = known.every(({ text }) => !isNaN(number(text)));
    const order = (one, other) => (numeric ? number(one.text) - number(other.text) : one.text.localeCompare(other.text));
    const rising = ascending ?? !numeric;
    known.sort((one, other) => (rising ? order(one, other) : order(other, one)));
    for (const { row } of [...known, ...rows.filter(({ text }) => empty.test(text))]) table.tBodies[0].append(row);
    return rising ? "ascending" : "descending";
  }

  for (const table of document.querySelectorAll("main:not(.md-main) table, .leaderboard table")) {
    const headings = [...table.tHead.rows[0].cells];
    for (const [place, heading] of headings.entries()) {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...heading.childNodes);
      heading.append(button);
      button.addEventListener("click", () => {
        const before = heading.getAttribute("aria-sort");
        const order = sort(table, place, before ? before === "descending" : undefined);
        for (const each of headings) each.removeAttribute("aria-sort");
        heading.setAttribute("aria-sort", order);
      });
    }
  }
})();
