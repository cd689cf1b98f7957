"use strict";
// What the reader has chosen, and what follows from it for tables and charts.
(() => {
  const state = { step: null, hidden: new Set(), out: new Set() };
  const config = { responsive: true, displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };
  const narrow = 560; // CSS pixels, under which titles of rows take several lines
  const legendLine = 20; // CSS pixels of an entry of a legend
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let onPaper = false;
  let ready = false; // plotly.js, charts and rows of tables are unpacked
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const steps = all("#steps option").map((option) => Number(option.dataset.step));
  const sections = new Map(all("section[data-comparison]").map((section) => [section.dataset.comparison, section]));
  const charts = all(".chart").map((element) => ({
    element,
    plot: element.querySelector(".plot"),
    source: element.querySelector("script"),
    everyone: "whole" in element.dataset, // shows all teachers, whoever is chosen
    figure: null,
    stale: false,
    near: false,
  }));

  /** The text of a script element, which the page holds compressed by gzip, in base64. */
  async function unpacked(element) {
    const bytes = Uint8Array.from(atob(element.textContent), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    element.unpacked = await new Response(stream).text();
    return element.unpacked;
  }

  /** Unpacks everything before the first chart is drawn, since printing cannot wait. */
  async function unpack() {
    const library = document.createElement("script");
    library.textContent = await unpacked(document.getElementById("plotly"));
    await Promise.all([...charts.map((chart) => chart.source), ...all("script.step-rows")].map(unpacked));
    document.head.append(library);
    ready = true;
    if (state.step !== null) showStep();
    refresh();
  }

  /** The last of `names` that is a step up to the chosen one; the first if all lie after it. */
  function frameName(names) {
    if (state.step === null) return names.includes("end") ? "end" : names[names.length - 1];
    const numbers = names.filter((name) => name !== "end").map(Number);
    const before = numbers.filter((number) => number <= state.step);
    return String(before.length ? Math.max(...before) : Math.min(...numbers));
  }

  /** A trace with what a frame changes of it. */
  function patched(trace, patch) {
    const marker = { ...trace.marker, ...patch.marker };
    const error = trace.error_x && { ...trace.error_x, ...patch.error_x };
    return { ...trace, ...patch, marker, ...(error && { error_x: error }) };
  }

  const shades = { "#22262b": "#e4e7ea", "#6a717b": "#a0a8b2", "#d9dce1": "#363c44", "#e6e8eb": "#2a2f36", white: "#15181c" };
  const bright = 0.216; // relative luminance (WCAG) whose contrast to the dark page is 4.5

  function luminance(parts) {
    const [red, green, blue] = parts.map((part) => (part <= 10 ? part / 3294.6 : ((part / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  }

  /** A colour as it is seen on a dark page: greys change places, dark colours get as light as they must. */
  function onDark(colour) {
    if (shades[colour]) return shades[colour];
    const parts = /^#([0-9a-f]{6})$/i.test(colour) ? [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16)) : (/^rgba?\(([\d., ]+)\)$/.exec(colour) || [])[1]?.split(",").map(Number);
    if (!parts) return colour;
    const [red, green, blue, opacity = 1] = parts;
    let mixed = [red, green, blue];
    for (let white = 0.02; luminance(mixed) < bright; white += 0.02) mixed = [red, green, blue].map((part) => Math.round(part + (255 - part) * white));
    return `rgba(${mixed.join()},${opacity})`;
  }

  /** The small squares that name teachers by their colour, on the page as it is now. */
  function paintSwatches() {
    for (const swatch of all(".swatch")) {
      swatch.colour = swatch.colour || swatch.style.backgroundColor;
      swatch.style.backgroundColor = dark.matches && !onPaper ? onDark(swatch.colour) : swatch.colour;
    }
  }

  /** A scale whose high end stands out from a dark page: those that grow darker become pale for more. */
  function lightForMore(scale) {
    const sum = (place) => (String(scale[place][1]).match(/\d+/g) || []).slice(0, 3).reduce((total, part) => total + Number(part), 0);
    return typeof scale !== "string" && sum(0) > sum(scale.length - 1) ? [[0, "#1f2831"], [0.5, "#2f6f9f"], [1, "#a9d8fb"]] : scale;
  }

  /** What plotly is given, with the colours of the page it stands on. */
  function themed(value, key = "") {
    if (typeof value === "string") return /color$/i.test(key) ? onDark(value) : value;
    if (key === "colorscale") return lightForMore(value);
    if (ArrayBuffer.isView(value)) return value;
    if (Array.isArray(value)) return value.some((each) => each && typeof each === "object") ? value.map((each) => themed(each)) : value;
    if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([name, each]) => [name, themed(each, name)]));
    return value;
  }

  /** Traces and layout of a figure as the reader has chosen them. */
  function chosen(figure, width, hidden) {
    const frames = figure.frames || [];
    const name = frames.length ? frameName(frames.map((frame) => frame.name)) : null;
    const frame = frames.find((each) => each.name === name);
    const data = figure.data.map((trace, index) => {
      const place = frame && frame.traces ? frame.traces.indexOf(index) : -1;
      const whose = trace.meta || {};
      const shown = !hidden.has(whose.teacher) && !state.out.has(whose.comparison);
      return { ...(place < 0 ? trace : patched(trace, frame.data[place])), visible: shown };
    });
    const layout = { ...figure.layout };
    if (frame && frame.layout && frame.layout.title) layout.title = { ...layout.title, ...frame.layout.title };
    const meta = layout.meta || {};
    if (meta.marks_step && state.step !== null) layout.shapes = [stepMark()];
    if (meta.rows) closeRows(data, layout, meta, width < narrow);
    if (meta.line_height) closeLines(layout, meta, hidden);
    if (layout.showlegend && width < narrow) layout.height += legendLine * Math.max(0, entries(data) - 3);
    if (!dark.matches || onPaper) return { data, layout };
    const hoverlabel = { ...layout.hoverlabel, bgcolor: "#1d2126" };
    return { data: data.map((trace) => themed(trace)), layout: { ...themed(layout), hoverlabel } };
  }

  /** Entries of the legend, which on a phone stand one below the other and would leave no room for the chart. */
  function entries(data) {
    return data.filter((trace) => trace.visible && trace.showlegend !== false && trace.name).length;
  }

  function stepMark() {
    const line = { color: "#6a717b", width: 1, dash: "dot" };
    return { type: "line", x0: state.step, x1: state.step, y0: 0, y1: 1, yref: "paper", line };
  }

  /** Moves the rows of an overview together where comparisons or teachers are left out, and legend entries with them. */
  function closeRows(data, layout, meta, wrapped) {
    const kept = meta.rows.map((_, place) => place).filter((place) => !state.out.has(meta.rows[place]));
    const places = new Map(kept.map((place, index) => [meta.rows[place], index]));
    const there = meta.teachers.filter((teacher) => !state.hidden.has(teacher));
    const offset = (teacher) => (0.66 * (there.indexOf(teacher) + 1)) / (there.length + 1) - 0.33;
    const named = new Set();
    for (const trace of data) {
      trace.y = trace.y.map(() => (places.get(trace.meta.comparison) || 0) + offset(trace.meta.teacher));
      trace.showlegend = trace.visible && !named.has(trace.meta.teacher);
      if (trace.showlegend) named.add(trace.meta.teacher);
    }
    const titles = kept.map((place) => layout.yaxis.ticktext[place]);
    const ticktext = wrapped ? titles.map((title) => title.replaceAll(", ", ",<br>")) : titles;
    const range = [kept.length - 0.5, -0.5];
    layout.yaxis = { ...layout.yaxis, ticktext, tickvals: kept.map((_, index) => index), range };
    layout.shapes = (layout.shapes || []).slice(0, Math.max(0, kept.length - 1));
    layout.height = meta.frame_height + Math.max(meta.least_height, meta.spacing * (there.length + 1)) * Math.max(1, kept.length);
    layout.uirevision = [...kept, there.length].join();
  }

  /** Leaves out the lines of a chart that belong to teachers who are left out. */
  function closeLines(layout, meta, hidden) {
    const kept = meta.teachers.map((_, place) => place).filter((place) => !hidden.has(meta.teachers[place]));
    const [tickvals, ticktext] = ["tickvals", "ticktext"].map((name) => kept.map((place) => layout.yaxis[name][place]));
    layout.yaxis = { ...layout.yaxis, tickvals, ticktext };
    layout.height = meta.frame_height + meta.line_height * Math.max(1, kept.length);
    layout.uirevision = kept.length;
  }

  function draw(chart) {
    if (!ready || !chart.plot.offsetParent) return; // hidden: drawn when it is shown
    const first = chart.figure === null;
    if (first) chart.figure = JSON.parse(chart.source.unpacked);
    const { data, layout } = chosen(chart.figure, chart.plot.clientWidth, chart.everyone ? new Set() : state.hidden);
    chart.plot.style.height = `${layout.height}px`;
    Plotly.react(chart.plot, data, layout, { ...config, toImageButtonOptions: { filename: chart.element.dataset.chart, scale: 2 } });
    chart.stale = false;
    if (first) listen(chart);
  }

  /** A click on a legend chooses the teacher on the whole page. */
  function listen(chart) {
    chart.plot.on("plotly_legendclick", (event) => {
      const box = all("#controls [data-teacher]").find((each) => each.dataset.teacher === event.data[event.curveNumber].legendgroup);
      if (box) box.click();
      return false;
    });
    chart.plot.on("plotly_legenddoubleclick", () => false);
  }

  function refresh() {
    paintSwatches();
    for (const chart of charts) chart.stale = true;
    for (const chart of charts) if (chart.near) draw(chart);
  }

  function showTeachers() {
    state.hidden = new Set(all("#controls [data-teacher]").filter((box) => !box.checked).map((box) => box.dataset.teacher));
    for (const element of all("[data-of]")) element.hidden = state.hidden.has(element.dataset.of);
  }

  function showComparisons() {
    const wanted = all("#controls [data-filter]").filter((select) => select.value !== "");
    state.out = new Set();
    for (const [anchor, section] of sections) {
      const fits = wanted.every((select) => {
        const name = select.dataset.filter.replace(/_(.)/g, (_, letter) => letter.toUpperCase());
        return section.dataset[name] === select.selectedOptions[0].dataset.value;
      });
      if (!fits) state.out.add(anchor);
    }
    for (const element of all("[data-comparison]")) element.hidden = state.out.has(element.dataset.comparison);
    const nothing = document.getElementById("nothing");
    if (nothing) nothing.hidden = sections.size === 0 || state.out.size < sections.size;
  }

  function showStep() {
    const slider = document.getElementById("step");
    if (!slider) return;
    const place = Number(slider.value);
    state.step = place < steps.length ? steps[place] : null;
    const name = document.getElementById("step-name");
    const text = state.step === null ? name.dataset.end : all("#steps option")[place].label;
    name.textContent = text;
    slider.setAttribute("aria-valuetext", text);
    const notice = document.getElementById("at-step");
    notice.hidden = state.step === null;
    notice.querySelector("b").textContent = text;
    for (const section of sections.values()) fillTables(section);
  }

  /** Fills the tables of a section for the chosen step; what they said at the end is kept in the cells. */
  function fillTables(section) {
    for (const source of ready ? all("script.step-rows", section) : []) {
      source.rows = source.rows || JSON.parse(source.unpacked);
      const names = Object.keys(source.rows);
      const rows = state.step === null || !names.length ? null : source.rows[frameName(names)];
      for (const row of all("tr[data-of]", source.previousElementSibling)) fillRow(row, rows && (rows[row.dataset.of] || {}));
    }
  }

  function fillRow(row, texts) {
    for (const cell of all("td[data-field]", row)) {
      cell.atEnd = cell.atEnd || [...cell.childNodes];
      cell.replaceChildren(...(texts === null ? cell.atEnd : [texts[cell.dataset.field] ?? "–"]));
      if (cell.dataset.field === "verdict") {
        for (const word of ["better", "worse"]) cell.classList.toggle(word, cell.textContent === word);
      }
    }
  }

  const controls = document.getElementById("controls");
  if (controls) {
    let waiting = false;
    controls.addEventListener("submit", (event) => event.preventDefault());
    controls.addEventListener("input", () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        showTeachers();
        showComparisons();
        showStep();
        refresh();
      });
    });
    controls.addEventListener("click", (event) => {
      const wanted = event.target.dataset.choose;
      if (!wanted) return;
      for (const box of all("[data-teacher]", controls)) box.checked = wanted === "all" || box.defaultChecked;
      controls.dispatchEvent(new Event("input"));
    });
    controls.reset(); // browsers remember choices over a reload, the page does not
    showTeachers();
  }

  const observer = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        const chart = charts.find((each) => each.element === entry.target);
        chart.near = entry.isIntersecting;
        if (chart.near && (chart.figure === null || chart.stale)) draw(chart);
      }
    },
    { rootMargin: "800px" },
  );
  for (const chart of charts) observer.observe(chart.element);
  paintSwatches();
  if (typeof DecompressionStream === "undefined") document.getElementById("old-browser").hidden = false;
  else unpack();

  dark.addEventListener("change", refresh);

  /** Opens what an address leads to, if it is folded. */
  function unfold() {
    const folded = location.hash.length > 1 && document.getElementById(location.hash.slice(1))?.querySelector("details.comparison");
    if (folded) folded.open = true;
  }
  unfold();
  addEventListener("hashchange", unfold);
  for (const link of all('a[href^="#"]')) link.addEventListener("click", () => setTimeout(unfold)); // also to where the address leads already

  // Paper shows everything that is chosen, unfolded, in dark ink, at the width of the paper.
  let folded = [];
  addEventListener("beforeprint", () => {
    onPaper = true;
    folded = all("details.comparison:not([open])");
    for (const each of folded) each.open = true;
    paintSwatches();
    for (const chart of charts) {
      draw(chart);
      if (chart.figure) Plotly.relayout(chart.plot, { width: Math.min(chart.plot.clientWidth, 660) });
    }
  });
  addEventListener("afterprint", () => {
    onPaper = false;
    for (const each of folded) each.open = false;
    for (const chart of charts) if (chart.figure) Plotly.relayout(chart.plot, { width: null, autosize: true });
    refresh();
  });
})();
