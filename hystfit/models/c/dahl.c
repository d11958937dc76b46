/* Bristles of Dahl. State: the bending of each. */
static void @f@_init(double *s, double u0)
{
    int i;
    (void)u0;
    for (i = 0; i < @M@_D_SIZE; i++)
        s[i] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double way = (u1 > u0) - (u1 < u0);
    double y = @M@_OFFSET + @M@_K * u1;
    int i;
    (void)dt;
    for (i = 0; i < @M@_D_SIZE; i++) {
        const double q = way + (s[i] - way) * exp(-fabs(u1 - u0) / @f@_d[i]);
        y += @f@_Fc[i] * q;
        if (next)
            next[i] = q;
    }
    return y;
}
