/* Damper. State: plays of the displacement, plays of the velocity, the velocity, the last rate, and the stage of the start: nothing
   read, the first sample read, moving. */
static void @f@_init(double *s, double u0)
{
    int j;
    for (j = 0; j < @M@_STROKES_SIZE + @M@_LAGS_SIZE + 3; j++)
        s[j] = j < @M@_STROKES_SIZE ? (u0 - @M@_CENTER) / @M@_HALF - @M@_STRAIN * @f@_strokes[j] : 0;
}

static double @f@_follow(double play, double at, double r)
{
    return fmax(at - r, fmin(at + r, play));
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const int end = @M@_STROKES_SIZE + @M@_LAGS_SIZE;
    const double x = (u1 - @M@_CENTER) / @M@_HALF;
    const double part = fmax(0, fmin(1, 0.5 * (1 + x)));
    double w = s[end], rate = s[end + 1], size, y;
    int j;
    if (dt > 0) {
        const int first = s[end + 2] == 1;
        const double left = first ? 0 : exp(-dt / @M@_TAU);
        rate = (u1 - u0) / dt / @M@_SPEED;
        w = left * w + (1 - left) * (rate + @M@_LEAD * (first ? 0 : rate - s[end + 1]));
    }
    size = fabs(w);
    y = @M@_OFFSET + x * (@f@_spring[0] + x * (@f@_spring[1] + x * (@f@_spring[2] + x * x * @f@_spring[3])));
    y += w * (@M@_VISCOUS + @f@_bent[0] * size + @f@_bent[1] * w * w + @f@_bent[2] * w);
    y += x * (@f@_coupling[0] * size + @f@_coupling[1] * w + x * (@f@_coupling[2] * w + @f@_coupling[3] * size));
    for (j = 0; j < @M@_BENDS_SIZE; j++)
        y += ((1 - part) * @f@_saturating[j] + part * @f@_saturating[@M@_BENDS_SIZE + j]) * tanh(w / @f@_bends[j]);
    for (j = 0; j < @M@_STROKES_SIZE; j++) {
        const double play = @f@_follow(s[j], x, @f@_strokes[j]);
        y += @f@_friction[j] * (x - play);
        if (next)
            next[j] = play;
    }
    for (j = 0; j < @M@_LAGS_SIZE; j++) {
        const double play = @f@_follow(s[@M@_STROKES_SIZE + j], w, @f@_lags[j]);
        y += @f@_lagging[j] * (w - play);
        if (next)
            next[@M@_STROKES_SIZE + j] = play;
    }
    if (next) {
        next[end] = w;
        next[end + 1] = rate;
        next[end + 2] = (s[end + 2] == 0 && u1 == u0) || (s[end + 2] == 1 && dt <= 0) ? 1 : 2;
    }
    return y;
}
