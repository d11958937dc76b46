/* Delay by a fractional number of samples: a line of the last inputs, newest first, read between two of them. */
static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k <= @M@_LONGEST; k++)
        s[k] = u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double lag = fmin(@M@_LAG, @M@_LONGEST), part = lag - floor(lag);
    const int whole = (int)lag;
    const double newer = whole == 0 ? u1 : s[whole - 1];
    const double older = whole == @M@_LONGEST ? 0 : s[whole];
    int k;
    (void)u0;
    (void)dt;
    if (next) {
        for (k = @M@_LONGEST; k > 0; k--)
            next[k] = s[k - 1];
        next[0] = u1;
    }
    return (1 - part) * newer + part * older;
}
