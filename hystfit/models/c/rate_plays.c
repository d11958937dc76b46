/* Plays with thresholds that grow with the rate. State: the plays, the averaged rate, the last rate. */
static void @f@_init(double *s, double u0)
{
    int j;
    for (j = 0; j < @M@_R_SIZE + 2; j++)
        s[j] = j < @M@_R_SIZE ? (u0 - @M@_LOW) / (@M@_HIGH - @M@_LOW) : 0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double x = (u1 - @M@_LOW) / (@M@_HIGH - @M@_LOW);
    double q = s[@M@_R_SIZE], rate = s[@M@_R_SIZE + 1], y = @M@_OFFSET + @M@_GAIN * x;
    int j;
    if (dt > 0) {
        const double left = exp(-dt / @M@_TAU);
        q = left * q + (1 - left) * rate;
        rate = fabs(u1 - u0) / (dt * @M@_SPEED);
    }
    for (j = 0; j < @M@_R_SIZE; j++) {
        const double width = @f@_r[j] + @M@_KAPPA * q;
        const double play = fmax(x - width, fmin(x + width, s[j]));
        y += @f@_w[j] * play;
        if (next)
            next[j] = play;
    }
    if (next) {
        next[@M@_R_SIZE] = q;
        next[@M@_R_SIZE + 1] = rate;
    }
    return y;
}
