"use strict";
// Two canvases, one over the other: axes and what is measured, drawn once, and what moves. Coordinates count from an offset, so that
// single precision suffices.

const MARGIN = { left: 62, right: 10, top: 10, bottom: 40 };

let colors = {}; // of the present scheme; reading one from the style sheet takes longer than a stroke

function color(name) {
  colors[name] ??= getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return colors[name];
}

function niceStep(span, count) {
  const rough = span / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
}

function tickText(value, step) {
  if (Math.abs(value) < step / 1e6) return "0";
  const size = Math.max(Math.abs(value), step);
  if (size >= 1e5 || size < 1e-3) return String(Number(value.toPrecision(6)).toExponential()).replace("e+", "e");
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
}

class Panel {
  constructor(canvas, xLabel, yLabel) {
    const below = document.createElement("canvas");
    canvas.before(below);
    Object.assign(this, { canvas, xLabel, yLabel, layers: [below, canvas].map((layer) => layer.getContext("2d")) });
  }

  get width() {
    return Math.max(this.canvas.clientWidth - MARGIN.left - MARGIN.right, 10);
  }

  get height() {
    return Math.max(this.canvas.clientHeight - MARGIN.top - MARGIN.bottom, 10);
  }

  get columns() {
    return Math.ceil(this.width * window.devicePixelRatio);
  }

  // Axes over x and y, each {low, high, offset}, if they have changed or `anew`, and then draw(); what follows is drawn over them.
  begin(x, y, anew, draw) {
    const { canvas } = this;
    const key = JSON.stringify([x, y, canvas.clientWidth, canvas.clientHeight, window.devicePixelRatio]);
    if (anew || key !== this.key) {
      Object.assign(this, { key, x, y, xScale: this.width / (x.high - x.low), yScale: this.height / (y.high - y.low) });
      this.#clear(0);
      this.#axes();
      draw?.();
    }
    this.#clear(1);
  }

  #clear(layer) {
    const ratio = window.devicePixelRatio, context = this.layers[layer], { clientWidth, clientHeight } = this.canvas;
    const wide = Math.round(clientWidth * ratio), high = Math.round(clientHeight * ratio);
    if (context.canvas.width !== wide || context.canvas.height !== high) Object.assign(context.canvas, { width: wide, height: high });
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, clientWidth, clientHeight);
    this.context = context;
  }

  toX(value) {
    return MARGIN.left + (value - this.x.low) * this.xScale;
  }

  toY(value) {
    return MARGIN.top + this.height - (value - this.y.low) * this.yScale;
  }

  fromX(pixel) {
    return this.x.low + (pixel - MARGIN.left) / this.xScale;
  }

  #axes() {
    const { context, width, height } = this;
    Object.assign(context, { strokeStyle: color("--line"), fillStyle: color("--faint"), lineWidth: 1, font: "12px system-ui, sans-serif" });
    context.strokeRect(MARGIN.left, MARGIN.top, width, height);
    context.textAlign = "center";
    for (const [value, text] of this.#ticks(this.x, width / 80)) {
      this.#segment(this.toX(value), MARGIN.top + height, 0, 5);
      context.fillText(text, this.toX(value), MARGIN.top + height + 17);
    }
    context.fillText(this.xLabel, MARGIN.left + width / 2, MARGIN.top + height + 34);
    context.textAlign = "right";
    for (const [value, text] of this.#ticks(this.y, height / 45)) {
      this.#segment(MARGIN.left, this.toY(value), -5, 0);
      context.fillText(text, MARGIN.left - 8, this.toY(value) + 4);
    }
    context.save();
    context.translate(13, MARGIN.top + height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(this.yLabel, 0, 0);
    context.restore();
  }

  #ticks({ low, high, offset }, count) {
    const step = niceStep(high - low, count), ticks = [];
    for (let k = Math.ceil((low + offset) / step); k * step <= high + offset + step * 1e-9; k++) {
      ticks.push([k * step - offset, tickText(k * step, step)]);
    }
    return ticks;
  }

  #segment(x, y, right, down) {
    this.context.beginPath();
    this.context.moveTo(x, y);
    this.context.lineTo(x + right, y + down);
    this.context.stroke();
  }

  #clipped(draw) {
    const { context } = this;
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, MARGIN.top, this.width, this.height);
    context.clip();
    context.beginPath();
    draw(context);
    context.restore();
  }

  // A line through points; it is interrupted where a value is missing.
  curve(x, y, name, width, dash = []) {
    this.#clipped((context) => {
      let joined = false;
      for (let k = 0; k < x.length; k++) {
        const across = this.toX(x[k]), up = this.toY(y[k]);
        const shown = Number.isFinite(up);
        if (shown) context[joined ? "lineTo" : "moveTo"](across, Math.min(Math.max(up, -1e4), 1e4));
        joined = shown;
      }
      context.setLineDash(dash);
      Object.assign(context, { strokeStyle: color(name), lineWidth: width, lineJoin: "bevel" });
      context.stroke();
    });
  }

  level(value) {
    this.#clipped((context) => {
      context.moveTo(MARGIN.left, this.toY(value));
      context.lineTo(MARGIN.left + this.width, this.toY(value));
      Object.assign(context, { strokeStyle: color("--line"), lineWidth: 1 });
      context.stroke();
    });
  }

  shade(from, to) {
    this.#clipped((context) => {
      context.rect(Math.min(from, to), MARGIN.top, Math.abs(to - from), this.height);
      context.fillStyle = color("--band");
      context.fill();
    });
  }
}
