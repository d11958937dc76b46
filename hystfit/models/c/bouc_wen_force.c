/* Force of a yielding element: dw/du = rho (1 - (sigma sgn(w du) + 1 - sigma) |w|^n), y = offset + kappa_x u + kappa_w w. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = @M@_W0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double sign = u1 < u0 ? -1.0 : 1.0, half = 0.5 * @M@_RHO * fabs(u1 - u0) / @M@_SUBSTEPS;
    double q = sign * s[0];
    int k;
    (void)dt;
    for (k = 0; k < @M@_SUBSTEPS; k++) {
        const double kappa = half * (q >= 0 ? 1.0 : 2 * @M@_SIGMA - 1) * pow(fabs(q), @M@_N - 1);
        q = fmin(((1 - kappa) * q + 2 * half) / (1 + kappa), 1.0);
    }
    if (next)
        next[0] = sign * q;
    return @M@_OFFSET + @M@_KAPPA_X * u1 + @M@_KAPPA_W * sign * q;
}
