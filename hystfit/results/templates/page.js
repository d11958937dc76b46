(function () {
  const dialog = document.querySelector("dialog"), stage = dialog.querySelector("div"), fingers = new Map();
  let panels = [], span;

  // A panel has limits in data coordinates, logarithms where its axis is logarithmic; what is clipped to it moves, and its ticks are drawn anew.
  function panel(svg, facts) {
    const group = svg.getElementById(facts.id), space = group.namespaceURI, [left, top, right, bottom] = facts.box;
    const one = { ...facts, group, first: facts.limits.map((pair) => [...pair]), moved: [], ticks: document.createElementNS(space, "g") };
    for (const element of group.querySelectorAll(':scope > g:not([id^="matplotlib.axis"]) [clip-path]')) {
      const frame = document.createElementNS(space, "g"), box = element.getBBox(), marks = [...element.querySelectorAll("use")];
      frame.setAttribute("clip-path", element.getAttribute("clip-path"));
      element.removeAttribute("clip-path");
      element.replaceWith(frame);
      frame.append(element);
      const points = marks.filter((mark) => +mark.getAttribute("x")).map((mark) => [mark, +mark.getAttribute("x"), +mark.getAttribute("y")]);
      one.moved.push({ element, points, across: box.width > 0.999 * (right - left), along: box.height > 0.999 * (bottom - top) });
    }
    group.append(one.ticks);
    return one;
  }

  // Scale and shift of both directions from the first limits to the present ones, in the units of the picture.
  function change(one) {
    const [left, top, right, bottom] = one.box, ends = [[left, right], [bottom, top]];
    return ends.map(([from, to], k) => {
      const [a, b] = one.first[k], [c, d] = one.limits[k], scale = (b - a) / (d - c);
      return [scale, from + ((a - c) / (d - c)) * (to - from) - scale * from];
    });
  }

  function draw(one) {
    const [[sx, tx], [sy, ty]] = change(one);
    for (const { element, points, across, along } of one.moved) {
      if (points.length) for (const [mark, x, y] of points) { mark.setAttribute("x", sx * x + tx); mark.setAttribute("y", sy * y + ty); }
      else element.setAttribute("transform", `matrix(${across && !along ? `1 0 0 ${sy} 0 ${ty}` : along && !across ? `${sx} 0 0 1 ${tx} 0` : `${sx} 0 0 ${sy} ${tx} ${ty}`})`);
    }
    const zoomed = one.limits.map((pair, k) => pair.some((value, i) => value !== one.first[k][i]));
    one.ticks.replaceChildren(...[0, 1].filter((k) => zoomed[k]).flatMap((k) => ticks(one, k)));
    for (const [k, axis] of one.group.querySelectorAll(':scope > [id^="matplotlib.axis"]').entries()) {
      for (const part of axis.querySelectorAll(`:scope > [id^="${"xy"[k]}tick"]`)) part.style.display = zoomed[k] ? "none" : "";
    }
  }

  function ticks(one, k) {
    const [low, high] = one.limits[k], [left, top, right, bottom] = one.box, many = 6;
    const rough = Math.abs(high - low) / many, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * ([1, 2, 5].find((factor) => factor * power >= rough) ?? 10), marks = [];
    const [a, b] = low < high ? [low, high] : [high, low], largest = Math.max(Math.abs(a), Math.abs(b));
    for (let n = Math.ceil(a / step); n * step <= b; n += 1) {
      const value = n * step, part = (value - low) / (high - low);
      const x = k ? left : left + part * (right - left), y = k ? bottom + part * (top - bottom) : bottom;
      const space = one.group.namespaceURI, mark = document.createElementNS(space, "path"), text = document.createElementNS(space, "text");
      mark.setAttribute("d", `M ${x} ${y} ${k ? "h -3.5" : "v 3.5"}`);
      text.setAttribute("x", k ? x - 6 : x);
      text.setAttribute("y", k ? y + 3 : y + 13);
      text.setAttribute("text-anchor", k ? "end" : "middle");
      text.textContent = words(one, k, value, step, largest);
      marks.push(mark, text);
    }
    return marks;
  }

  // A tick label, beside the offset and the power of ten that stand at the axis.
  function words(one, k, value, step, largest) {
    if (one.log[k]) return String(+(10 ** value).toPrecision(3));
    const [offset, unit] = one.labels[k];
    [value, step, largest] = [(value - offset) / unit, step / unit, largest / unit];
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    if (largest < 1e5 && digits < 7) return value.toFixed(digits);
    return value === 0 ? "0" : value.toExponential(Math.max(0, Math.floor(Math.log10(Math.abs(value)) - Math.log10(step) + 1.000001)));
  }

  // The panel under a pointer, and the pointer's place in the picture.
  function under(event) {
    const svg = stage.querySelector("svg"), place = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const one = panels.find(({ box: [left, top, right, bottom] }) => place.x >= left && place.x <= right && place.y >= top && place.y <= bottom);
    return one && [one, place];
  }

  function linked(one, k) { return panels.filter((other) => other.moves[k] && (other === one || one.shared[k].includes(other.id))); }

  function zoom(one, place, factor) {
    const [left, top, right, bottom] = one.box, parts = [(place.x - left) / (right - left), (bottom - place.y) / (bottom - top)];
    for (const k of [0, 1]) for (const other of linked(one, k)) {
      const [low, high] = other.limits[k], at = low + parts[k] * (high - low);
      other.limits[k] = [at + (low - at) / factor, at + (high - at) / factor];
    }
    panels.forEach(draw);
  }

  function shift(one, dx, dy) {
    const [left, top, right, bottom] = one.box, parts = [dx / (right - left), -dy / (bottom - top)];
    for (const k of [0, 1]) for (const other of linked(one, k)) other.limits[k] = other.limits[k].map((end) => end - parts[k] * (other.limits[k][1] - other.limits[k][0]));
    panels.forEach(draw);
  }

  function reset() {
    for (const one of panels) { one.limits = one.first.map((pair) => [...pair]); draw(one); }
  }

  function open(image) {
    const svg = new DOMParser().parseFromString(new TextDecoder().decode(Uint8Array.from(atob(image.src.split(",")[1]), (c) => c.charCodeAt(0))), "image/svg+xml").documentElement;
    svg.removeAttribute("width");
    svg.removeAttribute("height");
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", image.alt);
    stage.replaceChildren(svg);
    fingers.clear();
    dialog.showModal();
    panels = JSON.parse(image.dataset.panels).map((facts) => panel(svg, facts));
  }

  for (const image of document.querySelectorAll("figure img")) {
    image.addEventListener("click", () => open(image));
    image.addEventListener("keydown", (event) => { if (event.key === "Enter") open(image); });
  }
  dialog.querySelector("button").addEventListener("click", () => dialog.close());
  dialog.addEventListener("keydown", (event) => {
    const factor = { "+": 1.25, "=": 1.25, "-": 0.8 }[event.key], way = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] }[event.key];
    const one = panels[0];
    if (one && factor) zoom(one, { x: (one.box[0] + one.box[2]) / 2, y: (one.box[1] + one.box[3]) / 2 }, factor);
    if (one && way) shift(one, -way[0], -way[1]);
    if (event.key === "0") reset();
  });
  stage.addEventListener("wheel", (event) => { event.preventDefault(); const found = under(event); if (found) zoom(...found, Math.exp(-event.deltaY / 400)); }, { passive: false });
  stage.addEventListener("dblclick", reset);
  stage.addEventListener("pointerdown", (event) => { stage.setPointerCapture(event.pointerId); fingers.set(event.pointerId, event); span = 0; });
  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), found = before && under(before);
    if (!before) return;
    fingers.set(event.pointerId, event);
    const all = [...fingers.values()], k = stage.querySelector("svg").getScreenCTM().a;
    if (all.length === 1) { if (found) shift(found[0], (event.clientX - before.clientX) / k, (event.clientY - before.clientY) / k); return; }
    const wide = Math.hypot(all[0].clientX - all[1].clientX, all[0].clientY - all[1].clientY);
    const middle = under({ clientX: (all[0].clientX + all[1].clientX) / 2, clientY: (all[0].clientY + all[1].clientY) / 2 });
    if (span && middle) zoom(...middle, wide / span);
    span = wide;
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, (event) => { fingers.delete(event.pointerId); span = 0; });
})();
