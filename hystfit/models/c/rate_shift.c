/* Input less a dynamic field of the rate of the sample before. State: the last two rates. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = s[1] = 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double before = dt > 0 ? s[1] : s[0], rate = dt > 0 ? (u1 - u0) / dt : s[1];
    const double shift = @M@_C * log1p(fabs(before) / @M@_Q0);
    if (next) {
        next[0] = before;
        next[1] = rate;
    }
    return before < 0 ? u1 + shift : u1 - shift;
}
