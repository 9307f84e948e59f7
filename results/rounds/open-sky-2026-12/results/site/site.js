"use strict";
(() => {
  const root = document.documentElement;

  // The choice of light or dark outlives the page where the browser lets it.
  const remembered = (value) => {
    try {
      if (value !== undefined) localStorage.setItem("skybench-theme", value);
      return localStorage.getItem("skybench-theme");
    } catch {
      return null;
    }
  };
  const dark = () => getComputedStyle(root).colorScheme === "dark" ||
    (root.dataset.theme === undefined && matchMedia("(prefers-color-scheme: dark)").matches);
  const saved = remembered();
  if (saved === "light" || saved === "dark") root.dataset.theme = saved;

  const setUpTheme = () => {
    const button = document.getElementById("theme");
    const name = () => { button.textContent = dark() ? "Light page" : "Dark page"; };
    button.hidden = false;
    name();
    button.addEventListener("click", () => {
      root.dataset.theme = dark() ? "light" : "dark";
      remembered(root.dataset.theme);
      name();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", name);
  };

  // Undefined values stand last in either direction.
  const compare = (one, other, sign) => {
    if (one === "" || other === "") return (one === "") - (other === "");
    const a = Number(one), b = Number(other);
    if (!Number.isNaN(a) && !Number.isNaN(b)) return sign * (a - b);
    return sign * one.localeCompare(other, "en", { numeric: true });
  };

  const sortBy = (table, header, place) => {
    const sorted = header.getAttribute("aria-sort");
    const first = header.dataset.first ?? "ascending";
    const next = sorted === null ? first : sorted === "ascending" ? "descending" : "ascending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", next);
    const body = table.tBodies[0];
    const key = (row) => row.cells[place].dataset.value ?? row.cells[place].textContent.trim();
    const rows = [...body.rows].map((row, n) => ({ row, n, value: key(row) }));
    rows.sort((a, b) => compare(a.value, b.value, next === "ascending" ? 1 : -1) || a.n - b.n);
    body.append(...rows.map(({ row }) => row));
  };

  const setUpSorting = (table) => {
    [...table.tHead.rows[0].cells].forEach((header, place) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...header.childNodes);
      header.append(button);
      button.addEventListener("click", () => sortBy(table, header, place));
    });
  };

  const setUpFilters = (form) => {
    const status = form.querySelector("output");
    const choices = [...form.querySelectorAll("select")];
    const things = [...document.querySelectorAll("[data-filtered], [data-measure] [data-task]")];
    const apply = () => {
      let shown = 0, all = 0;
      for (const thing of things) {
        const fits = choices.every(({ name, value }) =>
          value === "" || thing.dataset[name] === undefined || thing.dataset[name] === value);
        thing.hidden = !fits;
        if (thing.dataset.filtered === "counted") {
          all += 1;
          shown += fits ? 1 : 0;
        }
      }
      status.textContent = `${shown} of ${all} results`;
    };
    form.hidden = false;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("change", apply);
    form.addEventListener("reset", () => setTimeout(apply));
    apply();
  };

  // Parts that the page carries as compressed text, so that a folder of many pages stays light.
  const unfold = async (part) => {
    const packed = part.querySelector("script").textContent.trim();
    const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const unfolded = document.createElement("template");
    unfolded.innerHTML = await new Response(stream).text();
    part.replaceWith(unfolded.content);
  };

  document.addEventListener("DOMContentLoaded", async () => {
    setUpTheme();
    await Promise.all([...document.querySelectorAll(".folded")].map(unfold));
    document.querySelectorAll("table.sortable").forEach(setUpSorting);
    document.querySelectorAll("form.filters:not([id])").forEach(setUpFilters);
    // What a link means may have moved down since the browser went there.
    if (location.hash) document.getElementById(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
  });
})();
