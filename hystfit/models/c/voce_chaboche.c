/* Updated Voce-Chaboche: state: plastic strain, its path, backstresses. */
static double @f@_yield(double p)
{
    return @M@_SY0 - @M@_Q * expm1(-@M@_B * p) + @M@_D * expm1(-@M@_A * p);
}

static void @f@_move(const double *s, double u1, double *next)
{
    const double trial = @M@_E * (u1 - s[0]);
    double together = 0, sign, dp = 0;
    int i, k;
    for (k = 0; k < @M@_S_SIZE; k++)
        together += s[2 + k];
    sign = trial < together ? -1.0 : 1.0;
    if (sign * (trial - together) > @f@_yield(s[1])) {
        for (i = 0; i <= @M@_NEWTON; i++) {
            double excess = sign * trial - @M@_E * dp - @f@_yield(s[1] + dp);
            double slope = -@M@_E - @M@_Q * @M@_B * exp(-@M@_B * (s[1] + dp)) +
                           @M@_D * @M@_A * exp(-@M@_A * (s[1] + dp));
            for (k = 0; k < @M@_S_SIZE; k++) {
                const double left = (@f@_S[k] - sign * s[2 + k]) * exp(-@f@_g[k] * dp);
                excess -= @f@_S[k] - left;
                slope -= @f@_g[k] * left;
            }
            dp = dp - excess / fmin(slope, -@M@_SOFTEST * @M@_E);
            if (i < @M@_NEWTON)
                dp = fmax(dp, 0.0);
        }
    }
    next[0] = s[0] + sign * dp;
    next[1] = s[1] + dp;
    for (k = 0; k < @M@_S_SIZE; k++)
        next[2 + k] = sign * @f@_S[k] - (sign * @f@_S[k] - s[2 + k]) * exp(-@f@_g[k] * dp);
}

static void @f@_init(double *s, double u0)
{
    int k;
    for (k = 0; k < 2 + @M@_S_SIZE; k++)
        s[k] = 0;
    @f@_move(s, u0, s);
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double to[2 + @M@_S_SIZE];
    int k;
    (void)u0;
    (void)dt;
    @f@_move(s, u1, to);
    if (next)
        for (k = 0; k < 2 + @M@_S_SIZE; k++)
            next[k] = to[k];
    return @M@_OFFSET + @M@_E * (u1 - to[0]);
}
