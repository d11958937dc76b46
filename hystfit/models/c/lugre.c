/* LuGre friction. State: deflection of the bristle, velocity. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = s[1] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double way = u1 - u0;
    const double v = dt > 0 ? way / dt : s[1];
    const double g = @M@_FC + @M@_DFS * exp(-(v / @M@_VS) * (v / @M@_VS));
    const double end = ((way > 0) - (way < 0)) * g / @M@_SIGMA0;
    const double z = end + (s[0] - end) * exp(-@M@_SIGMA0 * fabs(way) / g);
    const double bending = dt > 0 ? (z - s[0]) / dt : 0;
    if (next) {
        next[0] = z;
        next[1] = v;
    }
    return @M@_OFFSET + @M@_K * u1 + @M@_SIGMA0 * z + @M@_SIGMA1 * bending + @M@_SIGMA2 * v;
}
