/* Logarithmic creep by relaxations: y = (1 - gamma b) x + sum of z_i, tau_i z_i' = gamma w_i x - z_i. */
static double @f@_rate(double x)
{
    double total = 0;
    int k;
    for (k = @M@_GAMMA_SIZE - 1; k >= 0; k--)
        total = total * (x / @M@_SPAN) + @f@_gamma[k];
    return total;
}

static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k < @M@_TAU_SIZE; k++)
        s[k] = @f@_rate(u0) * @f@_weights[k] * u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double gamma = @f@_rate(u1);
    double y = (1 - gamma * @M@_BASE) * u1;
    int k;
    (void)u0;
    for (k = 0; k < @M@_TAU_SIZE; k++) {
        const double z = s[k] - expm1(-dt / @f@_tau[k]) * (gamma * @f@_weights[k] * u1 - s[k]);
        if (next)
            next[k] = z;
        y += z;
    }
    return y;
}
