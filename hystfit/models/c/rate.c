/* Force of the input's rate: c du/dt, or F tanh((du/dt) / v0); the last rate stays over repeated time stamps. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double rate = dt > 0 ? (u1 - u0) / dt : s[0];
    if (next)
        next[0] = rate;
#if @M@_SATURATES
    return @M@_FORCE * tanh(rate / @M@_V0);
#else
    return @M@_FORCE * rate;
#endif
}
