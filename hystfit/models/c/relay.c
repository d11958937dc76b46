/* A relay: two levels, and a threshold for each way between them. */
static void @f@_init(double *s, double u0)
{
    s[0] = u0 > 0.5 * (@M@_UP + @M@_DOWN) ? 1.0 : 0.0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double state = u1 > @M@_UP ? 1.0 : u1 < @M@_DOWN ? 0.0 : s[0];
    (void)u0;
    (void)dt;
    if (next)
        next[0] = state;
    return state > 0.5 ? @M@_HIGH : @M@_LOW;
}
