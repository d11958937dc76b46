// Where curves and fits come from: the server of this page, or the page itself where there is none.

class Server {
  live = true;

  async #ask(name, question) {
    let answer;
    try {
      answer = await fetch(name, {
        method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(question),
      });
    } catch {
      throw new Error("hystfit explore does not answer any more: start it again");
    }
    if (!answer.ok) throw new Error((await answer.json()).error);
    return answer;
  }

  async json(name, question) {
    return (await this.#ask(name, question)).json();
  }

  async curves(name, question) {
    const answer = await this.#ask(name, question);
    const facts = JSON.parse(answer.headers.get("X-Facts"));
    const numbers = new Float32Array(await answer.arrayBuffer());
    let at = 0;
    const next = (count) => numbers.subarray(at, (at += count));
    const points = { facts, x: next(facts.points), u: next(facts.points) };
    points.y = Array.from({ length: facts.curves }, () => next(facts.points));
    [points.residualX, points.residual] = [next(facts.columns), next(facts.columns)];
    return points;
  }
}

// The record is in the page, and simulateModel(values, u) is a script beside it.
class Local {
  live = false;

  constructor(record) {
    const decoded = (text) => new Float64Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
    this.record = record;
    [this.t, this.u, this.y] = [record.t, record.u64, record.y64].map(decoded);
  }

  async curves(name, { from, to, values, band = [] }) {
    const first = from === null ? 0 : Math.max(this.t.findIndex((t) => t >= from), 0);
    const last = to === null ? this.t.length : Math.max(this.t.findLastIndex((t) => t <= to) + 1, first + 2);
    const { u: uOrigin, y: yOrigin } = this.record.origin;
    const part = (signal, origin) => signal.slice(first, last).map((value) => value - origin);
    const points = { facts: { x: this.t[first] }, x: part(this.t, this.t[first]), u: part(this.u, uOrigin) };
    if (name === "measured") return { ...points, y: [part(this.y, yOrigin)] };
    const all = [values, ...band.map((side) => ({ ...values, ...side }))].map((set) => simulateModel(set, this.u));
    const residuals = this.y.map((value, k) => value - all[0][k]);
    points.facts.error = this.#error(residuals);
    points.y = all.map((curve) => part(curve, yOrigin));
    points.residualX = points.x;
    points.residual = part(residuals, 0);
    return points;
  }

  #error(residuals) {
    const span = this.record.y[3] - this.record.y[2];
    const rmse = Math.sqrt(residuals.reduce((sum, value) => sum + value * value, 0) / residuals.length);
    const worst = residuals.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    return { rmse, nrmse_percent: (100 * rmse) / span, max_error: worst, max_error_percent: (100 * worst) / span };
  }
}
