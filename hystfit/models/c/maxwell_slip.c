/* Generalized Maxwell slip. State: deflection of each element, velocity. */
static void @f@_init(double *s, double u0)
{
    int i;
    (void)u0;
    for (i = 0; i <= @M@_R_SIZE; i++)
        s[i] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double v = dt > 0 ? (u1 - u0) / dt : s[@M@_R_SIZE];
    const double scale = 1 + @M@_EXCESS * exp(-(v / @M@_VS) * (v / @M@_VS));
    double y = @M@_OFFSET + @M@_K * ((u1 - @M@_CENTER) / @M@_HALF) + @M@_VISCOUS * v / @M@_SPEED;
    int i;
    for (i = 0; i < @M@_R_SIZE; i++) {
        const double limit = @f@_r[i] * scale;
        const double e = fmin(fmax(s[i] + (u1 - u0) / @M@_HALF, -limit), limit);
        y += @f@_w[i] * e;
        if (next)
            next[i] = e;
    }
    if (next)
        next[@M@_R_SIZE] = v;
    return y;
}
