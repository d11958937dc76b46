/* Linear creep: y = sum of a_i z_i, tau_i z_i' = x - z_i, x = (u - low) / (high - low). */
static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k < @M@_TAU_SIZE; k++)
        s[k] = ((@M@_FIRST ? u0 : @M@_LEVEL) - @M@_LOW) / (@M@_HIGH - @M@_LOW);
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double x = (u1 - @M@_LOW) / (@M@_HIGH - @M@_LOW);
    double y = 0;
    int k;
    (void)u0;
    for (k = 0; k < @M@_TAU_SIZE; k++) {
        const double z = s[k] - expm1(-dt / @f@_tau[k]) * (x - s[k]);
        if (next)
            next[k] = z;
        y += @f@_a[k] * z;
    }
    return y;
}
