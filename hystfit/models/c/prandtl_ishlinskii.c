/* Prandtl-Ishlinskii: weighted plays or stops of envelopes of the input, and a polynomial. */
static double @f@_envelope(int kind, double x)
{
    if (kind == 0)
        return x;
    if (kind == 1)
        return x * fabs(x);
    return 1 - (1 - x) * fabs(1 - x);
}

static double @f@_position(double u)
{
    return (u - @M@_LOW) / (@M@_HIGH - @M@_LOW);
}

#if @M@_RISE_SIZE
/* A polynomial that rises over 0 <= x <= 1, by the Bernstein coefficients; its tangents outside. */
static double @f@_rising(double x)
{
    const double inside = fmax(0, fmin(1, x));
    double level[@M@_RISE_SIZE + 1];
    int i, k;
    level[0] = 0;
    for (i = 0; i < @M@_RISE_SIZE; i++)
        level[i + 1] = level[i] + @f@_rise[i];
    for (k = @M@_RISE_SIZE; k > 0; k--)
        for (i = 0; i < k; i++)
            level[i] += inside * (level[i + 1] - level[i]);
    return level[0] +
           @M@_RISE_SIZE * (@f@_rise[@M@_RISE_SIZE - 1] * fmax(x - 1, 0) + @f@_rise[0] * fmin(x, 0));
}
#endif

static double @f@_move(double play, double target, double r)
{
    return fmax(target - r, fmin(target + r, play));
}

static void @f@_init(double *s, double u0)
{
    const double rest = @f@_position(@M@_FIRST ? u0 : @M@_LEVEL), x = @f@_position(u0);
    int e, j;
    for (e = 0; e < @M@_KINDS_SIZE; e++)
        for (j = 0; j < @M@_R_SIZE; j++)
            s[e * @M@_R_SIZE + j] =
                @f@_move(@f@_envelope(@f@_kinds[e], rest), @f@_envelope(@f@_kinds[e], x), @f@_r[j]);
#if @M@_HARDENING_SIZE
    s[@M@_KINDS_SIZE * @M@_R_SIZE] = fabs(x - rest);
#endif
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double x = @f@_position(u1);
    double y = @M@_OFFSET + legendre(@f@_b, @M@_B_SIZE, 2 * x - 1);
    int e, j;
#if @M@_HARDENING_SIZE
    const double path = s[@M@_KINDS_SIZE * @M@_R_SIZE] + fabs(x - @f@_position(u0));
    const double fading = exp(-path / @M@_S0);
#else
    (void)u0;
#endif
    (void)dt;
#if @M@_RISE_SIZE
    y += @f@_rising(x);
#endif
    for (e = 0; e < @M@_KINDS_SIZE; e++) {
        const double target = @f@_envelope(@f@_kinds[e], x);
        for (j = 0; j < @M@_R_SIZE; j++) {
            const double play = @f@_move(s[e * @M@_R_SIZE + j], target, @f@_r[j]);
            const double element = @M@_STOPS ? target - play : play;
            if (next)
                next[e * @M@_R_SIZE + j] = play;
            y += @f@_w[e * @M@_R_SIZE + j] * element;
#if @M@_HARDENING_SIZE
            if (e == 0)
                y += fading * @f@_hardening[j] * element;
#endif
        }
    }
#if @M@_HARDENING_SIZE
    if (next)
        next[@M@_KINDS_SIZE * @M@_R_SIZE] = path;
#endif
    return y;
}
