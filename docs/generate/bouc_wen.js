"use strict";
// Output of hystfit.BoucWen over an input by its semi-implicit step, for the page without a server.
function simulateModel({ c, mu, tau, rho, h0, offset }, u) {
  const m = mu * c, up = tau * (1 + rho), down = tau * (1 - rho);
  const highest = up > 0 ? m / up : Infinity;
  let h = Number.isFinite(highest) ? h0 * highest : 0;
  return u.map((value, k) => {
    const dv = k ? value - u[k - 1] : 0;
    const sign = dv < 0 ? -1 : 1, x = Math.abs(dv), q = sign * h;
    const below = m > 0 ? Math.min(Math.max(-q, 0), m * x) / m : 0;
    const half = 0.5 * (up * x + (down - up) * below);
    const moved = ((1 - half) * q + m * x) / (1 + half);
    h = sign * Math.min(Math.max(moved, Math.min(q, highest)), Math.max(q, highest));
    return offset + c * value - h;
  });
}
