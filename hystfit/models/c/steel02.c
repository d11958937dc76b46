/* Steel02: Menegotto-Pinto with the isotropic shift of Filippou. State: sig, emax, emin, epl, e0, s0, er, sr, direction, farthest strain, its stress. */
static void @f@_move(const double *s, double u0, double u1, double *next)
{
    const double ey = @M@_FY / @M@_E, harder = 1 - @M@_B;
    double t[11];
    int back, k;
    for (k = 0; k < 11; k++)
        t[k] = s[k];
    back = fabs(u1 - t[9]) > @M@_DEADBAND && (t[8] == 0 || t[8] * (u1 - t[9]) < 0);
    if (back) {
        const int first = t[8] == 0;
        t[8] = u1 > t[9] ? 1 : -1;
        if (first) {
            t[4] = t[8] * ey;
            t[5] = t[8] * @M@_FY;
        } else {
            double yield;
            if (t[8] < 0)
                t[1] = fmax(t[1], t[9]);
            else
                t[2] = fmin(t[2], t[9]);
            yield = t[8] * (1 + (t[8] > 0 ? @M@_A3 : @M@_A1) * pow((t[1] - t[2]) / (2 * ey), 0.8)) * @M@_FY * harder;
            t[6] = t[9];
            t[7] = t[10];
            t[4] = (yield - t[7] + @M@_E * t[6]) / (@M@_E * harder);
            t[5] = yield + @M@_B * @M@_E * t[4];
        }
        t[3] = t[8] > 0 ? t[1] : t[2];
    }
    if (u1 != u0) {
        if (t[8] == 0)
            t[0] = @M@_SIGINIT + @M@_E * (u1 - t[9]);
        else {
            const double x = (u1 - t[6]) / (t[4] - t[6]), xi = fabs(t[3] - t[4]) / ey;
            const double R = @M@_R0 * (1 - @M@_CR1 * xi / (@M@_CR2 + xi));
            double bend = 1;
            if (x != 0) {
                const double z = R * log(fabs(x));
                bend = exp(-(fmax(z, 0) + log1p(exp(-fabs(z)))) / R);
            }
            t[0] = t[7] + (t[5] - t[7]) * x * (@M@_B + harder * bend);
        }
    }
    if (back || t[8] * (u1 - t[9]) > 0) {
        t[9] = u1;
        t[10] = t[0];
    }
    for (k = 0; k < 11; k++)
        next[k] = t[k];
}

static void @f@_init(double *s, double u0)
{
    const double ey = @M@_FY / @M@_E, rest = @M@_SIGINIT / @M@_E;
    const double start[11] = {@M@_SIGINIT, ey, -ey, 0, ey, @M@_FY, 0, 0, 0, rest, @M@_SIGINIT};
    @f@_move(start, rest, u0 + rest, s);
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double to[11];
    int k;
    (void)dt;
    @f@_move(s, u0 + @M@_SIGINIT / @M@_E, u1 + @M@_SIGINIT / @M@_E, to);
    if (next)
        for (k = 0; k < 11; k++)
            next[k] = to[k];
    return @M@_OFFSET + to[0];
}
