/* Mass, damper and Bouc-Wen spring, Runge-Kutta of fourth order. State: displacement, velocity, z, 1 once the first sample is read. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = s[1] = s[2] = s[3] = 0;
}

static void @f@_slope(const double *q, double force, double *rate)
{
    const double kz = (1 - @M@_A) * @M@_K, share = 0.5 * (@M@_R_LOAD + @M@_R_UNL), skew = 0.5 * (@M@_R_LOAD - @M@_R_UNL);
    const double size = @M@_N == 1.0 ? fabs(q[2]) / @M@_Z : pow(fabs(q[2]) / @M@_Z, @M@_N);
    const double sign = q[2] > 0 ? 1.0 : q[2] < 0 ? -1.0 : 0.0;
    rate[0] = q[1];
    rate[1] = (force - @M@_C * q[1] - @M@_A * @M@_K * q[0] - q[2]) / @M@_M;
    rate[2] = kz * (q[1] - (share * fabs(q[1]) * sign + skew * q[1]) * size);
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double h = dt * s[3] / @M@_SUBSTEPS, rise = @M@_HOLD ? 0.0 : u1 - u0;
    double q[3] = {s[0], s[1], s[2]};
    for (int i = 0; i < @M@_SUBSTEPS; i++) {
        double rate[3] = {0, 0, 0}, total[3] = {0, 0, 0}, moved[3];
        for (int stage = 0; stage < 4; stage++) {
            for (int j = 0; j < 3; j++)
                moved[j] = q[j] + at[stage] * h * rate[j];
            @f@_slope(moved, u0 + rise * (i + at[stage]) / @M@_SUBSTEPS, rate);
            for (int j = 0; j < 3; j++)
                total[j] += weight[stage] * rate[j];
        }
        for (int j = 0; j < 3; j++)
            q[j] += h * total[j];
    }
    if (next) {
        next[0] = q[0];
        next[1] = q[1];
        next[2] = q[2];
        next[3] = 1;
    }
    return @M@_OFFSET + q[0];
}
