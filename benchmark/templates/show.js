"use strict";
// Every text from the dataset reaches the page as a text node, never as markup.
const skybench = (() => {
  const content = JSON.parse(document.getElementById("content").textContent);
  const at = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg";
  const make = (tag, text, parent) => {
    const element = document.createElement(tag);
    if (text !== undefined) element.textContent = text;
    if (parent) parent.append(element);
    return element;
  };
  const shown = (value, decimals) => (value === null || value === undefined ? "–" : value.toFixed(decimals));

  // Filters: a pair of limits per number that varies, a list per choice.
  const limits = new Map();
  const chosen = new Map();

  function matches(frame) {
    for (const [column, [low, high]] of limits) {
      const value = frame.values[column];
      if (value === null || value === undefined) {
        if (low !== -Infinity || high !== Infinity) return false;
      } else if (value < low || value > high) return false;
    }
    for (const [column, value] of chosen) if (value !== null && frame.values[column] !== value) return false;
    return true;
  }

  function applyFilters() {
    let count = 0;
    content.frames.forEach((frame, number) => {
      const good = matches(frame);
      cards[number].hidden = !good;
      count += good;
    });
    at("matching").textContent = `${count} of ${content.frames.length} shown.`;
    for (const redraw of redraws) redraw();
  }

  const redraws = [];
  function addHistogram(number) {
    const figure = make("figure", undefined, at("histograms"));
    make("figcaption", number.title + (number.unit ? `, ${number.unit}` : ""), figure);
    const drawing = document.createElementNS(SVG, "svg");
    drawing.setAttribute("viewBox", `0 0 ${number.counts.length} 1`);
    drawing.setAttribute("preserveAspectRatio", "none");
    figure.append(drawing);
    const tallest = Math.max(...number.counts);
    const width = (number.high - number.low) / number.counts.length;
    const bars = number.counts.map((count, bin) => {
      const bar = document.createElementNS(SVG, "rect");
      const height = count / tallest;
      for (const [key, value] of Object.entries({ x: bin + 0.04, y: 1 - height, width: 0.92, height }))
        bar.setAttribute(key, value);
      const tip = document.createElementNS(SVG, "title");
      tip.textContent = `${shown(number.low + bin * width, number.decimals)} to ${shown(number.low + (bin + 1) * width, number.decimals)}: ${count}`;
      bar.append(tip);
      drawing.append(bar);
      return bar;
    });
    const row = make("div", undefined, figure);
    row.className = "limits";
    const ends = ["at least", "at most"].map((word, end) => {
      const input = make("input", undefined, row);
      input.type = "number";
      input.step = "any";
      input.placeholder = shown(end ? number.high : number.low, number.decimals);
      input.setAttribute("aria-label", `${number.title} ${word}`);
      input.id = `${number.column}-${end ? "high" : "low"}`;
      input.addEventListener("input", () => {
        const read = (field, open) => (field.value === "" ? open : Number(field.value));
        limits.set(number.column, [read(ends[0], -Infinity), read(ends[1], Infinity)]);
        applyFilters();
      });
      return input;
    });
    redraws.push(() => {
      const [low, high] = limits.get(number.column) ?? [-Infinity, Infinity];
      bars.forEach((bar, bin) => {
        const left = number.low + bin * width;
        bar.classList.toggle("in", left + width >= low && left <= high);
      });
    });
    return ends;
  }

  function addChoice(choice) {
    const label = make("label", `${choice.title} `, at("choices"));
    const list = make("select", undefined, label);
    list.id = `choice-${choice.column}`;
    make("option", "all", list);
    for (const value of choice.values) make("option", value, list);
    list.addEventListener("change", () => {
      chosen.set(choice.column, list.selectedIndex === 0 ? null : choice.values[list.selectedIndex - 1]);
      applyFilters();
    });
    return list;
  }

  const cards = content.frames.map((frame, number) => {
    const card = make("button", undefined, at("sheet"));
    card.type = "button";
    const picture = make("img", undefined, card);
    picture.src = frame.picture;
    picture.alt = "";
    picture.loading = "lazy";
    const words = [frame.id];
    if (frame.values.bortle) words.push(`Bortle ${frame.values.bortle}`);
    const rows = `${shown(frame.values.n_in_field, 0)} catalogue rows`;
    if (frame.values.n_visible != null) words.push(`${shown(frame.values.n_visible, 0)} stars with SNR ≥ 5 (${rows})`);
    else words.push(rows);
    make("span", words.join(", "), card);
    card.addEventListener("click", () => open(number));
    return card;
  });
  const fields = content.numbers.flatMap(addHistogram);
  const lists = content.choices.map(addChoice);
  at("reset").addEventListener("click", () => {
    for (const field of fields) field.value = "";
    for (const list of lists) list.selectedIndex = 0;
    limits.clear();
    chosen.clear();
    applyFilters();
  });

  // The viewer. A point (u, v) of the frame lies at (left + (u + 0.5) * scale, top + (v + 0.5) * scale) on the canvas.
  const viewer = at("viewer");
  const canvas = at("canvas");
  const pen = canvas.getContext("2d");
  const picture = document.createElement("canvas");
  let number = -1;
  let frame = null;
  let pixels = null;
  let view = { scale: 1, left: 0, top: 0 };
  let waiting = null;

  function open(wanted) {
    number = wanted;
    frame = null;
    if (!viewer.open) viewer.showModal();
    const card = content.frames[number];
    at("frame-title").textContent = `${card.id}, ${card.utc}`;
    fillConditions(card);
    waiting?.remove();
    waiting = document.createElement("script");
    waiting.src = `frames/${number}.js`;
    waiting.onerror = () => { at("frame-title").textContent = `${card.id}: frames/${number}.js is missing beside this page`; };
    document.body.append(waiting);
  }

  async function receive(received) {
    if (received.number !== number) return;
    const packed = Uint8Array.from(atob(received.pixels), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    if (received.number !== number) return;
    const count = received.width * received.height;
    pixels = new Uint16Array(count);
    for (let k = 0; k < count; k += 1) pixels[k] = (planes[k] << 8) | planes[k + count];
    frame = received;
    picture.width = frame.width;
    picture.height = frame.height;
    fillTables();
    develop();
    fit();
    canvas.focus({ preventScroll: true });
  }

  // Brightness log(1 + a x) / log(1 + a), x from black to white, a = 10^slider - 1.
  function develop() {
    if (!frame) return;
    const a = Math.max(10 ** Number(at("stretch").value) - 1, 1e-6);
    const range = Math.max(frame.white - frame.black, 1);
    const white = frame.black + Math.max(1, range ** Number(at("white").value));
    at("white-dn").textContent = `${Math.round(white)} DN`;
    const table = new Uint8Array(65536);
    for (let dn = 0; dn < 65536; dn += 1) {
      const x = Math.min(Math.max((dn - frame.black) / (white - frame.black), 0), 1);
      table[dn] = Math.round((255 * Math.log1p(a * x)) / Math.log1p(a));
    }
    const image = new ImageData(frame.width, frame.height);
    const grey = new Uint32Array(image.data.buffer);
    for (let k = 0; k < pixels.length; k += 1) grey[k] = 0xff000000 | (table[pixels[k]] * 0x010101);
    picture.getContext("2d").putImageData(image, 0, 0);
    draw();
  }

  const size = () => ({ width: frame.width * frame.block, height: frame.height * frame.block });
  const toCanvas = (u, y) => [view.left + (u + 0.5) * view.scale, view.top + (y + 0.5) * view.scale];
  const toFrame = (x, y) => [(x - view.left) / view.scale - 0.5, (y - view.top) / view.scale - 0.5];

  function fit() {
    if (!frame) return;
    const box = canvas.getBoundingClientRect();
    const { width, height } = size();
    const scale = Math.min(box.width / width, box.height / height);
    view = { scale, left: (box.width - width * scale) / 2, top: (box.height - height * scale) / 2 };
    draw();
  }

  function zoomTo(scale, x, y) {
    if (!frame) return;
    const box = canvas.getBoundingClientRect();
    const [px, py] = [x ?? box.width / 2, y ?? box.height / 2];
    const bounded = Math.min(Math.max(scale, 0.02), 64);
    const grown = bounded / view.scale;
    view = { scale: bounded, left: px - (px - view.left) * grown, top: py - (py - view.top) * grown };
    draw();
  }

  const visibleStars = () => {
    const stars = frame.stars;
    const faintest = Number(at("faintest").value);
    const least = Number(at("least-snr").value);
    const found = [];
    for (let k = 0; k < stars.v.length; k += 1)
      if (stars.v[k] <= faintest && (stars.snr[k] >= least || stars.occluded[k]) && stars.u[k] !== null) found.push(k);
    return found;
  };

  function draw() {
    if (!frame) return;
    const box = canvas.getBoundingClientRect();
    const dense = window.devicePixelRatio || 1;
    canvas.width = Math.round(box.width * dense);
    canvas.height = Math.round(box.height * dense);
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.fillStyle = "#000";
    pen.fillRect(0, 0, box.width, box.height);
    pen.imageSmoothingEnabled = view.scale * frame.block < 1;
    pen.imageSmoothingQuality = "high";
    const { width, height } = size();
    pen.drawImage(picture, view.left, view.top, width * view.scale, height * view.scale);
    at("zoom").textContent = `${Math.round(view.scale * 100)} %`;
    if (at("overlay").checked) drawTruth();
  }

  function drawTruth() {
    const stars = frame.stars;
    const labelled = Number(at("labels").value);
    pen.lineWidth = 1.2;
    pen.font = "12px system-ui, sans-serif";
    const labels = [];
    const mark = (u, y, u0, y0, u1, y1, radius, label) => {
      const [x, z] = toCanvas(u, y);
      pen.beginPath();
      if (u0 !== null && u1 !== null && Math.hypot(u1 - u0, y1 - y0) * view.scale > 4) {
        pen.moveTo(...toCanvas(u0, y0));
        pen.lineTo(...toCanvas(u1, y1));
      }
      pen.moveTo(x + radius, z);
      pen.arc(x, z, radius, 0, 2 * Math.PI);
      pen.stroke();
      if (label) labels.push({ text: label, x: x + radius + 3, z: z + 4, colour: pen.strokeStyle });
    };
    for (const object of frame.objects) {
      if (object.u === null || (object.snr !== null && object.snr < Number(at("least-snr").value))) continue;
      pen.strokeStyle = pen.fillStyle = object.occluded ? "#ff8a80" : "#7fe08a";
      mark(object.u, object.y, object.u0, object.y0, object.u1, object.y1, 12, labelled ? object.kind.replace("_", " ") : "");
    }
    visibleStars().forEach((k, order) => {
      const colour = stars.occluded[k] ? "#ff8a80" : stars.planet[k] ? "#ffd54a" : "#56b4e9";
      pen.strokeStyle = pen.fillStyle = colour;
      const radius = Math.max(4, 11 - 1.2 * stars.v[k]);
      const label = order < labelled ? `${stars.name[k]} ${shown(stars.v[k], 1)}, SNR ${shown(stars.snr[k], 0)}` : "";
      mark(stars.u[k], stars.y[k], stars.u0[k], stars.y0[k], stars.u1[k], stars.y1[k], radius, label);
    });
    drawLabels(labels);
  }

  // Labels, objects first, then stars by brightness; one that would cover another is left out.
  function drawLabels(labels) {
    const taken = [];
    for (const { text, x, z, colour } of labels) {
      const box = { left: x - 2, right: x + pen.measureText(text).width + 2, top: z - 12, bottom: z + 4 };
      if (taken.some((other) => box.left < other.right && other.left < box.right && box.top < other.bottom && other.top < box.bottom))
        continue;
      taken.push(box);
      pen.fillStyle = "rgb(0 0 0 / 60%)";
      pen.fillRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
      pen.fillStyle = colour;
      pen.fillText(text, x, z);
    }
  }

  function fillConditions(card) {
    const body = at("frame-conditions").tBodies[0];
    body.replaceChildren();
    for (const condition of content.conditions) {
      const value = card.values[condition.column];
      if (value === null || value === undefined || value === "") continue;
      const row = make("tr", undefined, body);
      make("td", condition.title, row);
      const text = typeof value === "number" ? shown(value, condition.decimals) : value;
      make("td", condition.unit ? `${text} ${condition.unit}` : text, row);
    }
  }

  function fillTables() {
    const stars = frame.stars;
    const body = at("stars").tBodies[0];
    body.replaceChildren();
    for (let k = 0; k < Math.min(stars.v.length, 100); k += 1) {
      const row = make("tr", undefined, body);
      make("td", stars.name[k], row);
      const notes = [stars.saturated[k] ? "saturated" : "", stars.occluded[k] ? "occluded" : ""];
      for (const [column, decimals] of [["v", 2], ["bv", 2], ["snr", 1], ["electrons", 0], ["u", 2], ["y", 2]])
        make("td", shown(stars[column][k], decimals), row);
      make("td", notes.filter(Boolean).join(", "), row);
    }
    const others = at("objects").tBodies[0];
    others.replaceChildren();
    at("objects-block").hidden = frame.objects.length === 0;
    for (const object of frame.objects) {
      const row = make("tr", undefined, others);
      make("td", object.kind.replace("_", " "), row);
      for (const [column, decimals] of [["v", 1], ["snr", 1], ["electrons", 0], ["u", 1], ["y", 1]])
        make("td", shown(object[column], decimals), row);
      make("td", object.occluded ? "occluded" : "", row);
    }
  }

  function pointAt(event) {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  function describe(x, y) {
    const [u, v] = toFrame(x, y);
    const column = Math.floor((u + 0.5) / frame.block);
    const line = Math.floor((v + 0.5) / frame.block);
    const inside = column >= 0 && line >= 0 && column < frame.width && line < frame.height;
    const mean = frame.block > 1 ? ` (mean of ${frame.block} x ${frame.block} pixels)` : "";
    at("pixel").textContent = inside
      ? `u ${Math.round(u)}, v ${Math.round(v)}: ${pixels[line * frame.width + column]} DN${mean}`
      : "\u00a0";
    const hint = at("hint");
    let best = -1;
    let nearest = 12;
    if (at("overlay").checked) {
      for (const k of visibleStars()) {
        const [sx, sy] = toCanvas(frame.stars.u[k], frame.stars.y[k]);
        const distance = Math.hypot(sx - x, sy - y);
        if (distance < nearest) { nearest = distance; best = k; }
      }
    }
    hint.hidden = best < 0;
    if (best >= 0) {
      const stars = frame.stars;
      hint.textContent = `${stars.name[best]}\nV ${shown(stars.v[best], 2)}, B−V ${shown(stars.bv[best], 2)}\n` +
        `SNR ${shown(stars.snr[best], 1)}, ${shown(stars.electrons[best], 0)} electrons`;
      hint.style.left = `${x + 14}px`;
      hint.style.top = `${y + 14}px`;
    }
  }

  let grip = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    grip = { from: pointAt(event), view };
  });
  canvas.addEventListener("pointerup", () => { grip = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!frame) return;
    const [x, y] = pointAt(event);
    if (grip) {
      view = { scale: grip.view.scale, left: grip.view.left + x - grip.from[0], top: grip.view.top + y - grip.from[1] };
      draw();
    }
    describe(x, y);
  });
  canvas.addEventListener("pointerleave", () => { at("hint").hidden = true; });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomTo(view.scale * 1.0015 ** -event.deltaY, ...pointAt(event));
  }, { passive: false });
  for (const id of ["stretch", "white"]) at(id).addEventListener("input", develop);
  for (const id of ["overlay", "labels", "faintest", "least-snr"]) at(id).addEventListener("input", draw);
  at("zoom-in").addEventListener("click", () => zoomTo(view.scale * 1.5));
  at("zoom-out").addEventListener("click", () => zoomTo(view.scale / 1.5));
  at("fit").addEventListener("click", fit);
  at("one").addEventListener("click", () => zoomTo(1));
  at("close").addEventListener("click", () => viewer.close());
  viewer.addEventListener("close", () => { number = -1; frame = null; });
  function step(by) {
    for (let k = number + by; k >= 0 && k < cards.length; k += by)
      if (!cards[k].hidden) { open(k); return; }
  }
  at("previous").addEventListener("click", () => step(-1));
  at("next").addEventListener("click", () => step(1));
  viewer.addEventListener("keydown", (event) => {
    if (event.target instanceof HTMLInputElement) return;
    const actions = { "+": () => zoomTo(view.scale * 1.5), "-": () => zoomTo(view.scale / 1.5), 0: fit, 1: () => zoomTo(1),
      ArrowLeft: () => step(-1), ArrowRight: () => step(1) };
    if (event.key in actions) { event.preventDefault(); actions[event.key](); }
  });
  window.addEventListener("resize", draw);
  applyFilters();

  return { receive };
})();
