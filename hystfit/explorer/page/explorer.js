// Sliders, plots and buttons of the page.

const scene = JSON.parse(document.getElementById("scene").textContent);
const source = scene.live ? new Server() : new Local(scene.record);
const element = (id) => document.getElementById(id);
const POSITIONS = 1000; // of a slider
const STEP = 30; // positions to either side that show what a parameter does

const state = { view: null, values: {}, fitted: new Set(), active: null, band: true, from: null, to: null, made: null, history: [] };
const shown = { measured: null, model: null, anew: true, frames: 0 };
window.hystfitExplorer = { state, shown, scene };

// -- plots ----------------------------------------------------------------------------------------------------------------------

const withUnit = ([name, unit]) => (unit && !name.endsWith(`_${unit}`) ? `${name} [${unit}]` : name.replace(`_${unit}`, ` [${unit}]`));
const labels = Object.fromEntries(["u", "y", "x"].map((key) => [key, withUnit(scene.record[key])]));
const panels = {
  loop: new Panel(element("loop"), labels.u, labels.y),
  series: new Panel(element("series"), labels.x, labels.y),
  residuals: new Panel(element("residuals"), labels.x, `residual${scene.record.y[1] ? ` [${scene.record.y[1]}]` : ""}`),
};
let drag = null;

function range(key, part) {
  const [, , low, high] = scene.record[key];
  const offset = scene.record.origin[key], margin = part * (high - low || 1);
  return { low: low - offset - margin, high: high - offset + margin, offset };
}

function draw() {
  const { measured, model, anew } = shown;
  if (!measured) return;
  shown.anew = false;
  const time = { low: 0, high: measured.x[measured.x.length - 1] || 1, offset: measured.facts.x };
  for (const [panel, key, across] of [[panels.loop, "u", range("u", 0.04)], [panels.series, "x", time]]) {
    panel.begin(across, range("y", 0.12), anew, () => panel.curve(measured[key], measured.y[0], "--measured", 3.5));
    if (!model) continue;
    const [middle, lower, higher] = model.y;
    if (lower) {
      panel.curve(model[key], lower, "--lower", 1, [4, 4]);
      panel.curve(model[key], higher, "--higher", 1);
    }
    panel.curve(model[key], middle, "--model", 1.5);
  }
  drawResiduals(time, model, anew);
  if (drag) for (const name of ["series", "residuals"]) panels[name].shade(drag.from, drag.to);
}

function drawResiduals(time, model, anew) {
  const panel = panels.residuals;
  let most = 0;
  if (model) for (const value of model.residual) if (Number.isFinite(value)) most = Math.max(most, Math.abs(value));
  const limit = niceStep(most * 1.05 || 1, 1);
  panel.begin(time, { low: -limit, high: limit, offset: 0 }, anew, () => panel.level(0));
  if (model) panel.curve(model.residualX, model.residual, "--model", 1);
}

let scheduled = false;
function redraw() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(() => {
    scheduled = false;
    draw();
  });
}

// -- curves: one question at a time, and the newest values win --------------------------------------------------------------------

function question() {
  const asked = { view: state.view.view, values: state.values, from: state.from, to: state.to, columns: panels.series.columns, band: [] };
  const slider = state.band && state.view.sliders.find(({ name }) => name === state.active);
  if (slider) asked.band = sides(slider).map((value) => ({ [slider.name]: value }));
  return asked;
}

let wanted = false, busy = false;
async function update() {
  wanted = true;
  if (busy) return;
  busy = true;
  try {
    while (wanted) {
      wanted = false;
      shown.model = await source.curves("predict", question());
      shown.frames += 1;
      tellError(shown.model.facts.error);
      redraw();
    }
  } catch (error) {
    say(error.message, true);
  } finally {
    busy = false;
  }
}

async function updateMeasured() {
  shown.measured = await source.curves("measured", { from: state.from, to: state.to, columns: panels.series.columns });
  shown.anew = true;
  redraw();
  update();
}

function tellError({ rmse, nrmse_percent: part, max_error: worst }) {
  const number = (value) => (value === null ? "not finite" : Number(value.toPrecision(3)));
  const unit = scene.record.y[1];
  const share = part === null ? "" : `${number(part)} % of the range, `;
  const text = `error ${share}${number(rmse)} ${unit} rms, ${number(worst)} ${unit} at most`;
  tell(element("error"), text);
  element("loop").setAttribute("aria-label", `output over input, measured and of ${state.view.model}: ${text}`);
}

