/* Two equal first-order lags, each exact for inputs linear between samples. */
static void @f@_init(double *s, double u0)
{
    s[0] = s[1] = @M@_FIRST ? u0 : @M@_LEVEL;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double passed = 2 * dt / @M@_TAU, decay = exp(-passed), mean = passed > 0 ? -expm1(-passed) / passed : 1;
    const double first = u1 + decay * (s[0] - u0) - mean * (u1 - u0);
    const double y = first + decay * (s[1] - s[0]) - mean * (first - s[0]);
    if (next) {
        next[0] = first;
        next[1] = y;
    }
    return y;
}
