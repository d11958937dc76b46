/* Relaxation: y = x - sum of a_i (x - z_i), tau_i z_i' = x - z_i. */
static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k < @M@_TAU_SIZE; k++)
        s[k] = u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double y = u1;
    int k;
    (void)u0;
    for (k = 0; k < @M@_TAU_SIZE; k++) {
        const double z = s[k] - expm1(-dt / @f@_tau[k]) * (u1 - s[k]);
        if (next)
            next[k] = z;
        y -= @f@_a[k] * (u1 - z);
    }
    return y;
}
