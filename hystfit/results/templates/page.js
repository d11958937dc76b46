(function () {
  const dialog = document.querySelector("dialog"), image = dialog.querySelector("img"), fingers = new Map();
  let scale, x, y, span;
  function show() { image.style.transform = "translate(" + x + "px," + y + "px) scale(" + scale + ")"; }
  function reset() { scale = 1; x = y = 0; show(); }
  function zoom(factor, px, py) {
    const next = Math.min(40, Math.max(1, scale * factor));
    x = px - (px - x) * next / scale; y = py - (py - y) * next / scale; scale = next;
    if (scale === 1) x = y = 0;
    show();
  }
  function open(source) { image.src = source.src; image.alt = source.alt; reset(); dialog.showModal(); }
  for (const picture of document.querySelectorAll("figure img")) {
    picture.addEventListener("click", function () { open(picture); });
    picture.addEventListener("keydown", function (event) { if (event.key === "Enter") open(picture); });
  }
  dialog.querySelector("button").addEventListener("click", function () { dialog.close(); });
  dialog.addEventListener("keydown", function (event) {
    const factor = { "+": 1.25, "=": 1.25, "-": 0.8 }[event.key];
    if (factor) zoom(factor, innerWidth / 2, innerHeight / 2);
    if (event.key === "0") reset();
  });
  image.addEventListener("wheel", function (event) { event.preventDefault(); zoom(Math.exp(-event.deltaY / 400), event.clientX, event.clientY); }, { passive: false });
  image.addEventListener("dblclick", reset);
  image.addEventListener("dragstart", function (event) { event.preventDefault(); });
  image.addEventListener("pointerdown", function (event) { image.setPointerCapture(event.pointerId); fingers.set(event.pointerId, event); span = 0; });
  image.addEventListener("pointermove", function (event) {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, event);
    const all = [...fingers.values()];
    if (all.length === 1) { x += event.clientX - before.clientX; y += event.clientY - before.clientY; show(); return; }
    const wide = Math.hypot(all[0].clientX - all[1].clientX, all[0].clientY - all[1].clientY);
    if (span) zoom(wide / span, (all[0].clientX + all[1].clientX) / 2, (all[0].clientY + all[1].clientY) / 2);
    span = wide;
  });
  for (const end of ["pointerup", "pointercancel"]) image.addEventListener(end, function (event) { fingers.delete(event.pointerId); span = 0; });
})();
