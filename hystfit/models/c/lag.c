/* One first-order lag, or two equal ones, exact for steps of the input. */
static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k < @M@_ORDER; k++)
        s[k] = @M@_FIRST ? u0 : @M@_LEVEL;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double passed = @M@_ORDER * dt / @M@_TAU, decay = exp(-passed), first = s[0] - u1;
    const double reached = u1 + decay * first;
#if @M@_ORDER == 2
    const double y = u1 + decay * (s[1] - u1 + passed * first);
#else
    const double y = reached;
#endif
    (void)u0;
    if (next) {
        next[0] = reached;
        next[@M@_ORDER - 1] = y;
    }
    return y;
}