// Set a text only where it changes: a frame must not lay out the page again.
function tell(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

function say(text, bad = false) {
  tell(element("message"), text);
  element("message").classList.toggle("bad", bad);
}

// -- sliders ----------------------------------------------------------------------------------------------------------------------

const short = (value) => Number(value.toPrecision(6));
const clamp = (value, low, high) => Math.min(Math.max(value, low ?? -Infinity), high ?? Infinity);

function toPosition({ low, high, logarithmic }, value) {
  const part = logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return clamp(Math.round(POSITIONS * part), 0, POSITIONS) || 0;
}

function toValue({ low, high, lower, upper, logarithmic }, position) {
  const part = clamp(position / POSITIONS, 0, 1);
  const value = logarithmic ? low * (high / low) ** part : low + (high - low) * part;
  const least = (high - low) / (10 * POSITIONS);
  return clamp(Number((logarithmic || Math.abs(value) > least ? value : 0).toPrecision(5)), lower, upper);
}

function sides(slider) {
  const at = toPosition(slider, state.values[slider.name]);
  return [toValue(slider, at - STEP), toValue(slider, at + STEP)];
}

function row(slider) {
  const { name, unit, doc } = slider;
  const made = document.createElement("div");
  made.className = "row";
  made.innerHTML = `<label><b></b> <span class="unit"></span></label><label class="small"><input type="checkbox"> fit</label>
    <input type="number" step="any"><input type="range" min="0" max="${POSITIONS}" step="1"><p class="small"></p>`;
  const [check, number, bar] = made.querySelectorAll("input");
  made.querySelector("b").textContent = name;
  made.querySelector(".unit").textContent = unit;
  bar.setAttribute("aria-label", `${name} ${unit}: ${doc}`);
  number.setAttribute("aria-label", `${name} ${unit}`);
  check.checked = state.fitted.has(name);
  check.title = "whether a fit may change it";
  check.disabled = !source.live;
  for (const [key, bound] of [["min", slider.lower], ["max", slider.upper]]) if (bound !== null) number[key] = bound;
  check.addEventListener("change", () => (state.fitted[check.checked ? "add" : "delete"](name), changed()));
  bar.addEventListener("input", () => set(slider, toValue(slider, Number(bar.value))));
  number.addEventListener("input", () => number.value !== "" && number.checkValidity() && set(slider, Number(number.value), number));
  number.addEventListener("change", () => number.checkValidity() || number.reportValidity());
  made.addEventListener("focusin", () => activate(name));
  made.addEventListener("pointerenter", () => activate(name));
  made.addEventListener("pointerleave", () => activate(focused()));
  made.addEventListener("focusout", () => activate(null));
  Object.assign(slider, { row: made, bar, number });
  return made;
}

const focused = () => state.view.sliders.find(({ row }) => row.contains(document.activeElement))?.name ?? null;

function activate(name) {
  if (state.active === name) return;
  state.active = name;
  tellSliders();
  update();
}

function tellSliders() {
  const errors = state.view.stderr ?? {};
  let ends = ["", ""];
  for (const slider of state.view.sliders) {
    const { name, row, doc, unit } = slider, active = name === state.active;
    row.classList.toggle("active", active);
    if (active && state.band) ends = sides(slider).map((value) => `${name} = ${value} ${unit}`);
    tell(row.querySelector("p"), doc + (state.made && errors[name] ? ` (±\u00a0${Number(errors[name].toPrecision(2))})` : ""));
  }
  for (const [k, kind] of ["lower", "higher"].entries()) tell(document.querySelector(`#legend .${kind}`), ends[k]);
}

function set(slider, value, typed = null) {
  if (!(value >= slider.low)) slider.low = slider.logarithmic ? Math.max(value, Number.MIN_VALUE) : value;
  if (!(value <= slider.high)) slider.high = value;
  if (slider.logarithmic && value <= 0) Object.assign(slider, { logarithmic: false, low: 0 });
  state.values[slider.name] = value;
  slider.bar.value = toPosition(slider, value);
  slider.bar.setAttribute("aria-valuetext", String(value));
  if (typed === null) slider.number.value = short(value);
  changed();
}

function changed() {
  state.made = null;
  say("");
  element("verdict").hidden = true;
  tellSliders();
  tellCommandsSoon();
  update();
}

function showView(view, values, fitted, made = null) {
  const begin = ({ value, lower, upper }) => (view.stderr ? value : clamp(short(value), lower, upper));
  const start = Object.fromEntries(view.sliders.map((slider) => [slider.name, begin(slider)]));
  Object.assign(state, { view, values: { ...start, ...view.start, ...values }, made, active: null });
  state.fitted = new Set(fitted ?? view.sliders.filter((slider) => slider.fitted).map(({ name }) => name));
  const rows = (weight) => view.sliders.filter((slider) => slider.weight === weight).map(row);
  element("sliders").replaceChildren(...rows(false));
  const weights = rows(true);
  element("weights").hidden = !weights.length;
  element("weights").querySelector("summary").textContent = `${weights.length} weights`;
  element("weights").querySelector("div").replaceChildren(...weights);
  element("hidden").textContent = view.hidden ? `${view.hidden} weights without sliders: a fit solves for them` : "";
  for (const slider of view.sliders) {
    const value = state.values[slider.name];
    Object.assign(slider, { low: Math.min(slider.low, value), high: Math.max(slider.high, value) });
    slider.bar.value = toPosition(slider, value);
    slider.number.value = short(value);
  }
  element("model").value = view.model;
  element("undo").disabled = !state.history.length;
  element("verdict").hidden = true;
  tellSliders();
  tellCommands();
  return update();
}

// -- models and fits ----------------------------------------------------------------------------------------------------------------

function remember() {
  state.history.push({ view: state.view, values: { ...state.values }, fitted: [...state.fitted], made: state.made });
}

function undo() {
  const before = state.history.pop();
  if (!before) return;
  showView(before.view, before.values, before.fitted, before.made);
  if (before.made) tellVerdict(before.view.verdict);
}

function reset() {
  remember();
  const first = state.view.first ?? state.view;
  showView(first, {}, null);
}

async function choose(model) {
  say(`starting values of ${model} ...`);
  try {
    const view = await source.json("model", { model });
    remember();
    await showView(view, {}, null);
    say("");
  } catch (error) {
    element("model").value = state.view.model;
    say(error.message, true);
  }
}

async function fit() {
  if (!source.live) return say("This demonstration has no fits. On your machine, hystfit explore loop.csv opens this page for your loop, with fits.");
  if (element("fit").disabled) return;
  element("fit").disabled = true;
  const before = state.view.first ?? state.view;
  try {
    let answer = await source.json("fit", { view: state.view.view, values: state.values, fitted: [...state.fitted] });
    while (answer.state === "running") {
      say(`fitting ... ${answer.seconds.toFixed(1)} s`);
      await new Promise((resolve) => setTimeout(resolve, 200));
      answer = await source.json("fit-state", {});
    }
    if (answer.state === "failed") throw new Error(answer.error);
    remember();
    const { from, result, view } = answer;
    const fitted = view.sliders.map(({ name, fitted }) => [name, (fitted || from.free.includes(name)) && !from.fix.includes(name)]);
    Object.assign(view, { first: before, stderr: result.stderr, verdict: result });
    await showView(view, {}, fitted.filter(([, may]) => may).map(([name]) => name), { model: view.model, ...from });
    say(`fit: ${result.status}`, !result.usable);
    tellVerdict(result);
  } catch (error) {
    say(error.message, true);
  } finally {
    element("fit").disabled = false;
  }
}

function tellVerdict({ model, status, usable, advice, notes }) {
  const box = element("verdict");
  box.hidden = false;
  box.classList.toggle("bad", !usable);
  box.querySelector("h2").textContent = `${model}: ${status}`;
  box.querySelector("p").textContent = usable ? "" : advice;
  box.querySelector("ul").replaceChildren(...notes.map(({ text }) => Object.assign(document.createElement("li"), { textContent: text })));
}

// -- commands ---------------------------------------------------------------------------------------------------------------------------

const quoted = (text) => (/^[\w./:=+,@%-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
const python = (value) => JSON.stringify(value).replaceAll(/(?<=[\]}"\d]),(?=["[{])|(?<="):/g, "$& ");

function commands() {
  const free = (fitted) => state.view.sliders.filter((slider) => slider.fitted !== fitted && state.fitted.has(slider.name) === fitted);
  const names = (fitted) => free(fitted).map(({ name }) => name);
  const { model, start, fix, free: freed } = state.made ?? { model: state.view.model, start: state.values, fix: names(false), free: names(true) };
  const options = [
    ...Object.entries(start).map(([name, value]) => `--at ${quoted(`${name}=${value}`)}`),
    ...fix.map((name) => `--fix ${quoted(name)}`),
    ...freed.map((name) => `--free ${quoted(name)}`),
  ];
  const { shell, python: record } = scene.source;
  const lines = [
    "import hystfit as hf", "", "hf.enable_x64()", record || "# record: as it was passed to hf.explore", "result = hf.fit(",
    `    ${python(model)},`, "    record,", `    start={${Object.entries(start).map(([name, value]) => `${python(name)}: ${value}`).join(", ")}},`,
    "    starts=1,", ...(fix.length ? [`    fix=${python(fix)},`] : []), ...(freed.length ? [`    free=${python(freed)},`] : []), ")",
  ];
  return {
    shell: shell && `hystfit fit ${shell} --model ${quoted(model)} ${options.join(" ")} --starts 1 --out fit`,
    python: lines.join("\n"),
  };
}

let telling = 0;
function tellCommandsSoon() {
  clearTimeout(telling);
  telling = setTimeout(tellCommands, 150);
}

function tellCommands() {
  const texts = commands();
  for (const [kind, text] of Object.entries(texts)) {
    element(kind).hidden = !text;
    tell(element(kind).querySelector("pre"), text);
  }
  tell(element("what"), state.made ? "These commands repeat the fit shown above." : "These commands start a fit at the values shown above.");
}

async function copy(kind) {
  const text = element(kind).querySelector("pre");
  if (!text.textContent) return;
  try {
    await navigator.clipboard.writeText(text.textContent);
    say("copied");
  } catch {
    getSelection().selectAllChildren(text);
    say("selected: copy it with Ctrl-C");
  }
}

// -- zoom -----------------------------------------------------------------------------------------------------------------------------

function zoom(from, to) {
  const [, , low, high] = scene.record.x;
  const whole = from === null || (from <= low && to >= high);
  const width = Math.min(to - from, high - low), start = clamp(from, low, high - width);
  Object.assign(state, whole ? { from: null, to: null } : { from: start, to: start + width });
  updateMeasured();
}

function zoomBy(factor, shift = 0) {
  const [, , low, high] = scene.record.x;
  const from = state.from ?? low, to = state.to ?? high, half = (to - from) / 2;
  const middle = (from + to) / 2 + shift * half;
  zoom(middle - half * factor, middle + half * factor);
}

for (const name of ["series", "residuals"]) {
  const panel = panels[name], canvas = panel.canvas;
  canvas.addEventListener("pointerdown", (event) => {
    drag = { from: event.offsetX, to: event.offsetX };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => drag && ((drag.to = event.offsetX), redraw()));
  canvas.addEventListener("pointercancel", () => ((drag = null), redraw()));
  canvas.addEventListener("pointerup", () => {
    const [from, to] = [drag.from, drag.to].sort((a, b) => a - b);
    drag = null;
    if (to - from > 4) zoom(panel.fromX(from) + panel.x.offset, panel.fromX(to) + panel.x.offset);
    else redraw();
  });
  canvas.addEventListener("dblclick", () => zoom(null));
}

// -- keys and start -----------------------------------------------------------------------------------------------------------------------

function moveFocus(way) {
  const bars = state.view.sliders.map(({ bar }) => bar).filter((bar) => bar.checkVisibility());
  const at = bars.indexOf(document.activeElement);
  bars[(at + way + bars.length + (at < 0 && way < 0)) % bars.length].focus();
}

const KEYS = {
  f: fit, z: undo, r: reset, m: () => element("model").focus(), s: () => copy("shell"), p: () => copy("python"),
  j: () => moveFocus(1), k: () => moveFocus(-1), b: () => ((state.band = !state.band), tellSliders(), update()),
  "+": () => zoomBy(0.5), "-": () => zoomBy(2), ",": () => zoomBy(1, -0.5), ".": () => zoomBy(1, 0.5), Escape: () => zoom(null),
  "?": () => element("keys").showModal(),
};

document.addEventListener("keydown", (event) => {
  const writing = event.target.matches("select, input[type=number]") && event.key !== "Escape";
  if (writing || event.ctrlKey || event.metaKey || event.altKey || element("keys").open || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});

const dark = matchMedia("(prefers-color-scheme: dark)");
function colorScheme() {
  document.documentElement.dataset.theme = dark.matches ? "dark" : "light";
  colors = {};
  shown.anew = true;
  redraw();
}
dark.addEventListener("change", colorScheme);
colorScheme();

for (const [id, action] of [["fit", fit], ["undo", undo], ["reset", reset], ["help", KEYS["?"]]]) element(id).addEventListener("click", action);
for (const button of document.querySelectorAll("[data-copy]")) button.addEventListener("click", () => copy(button.dataset.copy));
element("model").replaceChildren(...scene.choices.map((name) => new Option(name)));
element("model").addEventListener("change", (event) => choose(event.target.value));
showView(scene.view, {}, null);
if (!source.live) say("Demonstration: a simulated piezo actuator (gray) and a Bouc-Wen model. Drag a slider to change the model.");
new ResizeObserver(updateMeasured).observe(element("series"));
