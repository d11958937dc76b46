/* Duhem: dw/dv = s alpha (f(v) - w) + g(v), f and g Legendre series of (v - center) / half. */
#if @M@_EXACT
static double @f@_particular(double v, double kappa)
{
    double q[@M@_F_PADDED_SIZE], slope[@M@_F_PADDED_SIZE], total = 0;
    int i, j, round;
    for (i = 0; i < @M@_F_PADDED_SIZE; i++)
        q[i] = @f@_f_padded[i] + @f@_g_padded[i] / kappa;
    for (round = 0; round < @M@_F_PADDED_SIZE; round++) {
        total += legendre(q, @M@_F_PADDED_SIZE, (v - @M@_CENTER) / @M@_HALF);
        for (i = 0; i < @M@_F_PADDED_SIZE; i++) {
            slope[i] = 0;
            for (j = 0; j < @M@_F_PADDED_SIZE; j++)
                slope[i] += @f@_derivative[i * @M@_F_PADDED_SIZE + j] * q[j];
        }
        for (i = 0; i < @M@_F_PADDED_SIZE; i++)
            q[i] = -slope[i] / kappa;
    }
    return total;
}
#endif

static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = @M@_W0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double dv = u1 - u0, drive = @M@_ALPHA * fabs(dv);
    double w = s[0];
    (void)dt;
#if @M@_EXACT
    if (drive > @M@_LONG) {
        const double kappa = (dv < 0 ? -1.0 : 1.0) * @M@_ALPHA;
        w = @f@_particular(u1, kappa) + exp(-drive) * (w - @f@_particular(u0, kappa));
    } else {
        double sum = 0;
        int k;
        for (k = 0; k < @M@_NODES_SIZE; k++) {
            const double x = (u0 + 0.5 * (1 + @f@_nodes[k]) * dv - @M@_CENTER) / @M@_HALF;
            const double push = drive * legendre(@f@_f, @M@_F_SIZE, x) + dv * legendre(@f@_g, @M@_G_SIZE, x);
            sum += @f@_weights[k] * exp(-0.5 * (1 - @f@_nodes[k]) * drive) * push;
        }
        w = exp(-drive) * w + 0.5 * sum;
    }
#else
    {
        const double x = (0.5 * (u0 + u1) - @M@_CENTER) / @M@_HALF;
        const double f = legendre(@f@_f, @M@_F_SIZE, x), g = legendre(@f@_g, @M@_G_SIZE, x);
        if (@M@_EXPLICIT)
            w += drive * (f - w) + dv * g;
        else
            w = ((1 - 0.5 * drive) * w + drive * f + dv * g) / (1 + 0.5 * drive);
    }
#endif
    if (next)
        next[0] = w;
    return w;
}
