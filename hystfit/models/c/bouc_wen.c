/* Bouc-Wen: dh/dv = mu c - (s tau sgn h + delta) |h|, y = offset + c v - h. */
static double @f@_phi(double kappa, double x)
{
    const double k = kappa * x;
    if (fabs(k) < 3e-4)
        return x * (1 - k / 2 * (1 - k / 3 * (1 - k / 4)));
    return -expm1(-k) / kappa;
}

static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = @M@_H0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double sign = u1 - u0 < 0 ? -1.0 : 1.0, x = fabs(u1 - u0);
    const double m = @M@_MU * @M@_C, up = @M@_TAU * (1 + @M@_RHO), down = @M@_TAU * (1 - @M@_RHO);
    double q = sign * s[0];
    (void)dt;
    if (@M@_EXACT) {
        if (q >= 0) {
            q += (m - up * q) * @f@_phi(up, x);
        } else {
            const double part = -q / m, k = down * part;
            const double crossing = k < 3e-4 ? part * (1 - k * (1.0 / 2 - k * (1.0 / 3 - k / 4))) : log1p(k) / down;
            if (x > crossing)
                q = m * @f@_phi(up, x - crossing);
            else
                q += (m - down * q) * @f@_phi(down, x);
        }
    } else {
        const double below = q < 0 ? fmin(-q / m, x) : 0.0, half = 0.5 * (up * x + (down - up) * below), highest = m / up;
        const double moved = ((1 - half) * q + m * x) / (1 + half);
        q = fmin(fmax(moved, fmin(q, highest)), fmax(q, highest));
    }
    if (next)
        next[0] = sign * q;
    return @M@_OFFSET + @M@_C * u1 - sign * q;
}
