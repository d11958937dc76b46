/* Maxwell elements. State: the extension of each spring. */
static void @f@_init(double *s, double u0)
{
    int i;
    (void)u0;
    for (i = 0; i < @M@_TAU_SIZE; i++)
        s[i] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double y = 0;
    int i;
    for (i = 0; i < @M@_TAU_SIZE; i++) {
        const double passed = dt / @f@_tau[i];
        const double share = passed > 0 ? -expm1(-passed) / passed : 1.0;
        const double q = exp(-passed) * s[i] + share * (u1 - u0);
        y += @f@_g[i] * q;
        if (next)
            next[i] = q;
    }
    return y;
}
