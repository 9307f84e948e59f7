"use strict";
// The list of failures: filtered, page by page, with the picture of the one that is chosen.
(() => {
  const PAGE = 50;
  const WRONG = 0;

  // JSON in gzip in base64: a third of the size.
  const unpack = async (text) => {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(stream).text());
  };

  const setUp = async () => {
    const data = await unpack(document.getElementById("failure-data").textContent);
    const form = document.getElementById("failure-filters");
    const table = document.getElementById("failure-list");
    const pager = document.querySelector(".pager");
    const shown = document.getElementById("shown");
    const status = form.querySelector("output");
    const overlays = new Map(data.overlays.map(([solver, frame, path]) => [`${solver} ${frame}`, path]));
    const happened = (row) => row[2] === WRONG ? `fix off by ${row[3].toLocaleString("en")} km`
      : `${data.kinds[row[2]]}: ${data.reasons[row[3]]}`;
    const named = (row) => row[5] ? `${row[4]} of ${row[5]} stars named right` : "no star named";
    let found = data.rows, start = 0;

    const choose = (row) => {
      const frame = data.frames[row[1]];
      const picture = data.pictures[frame];
      const overlay = overlays.get(`${row[0]} ${frame}`);
      const [image, over] = shown.querySelectorAll("img");
      shown.querySelector(".picture").hidden = picture === undefined;
      if (picture !== undefined) image.src = picture;
      image.alt = frame;
      over.hidden = overlay === undefined;
      if (overlay !== undefined) over.src = overlay;
      const words = `${data.solvers[row[0]]} on ${frame}: ${happened(row)}; ${named(row)}, ${row[6]} detections.`;
      const lacking = picture === undefined ? ` ${data.without}`
        : overlay === undefined ? " Its detections were not kept." : "";
      shown.querySelector("figcaption").textContent = words + lacking;
      shown.hidden = false;
      shown.scrollIntoView({ block: "nearest" });
    };

    const cell = (text, kind) => {
      const made = document.createElement("td");
      made.textContent = text;
      made.className = kind;
      return made;
    };

    const line = (row) => {
      const made = document.createElement("tr");
      const head = document.createElement("th");
      head.scope = "row";
      const button = document.createElement("button");
      button.type = "button";
      button.className = "choose";
      const frame = data.frames[row[1]];
      button.textContent = data.pictures[frame] === undefined ? frame : `${frame} ▣`;
      button.addEventListener("click", () => choose(row));
      head.append(button);
      made.append(head, cell(data.solvers[row[0]], "left"));
      if (data.condition) made.append(cell(data.conditions[row[1]] ?? "—", "wide"));
      made.append(cell(happened(row), "left"),
        cell(row[5] ? `${row[4]} of ${row[5]}` : "—", "wide"), cell(row[6], "wide"));
      return made;
    };

    const draw = () => {
      const page = found.slice(start, start + PAGE);
      table.tBodies[0].replaceChildren(...page.map(line));
      status.textContent = found.length === 0 ? "no failure is like that"
        : `${start + 1} to ${start + page.length} of ${found.length} failures`;
      pager.hidden = found.length <= PAGE;
      pager.querySelector("[name=back]").disabled = start === 0;
      pager.querySelector("[name=on]").disabled = start + PAGE >= found.length;
    };

    const apply = () => {
      const chosen = Object.fromEntries(new FormData(form));
      const words = chosen.words.trim().toLowerCase();
      found = data.rows.filter((row) =>
        (chosen.solver === "" || row[0] === Number(chosen.solver)) &&
        (chosen.kind === "" || row[2] === Number(chosen.kind)) &&
        (!chosen.condition || data.conditions[row[1]] === Number(chosen.condition)) &&
        (chosen.picture === "" || data.pictures[data.frames[row[1]]] !== undefined) &&
        (words === "" || `${data.frames[row[1]]} ${happened(row)}`.toLowerCase().includes(words)));
      start = 0;
      draw();
    };

    const conditions = form.elements.condition;
    if (conditions) {
      const values = [...new Set(data.conditions)].filter((value) => value !== null).sort((a, b) => a - b);
      if (values.length > 40) conditions.closest("label").hidden = true;
      else conditions.append(...values.map((value) => new Option(String(value), String(value))));
    }
    // A link may name the solver whose failures are meant.
    const linked = data.solvers.indexOf(decodeURIComponent(location.hash.slice(1)));
    if (linked >= 0) form.elements.solver.value = String(linked);
    form.hidden = table.hidden = false;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", apply);
    form.addEventListener("reset", () => setTimeout(apply));
    pager.querySelector("[name=back]").addEventListener("click", () => { start -= PAGE; draw(); });
    pager.querySelector("[name=on]").addEventListener("click", () => { start += PAGE; draw(); });
    apply();
  };

  document.addEventListener("DOMContentLoaded", setUp);
})();
