/* Force of a yielding element: dw/du = rho (1 - (sigma sgn(w du) + 1 - sigma) |w|^n), y = offset + kappa_x u + kappa_w w. */
static void @f@_init(double *s, double u0)
{
    (void)u0;
    s[0] = @M@_W0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double sign = u1 < u0 ? -1.0 : 1.0, way = @M@_RHO * fabs(u1 - u0) / @M@_SUBSTEPS;
    double q = sign * s[0];
    int k;
    (void)dt;
    for (k = 0; k < @M@_SUBSTEPS; k++) {
        const double lost = (q >= 0 ? 1.0 : 2 * @M@_SIGMA - 1) * pow(fabs(q), @M@_N - 1) * q;
        const double middle = fmin(q + 0.5 * way * (1 - lost), 1.0), below = fmin(fmax(-q, 0.0), way);
        const double half = 0.5 * pow(fabs(middle), @M@_N - 1) * (way + 2 * (@M@_SIGMA - 1) * below);
        const double moved = ((1 - half) * q + way) / (1 + half);
        q = fmin(fmax(moved, fmin(q, 1.0)), fmax(q, 1.0));
    }
    if (next)
        next[0] = sign * q;
    return @M@_OFFSET + @M@_KAPPA_X * u1 + @M@_KAPPA_W * sign * q;
}
