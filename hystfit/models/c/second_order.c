/* A resonance with static gain one, exact for inputs linear between samples. State: output and its rate. */
static void @f@_init(double *s, double u0)
{
    s[0] = u0;
    s[1] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double damped = @M@_OMEGA * sqrt(fmax(1 - @M@_ZETA * @M@_ZETA, 1e-12));
    const double decay = exp(-@M@_ZETA * @M@_OMEGA * dt), slope = dt > 0 ? (u1 - u0) / dt : 0.0;
    const double lag = 2 * @M@_ZETA * slope / @M@_OMEGA, e = s[0] - u0 + lag, v = s[1] - slope;
    const double cosine = cos(damped * dt), sine = sin(damped * dt) / damped;
    double y = s[0], rate = s[1];
    if (dt > 0) {
        y = decay * (e * cosine + (v + @M@_ZETA * @M@_OMEGA * e) * sine) + u1 - lag;
        rate = decay * (v * cosine - (@M@_OMEGA * @M@_OMEGA * e + @M@_ZETA * @M@_OMEGA * v) * sine) + slope;
    }
    if (next) {
        next[0] = y;
        next[1] = rate;
    }
    return y;
}
