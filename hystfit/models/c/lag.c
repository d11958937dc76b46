/* Two equal first-order lags, exact for steps of the input. */
static void @f@_init(double *s, double u0)
{
    s[0] = s[1] = @M@_FIRST ? u0 : @M@_LEVEL;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double passed = 2 * dt / @M@_TAU, decay = exp(-passed);
    const double first = s[0] - u1, y = u1 + decay * (s[1] - u1 + passed * first);
    (void)u0;
    if (next) {
        next[0] = u1 + decay * first;
        next[1] = y;
    }
    return y;
}
