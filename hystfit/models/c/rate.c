/* Output of the input's rate v: c v, F tanh(v / v0), or g v / (v^2 + e^2)^(1/4); the last rate stays over repeated time stamps. */
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
#if @M@_SATURATES == 2
    return @M@_FORCE * rate / sqrt(hypot(rate, @M@_V0));
#elif @M@_SATURATES
    return @M@_FORCE * tanh(rate / @M@_V0);
#else
    return @M@_FORCE * rate;
#endif
}
