/* Bouc-Wen-Baber-Noori. State: w and the energy e. */
static double @f@_slope(double w, double e, double *nu, double *largest)
{
    const double depth = -@M@_ZS * expm1(-@M@_P * e);
    const double width = (@M@_PSI + @M@_DPSI * e) * (@M@_LAM + depth);
    double place;
    *nu = 1 + @M@_DNU * e;
    *largest = pow(*nu, -1 / @M@_N);
    place = (w - @M@_Q * *largest) / width;
    return (1 - depth * exp(-place * place)) / (1 + @M@_DETA * e);
}

static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = s[1] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double sign = u1 < u0 ? -1.0 : 1.0, x = fabs(u1 - u0) / (@M@_ZY * @M@_SUBSTEPS);
    double w = sign * s[0], e = s[1];
    int k;
    (void)dt;
    for (k = 0; k < @M@_SUBSTEPS; k++) {
        double nu, largest, gain = @f@_slope(w, e, &nu, &largest);
        double middle, below, half, moved;
        const double loss = nu * (w >= 0 ? 1.0 : 1 - 2 * @M@_BETA) * pow(fabs(w), @M@_N);
        middle = fmin(w + 0.5 * x * gain * (1 - loss), fmax(w, largest));
        gain = @f@_slope(middle, fmax(e + 0.5 * x * w, 0.0), &nu, &largest);
        below = fmin(fmax(-w, 0.0), gain * x);
        middle = fmax(fabs(middle), 0.25 * gain * x);
        half = middle == 0 ? (@M@_N > 1 ? 0.0 : 1.0) : pow(middle, @M@_N - 1);
        half *= 0.5 * nu * (gain * x + 2 * (@M@_BETA - 1) * below);
        moved = ((1 - half) * w + gain * x) / (1 + half);
        moved = fmin(fmax(moved, fmin(w, largest)), fmax(w, largest));
        e = fmax(e + 0.5 * x * (w + moved), 0.0);
        w = moved;
    }
    if (next) {
        next[0] = sign * w;
        next[1] = e;
    }
    return @M@_OFFSET + @M@_KAPPA_X * u1 + @M@_KAPPA_W * sign * w;
}
