"use strict";
// Choices of the reader in the address, so that a link or a reload shows the same; tables as Markdown.
(() => {
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const controls = document.getElementById("controls");
  const start = "#show?";

  /** What differs from the page as it was written, as the end of an address. */
  function written() {
    const said = new URLSearchParams();
    const changed = all("[data-teacher]", controls).filter((box) => box.checked !== box.defaultChecked);
    if (changed.length) said.set("teachers", all("[data-teacher]:checked", controls).map((box) => box.dataset.teacher).join(","));
    for (const select of all("[data-filter]", controls)) {
      if (select.value !== "") said.set(select.dataset.filter, select.selectedOptions[0].dataset.value);
    }
    const slider = document.getElementById("step");
    const place = slider && all("#steps option")[Number(slider.value)];
    if (place) said.set("step", place.dataset.step);
    return String(said);
  }

  /** Chooses what an address says. */
  function apply(text) {
    const said = new URLSearchParams(text);
    const teachers = said.has("teachers") ? said.get("teachers").split(",") : null;
    for (const box of all("[data-teacher]", controls)) box.checked = teachers ? teachers.includes(box.dataset.teacher) : box.defaultChecked;
    for (const select of all("[data-filter]", controls)) {
      const option = all("option", select).find((each) => said.has(select.dataset.filter) && each.dataset.value === said.get(select.dataset.filter));
      select.value = option ? option.value : "";
    }
    const slider = document.getElementById("step");
    const place = all("#steps option").findIndex((option) => option.dataset.step === said.get("step"));
    if (slider) slider.value = place < 0 ? slider.max : place;
    controls.dispatchEvent(new Event("input"));
  }

  if (controls) {
    const told = () => location.hash.startsWith(start) && apply(location.hash.slice(start.length));
    told();
    addEventListener("hashchange", told);
    controls.addEventListener("input", (event) => {
      if (!event.isTrusted && !event.bubbles && location.hash.slice(start.length) === written()) return;
      const text = written();
      history.replaceState(null, "", text ? start + text : location.hash.startsWith(start) ? "#" : location.hash || "#");
    });
  }

  /** A table as it is seen, in Markdown. */
  function markdown(table) {
    const rows = all("tr", table).filter((row) => !row.hidden);
    const lines = rows.map((row) => `| ${[...row.cells].map((cell) => cell.innerText.replace(/\s+/g, " ").trim().replaceAll("|", "\\|")).join(" | ")} |`);
    lines.splice(1, 0, `|${" --- |".repeat(rows[0].cells.length)}`);
    return `${lines.join("\n")}\n`;
  }

  for (const table of all("main table")) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "copy";
    button.textContent = "Copy as Markdown";
    button.addEventListener("click", async () => {
      await navigator.clipboard.writeText(markdown(table));
      button.textContent = "Copied";
      setTimeout(() => (button.textContent = "Copy as Markdown"), 2000);
    });
    let last = table.closest(".table") || table;
    if (last.nextElementSibling?.matches("script.step-rows")) last = last.nextElementSibling;
    last.after(button);
  }
})();
