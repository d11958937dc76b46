/* Self-similar stops. State: the plays, the largest input so far, the path. */
static void @f@_move(const double *s, double u0, double u1, double *next)
{
    const double peak = fmax(s[@M@_R_SIZE], fabs(u1)), v = u1 / peak;
    int j;
    next[@M@_R_SIZE + 1] = s[@M@_R_SIZE + 1] * pow(s[@M@_R_SIZE] / peak, 8) + fabs(u1 - u0) / peak;
    next[@M@_R_SIZE] = peak;
    for (j = 0; j < @M@_R_SIZE; j++)
        next[j] = fmax(v - @f@_r[j], fmin(v + @f@_r[j], s[j]));
}

static void @f@_init(double *s, double u0)
{
    int j;
    for (j = 0; j < @M@_R_SIZE + 2; j++)
        s[j] = j == @M@_R_SIZE ? @M@_FLOOR : 0;
    @f@_move(s, 0, u0, s);
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double to[@M@_R_SIZE + 2], y = @M@_OFFSET, hat, below = 1, v, at;
    int b, j;
    (void)dt;
    @f@_move(s, u0, u1, to);
    v = u1 / to[@M@_R_SIZE];
    at = log(to[@M@_R_SIZE]);
    for (b = 0; b < @M@_PEAKS_SIZE; b++) {
        double above = 0, power = v;
        const double *w = @f@_weights + b * (@M@_R_SIZE + 3);
        if (b < @M@_PEAKS_SIZE - 1) {
            const double left = log(@f@_peaks[b]);
            above = fmax(0, fmin(1, (at - left) / (log(@f@_peaks[b + 1]) - left)));
        }
        hat = below - above;
        below = above;
        for (j = 0; j < @M@_R_SIZE; j++)
            y += hat * w[j] * (v - to[j]);
        for (j = 0; j < 3; j++, power *= v * v)
            y += hat * w[@M@_R_SIZE + j] * power;
    }
#if @M@_FADING_SIZE
    {
        const double left = to[@M@_R_SIZE] / @f@_peaks[@M@_PEAKS_SIZE - 1] * exp(-to[@M@_R_SIZE + 1] / @M@_DECAY);
        double power = v;
        for (j = 0; j < @M@_R_SIZE; j++)
            y += left * @f@_fading[j] * (v - to[j]);
        for (j = 0; j < 3; j++, power *= v * v)
            y += left * @f@_fading[@M@_R_SIZE + j] * power;
    }
#endif
    if (next)
        for (j = 0; j < @M@_R_SIZE + 2; j++)
            next[j] = to[j];
    return y;
}
