/* Generalized Bouc-Wen: dh/dv = mu c - (s tau sgn h + delta + a sgn h) |h| (|h| / H)^(n - 1), and a bent backbone. */
static double @f@_kappa(double side, double s)
{
    return @M@_TAU * (1 + (side >= 0 ? @M@_RHO : -@M@_RHO)) + s * @M@_SKEW * @M@_TAU * (1 + @M@_RHO);
}

static double @f@_power(double q)
{
    const double total = @M@_TAU * (1 + @M@_RHO), m = @M@_MU * @M@_C;
    const double base = fabs(q) * total / (m > 0 ? m : 1.0), exponent = @M@_N - 1;
    if (base > 0)
        return exp(exponent * log(base));
    return exponent > 0 ? 0.0 : 1.0;
}

static double @f@_slope(double q, double s)
{
    return @M@_MU * @M@_C - @f@_kappa(q, s) * @f@_power(q) * q;
}

static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = @M@_H0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double sign = u1 - u0 < 0 ? -1.0 : 1.0, x = fabs(u1 - u0);
    const double m = @M@_MU * @M@_C, total = @M@_TAU * (1 + @M@_RHO);
    const double highest = total > 0 ? m * pow(1 + sign * @M@_SKEW, -1 / @M@_N) / total : INFINITY;
    double q = sign * s[0];
    (void)dt;
#if @M@_EXACT
    {
        const double hold = fmax(q, highest), d = x / 8;
        int k;
        for (k = 0; k < 8; k++) {
            const double k1 = @f@_slope(q, sign), q1 = fmin(q + 0.5 * d * k1, hold);
            const double k2 = @f@_slope(q1, sign), q2 = fmin(q + 0.5 * d * k2, hold);
            const double k3 = @f@_slope(q2, sign), q3 = fmin(q + d * k3, hold);
            const double k4 = @f@_slope(q3, sign);
            q = fmin(q + d * (k1 + 2 * k2 + 2 * k3 + k4) / 6, hold);
        }
    }
#else
    {
        const double middle = fmin(q + 0.5 * x * @f@_slope(q, sign), fmax(q, highest));
        const double up = @f@_kappa(1, sign), down = @f@_kappa(-1, sign), below = q >= 0 ? 0.0 : m > 0 ? fmin(-q / m, x) : x;
        const double half = 0.5 * @f@_power(fmax(fabs(middle), 0.25 * m * x)) * (up * x + (down - up) * below);
        const double moved = ((1 - half) * q + m * x) / (1 + half);
        q = fmin(fmax(moved, fmin(q, highest)), fmax(q, highest));
    }
#endif
    if (next)
        next[0] = sign * q;
    return @M@_OFFSET + @M@_C * u1 + legendre(@f@_b, @M@_B_SIZE, (u1 - @M@_CENTER) / @M@_HALF) - sign * q;
}
